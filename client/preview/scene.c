// SPDX-License-Identifier: MIT
// Fetches the model: geometry as a mesh for the raster room, environments, and colours under a
// light.
#include "preview.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int fail(const char *text)
{
    fprintf(stderr, "relight-preview: %s\n", text);
    return EXIT_FAILED;
}

// Blocks of the answer, checked: the raster room trusts its mesh.
static bool put_blocks(const struct relight_geometry *g, struct prt_mesh *m)
{
    for (uint32_t i = 0; i < m->n_block; i++) {
        const struct relight_block *b = g->block + i;
        if (b->vertex_begin > g->n_vertex || b->n_vertex > g->n_vertex - b->vertex_begin ||
            b->triangle_begin > g->n_triangle ||
            b->n_triangle > g->n_triangle - b->triangle_begin)
            return false;
        m->block[i] = (struct prt_block){
            b->object, i, b->vertex_begin, b->n_vertex, b->triangle_begin, b->n_triangle};
        struct prt_surface *s = m->surface + i;
        *s = (struct prt_surface){.translucent = b->translucent, .roughness = 1, .ior = 1.5f};
        snprintf(s->name, sizeof s->name, "%s", b->surface);
        memcpy(s->base_color, b->base_color, sizeof b->base_color);
        s->base_color[3] = 1;
        if (b->object >= g->n_block) return false;
        snprintf(m->object[b->object].name, sizeof m->object[0].name, "%s", b->node);
    }
    return true;
}

static int count_objects(struct prt_mesh *m)
{
    for (uint32_t i = 0; i < m->n_block; i++)
        if (m->block[i].object >= m->n_object) m->n_object = m->block[i].object + 1;
    return EXIT_DONE;
}

static int make_mesh(struct scene *scene)
{
    const struct relight_geometry *g = &scene->geometry;
    struct prt_mesh *m = &scene->mesh;
    if (!g->n_block || !g->n_triangle || !g->normal) return fail("the model has no triangles");
    *m = (struct prt_mesh){.n_vertex = g->n_vertex,
                           .n_triangle = g->n_triangle,
                           .n_block = (uint32_t)g->n_block,
                           .n_surface = (uint32_t)g->n_block,
                           .n_weld = g->n_vertex,
                           .mm_per_unit = (float)g->mm_per_unit};
    m->position = prt_alloc(g->n_vertex, 12);
    m->normal = prt_alloc(g->n_vertex, 12);
    m->triangle = prt_alloc(g->n_triangle, 12);
    m->weld = prt_alloc(g->n_vertex, 4);
    m->block = prt_calloc(g->n_block, sizeof *m->block);
    m->surface = prt_calloc(g->n_block, sizeof *m->surface);
    m->object = prt_calloc(g->n_block, sizeof *m->object); // there are no more than blocks
    if (!m->position || !m->normal || !m->triangle || !m->weld || !m->block || !m->surface ||
        !m->object)
        return fail("not enough memory for the model");
    memcpy(m->position, g->position, 12 * (size_t)g->n_vertex);
    memcpy(m->normal, g->normal, 12 * (size_t)g->n_vertex);
    memcpy(m->triangle, g->triangle, 12 * (size_t)g->n_triangle);
    for (uint32_t i = 0; i < g->n_vertex; i++) m->weld[i] = i;
    if (!put_blocks(g, m)) return fail("the model's blocks do not fit its vertices");
    if (scene->options->no_textures) return count_objects(m);
    int status = scene_textures(scene);
    if (status) return status;
    return count_objects(m);
}

// The camera of options->camera_name.
static int find_camera(struct scene *scene, const struct relight_model *info)
{
    const struct options *o = scene->options;
    struct prt_mesh_camera list[PRT_MESH_MOST_CAMERAS];
    struct prt_mesh mesh = {.camera = list};
    if (!o->camera_name) return EXIT_DONE;
    for (size_t i = 0; i < info->n_camera && i < PRT_MESH_MOST_CAMERAS; i++) {
        const struct relight_named_camera *c = &info->camera[i];
        struct prt_mesh_camera *to = &list[mesh.n_camera++];
        *to = (struct prt_mesh_camera){.fovy_deg = c->fovy_deg};
        snprintf(to->name, sizeof to->name, "%s", c->name);
        memcpy(to->eye, c->eye, sizeof to->eye);
        memcpy(to->target, c->target, sizeof to->target);
        memcpy(to->up, c->up, sizeof to->up);
    }
    return prt_camera_named(&scene->ctx, &mesh, o->camera_name, &scene->named) ? EXIT_USAGE
                                                                               : EXIT_DONE;
}

static int read_info(struct scene *scene)
{
    struct relight_error error;
    struct relight_model info;
    if (relight_info(scene->client, scene->options->model, &info, &error))
        return report(&error);
    scene->exit_planes = info.exit_planes > 0;
    int status = find_camera(scene, &info);
    relight_model_finish(&info);
    return status;
}

static int find_sky(struct scene *scene, const char *word, struct sky *sky)
{
    struct relight_error error;
    if (relight_env_resolve(scene->client, word, NULL, NULL, sky->word, &error))
        return report(&error);
    if (!strncmp(word, "env:", 4)) return EXIT_DONE; // the daemon does not send images back
    return prt_env_load(&scene->ctx, word, &sky->env) ? EXIT_FAILED : EXIT_DONE;
}

