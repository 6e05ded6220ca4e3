// SPDX-License-Identifier: MIT
// What the tests of pictures without a bake share.
#include "ball.h"

struct daemon d;
struct relight_client *client;
struct relight_error error;
char ball[ID_SIZE];
const struct relight_light white = {.env = "constant"};
static float cube_texel[6 * CUBE * CUBE * 3];

void write_ball(const char *path, float stretch)
{
    FILE *f = fopen(path, "w");
    assert_non_null(f);
    fprintf(f, "v 0 %g 0\n", (double)stretch);
    for (int i = 1; i < RINGS; i++) {
        double a = M_PI * i / RINGS;
        for (int j = 0; j < SIDES; j++) {
            double b = 2 * M_PI * j / SIDES;
            fprintf(f, "v %.7f %.7f %.7f\n", sin(a) * cos(b), cos(a) * stretch,
                    -sin(a) * sin(b));
        }
    }
    fprintf(f, "v 0 %g 0\n", -(double)stretch);
    for (int j = 0; j < SIDES; j++) {
        int k = (j + 1) % SIDES, south = N_VERTEX - 1 - SIDES;
        fprintf(f, "f 1 %d %d\n", 2 + j, 2 + k);
        for (int i = 0; i < RINGS - 2; i++) {
            int a = 2 + i * SIDES + j, b = 2 + i * SIDES + k;
            fprintf(f, "f %d %d %d\nf %d %d %d\n", a, a + SIDES, b, b, a + SIDES, b + SIDES);
        }
        fprintf(f, "f %d %d %d\n", N_VERTEX, 1 + south + k, 1 + south + j);
    }
    fclose(f);
}

struct relight_load small_load(bool preview)
{
    return (struct relight_load){.size_mm = 20,
                                 .material = "skin1",
                                 .preview = preview,
                                 .bake = {.samples = 1500, .cube = 16, .no_single = true}};
}

int load_ball(const char *name, struct relight_load load, struct relight_loaded *out)
{
    char path[160];
    snprintf(path, sizeof path, "%s/%s", d.folder, name);
    if (access(path, F_OK)) write_ball(path, 1);
    return relight_load_file(client, path, &load, NULL, NULL, out, &error);
}

int ball_setup(void **state)
{
    daemon_folder(&d);
    daemon_start(&d, NULL);
    client = client_open(d.address);
    struct relight_loaded loaded;
    OK(load_ball("ball.obj", small_load(true), &loaded));
    snprintf(ball, sizeof ball, "%s", loaded.model);
    assert_int_equal(loaded.state, RELIGHT_MODEL_PREVIEW);
    assert_string_equal(loaded.job, "");
    relight_loaded_finish(&loaded);
    // brighter from +x and from above
    for (int i = 0; i < 6 * CUBE * CUBE; i++)
        for (int c = 0; c < 3; c++)
            cube_texel[3 * i + c] = (i < CUBE * CUBE          ? 3
                                     : i / (CUBE * CUBE) == 2 ? 1
                                                              : 0.2f) *
                                    (c == 0 ? 1 : 0.8f);
    return 0;
}

int ball_teardown(void **state)
{
    relight_close(client);
    int status = daemon_end(&d);
    daemon_remove(&d);
    return status;
}

const struct relight_light *sun(void)
{
    static struct relight_light light = {.cube_n = CUBE};
    light.cube = cube_texel;
    return &light;
}

struct relight_image_request request_of(const char *model, enum relight_engine engine)
{
    return (struct relight_image_request){.model = model,
                                          .n_light = 1,
                                          .lights = sun(),
                                          .shade = {.engine = engine},
                                          .picture = {.width = SIDE,
                                                      .height = SIDE,
                                                      .format = RELIGHT_IMAGE_F16,
                                                      .plain_background = true,
                                                      .no_specular = true}};
}

float *pixels_of(const struct relight_image *image)
{
    size_t n = (size_t)image->width * image->height * 3;
    assert_int_equal(image->n_byte, n * 2);
    float *out = malloc(n * sizeof *out);
    assert_non_null(out);
    relight_decode_f16(image->data, n, out);
    for (size_t i = 0; i < n; i++) assert_true(isfinite(out[i]) && out[i] >= 0);
    return out;
}

