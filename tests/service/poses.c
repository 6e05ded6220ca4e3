// SPDX-License-Identifier: MIT
// Poses: vertices that requests name by their content. Two people never move each other's;
// poses are charged, evicted and missed; UPDATE_VERTICES has a precondition.
#include "ask.h"
#include "frames.h"
#include "lone_daemon.h"

static char model[ID_SIZE];
enum { N = OCTAHEDRON_VERTICES };
static float file_mm[N][3];

static void begin_with_model(const char *const extra[])
{
    begin(extra);
    struct relight_client *client = client_open(d.address);
    struct relight_geometry g;
    struct relight_error error;
    bake_small(client, &d, model);
    OK(relight_geometry(client, model, false, &g, &error));
    memcpy(file_mm, g.position, sizeof file_mm);
    relight_geometry_finish(&g);
    relight_close(client);
}

static void scaled(float factor, float out[N][3])
{
    for (int i = 0; i < N; i++)
        for (int c = 0; c < 3; c++) out[i][c] = file_mm[i][c] * (c == 1 ? factor : 1);
}

static void put(struct relight_client *client, float factor, char pose[65])
{
    struct relight_error error;
    float moved[N][3];
    scaled(factor, moved);
    OK(relight_put_pose(client, model, NULL, 0, N, moved[0], NULL, false, pose, &error));
}

static float height_of(struct relight_client *client, const char *pose, uint64_t *generation)
{
    struct relight_geometry g;
    struct relight_error error;
    float most = 0;
    OK(relight_geometry_posed(client, model, pose, false, &g, &error));
    for (uint32_t i = 0; i < g.n_vertex; i++) most = fmaxf(most, g.position[i][1]);
    *generation = g.generation;
    relight_geometry_finish(&g);
    return most;
}

static int picture(struct relight_client *client, const char *pose, char hash[65],
                   struct relight_error *error)
{
    struct relight_light light = {.env = "constant:1,2,3"};
    struct relight_image image;
    struct relight_image_request request = {
        .model = model, .n_light = 1, .lights = &light, .pose = pose};
    request.picture = (struct relight_picture){
        .width = 32, .height = 32, .plain_background = true, .format = RELIGHT_IMAGE_RGB8};
    // One camera: else each picture is framed anew, and all look alike.
    request.picture.camera =
        (struct relight_camera){.set = true, .eye = {0, 1, 6}, .up = {0, 1, 0}};
    int status = relight_image(client, &request, &image, error);
    if (status) return status;
    relight_hash(image.data, image.n_byte, hash);
    if (pose) assert_non_null(strstr(image.cost.note, "vertices moved"));
    relight_image_finish(&image);
    return 0;
}

