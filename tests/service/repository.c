// SPDX-License-Identifier: MIT
// The models folder: NAME/VERSION beside files, model.json, and what becomes of models whose
// file was replaced or removed.
#include "ask.h"
#include "frames.h"

static struct daemon d;
static const char *const fast[] = {"--poll", "0.2", NULL};
static const char preview[] = "{\"size_mm\": 10, \"material\": \"marble\", \"preview\": true}";

static char keeper[64]; // two bakes, outside all folders of the daemon

static void copy_file(const char *from, const char *to)
{
    char command[1000];
    snprintf(command, sizeof command, "cp %s %s.part && mv %s.part %s", from, to, to, to);
    assert_int_equal(system(command), 0);
}

static int setup(void **state)
{
    char id[ID_SIZE], from[200], to[200];
    strcpy(keeper, "/tmp/relightd-keep-XXXXXX");
    assert_non_null(mkdtemp(keeper));
    daemon_folder(&d);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    for (unsigned i = 0; i < 2; i++) {
        struct relight_load load = small_bake(i + 1, 32);
        bake_octahedron(client, &d, "small.obj", &load, id);
        snprintf(from, sizeof from, "%s/bakes/%s.prt", d.data, id);
        snprintf(to, sizeof to, "%s/%u.prt", keeper, i);
        copy_file(from, to);
    }
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_remove(&d);
    return 0;
}

static int teardown(void **state)
{
    return nftw(keeper, remove_one, 16, FTW_DEPTH | FTW_PHYS);
}

static int fresh_folder(void **state)
{
    daemon_folder(&d);
    return 0;
}

static int after_each(void **state)
{
    int status = daemon_end(&d);
    daemon_remove(&d);
    return status;
}

static void in_models(const char *name, char path[200])
{
    snprintf(path, 200, "%s/%s", d.models, name);
}

static void make_folders(char *path)
{
    for (char *slash = path + strlen(d.models) + 1; (slash = strchr(slash, '/'));
         *slash++ = '/') {
        *slash = 0;
        mkdir(path, 0700);
        *slash = '/';
    }
}

static void put_text(const char *name, const char *text)
{
    char path[200], aside[200];
    in_models(name, path);
    make_folders(path);
    snprintf(aside, sizeof aside, "%s/aside", d.folder);
    write_text(aside, text);
    assert_int_equal(rename(aside, path), 0);
}

// The octahedron with its first vertex at x.
static void put_shape(const char *name, double x)
{
    char text[600];
    snprintf(text, sizeof text, "v %g 0 0\n%s", x, strchr(octahedron, '\n') + 1);
    put_text(name, text);
}

// One of the bakes.
static void put_bake(const char *name, unsigned which)
{
    char from[200], path[200];
    in_models(name, path);
    make_folders(path);
    snprintf(from, sizeof from, "%s/%u.prt", keeper, which);
    copy_file(from, path);
}

static void take_away(const char *name)
{
    char path[200];
    in_models(name, path);
    assert_int_equal(unlink(path), 0);
}

static int state_of(struct relight_client *client, const char *name, char id[ID_SIZE])
{
    struct relight_error error;
    struct relight_model info;
    id[0] = 0;
    if (relight_info(client, name, &info, &error)) return -1;
    int is = info.state;
    snprintf(id, ID_SIZE, "%s", info.id);
    relight_model_finish(&info);
    return is;
}

// Waits until the name stands for a model other than `before` that has this state.
static void wait_for(struct relight_client *client, const char *name, int wanted,
                     const char *before, char id[ID_SIZE])
{
    for (int i = 0; i < 6000; i++) {
        int is = state_of(client, name, id);
        if (is == wanted && (!before || strcmp(id, before))) return;
        sleep_ms(20);
    }
    fail_msg("%s: it is no other model in state %d: %s is in %d", name, wanted, id,
             state_of(client, name, id));
}

static void wait_gone(struct relight_client *client, const char *name)
{
    char id[ID_SIZE];
    for (int i = 0; i < 6000; i++) {
        if (state_of(client, name, id) < 0) return;
        sleep_ms(20);
    }
    fail_msg("%s is there still", name);
}

