// SPDX-License-Identifier: MIT
// The daemon at its work: a real relightd, real sockets, librelight as the client. One
// scenario a test. The model is an octahedron, so that a bake takes seconds. Above 600 lines:
// a list of scenarios, each read alone.
#include "ask.h"

#include <pthread.h>

static struct daemon d;
static char model[ID_SIZE];

static int group_setup(void **state)
{
    daemon_folder(&d);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    bake_small(client, &d, model);
    relight_close(client);
    return 0;
}

static int group_teardown(void **state)
{
    int status = daemon_end(&d);
    daemon_remove(&d);
    return status;
}

static void colors_of(struct relight_client *client, const struct relight_light *lights,
                      size_t n, bool sum, enum relight_color_format format, float *out)
{
    struct relight_error error;
    struct relight_colors_request request = {
        .model = model, .n_light = n, .lights = lights, .sum = sum, .format = format};
    OK(ask_colors(client, &request, out, NULL, &error));
}

static void test_both_sockets_answer(void **state)
{
    char address[96];
    snprintf(address, sizeof address, "tcp:%s", d.tcp);
    const char *const each[] = {d.address, address};
    for (int i = 0; i < 2; i++) {
        struct relight_client *client = client_open(each[i]);
        struct relight_error error;
        double seconds;
        OK(relight_ping(client, &seconds, &error));
        assert_true(relight_server(client)->n_preset >= 12);
        relight_close(client);
    }
}

static void test_colors_equal_prt(void **state)
{
    char command[700], path[160];
    snprintf(path, sizeof path, "%s/out.csv", d.folder);
    snprintf(command, sizeof command,
             PRT_BINARY_DIR "/prt colors %s/bakes/%s.prt --env constant:1,0.5,0.25 -q -o %s",
             d.data, model, path);
    assert_int_equal(system(command), 0);
    struct relight_client *client = client_open(d.address);
    struct relight_light light = {.env = "constant:1,0.5,0.25"};
    float got[N_COLOR], want[N_COLOR];
    colors_of(client, &light, 1, false, RELIGHT_COLOR_F32, got);
    read_csv(path, want);
    assert_close(got, want, N_COLOR, 1e-6f);
    relight_close(client);
}

// Law: under radiance 1 from everywhere E on a convex body is pi times the cosine-weighted mean
// of F_t, 0.908222 at eta 1.5 (METHODS section 1). A picture of it shows what the colours say.
static void test_irradiance(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_colors colors;
    struct relight_light light = {.env = "constant"};
    struct relight_colors_request request = {.model = model,
                                             .n_light = 1,
                                             .lights = &light,
                                             .shade = {.term = RELIGHT_TERM_IRRADIANCE}};
    OK(relight_colors(client, &request, &colors, &error));
    assert_int_equal(colors.n_vertex, OCTAHEDRON_VERTICES);
    assert_int_equal(colors.cost.engine, RELIGHT_ENGINE_REFERENCE);
    for (int i = 0; i < N_COLOR; i++)
        assert_float_equal(((const float *)colors.data)[i], 3.14159265 * 0.908222, 0.01);
    relight_colors_finish(&colors);
    request.shade.engine = RELIGHT_ENGINE_WAVELET;
    assert_int_equal(relight_colors(client, &request, &colors, &error), -RELIGHT_E_MISMATCH);
    struct relight_image image;
    struct relight_image_request picture = {
        .model = model,
        .n_light = 1,
        .lights = &light,
        .shade = {.term = RELIGHT_TERM_IRRADIANCE},
        .picture = {
            .width = 64, .height = 48, .format = RELIGHT_IMAGE_F16, .plain_background = true}};
    OK(relight_image(client, &picture, &image, &error));
    float rgb[3];
    relight_decode_f16((const uint16_t *)image.data + 3 * (24 * 64 + 32), 3, rgb);
    for (int i = 0; i < 3; i++) assert_float_equal(rgb[i], 3.14159265 * 0.908222, 0.01);
    relight_image_finish(&image);
    relight_close(client);
}