static void two_people_and_their_poses(void **state)
{
    begin_with_model(NULL);
    char address[80], mine[65], theirs[65], again[65];
    char file[65], tall[65], flat[65], now[65];
    struct relight_error error;
    uint64_t generation, first, second;
    snprintf(address, sizeof address, "tcp:%s", d.tcp);
    struct relight_client *a = client_open(d.address), *b = client_open(address);
    OK(picture(a, NULL, file, &error));
    put(a, 1.5f, mine);
    put(b, 0.5f, theirs);
    assert_true(strcmp(mine, theirs) != 0);
    OK(picture(a, mine, tall, &error));
    OK(picture(b, theirs, flat, &error));
    assert_true(strcmp(tall, flat) && strcmp(tall, file) && strcmp(flat, file));
    // Neither moved the model.
    float own = height_of(a, NULL, &generation);
    assert_int_equal(generation, 1);
    assert_float_equal(height_of(a, mine, &first), 1.5f * own, 1e-5f * own);
    assert_float_equal(height_of(b, theirs, &second), 0.5f * own, 1e-5f * own);
    assert_true(first != second && first > 1 && second > 1);
    OK(picture(b, NULL, now, &error));
    assert_string_equal(now, file);
    // The content is the address: the same vertices are the same pose, in other units, from
    // another client, as a part of another pose.
    put(b, 1.5f, again);
    assert_string_equal(again, mine);
    struct relight_geometry g;
    OK(relight_geometry_posed(a, model, mine, true, &g, &error));
    OK(relight_put_pose(b, model, theirs, 0, N, g.position[0], NULL, true, again, &error));
    OK(relight_put_pose(b, model, mine, 3, 0, NULL, NULL, true, again, &error));
    assert_string_equal(again, mine);
    relight_geometry_finish(&g);
    // Colours of a bake are of the file's shape, and say so.
    struct relight_light light = {.env = "constant"};
    struct relight_colors colors;
    struct relight_colors_request request = {
        .model = model, .n_light = 1, .lights = &light, .pose = mine};
    OK(relight_colors(a, &request, &colors, &error));
    assert_non_null(strstr(colors.cost.note, "before its vertices moved"));
    relight_colors_finish(&colors);
    // A view takes a pose, changes it and goes back.
    struct relight_view *view;
    struct relight_frame_out frame;
    struct relight_view_request open = {
        .model = model, .n_light = 1, .lights = &light, .pose = mine};
    open.picture.width = open.picture.height = 16;
    uint64_t sequence;
    OK(relight_view_open(a, &open, &view, &error));
    OK(relight_view_next(view, 20, &frame, &error));
    assert_int_equal(frame.image.generation, first);
    relight_frame_out_finish(&frame);
    for (int i = 0; i < 2; i++) {
        open.pose = i ? NULL : theirs;
        OK(relight_view_change(view, &open, 1, (const char *[]){"pose"}, &sequence, &error));
        do {
            OK(relight_view_next(view, 20, &frame, &error));
            generation = frame.image.generation;
            bool old = frame.sequence < sequence;
            relight_frame_out_finish(&frame);
            if (!old) break;
        } while (true);
        assert_int_equal(generation, i ? 1 : second);
    }
    OK(relight_view_close(view, NULL, NULL, &error));
    // Who forgets the model forgets its poses.
    OK(relight_unload(a, model, true, NULL, &error));
    relight_close(a);
    relight_close(b);
    end();
}

// A pose of a part of another one keeps the rest of it, with its normals.
static void a_part_of_a_pose(void **state)
{
    begin_with_model(NULL);
    struct relight_client *a = client_open(d.address);
    struct relight_error error;
    char base[65], part[65], whole[65];
    float moved[N][3], normal[N][3];
    scaled(2, moved);
    for (int i = 0; i < N; i++) memcpy(normal[i], (const float[3]){0, i - 2.5f, 2}, 12);
    OK(relight_put_pose(a, model, NULL, 0, N, moved[0], normal[0], false, base, &error));
    moved[4][0] += 1;
    normal[4][2] = 7;
    OK(relight_put_pose(a, model, base, 4, 1, moved[4], normal[4], false, part, &error));
    OK(relight_put_pose(a, model, NULL, 0, N, moved[0], normal[0], false, whole, &error));
    assert_string_equal(part, whole);
    assert_string_not_equal(part, base);
    relight_close(a);
    end();
}