static struct relight_view *open_view(struct relight_client *client, const char *model,
                                      uint64_t *hash)
{
    struct relight_error error;
    struct relight_view *view;
    struct relight_frame_out frame;
    struct relight_light light = {.env = "constant"};
    struct relight_view_request open = {
        .model = model, .n_light = 1, .lights = &light, .colors = true};
    OK(relight_view_open(client, &open, &view, &error));
    OK(relight_view_next(view, 60, &frame, &error));
    assert_true(frame.has_colors);
    *hash = frame.hash;
    relight_frame_out_finish(&frame);
    OK(relight_view_set(view, 0, NULL, NULL, NULL, NULL, &error)); // shown
    return view;
}

// The view goes on with a frame of other colours.
static void view_goes_over(struct relight_view *view, uint64_t before)
{
    struct relight_error error;
    struct relight_frame_out frame;
    for (uint64_t hash = before; hash == before; relight_frame_out_finish(&frame)) {
        OK(relight_view_next(view, 60, &frame, &error));
        assert_true(frame.has_colors);
        hash = frame.hash;
    }
}

// Waits until the name stands for this model.
static void wait_same(struct relight_client *client, const char *name, const char *wanted)
{
    char id[ID_SIZE];
    for (int i = 0; i < 6000; i++) {
        if (state_of(client, name, id) >= 0 && !strcmp(id, wanted)) return;
        sleep_ms(20);
    }
    fail_msg("%s is %s, not %s", name, id, wanted);
}

// NAME is the newest version as a number, NAME/VERSION stays; a view follows the name that it
// was opened with. Two versions of one content are one model.
static void test_versions(void **state)
{
    char first[ID_SIZE], second[ID_SIZE], id[ID_SIZE];
    struct relight_error error;
    uint64_t hash, fixed_hash;
    put_bake("ball/1/a.prt", 0);
    daemon_start(&d, fast);
    struct relight_client *client = client_open(d.address), *other = client_open(d.address);
    assert_true(state_of(client, "ball/1", first) >= 0);
    wait_same(client, "ball", first);
    // The file of a version is no name.
    assert_int_equal(state_of(client, "a.prt", id), -1);
    assert_int_equal(state_of(client, "a", id), -1);
    struct relight_view *view = open_view(client, "ball", &hash);
    struct relight_view *fixed = open_view(other, "ball/1", &fixed_hash);
    put_bake("ball/2/b.prt", 1);
    view_goes_over(view, hash);
    assert_true(state_of(client, "ball", second) >= 0);
    assert_string_not_equal(first, second);
    put_bake("ball/10/c.prt", 0);
    wait_same(client, "ball", first);
    wait_same(client, "ball/2", second);
    wait_same(client, "ball/1", first);
    take_away("ball/10/c.prt");
    wait_gone(client, "ball/10");
    wait_same(client, "ball", second);
    wait_same(client, "ball/1", first);
    take_away("ball/2/b.prt");
    wait_gone(client, "ball/2");
    wait_same(client, "ball", first);
    // The one that was opened as ball/1 has the same colours still.
    struct relight_frame_out frame;
    while (!relight_view_next(fixed, 0.3, &frame, &error)) {
        assert_true(frame.has_colors && frame.hash == fixed_hash);
        relight_frame_out_finish(&frame);
    }
    OK(relight_view_close(fixed, NULL, NULL, &error));
    OK(relight_view_close(view, NULL, NULL, &error));
    wait_gone(client, second); // nobody uses it any more
    relight_close(client);
    relight_close(other);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, fast);
    client = client_open(d.address);
    assert_true(state_of(client, "ball", id) >= 0);
    assert_string_equal(id, first);
    relight_close(client);
}

static unsigned listed(struct relight_client *client, const char *name)
{
    struct relight_error error;
    struct relight_list list;
    unsigned n = 0;
    OK(relight_list(client, false, &list, &error));
    for (size_t i = 0; i < list.n_model; i++) n += !strcmp(list.model[i].name, name);
    relight_list_finish(&list);
    return n;
}

// A client that follows the events of one model alone.
static struct frames *follow_model(const char *id)
{
    Relight__SubscribeRequest in = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    struct frames *f = frames_open(&d);
    in.model = (char *)id;
    frames_add(f, RELIGHT_TYPE_SUBSCRIBE, 2, &in.base, NULL, 0);
    frames_send(f);
    return f;
}

