// SPDX-License-Identifier: MIT
// Models as they come: pictures of a textured bake against the same without textures, an edit
// of one object's medium against that of all, and the import of a document of materials.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "bench.h"
#include "prt/light.h"
#include "prt/raster.h"
#include "prt/relight.h"

static int open_file(struct bench_env *env, const char *why, struct prt_file **out)
{
    if (!env->file) {
        fprintf(stderr, "%s needs --file\n", why);
        return PRT_ARG;
    }
    return prt_file_open(&env->ctx, env->file, PRT_FILE_CHECK_HEADERS, out);
}

static double cpu_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

// The least CPU time of a call of each of two things [s], by turns for the bench's time: a
// ratio that other programs on the machine disturb least.
static int compare_cpu(const struct bench_env *env, bench_fn fn, void *const arg[2],
                       double best[2])
{
    const double end = prt_time_s() + env->seconds;
    int status = fn(arg[0]);
    if (!status) status = fn(arg[1]);
    best[0] = best[1] = INFINITY;
    for (unsigned n = 0; !status && (n < 6 || prt_time_s() < end); n++) {
        const double start = cpu_s();
        status = fn(arg[n % 2]);
        best[n % 2] = fmin(best[n % 2], cpu_s() - start);
    }
    return status;
}

// ---- pictures

enum { WIDTH = 800, HEIGHT = 600, QUALITY = 90, TURNS = 4 };

// A new light each time, to a JPEG: planes at the vertices, shading, encoding.
struct picture {
    struct bench_env *env;
    const struct prt_transport *transport;
    struct prt_mesh mesh; // with its textures or without
    struct prt_visibility *visibility;
    const struct prt_cube *light;         // [TURNS]
    struct prt_specular *const *specular; // [TURNS]
    float *planes;
    uint8_t *rgb8;
    unsigned turn;
};

static int draw(void *arg)
{
    struct picture *p = arg;
    const unsigned k = p->turn++ % TURNS;
    const struct prt_context *ctx = &p->env->ctx;
    const struct prt_query query = {.term = PRT_ANSWER_TOTAL, .light = &p->light[k]};
    struct prt_image image = {0};
    struct prt_blob jpeg = {0};
    unsigned n;
    int status = prt_answer_planes(ctx, p->transport, &query, &n, p->planes);
    const struct prt_shade shade = {.n_plane = n,
                                    .planes = p->planes,
                                    .media = p->transport->media,
                                    .fresnel = true,
                                    .specular = p->specular[k],
                                    .rgb8 = p->rgb8};
    if (!status) status = prt_shade_image(ctx, p->visibility, &p->mesh, &shade, &image);
    if (!status) status = prt_encode_jpeg(ctx, p->rgb8, WIDTH, HEIGHT, QUALITY, &jpeg);
    prt_free(jpeg.bytes);
    prt_image_finish(&image);
    return status;
}

static int picture_init(struct picture *p, bool textured)
{
    const struct prt_raster raster = {WIDTH, HEIGHT, 4, PRT_RASTER_AUTO};
    struct prt_camera camera;
    p->mesh = p->transport->mesh;
    if (!textured) prt_mesh_drop_textures(&p->mesh);
    prt_camera_frame(&p->mesh, (float)WIDTH / HEIGHT, &camera);
    p->planes = prt_alloc(p->mesh.n_vertex, 16 * 3 * sizeof *p->planes);
    p->rgb8 = prt_alloc(WIDTH * HEIGHT, 3);
    if (!p->planes || !p->rgb8) return PRT_NOMEM;
    return prt_visibility_create(&p->env->ctx, &p->mesh, &camera, &raster, &p->visibility);
}

static void picture_finish(struct picture *p)
{
    prt_visibility_destroy(p->visibility);
    prt_free(p->planes);
    prt_free(p->rgb8);
}

static int picture_textured(struct bench_env *env)
{
    struct prt_file *file = NULL;
    struct prt_cube light[TURNS] = {{0}};
    struct prt_specular *specular[TURNS] = {NULL};
    struct picture pair[2] = {{0}};
    double time[2];
    int status = open_file(env, "picture_textured", &file);
    if (status) return status;
    const struct prt_transport *t = prt_file_transport(file);
    for (unsigned k = 0; k < TURNS && !status; k++) {
        status = bench_cube(t->cube, env->seed + k, &light[k]);
        if (!status) status = prt_specular_create(&env->ctx, &light[k], &specular[k]);
    }
    for (int i = 0; i < 2 && !status; i++) {
        pair[i] =
            (struct picture){.env = env, .transport = t, .light = light, .specular = specular};
        status = picture_init(&pair[i], i == 0);
    }
    if (!status) status = compare_cpu(env, draw, (void *const[2]){&pair[0], &pair[1]}, time);
    if (!status) {
        bench_begin(env, "picture_textured");
        bench_number("vertices", t->mesh.n_vertex);
        bench_number("images", t->mesh.n_image);
        bench_number("textured_cpu_ms", time[0] * 1e3);
        bench_number("untextured_cpu_ms", time[1] * 1e3);
        bench_number("ratio", time[0] / time[1]);
        bench_number("target_at_most", 1.5);
        bench_end();
    }
    for (int i = 0; i < 2; i++) picture_finish(&pair[i]);
    for (unsigned k = 0; k < TURNS; k++) {
        prt_specular_destroy(specular[k]);
        prt_cube_finish(&light[k]);
    }
    prt_file_close(file);
    return status;
}
BENCH(picture_textured,
      "a JPEG of 800x600 under a new light, --file with and without its textures",
      picture_textured)