static void poses_have_a_limit(void **state)
{
    enum { EACH = N * 24 + 500 }; // a pose costs some hundred bytes beside its vertices
    char limit[16], pose[8][65], hash[65];
    snprintf(limit, sizeof limit, "%d", 4 * EACH);
    begin_with_model((const char *const[]){"--client-poses", limit, NULL});
    struct relight_client *a = client_open(d.address);
    struct relight_error error;
    put(a, 2, pose[0]);
    // One that a view shows stays, whatever comes.
    struct relight_view *view;
    struct relight_frame_out frame;
    struct relight_light light = {.env = "constant"};
    struct relight_view_request open = {
        .model = model, .n_light = 1, .lights = &light, .pose = pose[0]};
    open.picture.width = open.picture.height = 16;
    OK(relight_view_open(a, &open, &view, &error));
    OK(relight_view_next(view, 20, &frame, &error));
    relight_frame_out_finish(&frame);
    for (int i = 1; i < 8; i++) {
        put(a, 2.0f + (float)i, pose[i]);
        OK(picture(a, pose[i], hash, &error));
    }
    OK(picture(a, pose[0], hash, &error));
    OK(picture(a, pose[7], hash, &error));
    expect(picture(a, pose[1], hash, &error), RELIGHT_E_NOT_FOUND, &error, "send it again");
    put(a, 3, pose[1]); // and it is there again, under its name
    OK(picture(a, pose[1], hash, &error));
    OK(relight_view_close(view, NULL, NULL, &error));
    relight_close(a);
    end();
    // A pose that is larger than all that a client may have.
    snprintf(limit, sizeof limit, "%d", N * 24);
    begin_with_model((const char *const[]){"--client-poses", limit, NULL});
    a = client_open(d.address);
    float moved[N][3];
    scaled(2, moved);
    expect(relight_put_pose(a, model, NULL, 0, N, moved[0], NULL, false, hash, &error),
           RELIGHT_E_LIMIT, &error, "--client-poses");
    relight_close(a);
    end();
}

static void poses_that_are_refused(void **state)
{
    begin_with_model(NULL);
    struct relight_client *a = client_open(d.address);
    struct relight_error error;
    char pose[65], hash[65], other[ID_SIZE];
    float moved[N][3], normal[N][3] = {{0}};
    scaled(2, moved);
    expect(relight_put_pose(a, "nobody", NULL, 0, N, moved[0], NULL, false, pose, &error),
           RELIGHT_E_NOT_FOUND, &error, NULL);
    expect(relight_put_pose(a, model, NULL, 1, N, moved[0], NULL, false, pose, &error),
           RELIGHT_E_OUT_OF_RANGE, &error, "first+n");
    assert_true(error.has_range && error.maximum == N);
    expect(relight_put_pose(a, model, NULL, UINT32_MAX, N, moved[0], NULL, false, pose, &error),
           RELIGHT_E_OUT_OF_RANGE, &error, "first+n");
    expect(relight_put_pose(a, model, "abc", 0, N, moved[0], NULL, false, pose, &error),
           RELIGHT_E_BAD_REQUEST, &error, "64 lower-case");
    moved[2][1] = NAN;
    expect(relight_put_pose(a, model, NULL, 0, N, moved[0], NULL, false, pose, &error),
           RELIGHT_E_OUT_OF_RANGE, &error, "vertex 2: its position");
    moved[2][1] = 1;
    normal[3][0] = INFINITY;
    expect(relight_put_pose(a, model, NULL, 0, N, moved[0], normal[0], false, pose, &error),
           RELIGHT_E_OUT_OF_RANGE, &error, "vertex 3: its normal");
    normal[3][0] = 0;
    OK(relight_put_pose(a, model, NULL, 0, N, moved[0], normal[0], false, pose, &error));
    OK(picture(a, pose, hash, &error));
    // It is this model's, not another's.
    struct relight_load load = small_bake(7, 200);
    bake_octahedron(a, &d, "other.obj", &load, other);
    struct relight_geometry g;
    expect(relight_geometry_posed(a, other, pose, false, &g, &error), RELIGHT_E_NOT_FOUND,
           &error, "send it again");
    relight_close(a);
    end();
}

static void vertices_with_a_precondition(void **state)
{
    begin_with_model(NULL);
    struct relight_client *a = client_open(d.address), *b = client_open(d.address);
    struct relight_error error;
    uint64_t seen = 0, generation = 0;
    float up[N][3];
    scaled(2, up);
    height_of(a, NULL, &seen);
    OK(relight_update_vertices_if(a, model, seen, 0, N, up[0], NULL, false, &generation,
                                  &error));
    assert_int_equal(generation, seen + 1);
    scaled(3, up);
    expect(relight_update_vertices_if(b, model, seen, 0, N, up[0], NULL, false, &generation,
                                      &error),
           RELIGHT_E_MISMATCH, &error, "others moved");
    assert_int_equal(error.generation, seen + 1);
    float now = height_of(b, NULL, &generation);
    assert_int_equal(generation, seen + 1);
    OK(relight_update_vertices_if(b, model, error.generation, 0, N, up[0], NULL, false,
                                  &generation, &error));
    assert_true(height_of(a, NULL, &generation) > now);
    relight_close(a);
    relight_close(b);
    end();
}