// It is told by which model its own was replaced, and of no other model.
static void expect_successor(struct frames *f, const char *first, const char *second)
{
    struct frames_answer a;
    for (bool told = false; !told;) {
        ProtobufCMessage *m = NULL;
        if (!frames_next(f, &a, 20000, &m)) fail_msg("no event of the replacement");
        assert_int_equal(a.type, RELIGHT_TYPE_SUBSCRIBE | RELIGHT_TYPE_ANSWER);
        const Relight__Event *e = (const Relight__Event *)m;
        told = e->kind == RELIGHT__EVENT_KIND__EVENT_MODEL_REPLACED;
        if (told) assert_string_equal(e->model, second);
        if (e->kind) assert_string_equal(told ? e->before : e->model, first);
        protobuf_c_message_free_unpacked(m, NULL);
    }
    frames_close(f);
}

// The file of a version is replaced: its name goes over, the earlier model goes.
static void test_replaced_version(void **state)
{
    char first[ID_SIZE], second[ID_SIZE], id[ID_SIZE];
    put_text("ball/1/model.json", preview);
    put_shape("ball/1/o.obj", 1);
    daemon_start(&d, fast);
    struct relight_client *client = client_open(d.address);
    wait_for(client, "ball", RELIGHT_MODEL_PREVIEW, NULL, first);
    struct frames *follower = follow_model(first);
    put_shape("ball/1/o.obj", 1.7);
    wait_for(client, "ball/1", RELIGHT_MODEL_PREVIEW, first, second);
    wait_gone(client, first);
    expect_successor(follower, first, second);
    assert_int_equal(listed(client, "ball/1"), 1);
    // Other settings are another model, too; broken ones leave the model as it is.
    put_text("ball/1/model.json", "{\"size_mm\": 20, \"preview\": true}");
    wait_for(client, "ball/1", RELIGHT_MODEL_PREVIEW, second, id);
    put_text("ball/1/model.json", "{\"size_mm\": 20, \"colour\": 1}");
    assert_true(log_says(&d, "model.json: colour", 20000));
    char same[ID_SIZE];
    assert_int_equal(state_of(client, "ball/1", same), RELIGHT_MODEL_PREVIEW);
    assert_string_equal(same, id);
    relight_close(client);
    // The same after a restart, without reading its file again.
    assert_int_equal(daemon_stop(&d), 0);
    put_text("ball/1/model.json", "{\"size_mm\": 20, \"preview\": true}");
    daemon_start(&d, fast);
    client = client_open(d.address);
    wait_same(client, "ball", id);
    assert_false(log_says(&d, "read ms", 0));
    relight_close(client);
}

// A model that a client uploaded itself stays where a version has the same content.
static void test_version_of_an_upload(void **state)
{
    char own[ID_SIZE], id[ID_SIZE];
    struct relight_error error;
    struct relight_loaded loaded;
    struct relight_load load = {
        .name = "mine", .size_mm = 10, .material = "marble", .preview = true};
    daemon_start(&d, fast);
    struct relight_client *client = client_open(d.address);
    OK(load_octahedron(client, &d, "o.obj", &load, &loaded, &error));
    snprintf(own, sizeof own, "%s", loaded.model);
    relight_loaded_finish(&loaded);
    put_text("ball/1/model.json", preview);
    put_shape("ball/1/o.obj", 1);
    wait_same(client, "ball/1", own);
    put_shape("ball/1/o.obj", 1.7); // the version has another model from here on
    wait_for(client, "ball/1", RELIGHT_MODEL_PREVIEW, own, id);
    put_text("ball/2/model.json", preview);
    put_shape("ball/2/o.obj", 1);
    wait_same(client, "ball/2", own);
    take_away("ball/2/o.obj");
    wait_gone(client, "ball/2");
    assert_int_equal(state_of(client, "mine", id), RELIGHT_MODEL_PREVIEW);
    assert_string_equal(id, own);
    assert_int_equal(listed(client, "mine"), 1);
    relight_close(client);
}