// ---- media by object

// A new medium each time: of the first object, or of all.
struct edit {
    struct bench_env *env;
    const struct prt_transport *transport;
    struct prt_contracted_light *lit;
    struct prt_media *media;
    float (*color)[3];
    unsigned turn;
};

static int edit_once(void *arg)
{
    struct edit *e = arg;
    struct prt_material *edited = (struct prt_material *)e->media->medium;
    edited->sigma_a[1] = 0.03f + 0.001f * (float)(++e->turn % 16);
    const struct prt_query query = {
        .term = PRT_ANSWER_TOTAL, .media = *e->media, .lit = e->lit};
    return prt_answer_colors(&e->env->ctx, e->transport, &query, e->color);
}

static int edit_object(struct bench_env *env)
{
    struct prt_file *file = NULL;
    struct prt_cube cube = {0};
    struct edit pair[2] = {{0}};
    double time[2];
    int status = open_file(env, "edit_object", &file);
    if (status) return status;
    const struct prt_transport *t = prt_file_transport(file);
    const uint32_t n = t->mesh.n_object;
    const struct prt_media one = prt_media_one(&t->media.medium[0]);
    struct prt_contracted_light *lit = NULL;
    status = bench_cube(t->cube, env->seed, &cube);
    if (!status) status = prt_contracted_light_create(&env->ctx, t, &cube, &lit);
    for (int i = 0; i < 2 && !status; i++) {
        pair[i] = (struct edit){.env = env, .transport = t, .lit = lit};
        pair[i].media = prt_media_copy(i ? &one : &t->media, n);
        pair[i].color = prt_alloc(t->mesh.n_vertex, sizeof *pair[i].color);
        if (!pair[i].media || !pair[i].color) status = PRT_NOMEM;
    }
    if (!status)
        status = compare_cpu(env, edit_once, (void *const[2]){&pair[0], &pair[1]}, time);
    if (!status) {
        bench_begin(env, "edit_object");
        bench_number("vertices", t->mesh.n_vertex);
        bench_number("media", t->media.n);
        bench_number("by_object_cpu_ms", time[0] * 1e3);
        bench_number("one_medium_cpu_ms", time[1] * 1e3);
        bench_number("ratio", time[0] / time[1]);
        bench_number("target_at_most", 1.2);
        bench_end();
    }
    for (int i = 0; i < 2; i++) {
        prt_free(pair[i].media);
        prt_free(pair[i].color);
    }
    prt_contracted_light_destroy(lit);
    prt_cube_finish(&cube);
    prt_file_close(file);
    return status;
}
BENCH(edit_object,
      "an edit of one object's medium in --file, joint and of several media, against "
      "an edit of one medium of all",
      edit_object)

// ---- import

enum { MATERIALS = 20, ROOM = 1 << 16 };

struct document {
    struct bench_env *env;
    char text[ROOM];
    size_t n;
};

// Shaders by turns of both kinds, each with a graph of constants and arithmetic.
static void write_document(struct document *d)
{
    d->n = (size_t)snprintf(d->text, ROOM,
                            "<materialx version=\"1.39\" colorspace=\"lin_rec709\">");
    for (int i = 0; i < MATERIALS; i++) {
        const char *kind = i % 2 ? "standard_surface" : "open_pbr_surface";
        d->n += (size_t)snprintf(
            d->text + d->n, ROOM - d->n,
            "<nodegraph name=\"g%d\"><constant name=\"a\" type=\"color3\"><input name=\"value\" "
            "type=\"color3\" value=\".%d,.4,.2\"/></constant><multiply name=\"b\" type=\"color3\">"
            "<input name=\"in1\" type=\"color3\" nodename=\"a\"/><input name=\"in2\" type=\"float\""
            " value=\".9\"/></multiply><output name=\"out\" type=\"color3\" nodename=\"b\"/>"
            "</nodegraph><%s name=\"s%d\" type=\"surfaceshader\"><input name=\"%s\" type=\"float\" "
            "value=\"1\"/><input name=\"subsurface_color\" type=\"color3\" nodegraph=\"g%d\" "
            "output=\"out\"/></%s><surfacematerial name=\"m%d\" type=\"material\"><input "
            "name=\"surfaceshader\" type=\"surfaceshader\" nodename=\"s%d\"/></surfacematerial>",
            i, 20 + i, kind, i, i % 2 ? "subsurface" : "subsurface_weight", i, kind, i, i);
    }
    d->n += (size_t)snprintf(d->text + d->n, ROOM - d->n, "</materialx>");
}

static int import_once(void *arg)
{
    struct document *d = arg;
    struct prt_import *item;
    unsigned n;
    int status = prt_material_import(&d->env->ctx, "bench.mtlx", d->text, d->n, 0, &item, &n);
    if (status) return status;
    bool all = n == MATERIALS;
    for (unsigned i = 0; i < n; i++) all &= item[i].has_medium;
    prt_free(item);
    return all ? PRT_OK : PRT_FORMAT;
}

static int import_materials(struct bench_env *env)
{
    struct document *d = calloc(1, sizeof *d);
    struct bench_time time;
    if (!d) return PRT_NOMEM;
    d->env = env;
    write_document(d);
    int status = bench_measure(env, import_once, d, &time);
    if (!status) {
        bench_begin(env, "import_materials");
        bench_number("materials", MATERIALS);
        bench_number("bytes", (double)d->n);
        bench_number("ms", time.median * 1e3);
        bench_number("target_ms", 50);
        bench_end();
    }
    free(d);
    return status;
}
BENCH(import_materials, "20 materials of a MaterialX document to media", import_materials)