// INFO tells the box of the vertices as they are, before anything was drawn of them.
static void the_box_follows_the_vertices(void **state)
{
    begin_with_model(NULL);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_model before, info;
    float up[N][3];
    OK(relight_info(client, model, &before, &error));
    for (int k = 2; k <= 3; k++) {
        scaled((float)k, up);
        OK(relight_update_vertices(client, model, 0, N, up[0], NULL, false, NULL, &error));
        OK(relight_info(client, model, &info, &error));
        for (int c = 0; c < 3; c++) {
            const float factor = c == 1 ? (float)k : 1;
            assert_true(fabsf(info.box_min[c] - factor * before.box_min[c]) < 1e-4f);
            assert_true(fabsf(info.box_max[c] - factor * before.box_max[c]) < 1e-4f);
        }
        relight_model_finish(&info);
    }
    OK(relight_unload(client, model, false, NULL, &error));
    OK(relight_info(client, model, &info, &error));
    assert_true(info.box_max[1] == before.box_max[1]);
    relight_model_finish(&info);
    relight_model_finish(&before);
    relight_close(client);
    end();
}

static uint64_t add_update(struct frames *f, uint64_t id, float factor)
{
    Relight__UpdateVerticesRequest m = RELIGHT__UPDATE_VERTICES_REQUEST__INIT;
    float up[N][3];
    scaled(factor, up);
    m.model = model;
    m.n = N;
    frames_add(f, RELIGHT_TYPE_UPDATE_VERTICES, id, &m.base, up, sizeof up);
    return id;
}

// Vertices that move while a geometry is made: its generation is that of its positions.
static void a_geometry_and_its_generation(void **state)
{
    begin_with_model(NULL);
    struct frames *f = frames_open(&d);
    struct frames_answer a;
    ProtobufCMessage *m = NULL;
    uint64_t generation[3] = {0};
    float height = 0, most = 0;
    Relight__GeometryRequest geometry = RELIGHT__GEOMETRY_REQUEST__INIT;
    geometry.model = model;
    add_update(f, 11, 2);
    frames_add(f, RELIGHT_TYPE_GEOMETRY, 12, &geometry.base, NULL, 0);
    add_update(f, 13, 3);
    frames_send(f);
    for (int n = 0; n < 3; n++) {
        assert_true(frames_next(f, &a, 20000, &m));
        assert_int_equal(a.code, 0);
        assert_true(a.id >= 11 && a.id <= 13);
        if (a.id == 12) {
            const float *position = (const float *)f->decoder.frame.payload;
            for (int i = 0; i < N; i++) height = fmaxf(height, position[3 * i + 1]);
            generation[1] = ((Relight__GeometryAnswer *)m)->generation;
        } else {
            generation[a.id - 11] = ((Relight__UpdateVerticesAnswer *)m)->generation;
        }
        protobuf_c_message_free_unpacked(m, NULL);
    }
    for (int i = 0; i < N; i++) most = fmaxf(most, file_mm[i][1]);
    const bool first = fabsf(height - 2 * most) < 1e-4f;
    assert_true(first || fabsf(height - 3 * most) < 1e-4f);
    assert_int_equal(generation[1], generation[first ? 0 : 2]);
    frames_close(f);
    end();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(two_people_and_their_poses, teardown),
        cmocka_unit_test_teardown(a_part_of_a_pose, teardown),
        cmocka_unit_test_teardown(poses_have_a_limit, teardown),
        cmocka_unit_test_teardown(poses_that_are_refused, teardown),
        cmocka_unit_test_teardown(vertices_with_a_precondition, teardown),
        cmocka_unit_test_teardown(the_box_follows_the_vertices, teardown),
        cmocka_unit_test_teardown(a_geometry_and_its_generation, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