// A principal's own model hides the folder's of the same name: a view of the name shows it from
// the first frame on, and goes over to no version.
static void test_own_model_of_a_versions_name(void **state)
{
    char own[ID_SIZE], first[ID_SIZE];
    struct relight_error error;
    struct relight_load load = small_bake(3, 300);
    uint64_t hash[3];
    struct relight_view *view[3];
    put_bake("ball/1/a.prt", 0);
    daemon_start(&d, fast);
    struct relight_client *client = client_open(d.address);
    assert_true(state_of(client, "ball/1", first) >= 0);
    load.name = "ball";
    bake_octahedron(client, &d, "o.obj", &load, own);
    wait_same(client, "ball", own);
    const char *const opened[3] = {"ball", own, first};
    for (int i = 0; i < 3; i++) view[i] = open_view(client, opened[i], &hash[i]);
    assert_true(hash[0] == hash[1] && hash[0] != hash[2]);
    for (int i = 0; i < 3; i++) OK(relight_view_close(view[i], NULL, NULL, &error));
    relight_close(client);
}

// Two versions of one source are one model, which stays while one of them is there.
static void test_equal_versions(void **state)
{
    char first[ID_SIZE], second[ID_SIZE];
    for (int i = 1; i < 3; i++) {
        put_text(i == 1 ? "twin/1/model.json" : "twin/2/model.json", preview);
        put_shape(i == 1 ? "twin/1/o.obj" : "twin/2/o.obj", 3);
    }
    daemon_start(&d, fast);
    struct relight_client *client = client_open(d.address);
    wait_for(client, "twin/1", RELIGHT_MODEL_PREVIEW, NULL, first);
    wait_for(client, "twin/2", RELIGHT_MODEL_PREVIEW, NULL, second);
    assert_string_equal(first, second);
    take_away("twin/2/o.obj");
    wait_gone(client, "twin/2");
    assert_int_equal(state_of(client, "twin/1", second), RELIGHT_MODEL_PREVIEW);
    assert_string_equal(first, second);
    assert_int_equal(state_of(client, "twin", second), RELIGHT_MODEL_PREVIEW);
    assert_string_equal(first, second);
    relight_close(client);
}

// Folders that cannot be used are named in the log, and are used once they are mended.
static void test_faulty_versions(void **state)
{
    char id[ID_SIZE];
    put_text("two/1/model.json", preview);
    put_shape("two/1/a.obj", 1);
    put_shape("two/1/b.obj", 2);
    put_text("empty/1/model.json", preview);
    put_text("words/1/model.json", "size 10");
    put_shape("words/1/o.obj", 1);
    put_text("out/1/model.json", "{\"path\": \"../../../keep.obj\", \"size_mm\": 10}");
    put_text("sub/folder/o.obj", octahedron); // no version
    daemon_start(&d, fast);
    struct relight_client *client = client_open(d.address);
    assert_true(log_says(&d, "name=two/1 error=\"2 model files", 20000));
    assert_true(log_says(&d, "name=\"words/1\" error=\"model.json", 20000));
    assert_true(
        log_says(&d, "name=out/1 error=\"../../../keep.obj is not in its folder", 20000));
    put_text("two/1/model.json",
             "{\"path\": \"b.obj\", \"size_mm\": 10, \"preview\": true, \"pin\": true}");
    wait_for(client, "two", RELIGHT_MODEL_PREVIEW, NULL, id);
    assert_int_equal(state_of(client, "empty", id), -1);
    assert_int_equal(state_of(client, "sub", id), -1);
    relight_close(client);
}

// A file that was loaded by its path gets the content of an upload that is being baked, and
// then another: the bake of the upload goes on.
static void test_source_like_an_upload(void **state)
{
    char first[ID_SIZE], upload[ID_SIZE], id[ID_SIZE], line[120];
    struct relight_error error;
    struct relight_loaded loaded;
    struct relight_load load = small_bake(3, 2000000), own = load;
    put_shape("o.obj", 1.5);
    daemon_start(&d, fast);
    struct relight_client *client = client_open(d.address);
    load.path = "o.obj";
    OK(relight_load(client, &load, &loaded, &error));
    snprintf(first, sizeof first, "%s", loaded.model);
    relight_loaded_finish(&loaded);
    OK(load_octahedron(client, &d, "o.obj", &own, &loaded, &error));
    snprintf(upload, sizeof upload, "%s", loaded.model);
    relight_loaded_finish(&loaded);
    assert_string_not_equal(first, upload);
    put_text("o.obj", octahedron);
    snprintf(line, sizeof line, "load model=%s name=\"o.obj\" conn=2", upload);
    assert_true(log_says(&d, line, 20000));
    sleep_ms(1500); // the order waits for the bake
    put_shape("o.obj", 1.7);
    assert_true(log_says(&d, "name=\"o.obj\" conn=3 new", 20000));
    assert_int_equal(state_of(client, upload, id), RELIGHT_MODEL_BAKING);
    relight_close(client);
}