// Over pixels that either picture covers.
double difference(const float *a, const float *b, size_t n)
{
    double num = 0, den = 0;
    for (size_t i = 0; i < n; i++) {
        num += ((double)a[i] - b[i]) * ((double)a[i] - b[i]);
        den += (double)b[i] * b[i];
    }
    return den > 0 ? sqrt(num / den) : num > 0 ? INFINITY : 0;
}

void expect(int status, int code, const char *word)
{
    if (status != -code || (word && !strstr(error.text, word)))
        fail_msg("%d (%s), expected %d (%s)", status, error.text, code, word ? word : "");
}

float *picture(const struct relight_image_request *r, struct relight_cost *cost)
{
    static char note[128];
    struct relight_image image;
    OK(relight_image(client, r, &image, &error));
    float *out = pixels_of(&image);
    if (cost) {
        *cost = image.cost;
        snprintf(note, sizeof note, "%s", image.cost.note);
        cost->note = note;
    }
    relight_image_finish(&image);
    return out;
}

float *exact_by(const struct relight_camera *seen, const char *file,
                const struct prt_material *material, struct prt_screen_options options)
{
    struct prt_context ctx;
    struct prt_mesh *mesh;
    struct prt_visibility *vis;
    struct prt_screen *screen;
    struct prt_cube cube;
    struct prt_image image;
    char path[160];
    snprintf(path, sizeof path, "%s/%s", d.folder, file);
    prt_context_init(&ctx);
    assert_int_equal(prt_mesh_load(&ctx, path, NULL, &mesh), 0);
    assert_int_equal(prt_mesh_scale(&ctx, mesh, 20, 0), 0);
    struct prt_camera camera = {.fovy_deg = seen->fovy_deg};
    memcpy(camera.eye, seen->eye, sizeof camera.eye);
    memcpy(camera.target, seen->target, sizeof camera.target);
    memcpy(camera.up, seen->up, sizeof camera.up);
    assert_int_equal(prt_visibility_create(&ctx, mesh, &camera,
                                           &(struct prt_raster){SIDE, SIDE, 4, PRT_RASTER_AUTO},
                                           &vis),
                     0);
    struct prt_env env = {.kind = PRT_ENV_CUBE, .cube = {CUBE, cube_texel}};
    assert_int_equal(prt_env_to_cube(&ctx, &env, 32, 0, &cube), 0);
    assert_int_equal(prt_screen_create(&ctx, mesh, NULL, &screen), 0);
    options.engine = PRT_SCREEN_REFERENCE;
    options.n_sample = 65536;
    const struct prt_media media = prt_media_one(material);
    struct prt_shade shade = {.media = media, .fresnel = true};
    struct prt_screen_input input = {.visibility = vis, .media = media, .cube = &cube};
    assert_int_equal(prt_screen_image(&ctx, screen, &input, &options, &shade, &image, NULL), 0);
    float *out = malloc((size_t)SIDE * SIDE * 12);
    assert_non_null(out);
    memcpy(out, image.rgb, (size_t)SIDE * SIDE * 12);
    prt_image_finish(&image);
    prt_cube_finish(&cube);
    prt_screen_destroy(screen);
    prt_visibility_destroy(vis);
    prt_mesh_destroy(mesh);
    return out;
}

float *exact_picture(const struct relight_camera *seen)
{
    struct prt_context ctx;
    struct prt_material material;
    prt_context_init(&ctx);
    assert_int_equal(prt_material_load(&ctx, "skin1", &material), 0);
    return exact_by(seen, "ball.obj", &material, (struct prt_screen_options){0});
}

// The next picture of a view; frame->image is the caller's.
void next_frame(struct relight_view *view, struct relight_frame_out *frame)
{
    OK(relight_view_next(view, 600, frame, &error)); // the test has its own time
    assert_true(frame->has_image);
}

struct relight_view *open_view(const char *model, enum relight_engine engine)
{
    struct relight_image_request r = request_of(model, engine);
    struct relight_view_request v = {.model = model,
                                     .n_light = 1,
                                     .lights = r.lights,
                                     .shade = r.shade,
                                     .picture = r.picture};
    struct relight_view *view;
    OK(relight_view_open(client, &v, &view, &error));
    return view;
}