static void test_color_formats_agree(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_light light = {.env = "constant:0.5,0.4,0.3"};
    float want[N_COLOR], got[N_COLOR];
    colors_of(client, &light, 1, false, RELIGHT_COLOR_F32, want);
    static const struct {
        enum relight_color_format format;
        float tolerance;
    } each[] = {{RELIGHT_COLOR_F16, 1e-3f},
                {RELIGHT_COLOR_RGB9E5, 4e-3f},
                {RELIGHT_COLOR_SRGB8, 1e-2f}};
    for (int i = 0; i < 3; i++) {
        colors_of(client, &light, 1, false, each[i].format, got);
        for (int k = 0; k < N_COLOR; k++)
            assert_true(fabsf(got[k] - want[k]) <= each[i].tolerance);
    }
    relight_close(client);
}

// Light transport is linear: the sum over lights is the light of the sum.
static void test_lights_add(void **state)
{
    static float cube[CUBE_FLOATS];
    struct relight_client *client = client_open(d.address);
    fill_cube(cube);
    struct relight_light lights[] = {{.cube_n = 16, .cube = cube},
                                     {.env = "constant", .gain = {0.5f, 1, 2}},
                                     {.cube_n = 16, .cube = cube, .rotate_deg = 90}};
    float each[3 * N_COLOR], sum[N_COLOR];
    colors_of(client, lights, 3, false, RELIGHT_COLOR_F32, each);
    colors_of(client, lights, 3, true, RELIGHT_COLOR_F32, sum);
    for (int k = 0; k < N_COLOR; k++) {
        float want = each[k] + each[N_COLOR + k] + each[2 * N_COLOR + k];
        assert_true(fabsf(sum[k] - want) <= 1e-4f * want);
    }
    relight_close(client);
}

// Turning by 90 degrees carries what was seen along +X to -Z, where vertex 5 is.
static void test_rotation_turns_the_light(void **state)
{
    static float cube[CUBE_FLOATS];
    for (int i = 0; i < 16 * 16 * 3; i++) cube[i] = 1; // the +X face
    struct relight_client *client = client_open(d.address);
    struct relight_light still = {.cube_n = 16, .cube = cube}, turned = still;
    turned.rotate_deg = 90;
    float a[N_COLOR], b[N_COLOR];
    colors_of(client, &still, 1, false, RELIGHT_COLOR_F32, a);
    colors_of(client, &turned, 1, false, RELIGHT_COLOR_F32, b);
    for (int v = 1; v < OCTAHEDRON_VERTICES; v++) assert_true(a[0] > 2 * a[3 * v]);
    for (int v = 0; v < 5; v++) assert_true(b[15] > 2 * b[3 * v]);
    relight_close(client);
}

static void test_pictures(void **state)
{
    static const struct {
        enum relight_image_format format;
        const char *magic;
        size_t n;
    } each[] = {{RELIGHT_IMAGE_JPEG, "\xff\xd8\xff", 3},
                {RELIGHT_IMAGE_PNG, "\x89PNG", 4},
                {RELIGHT_IMAGE_EXR, "\x76\x2f\x31\x01", 4}};
    struct relight_client *client = client_open(d.address);
    struct relight_light light = {.env = "constant"};
    struct relight_error error;
    for (int i = 0; i < 3; i++) {
        struct relight_image image;
        struct relight_image_request request = {
            .model = model,
            .n_light = 1,
            .lights = &light,
            .picture = {.width = 96, .height = 64, .format = each[i].format}};
        OK(relight_image(client, &request, &image, &error));
        assert_int_equal(image.width, 96);
        assert_memory_equal(image.data, each[i].magic, each[i].n);
        // Only the first picture of a camera is rasterised.
        if (i) assert_true(image.cost.raster_ms == 0);
        relight_image_finish(&image);
    }
    relight_close(client);
}