// A file that a client loaded by its path is replaced: it is baked again, and requests go on
// with the earlier model until then.
static void test_source_is_baked_again(void **state)
{
    char first[ID_SIZE], second[ID_SIZE];
    uint64_t hash;
    struct relight_error error;
    struct relight_loaded loaded;
    struct relight_load load = small_bake(0, 64);
    load.name = "rock";
    put_shape("stone.obj", 1);
    daemon_start(&d, fast);
    struct relight_client *client = client_open(d.address);
    load.path = "stone.obj";
    OK(relight_load(client, &load, &loaded, &error));
    OK(relight_watch(client, loaded.job, NULL, NULL, &error));
    relight_loaded_finish(&loaded);
    wait_for(client, "rock", RELIGHT_MODEL_READY, NULL, first);
    struct relight_view *view = open_view(client, "rock", &hash);
    put_text("stone.obj", "v 1 0 0\nf 1 1 7\n"); // no mesh: the bake fails
    assert_true(log_says(&d, "models folder name=", 120000));
    char id[ID_SIZE];
    assert_int_equal(state_of(client, "rock", id), RELIGHT_MODEL_READY);
    assert_string_equal(id, first);
    put_shape("stone.obj", 1.6);
    // Until the new bake is ready, the name stands for the earlier one.
    while (state_of(client, "rock", id) >= 0 && !strcmp(id, first)) sleep_ms(50);
    wait_for(client, "rock", RELIGHT_MODEL_READY, first, second);
    view_goes_over(view, hash);
    wait_gone(client, first);
    assert_int_equal(listed(client, "rock"), 1);
    OK(relight_view_close(view, NULL, NULL, &error));
    relight_close(client);
    // A restart finds it, and follows the file further.
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, fast);
    client = client_open(d.address);
    wait_same(client, "rock", second);
    assert_false(log_says(&d, " load model=", 0)); // it is known, and its file is the same
    relight_close(client);
}

// The daemon ends while a bake that is to replace a model runs: after the restart the name is
// the earlier model's until that bake has ended, and then the new one's, without a look at the
// folder.
static void test_replacement_over_a_restart(void **state)
{
    char first[ID_SIZE], second[ID_SIZE] = "", id[ID_SIZE], gate[160], prt[160], text[600];
    const char *const often[] = {"--poll", "0.2", "--prt", prt, NULL};
    const char *const seldom[] = {"--poll", "3600", "--prt", prt, NULL};
    struct relight_error error;
    struct relight_loaded loaded;
    struct relight_list list;
    struct relight_load load = small_bake(0, 64);
    load.name = "rock";
    load.path = "stone.obj";
    snprintf(gate, sizeof gate, "%s/gate", d.folder);
    snprintf(prt, sizeof prt, "%s/prt", d.folder);
    snprintf(text, sizeof text,
             "#!/bin/sh\ncase $* in bake*) while [ ! -e %s ]; do sleep 0.02; done;; esac\n"
             "exec %s/prt \"$@\"\n",
             gate, PRT_BINARY_DIR);
    write_text(prt, text);
    chmod(prt, 0700);
    write_text(gate, "");
    put_shape("stone.obj", 1);
    daemon_start(&d, often);
    struct relight_client *client = client_open(d.address);
    OK(relight_load(client, &load, &loaded, &error));
    relight_loaded_finish(&loaded);
    wait_for(client, "rock", RELIGHT_MODEL_READY, NULL, first);
    assert_int_equal(unlink(gate), 0);
    put_shape("stone.obj", 1.6);
    while (!second[0]) {
        sleep_ms(20);
        OK(relight_list(client, false, &list, &error));
        for (size_t i = 0; i < list.n_model; i++)
            if (list.model[i].state == RELIGHT_MODEL_BAKING)
                snprintf(second, sizeof second, "%s", list.model[i].id);
        relight_list_finish(&list);
    }
    assert_string_not_equal(first, second);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, seldom);
    client = client_open(d.address);
    assert_int_equal(state_of(client, "rock", id), RELIGHT_MODEL_READY);
    assert_string_equal(id, first);
    assert_int_equal(state_of(client, second, id), RELIGHT_MODEL_BAKING);
    write_text(gate, "");
    wait_same(client, "rock", second);
    wait_gone(client, first);
    relight_close(client);
}