int scene_fetch(struct scene *scene)
{
    struct relight_error error;
    const struct options *o = scene->options;
    const int failed = o->variant
                           ? relight_geometry_variant(scene->client, o->model, o->variant,
                                                      false, &scene->geometry, &error)
                           : relight_geometry_textured(scene->client, o->model, false,
                                                       &scene->geometry, &error);
    if (failed) return report(&error);
    int status = make_mesh(scene);
    if (!status) status = scene_media(scene, o->n_try ? o->attempt[0] : NULL);
    if (!status) status = read_info(scene);
    for (size_t i = 0; !status && i < o->n_env; i++)
        status = find_sky(scene, o->env[i], scene->sky + i);
    return status;
}

void scene_finish(struct scene *scene)
{
    struct prt_mesh *m = &scene->mesh;
    prt_free(m->position);
    prt_free(m->normal);
    prt_free(m->triangle);
    prt_free(m->weld);
    prt_free(m->block);
    prt_free(m->surface);
    prt_free(m->object);
    scene_media_finish(scene);
    scene_textures_finish(scene);
    for (int i = 0; i < MAX_ENV; i++)
        if (scene->sky[i].env) prt_env_destroy(scene->sky[i].env);
    relight_geometry_finish(&scene->geometry);
}

// RGB9E5 has no negative numbers, which the planes of a phase function and those of exit have.
static enum relight_color_format format_of(const struct scene *scene)
{
    const enum relight_color_format wanted = scene->options->format;
    return wanted == RELIGHT_COLOR_RGB9E5 && (scene->anisotropic || scene->exit_planes)
               ? RELIGHT_COLOR_F16
               : wanted;
}

int scene_colors_begin(struct scene *scene, const struct sky *sky, double rotate_deg,
                       struct colors_pending *pending)
{
    struct relight_error error;
    struct relight_light light = {.env = sky->word, .rotate_deg = (float)rotate_deg};
    struct relight_colors_request request = {.model = scene->options->model,
                                             .n_light = 1,
                                             .lights = &light,
                                             .shade = scene->shade,
                                             .format = format_of(scene),
                                             .phases = true,
                                             .exits = true};
    if (relight_colors_begin(scene->client, &request, 0, &pending->id, &error))
        return report(&error);
    pending->begun = true;
    return EXIT_DONE;
}

static uint32_t most(uint32_t a, uint32_t b)
{
    return a > b ? a : b;
}

// Single scattering in planes 0 to n_phase - 1, corrected for every view (METHODS §3.6).
static int correct(struct scene *scene, uint32_t n_phase, uint32_t n_plane, float *plane)
{
    const struct prt_mesh *m = &scene->mesh;
    int status = PRT_OK;
    for (uint32_t i = 0; i < m->n_block && !status; i++) {
        const struct prt_block *b = &m->block[i];
        const double eta = (double)prt_media_of(scene->media, b->object)->eta;
        status = prt_view_correct(&scene->ctx, m->n_vertex, b->vertex_begin,
                                  b->vertex_begin + b->n_vertex, (const float(*)[3])m->normal,
                                  eta, n_phase, n_plane, plane);
    }
    return status ? EXIT_FAILED : EXIT_DONE;
}

// The planes of prt_shade from the parts M, S_0, S_1, …, P_0, P_1, … of an answer.
static int make_planes(struct scene *scene, const struct relight_colors *c, struct planes *out)
{
    const size_t size = 3 * (size_t)scene->mesh.n_vertex;
    const uint32_t n_phase = c->n_part - 1 - c->n_exit;
    const uint32_t corrected = n_phase ? most(4, n_phase) : 1;
    const uint32_t n = most(corrected, c->n_exit);
    float *plane = prt_calloc((n + 1) * size + 1, sizeof *plane), *part = plane + n * size;
    prt_free(out->value);
    *out = (struct planes){n, plane};
    if (!plane) return fail("not enough memory for the colours");
    for (uint32_t k = 0; k < n_phase; k++) relight_colors_decode(c, 1 + k, plane + k * size);
    int status = n_phase ? correct(scene, n_phase, corrected, plane) : EXIT_DONE;
    for (uint32_t k = 0; k <= c->n_exit && !status; k++) { // M first
        float *to = plane + (k ? k - 1 : 0) * size;
        relight_colors_decode(c, k ? n_phase + k : 0, part);
        for (size_t i = 0; i < size; i++) to[i] += part[i];
    }
    return status;
}

int scene_colors_end(struct scene *scene, struct colors_pending *pending, struct planes *out)
{
    struct relight_error error;
    struct relight_colors colors;
    pending->begun = false;
    if (relight_colors_end(scene->client, pending->id, &colors, &error)) return report(&error);
    int status = colors.n_vertex == scene->mesh.n_vertex && colors.n_part > colors.n_exit &&
                         colors.n_part - 1 - colors.n_exit <= RELIGHT_MOST_PHASES &&
                         colors.n_exit <= RELIGHT_EXIT_PLANES
                     ? make_planes(scene, &colors, out)
                     : fail("the colours do not fit the model");
    relight_colors_finish(&colors);
    return status;
}