static void test_picture_shows_the_model(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_light light = {.env = "constant"};
    struct relight_error error;
    struct relight_image image;
    struct relight_image_request request = {
        .model = model,
        .n_light = 1,
        .lights = &light,
        .picture = {
            .width = 64, .height = 64, .format = RELIGHT_IMAGE_RGB8, .plain_background = true}};
    OK(relight_image(client, &request, &image, &error));
    const uint8_t *p = image.data;
    assert_int_equal(image.n_byte, 64 * 64 * 3);
    assert_int_equal(p[0], 0);
    assert_true(p[(32 * 64 + 32) * 3] > 40);
    relight_image_finish(&image);
    relight_close(client);
}

static void test_geometry_in_both_units(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_geometry own, mm;
    struct relight_error error;
    OK(relight_geometry(client, model, true, &own, &error));
    OK(relight_geometry(client, model, false, &mm, &error));
    assert_int_equal(own.n_vertex, OCTAHEDRON_VERTICES);
    assert_int_equal(own.n_triangle, 8);
    assert_true(fabsf(own.position[0][0] - 1) < 1e-5f);
    assert_true(fabs(mm.position[0][0] - mm.mm_per_unit) < 1e-4);
    assert_true(fabsf(own.normal[2][1] - 1) < 1e-4f);
    assert_int_equal(own.triangle[7][2], 5);
    relight_geometry_finish(&own);
    relight_geometry_finish(&mm);
    relight_close(client);
}

static void test_nonsense_is_refused_by_name(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_colors colors;
    struct relight_image image;
    struct relight_light light = {.env = "constant", .rotate_deg = NAN};
    struct relight_colors_request c = {.model = model, .n_light = 1, .lights = &light};
    expect(relight_colors(client, &c, &colors, &error), RELIGHT_E_OUT_OF_RANGE, &error,
           "rotate");
    light = (struct relight_light){.env = "constant", .gain = {-1, 1, 1}};
    expect(relight_colors(client, &c, &colors, &error), RELIGHT_E_OUT_OF_RANGE, &error, "gain");
    light = (struct relight_light){.env = "constant:1,nan,1"};
    expect(relight_colors(client, &c, &colors, &error), RELIGHT_E_OUT_OF_RANGE, &error, NULL);
    light = (struct relight_light){.env = "/etc/passwd"};
    expect(relight_colors(client, &c, &colors, &error), RELIGHT_E_BAD_REQUEST, &error, NULL);
    light = (struct relight_light){.env = "constant"};
    c.shade.material = "skin1";
    expect(relight_colors(client, &c, &colors, &error), RELIGHT_E_MISMATCH, &error, "material");
    c.shade.material = "{\"sigma_s_prime\":[1,1,1],\"sigma_a\":[-1,0,0]}";
    expect(relight_colors(client, &c, &colors, &error), RELIGHT_E_OUT_OF_RANGE, &error, NULL);
    c.shade.material = NULL;
    c.model = "nothing";
    expect(relight_colors(client, &c, &colors, &error), RELIGHT_E_NOT_FOUND, &error, "nothing");
    struct relight_image_request p = {.model = model,
                                      .n_light = 1,
                                      .lights = &light,
                                      .picture = {.width = 5000, .height = 10}};
    expect(relight_image(client, &p, &image, &error), RELIGHT_E_OUT_OF_RANGE, &error, "4096");
    p.picture = (struct relight_picture){
        .width = 8,
        .height = 8,
        .camera = {.set = true, .eye = {0, 1, 0}, .target = {0, 0, 0}}};
    expect(relight_image(client, &p, &image, &error), RELIGHT_E_OUT_OF_RANGE, &error, "line");
    for (int i = 0; i < 3; i++) { // each of its vectors has a range
        static const char *const name[3] = {"picture.camera.eye", "picture.camera.target",
                                            "picture.camera.up"};
        p.picture.camera =
            (struct relight_camera){.set = true, .eye = {0, 0, 5}, .up = {0, 1, 0}};
        float *const vector[3] = {p.picture.camera.eye, p.picture.camera.target,
                                  p.picture.camera.up};
        vector[i][1] = 2e9f;
        expect(relight_image(client, &p, &image, &error), RELIGHT_E_OUT_OF_RANGE, &error,
               name[i]);
        assert_string_equal(error.parameter, name[i]);
    }
    struct relight_load load = {.path = "../../etc/passwd", .material = "marble"};
    struct relight_loaded loaded;
    expect(relight_load(client, &load, &loaded, &error), RELIGHT_E_FORBIDDEN, &error, NULL);
    relight_close(client);
}