// A pose is of the model that it was sent for: a view that goes over to a version of another
// shape shows that as its file has it.
static void test_a_pose_stays_behind(void **state)
{
    static const char tetrahedron[] = "v 0 0 0\nv 2 0 0\nv 0 2 0\nv 0 0 2\nf 1 3 2\nf 1 2 4\n"
                                      "f 1 4 3\nf 2 3 4\n";
    char id[ID_SIZE], second[ID_SIZE], pose[65], before[17];
    float moved[OCTAHEDRON_VERTICES][3];
    struct relight_error error;
    struct relight_geometry g;
    struct relight_view *view;
    struct relight_frame_out frame;
    put_text("solid/1/model.json", preview);
    put_shape("solid/1/o.obj", 1);
    daemon_start(&d, fast);
    struct relight_client *client = client_open(d.address);
    wait_for(client, "solid", RELIGHT_MODEL_PREVIEW, NULL, id);
    OK(relight_geometry(client, id, false, &g, &error));
    for (int i = 0; i < 3 * OCTAHEDRON_VERTICES; i++)
        moved[i / 3][i % 3] = 1.5f * g.position[i / 3][i % 3];
    relight_geometry_finish(&g);
    OK(relight_put_pose(client, id, NULL, 0, OCTAHEDRON_VERTICES, moved[0], NULL, false, pose,
                        &error));
    struct relight_light light = {.env = "constant"};
    struct relight_view_request open = {
        .model = "solid", .n_light = 1, .lights = &light, .pose = pose};
    open.picture.width = open.picture.height = 16;
    OK(relight_view_open(client, &open, &view, &error));
    OK(relight_view_next(view, 20, &frame, &error));
    snprintf(before, sizeof before, "%s", frame.image.mesh_hash);
    relight_frame_out_finish(&frame);
    put_text("solid/2/model.json", preview);
    put_text("solid/2/o.obj", tetrahedron);
    wait_for(client, "solid", RELIGHT_MODEL_PREVIEW, id, second);
    for (bool over = false; !over; relight_frame_out_finish(&frame)) {
        OK(relight_view_next(view, 20, &frame, &error));
        over = strcmp(frame.image.mesh_hash, before) != 0;
    }
    OK(relight_view_close(view, NULL, NULL, &error));
    relight_close(client);
}

// LIST is answered in parts of at most as many models as were asked for.
static void test_list_in_parts(void **state)
{
    Relight__ListRequest list = RELIGHT__LIST_REQUEST__INIT;
    char names[5][40], id[ID_SIZE];
    unsigned n = 0, parts = 0;
    put_text("ball/model.json", preview);
    for (int i = 0; i < 5; i++) {
        snprintf(names[i], sizeof names[i], "ball/%d/o.obj", i + 1);
        put_shape(names[i], 1 + 0.1 * i);
    }
    daemon_start(&d, fast);
    struct relight_client *client = client_open(d.address);
    for (int i = 0; i < 5; i++) {
        snprintf(names[i], sizeof names[i], "ball/%d", i + 1);
        wait_for(client, names[i], RELIGHT_MODEL_PREVIEW, NULL, id);
    }
    struct frames *f = frames_open(&d);
    list.limit = 2;
    for (uint64_t id_of = 2;; id_of++) {
        struct frames_answer a;
        ProtobufCMessage *message = NULL;
        frames_add(f, RELIGHT_TYPE_LIST, id_of, &list.base, NULL, 0);
        frames_send(f);
        assert_true(frames_next(f, &a, 20000, &message) && !a.code);
        const Relight__ListAnswer *part = (Relight__ListAnswer *)message;
        assert_true(part->n_models <= 2);
        for (size_t i = 0; i < part->n_models; i++)
            for (int k = 0; k < 5; k++) n += !strcmp(part->models[i]->name, names[k]);
        parts++;
        list.after = part->next;
        protobuf_c_message_free_unpacked(message, NULL);
        if (!list.after) break;
    }
    assert_int_equal(n, 5);
    assert_int_equal(parts, 3);
    frames_close(f);
    relight_close(client);
}

// --memory holds one model: a pinned one leaves no room for another; unpinned they take turns.
static void test_memory_and_pins(void **state)
{
    static const char *const extra[] = {"--poll", "0.2", "--memory", "130k", NULL};
    char first[ID_SIZE], second[ID_SIZE];
    struct relight_error error;
    struct relight_load load = {.path = "a.prt", .pin = true};
    struct relight_loaded loaded;
    struct relight_light light = {.env = "constant"};
    struct relight_colors_request request = {.model = "b", .n_light = 1, .lights = &light};
    float out[N_COLOR];
    put_bake("a.prt", 0);
    put_bake("b.prt", 1);
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    OK(relight_load(client, &load, &loaded, &error));
    relight_loaded_finish(&loaded);
    expect(ask_colors(client, &request, out, NULL, &error), RELIGHT_E_LIMIT, &error, "pinned");
    OK(relight_unload(client, "a", false, NULL, &error));
    OK(ask_colors(client, &request, out, NULL, &error));
    request.model = "a";
    OK(ask_colors(client, &request, out, NULL, &error));
    assert_true(metric(client, "relightd_models_bytes") <= 130 * 1024);
    assert_true(state_of(client, "a", first) == RELIGHT_MODEL_READY);
    assert_true(state_of(client, "b", second) >= 0);
    relight_close(client);
}

static struct frames *load_pinned(struct frames *f, uint64_t id, const char *path)
{
    Relight__LoadRequest load = RELIGHT__LOAD_REQUEST__INIT;
    load.path = (char *)path;
    load.pin = true;
    frames_add(f, RELIGHT_TYPE_LOAD, id, &load.base, NULL, 0);
    return f;
}

// Two models that have room alone are pinned at once: one is opened, and the other refused
// though its opening had begun to wait for room.
static void test_pins_at_once(void **state)
{
    static const char *const extra[] = {"--poll",    "0.2", "--memory", "130k",
                                        "--threads", "1",   NULL};
    put_bake("a.prt", 0);
    put_bake("b.prt", 1);
    daemon_start(&d, extra);
    struct frames *f = frames_open(&d);
    int code[2], n_ok = 0;
    frames_send(load_pinned(load_pinned(f, 2, "a.prt"), 3, "b.prt"));
    for (int i = 0; i < 2; i++) {
        struct frames_answer a;
        assert_true(frames_next(f, &a, 20000, NULL) && !a.closed);
        code[i] = a.code;
        n_ok += !a.code;
    }
    assert_int_equal(n_ok, 1);
    assert_int_equal(code[0] + code[1], RELIGHT__ERROR_CODE__ERROR_LIMIT);
    frames_close(f);
}

// A model that is open already stays so from its pinning on.
static void test_pin_of_an_open_model(void **state)
{
    static const char *const extra[] = {"--poll", "0.2", "--memory", "130k", NULL};
    char id[ID_SIZE];
    struct relight_error error;
    struct relight_load load = {.path = "a.prt"};
    struct relight_loaded loaded;
    struct relight_light light = {.env = "constant"};
    struct relight_colors_request request = {.model = "b", .n_light = 1, .lights = &light};
    float out[N_COLOR];
    put_bake("a.prt", 0);
    put_bake("b.prt", 1);
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    for (int pin = 0; pin < 2; pin++) {
        load.pin = pin;
        OK(relight_load(client, &load, &loaded, &error));
        relight_loaded_finish(&loaded);
    }
    expect(ask_colors(client, &request, out, NULL, &error), RELIGHT_E_LIMIT, &error, "pinned");
    assert_int_equal(state_of(client, "a", id), RELIGHT_MODEL_READY);
    OK(relight_unload(client, "a", false, NULL, &error));
    OK(ask_colors(client, &request, out, NULL, &error));
    relight_close(client);
}

// The state of the model of this name, as a list has it.
static int listed_state(struct relight_client *client, const char *name)
{
    struct relight_error error;
    struct relight_list list;
    int state = -1;
    OK(relight_list(client, false, &list, &error));
    for (size_t i = 0; i < list.n_model; i++)
        if (!strcmp(list.model[i].name, name)) state = list.model[i].state;
    relight_list_finish(&list);
    return state;
}