static void test_wrong_hash_is_refused(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_light light = {
        .env = "env:0000000000000000000000000000000000000000000000000000000000000000"};
    struct relight_colors_request c = {.model = model, .n_light = 1, .lights = &light};
    struct relight_colors colors;
    expect(relight_colors(client, &c, &colors, &error), RELIGHT_E_NOT_FOUND, &error, NULL);
    relight_close(client);
}

static void test_uploaded_environment(void **state)
{
    // Radiance, 4 x 2 pixels of (1,1,1), not run-length coded.
    char hdr[128] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n";
    size_t n = strlen(hdr);
    for (int i = 0; i < 8; i++) memcpy(hdr + n + 4 * i, "\x80\x80\x80\x81", 4);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    char hash[65], env[80];
    OK(relight_upload(client, "white.hdr", hdr, n + 32, NULL, NULL, hash, NULL, &error));
    snprintf(env, sizeof env, "env:%s", hash);
    struct relight_light light = {.env = env}, white = {.env = "constant"};
    float a[N_COLOR], b[N_COLOR];
    colors_of(client, &light, 1, false, RELIGHT_COLOR_F32, a);
    colors_of(client, &white, 1, false, RELIGHT_COLOR_F32, b);
    for (int k = 0; k < N_COLOR; k++) assert_true(fabsf(a[k] - b[k]) <= 2e-3f * b[k]);
    relight_close(client);
}

static void test_broken_environment_hurts_nobody(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    char hash[65], env[80];
    const char bytes[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 200 +X 400\nshort";
    OK(relight_upload(client, "cut.hdr", bytes, sizeof bytes, NULL, NULL, hash, NULL, &error));
    snprintf(env, sizeof env, "env:%s", hash);
    struct relight_light light = {.env = env};
    struct relight_colors_request c = {.model = model, .n_light = 1, .lights = &light};
    struct relight_colors colors;
    int status = relight_colors(client, &c, &colors, &error);
    assert_true(status == -RELIGHT_E_FORMAT);
    double seconds;
    OK(relight_ping(client, &seconds, &error));
    relight_close(client);
}

static void test_broken_model_fails_its_job_only(void **state)
{
    char path[160];
    snprintf(path, sizeof path, "%s/bad.obj", d.folder);
    write_text(path, "v 0 0 0\nv 1 0 0\nf 1 2 9\n");
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_loaded loaded;
    struct relight_load load = {.size_mm = 10, .material = "marble"};
    OK(relight_load_file(client, path, &load, NULL, NULL, &loaded, &error));
    expect(relight_watch(client, loaded.job, NULL, NULL, &error), RELIGHT_E_JOB_FAILED, &error,
           "bad.obj");
    struct relight_model info;
    OK(relight_info(client, loaded.model, &info, &error));
    assert_int_equal(info.state, RELIGHT_MODEL_FAILED);
    relight_model_finish(&info);
    relight_loaded_finish(&loaded);
    relight_close(client);
}

// The pid of the bake that runs, from /proc: a child of the daemon whose program is prt.
static pid_t bake_pid(void)
{
    for (int tries = 0; tries < 500; tries++) {
        char command[200], line[32] = "";
        snprintf(command, sizeof command,
                 "for p in /proc/[0-9]*; do read -r _ n _ pp _ < $p/stat 2>/dev/null && "
                 "[ \"$n $pp\" = \"(prt) %d\" ] && echo ${p#/proc/}; done",
                 (int)d.pid);
        FILE *pipe = popen(command, "r");
        if (fgets(line, sizeof line, pipe)) line[31] = 0;
        pclose(pipe);
        if (atoi(line) > 0) return atoi(line);
        sleep_ms(20);
    }
    return 0;
}

static void test_killed_bake_fails_and_others_go_on(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_loaded loaded;
    OK(load_small(client, &d, "killed.obj", 7, 3000000, &loaded, &error));
    pid_t pid = bake_pid();
    assert_true(pid > 0);
    struct relight_light light = {.env = "constant:0.1,0.2,0.3"};
    float out[N_COLOR];
    colors_of(client, &light, 1, false, RELIGHT_COLOR_F32, out); // while it bakes
    kill(pid, SIGKILL);
    expect(relight_watch(client, loaded.job, NULL, NULL, &error), RELIGHT_E_JOB_FAILED, &error,
           "killed");
    light.env = "constant:0.3,0.2,0.1";
    colors_of(client, &light, 1, false, RELIGHT_COLOR_F32, out);
    relight_loaded_finish(&loaded);
    relight_close(client);
}

static void test_cancelled_bake(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_loaded loaded;
    enum relight_job_state job;
    OK(load_small(client, &d, "cancelled.obj", 8, 3000000, &loaded, &error));
    assert_true(bake_pid() > 0);
    struct relight_light light = {.env = "constant"};
    struct relight_colors_request c = {.model = loaded.model, .n_light = 1, .lights = &light};
    struct relight_colors colors;
    expect(relight_colors(client, &c, &colors, &error), RELIGHT_E_NOT_READY, &error, "bakes");
    OK(relight_cancel_job(client, loaded.job, &job, &error));
    expect(relight_watch(client, loaded.job, NULL, NULL, &error), RELIGHT_E_CANCELLED, &error,
           NULL);
    relight_loaded_finish(&loaded);
    relight_close(client);
}

static void test_load_again_is_ready_at_once(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_loaded loaded;
    OK(load_small(client, &d, "same.obj", 0, 200, &loaded, &error));
    assert_string_equal(loaded.model, model); // another name, the same content
    assert_int_equal(loaded.state, RELIGHT_MODEL_READY);
    relight_loaded_finish(&loaded);
    relight_close(client);
}

static void test_unload_and_return(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_list list;
    uint64_t freed;
    float out[N_COLOR];
    struct relight_light light = {.env = "constant:0.7,0.7,0.7"};
    colors_of(client, &light, 1, false, RELIGHT_COLOR_F32, out);
    OK(relight_unload(client, model, false, &freed, &error));
    assert_true(freed > 0);
    OK(relight_list(client, true, &list, &error));
    for (size_t i = 0; i < list.n_model; i++)
        if (!strcmp(list.model[i].id, model))
            assert_int_equal(list.model[i].state, RELIGHT_MODEL_UNLOADED);
    relight_list_finish(&list);
    light.env = "constant:0.8,0.7,0.7";
    colors_of(client, &light, 1, false, RELIGHT_COLOR_F32, out);
    relight_close(client);
}

static void test_prt_in_models_folder(void **state)
{
    char command[400];
    snprintf(command, sizeof command, "cp %s/bakes/%s.prt %s/placed.prt", d.data, model,
             d.models);
    assert_int_equal(system(command), 0);
    sleep_ms(1100); // the folder is looked at once a second at most
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_model info;
    OK(relight_info(client, "placed", &info, &error));
    assert_int_equal(info.state, RELIGHT_MODEL_READY);
    assert_int_equal(info.n_vertex, OCTAHEDRON_VERTICES);
    relight_model_finish(&info);
    relight_close(client);
}

// Pictures that take seconds leave a worker to the others: colours are there before the first
// of them. How long those take is no part of that.
static void test_large_pictures_leave_room(void **state)
{
    enum { N = 3 };
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    uint64_t id[N];
    struct relight_light light = {.env = "constant"};
    for (int i = 0; i < N; i++) {
        struct relight_image_request request = {.model = model,
                                                .n_light = 1,
                                                .lights = &light,
                                                .picture = {.width = 2200,
                                                            .height = 2100 + (uint32_t)i,
                                                            .format = RELIGHT_IMAGE_PNG}};
        OK(relight_image_begin(client, &request, 0, &id[i], &error));
    }
    float out[N_COLOR];
    light.env = "constant:0.11,0.22,0.33";
    colors_of(client, &light, 1, false, RELIGHT_COLOR_F32, out);
    double open = metric(client, "relightd_requests_open");
    assert_true(open >= N + 1); // the pictures, and this question
    for (int i = 0; i < N; i++) OK(relight_cancel(client, id[i], &error));
    for (int i = 0; i < N; i++) {
        struct relight_image image;
        int status = relight_image_end(client, id[i], &image, &error);
        if (status) assert_int_equal(error.code, RELIGHT_E_CANCELLED);
        else relight_image_finish(&image);
    }
    relight_close(client);
}

// Requests that come while a pass runs share the next one.
static void test_waiting_requests_share_a_pass(void **state)
{
    enum { N = 24 };
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    uint64_t id[N];
    double before = metric(client, "relightd_passes_total");
    for (int i = 0; i < N; i++) {
        char env[40];
        snprintf(env, sizeof env, "constant:%d,1,2", i + 100);
        struct relight_light light = {.env = env};
        struct relight_colors_request c = {.model = model, .n_light = 1, .lights = &light};
        OK(relight_colors_begin(client, &c, 0, &id[i], &error));
    }
    float last = 0;
    for (int i = 0; i < N; i++) {
        struct relight_colors colors;
        float out[N_COLOR];
        OK(relight_colors_end(client, id[i], &colors, &error));
        OK(relight_colors_decode(&colors, 0, out));
        assert_true(out[0] > last); // each answer is its own light's
        last = out[0];
        relight_colors_finish(&colors);
    }
    assert_true(metric(client, "relightd_passes_total") - before <= N);
    relight_close(client);
}

// Equal requests at the same time are computed once.
static void test_equal_requests_are_computed_once(void **state)
{
    enum { N = 16 };
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    uint64_t id[N];
    double before = metric(client, "relightd_relights_total");
    struct relight_light light = {.env = "constant:0.123,0.5,0.5"};
    struct relight_colors_request c = {.model = model, .n_light = 1, .lights = &light};
    for (int i = 0; i < N; i++) OK(relight_colors_begin(client, &c, 0, &id[i], &error));
    for (int i = 0; i < N; i++) {
        struct relight_colors colors;
        OK(relight_colors_end(client, id[i], &colors, &error));
        relight_colors_finish(&colors);
    }
    assert_true(metric(client, "relightd_relights_total") - before == 1);
    relight_close(client);
}

static void test_view_draws_the_last_state(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_view *view;
    struct relight_light light = {.env = "constant:1,1,1"};
    struct relight_view_request request = {
        .model = model, .n_light = 1, .lights = &light, .colors = true};
    OK(relight_view_open(client, &request, &view, &error));
    uint64_t sequence = 0, seen = 0;
    for (int i = 1; i <= 50; i++) {
        char env[40];
        snprintf(env, sizeof env, "constant:%d,1,1", i);
        light.env = env;
        OK(relight_view_set(view, 1, &light, NULL, NULL, &sequence, &error));
    }
    float out[N_COLOR] = {0}, want[N_COLOR];
    while (seen < sequence) {
        struct relight_frame_out frame;
        OK(relight_view_next(view, 20, &frame, &error));
        assert_true(frame.has_colors);
        assert_true(frame.sequence >= seen);
        seen = frame.sequence;
        OK(relight_colors_decode(&frame.colors, 0, out));
        relight_frame_out_finish(&frame);
    }
    light.env = "constant:50,1,1";
    colors_of(client, &light, 1, false, RELIGHT_COLOR_F32, want);
    assert_close(out, want, N_COLOR, 1e-5f);
    uint64_t frames, dropped;
    OK(relight_view_close(view, &frames, &dropped, &error));
    assert_true(frames >= 1 && frames <= 51);
    relight_close(client);
}

struct crowd {
    pthread_t thread;
    int number, failed;
};

static void *crowd_member(void *arg)
{
    struct crowd *c = arg;
    struct relight_error error;
    struct relight_client *client = NULL;
    char env[40], address[96];
    snprintf(address, sizeof address, "tcp:%s", d.tcp);
    if (relight_connect(c->number % 2 ? d.address : address, NULL, &client, &error)) {
        c->failed = 1000;
        return NULL;
    }
    for (int i = 0; i < 20; i++) {
        snprintf(env, sizeof env, "constant:%d,%d,1", c->number + 1, i + 1);
        struct relight_light light = {.env = env};
        struct relight_colors_request request = {
            .model = model, .n_light = 1, .lights = &light};
        struct relight_colors colors;
        if (relight_colors(client, &request, &colors, &error)) {
            c->failed++;
            continue;
        }
        const float *rgb = colors.data; // a convex body: red to green as in the light
        if (fabsf(rgb[0] / rgb[1] * (float)(i + 1) / (float)(c->number + 1) - 1) > 0.2f)
            c->failed++;
        relight_colors_finish(&colors);
    }
    relight_close(client);
    return NULL;
}

static void test_fifty_clients(void **state)
{
    enum { N = 50 };
    static struct crowd crowd[N];
    for (int i = 0; i < N; i++) {
        crowd[i] = (struct crowd){.number = i};
        assert_int_equal(pthread_create(&crowd[i].thread, NULL, crowd_member, &crowd[i]), 0);
    }
    for (int i = 0; i < N; i++) {
        pthread_join(crowd[i].thread, NULL);
        assert_int_equal(crowd[i].failed, 0);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_both_sockets_answer),
        cmocka_unit_test(test_colors_equal_prt),
        cmocka_unit_test(test_irradiance),
        cmocka_unit_test(test_color_formats_agree),
        cmocka_unit_test(test_lights_add),
        cmocka_unit_test(test_rotation_turns_the_light),
        cmocka_unit_test(test_pictures),
        cmocka_unit_test(test_picture_shows_the_model),
        cmocka_unit_test(test_geometry_in_both_units),
        cmocka_unit_test(test_nonsense_is_refused_by_name),
        cmocka_unit_test(test_wrong_hash_is_refused),
        cmocka_unit_test(test_uploaded_environment),
        cmocka_unit_test(test_broken_environment_hurts_nobody),
        cmocka_unit_test(test_broken_model_fails_its_job_only),
        cmocka_unit_test(test_killed_bake_fails_and_others_go_on),
        cmocka_unit_test(test_cancelled_bake),
        cmocka_unit_test(test_load_again_is_ready_at_once),
        cmocka_unit_test(test_unload_and_return),
        cmocka_unit_test(test_prt_in_models_folder),
        cmocka_unit_test(test_large_pictures_leave_room),
        cmocka_unit_test(test_waiting_requests_share_a_pass),
        cmocka_unit_test(test_equal_requests_are_computed_once),
        cmocka_unit_test(test_view_draws_the_last_state),
        cmocka_unit_test(test_fifty_clients),
    };
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("service", tests, group_setup, group_teardown);
}