static void bake_size(unsigned which, uint64_t *bytes)
{
    char path[200];
    struct stat st;
    snprintf(path, sizeof path, "%s/%u.prt", keeper, which);
    assert_int_equal(stat(path, &st), 0);
    *bytes = (uint64_t)st.st_size;
}

// Who lists the models uses none of them: for another one's room the file goes that was unused
// longest.
static void test_listing_is_no_use(void **state)
{
    char id[ID_SIZE], memory[32];
    uint64_t size[2];
    for (unsigned i = 0; i < 2; i++) bake_size(i, &size[i]);
    snprintf(memory, sizeof memory, "%llu", (unsigned long long)(size[0] + size[1] + 1500));
    const char *const extra[] = {"--poll", "0.2", "--memory", memory, NULL};
    put_bake("a.prt", 0);
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    assert_true(state_of(client, "a", id) >= 0);
    put_bake("b.prt", 1);
    wait_for(client, "b", RELIGHT_MODEL_READY, NULL, id); // opens it
    assert_int_equal(listed_state(client, "a.prt"), RELIGHT_MODEL_READY);
    assert_int_equal(listed_state(client, "b.prt"), RELIGHT_MODEL_READY);
    put_text("ball/model.json", preview);
    put_shape("ball/1/o.obj", 1);
    wait_for(client, "ball", RELIGHT_MODEL_PREVIEW, NULL, id);
    assert_int_equal(listed_state(client, "b.prt"), RELIGHT_MODEL_READY);
    assert_int_equal(listed_state(client, "a.prt"), RELIGHT_MODEL_UNLOADED);
    relight_close(client);
}

// A new version of a file that cannot be copied for a while, as on a full disk, is taken in as
// soon as it can be.
static void test_copy_that_failed_is_made_again(void **state)
{
    char first[ID_SIZE], second[ID_SIZE], folder[200], aside[200];
    put_bake("a.prt", 0);
    daemon_start(&d, fast);
    struct relight_client *client = client_open(d.address);
    assert_true(state_of(client, "a", first) >= 0);
    snprintf(folder, sizeof folder, "%s/imports", d.data);
    snprintf(aside, sizeof aside, "%s/imports.aside", d.data);
    assert_int_equal(rename(folder, aside), 0);
    put_bake("a.prt", 1);
    assert_true(log_says(&d, "import path=a.prt error=", 20000));
    assert_int_equal(rename(aside, folder), 0);
    for (int i = 0; i < 500; i++) {
        if (state_of(client, "a", second) >= 0 && strcmp(first, second)) break;
        sleep_ms(20);
    }
    assert_true(second[0] && strcmp(first, second));
    relight_close(client);
}

// The folder cannot be read for a while: no model is lost.
static void test_folder_that_is_away(void **state)
{
    char id[ID_SIZE], aside[200];
    put_text("ball/model.json", preview);
    put_shape("ball/1/o.obj", 1);
    daemon_start(&d, fast);
    struct relight_client *client = client_open(d.address);
    wait_for(client, "ball", RELIGHT_MODEL_PREVIEW, NULL, id);
    snprintf(aside, sizeof aside, "%s.aside", d.models);
    assert_int_equal(rename(d.models, aside), 0);
    assert_true(log_says(&d, "models folder cannot be read", 20000));
    sleep_ms(1000);
    assert_int_equal(state_of(client, "ball", id), RELIGHT_MODEL_PREVIEW);
    assert_int_equal(rename(aside, d.models), 0);
    relight_close(client);
}

int main(void)
{
#define TEST(f) cmocka_unit_test_setup_teardown(f, fresh_folder, after_each)
    const struct CMUnitTest tests[] = {
        TEST(test_versions),
        TEST(test_replaced_version),
        TEST(test_a_pose_stays_behind),
        TEST(test_version_of_an_upload),
        TEST(test_own_model_of_a_versions_name),
        TEST(test_equal_versions),
        TEST(test_faulty_versions),
        TEST(test_source_like_an_upload),
        TEST(test_source_is_baked_again),
        TEST(test_replacement_over_a_restart),
        TEST(test_list_in_parts),
        TEST(test_memory_and_pins),
        TEST(test_folder_that_is_away),
        TEST(test_pins_at_once),
        TEST(test_listing_is_no_use),
        TEST(test_pin_of_an_open_model),
        TEST(test_copy_that_failed_is_made_again),
    };
#undef TEST
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("repository", tests, setup, teardown);
}
