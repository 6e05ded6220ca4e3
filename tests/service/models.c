// SPDX-License-Identifier: MIT
// The registry: files of --models and their copies, ids and names, who pays for files, and
// which of them go when there is no room. Each test has a daemon and a data folder of its own;
// the octahedron is baked once. Above 600 lines: a list of scenarios, each read alone.
#include "ask.h"
#include "frames.h"

#include <dirent.h>
#include <pthread.h>

static struct daemon d;
static char baked[160]; // a .prt, outside all folders of the daemon
static off_t baked_bytes;
static char keeper[64];

static void copy_file(const char *from, const char *to)
{
    char command[700];
    snprintf(command, sizeof command, "cp %s %s", from, to);
    assert_int_equal(system(command), 0);
}

static int setup(void **state)
{
    char id[ID_SIZE], path[200];
    struct stat st;
    strcpy(keeper, "/tmp/relightd-keep-XXXXXX");
    assert_non_null(mkdtemp(keeper));
    snprintf(baked, sizeof baked, "%s/baked.prt", keeper);
    daemon_folder(&d);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    bake_small(client, &d, id);
    relight_close(client);
    snprintf(path, sizeof path, "%s/bakes/%s.prt", d.data, id);
    copy_file(path, baked);
    assert_int_equal(stat(baked, &st), 0);
    baked_bytes = st.st_size;
    assert_int_equal(daemon_stop(&d), 0);
    daemon_remove(&d);
    return 0;
}

static int teardown(void **state)
{
    unlink(baked);
    return rmdir(keeper);
}

static int fresh_folder(void **state)
{
    daemon_folder(&d);
    return 0;
}

static int after_each(void **state)
{
    if (d.pid) kill(d.pid, SIGKILL), waitpid(d.pid, NULL, 0);
    d.pid = 0;
    daemon_remove(&d);
    return 0;
}

static struct relight_client *open_tcp(void)
{
    char address[96];
    snprintf(address, sizeof address, "tcp:%s", d.tcp);
    return client_open(address);
}

static void in_models(const char *name, char path[200])
{
    snprintf(path, 200, "%s/%s", d.models, name);
}

// The id of the model of this name, asked for until it is there or five seconds have passed.
static bool id_of(struct relight_client *client, const char *name, const char *other_than,
                  char id[ID_SIZE])
{
    struct relight_error error;
    struct relight_model info;
    for (int i = 0; i < 500; i++) {
        if (!relight_info(client, name, &info, &error)) {
            snprintf(id, ID_SIZE, "%s", info.id);
            relight_model_finish(&info);
            if (!other_than || strcmp(id, other_than)) return true;
        }
        sleep_ms(20);
    }
    return false;
}

static void ask_red(struct relight_client *client, const char *model, float red)
{
    struct relight_error error;
    char env[40];
    float out[N_COLOR];
    snprintf(env, sizeof env, "constant:%g,1,1", (double)red);
    struct relight_light light = {.env = env};
    struct relight_colors_request request = {.model = model, .n_light = 1, .lights = &light};
    OK(ask_colors(client, &request, out, NULL, &error));
    assert_true(out[0] > 0);
}

static int load_preview(struct relight_client *client, const char *name, float size_mm,
                        char id[ID_SIZE], struct relight_error *error)
{
    struct relight_load load = {
        .size_mm = size_mm, .material = "marble", .preview = true, .name = name};
    struct relight_loaded loaded;
    int status = load_octahedron(client, &d, "octahedron.obj", &load, &loaded, error);
    if (status) return status;
    snprintf(id, ID_SIZE, "%s", loaded.model);
    relight_loaded_finish(&loaded);
    return 0;
}

static void assert_known(struct relight_client *client, const char *id)
{
    struct relight_error error;
    struct relight_model info;
    OK(relight_info(client, id, &info, &error));
    relight_model_finish(&info);
}

static uint64_t bytes_in(const char *folder, const char *end, unsigned *n)
{
    char path[200];
    uint64_t bytes = 0;
    snprintf(path, sizeof path, "%s/%s", d.data, folder);
    DIR *dir = opendir(path);
    *n = 0;
    for (struct dirent *e; dir && (e = readdir(dir));) {
        struct stat st;
        size_t length = strlen(e->d_name), tail = strlen(end);
        if (e->d_name[0] == '.' || length < tail || strcmp(e->d_name + length - tail, end) ||
            fstatat(dirfd(dir), e->d_name, &st, 0))
            continue;
        bytes += (uint64_t)st.st_size;
        ++*n;
    }
    if (dir) closedir(dir);
    return bytes;
}

// ---- copies of --models

// Whatever happens to a file of --models, requests go on with the copy, until the file is gone.
static void test_original_may_be_destroyed(void **state)
{
    char path[200], id[ID_SIZE], again[ID_SIZE];
    struct relight_error error;
    struct relight_model info;
    in_models("stone.prt", path);
    copy_file(baked, path);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    ask_red(client, "stone", 1); // known at once: the folder was looked at before the start
    assert_true(id_of(client, "stone", NULL, id));
    assert_int_equal(truncate(path, 64), 0);
    for (int i = 0; i < 30; i++) { // beyond the next look at the folder
        ask_red(client, id, (float)i + 2);
        if (i % 10 == 5) OK(relight_unload(client, id, false, NULL, &error));
        sleep_ms(100);
    }
    int fd = open(path, O_WRONLY);
    char junk[4096];
    memset(junk, 0xff, sizeof junk);
    for (off_t at = 0; at < baked_bytes; at += (off_t)sizeof junk)
        assert_true(write(fd, junk, sizeof junk) > 0);
    close(fd);
    OK(relight_unload(client, id, false, NULL, &error));
    ask_red(client, "stone", 50);
    assert_int_equal(unlink(path), 0);
    ask_red(client, id, 51); // a file that is missing in one scan may be on its way
    for (int i = 0; i < 500 && !relight_info(client, "stone", &info, &error); i++) {
        relight_model_finish(&info);
        sleep_ms(20);
    }
    expect(relight_info(client, "stone", &info, &error), RELIGHT_E_NOT_FOUND, &error, NULL);
    unsigned n; // the copy stays until its room is needed
    assert_true(bytes_in("imports", "", &n) >= (uint64_t)baked_bytes);
    copy_file(baked, path);
    assert_true(id_of(client, "stone", NULL, again));
    assert_string_equal(again, id);
    ask_red(client, "stone", 52);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// Another file under a name is another model of that name; the earlier one goes.
static void test_new_version_of_a_file(void **state)
{
    char path[200], first[ID_SIZE], second[ID_SIZE], id[ID_SIZE], from[300], aside[200];
    struct relight_error error;
    struct relight_model info;
    in_models("stone.prt", path);
    in_models("stone.new", aside);
    copy_file(baked, path);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    assert_true(id_of(client, "stone", NULL, first));
    OK(load_preview(client, "other", 20, id, &error));
    snprintf(from, sizeof from, "%s/previews/%s.prt", d.data, id);
    copy_file(from, aside);
    assert_int_equal(rename(aside, path), 0);
    assert_true(id_of(client, "stone", first, second));
    for (int i = 0; i < 250 && !relight_info(client, first, &info, &error); i++) {
        relight_model_finish(&info);
        sleep_ms(20);
    }
    expect(relight_info(client, first, &info, &error), RELIGHT_E_NOT_FOUND, &error, NULL);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// A view goes over to the new version of its file without being asked to; the old one goes.
static void test_view_follows_a_new_version(void **state)
{
    char path[200], first[ID_SIZE], second[ID_SIZE], id[ID_SIZE], from[300], aside[200];
    struct relight_error error;
    struct relight_model info;
    struct relight_view *view;
    struct relight_frame_out frame;
    struct relight_light light = {.env = "constant"};
    struct relight_load other = small_bake(77, 200);
    in_models("stone.prt", path);
    in_models("stone.new", aside);
    copy_file(baked, path);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    bake_octahedron(client, &d, "second.obj", &other, id);
    assert_true(id_of(client, "stone", NULL, first));
    struct relight_view_request open = {
        .model = "stone", .n_light = 1, .lights = &light, .colors = true};
    OK(relight_view_open(client, &open, &view, &error));
    OK(relight_view_next(view, 60, &frame, &error));
    uint64_t before = frame.hash;
    relight_frame_out_finish(&frame);
    OK(relight_view_set(view, 0, NULL, NULL, NULL, NULL, &error)); // shown
    snprintf(from, sizeof from, "%s/bakes/%s.prt", d.data, id);
    copy_file(from, aside);
    assert_int_equal(rename(aside, path), 0);
    for (uint64_t hash = before; hash == before; relight_frame_out_finish(&frame)) {
        OK(relight_view_next(view, 60, &frame, &error));
        assert_true(frame.has_colors);
        hash = frame.hash;
    }
    assert_true(id_of(client, "stone", first, second));
    for (int i = 0; i < 500 && !relight_info(client, first, &info, &error); i++) {
        relight_model_finish(&info);
        sleep_ms(20);
    }
    expect(relight_info(client, first, &info, &error), RELIGHT_E_NOT_FOUND, &error, NULL);
    OK(relight_view_close(view, NULL, NULL, &error));
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// A copy that had to go is made again when its model is asked for.
static void test_copy_comes_back(void **state)
{
    char path[200];
    static const char *const extra[] = {"--disk", "8k", "--memory", "1k", NULL};
    in_models("stone.prt", path);
    copy_file(baked, path);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    ask_red(client, "stone", 1);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, extra);
    unsigned n;
    struct relight_error error;
    client = client_open(d.address);
    for (int i = 0; i < 100 && bytes_in("imports", "", &n) >= (uint64_t)baked_bytes; i++) {
        char bytes[20], hash[65]; // an upload wants room
        snprintf(bytes, sizeof bytes, "bytes %d", i);
        (void)relight_upload(client, "b", bytes, 8, NULL, NULL, hash, NULL, &error);
        sleep_ms(50);
    }
    assert_true(bytes_in("imports", "", &n) < (uint64_t)baked_bytes);
    struct relight_light light = {.env = "constant"};
    struct relight_colors_request request = {.model = "stone", .n_light = 1, .lights = &light};
    struct relight_colors colors;
    expect(relight_colors(client, &request, &colors, &error), RELIGHT_E_LIMIT, &error, "disk");
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, NULL);
    client = client_open(d.address);
    ask_red(client, "stone", 2);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// A file that was replaced by a damaged one: its LOAD says so, also after a scan has looked at
// it, and the model of the good one goes on.
static void test_damaged_replacement_is_told(void **state)
{
    char path[200], aside[200], id[ID_SIZE];
    struct relight_error error;
    struct relight_loaded loaded;
    struct relight_load load = {.path = "stone.prt"};
    in_models("stone.prt", path);
    in_models("stone.new", aside);
    copy_file(baked, path);
    copy_file(baked, aside);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    assert_true(id_of(client, "stone", NULL, id));
    OK(relight_load(client, &load, &loaded, &error));
    assert_string_equal(loaded.model, id);
    relight_loaded_finish(&loaded);
    assert_int_equal(truncate(aside, 64), 0);
    assert_int_equal(rename(aside, path), 0);
    assert_true(log_says(&d, "import path=stone.prt error", 10000));
    for (int start = 0; start < 2; start++) {
        expect(relight_load(client, &load, &loaded, &error), RELIGHT_E_FORMAT, &error,
               "damaged");
        ask_red(client, id, (float)start + 1);
        relight_close(client);
        assert_int_equal(daemon_stop(&d), 0);
        daemon_start(&d, NULL); // nor does the index take the one for the other
        client = client_open(d.address);
    }
    copy_file(baked, path);
    assert_true(id_of(client, "stone", NULL, id));
    ask_red(client, "stone", 3);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// Writes other bytes into the daemon's copy of the one file of --models.
static void damage_copy(off_t at)
{
    char path[300];
    unsigned n = 0;
    snprintf(path, sizeof path, "%s/imports", d.data);
    DIR *dir = opendir(path);
    for (struct dirent *e; (e = readdir(dir));) {
        if (strlen(e->d_name) != 64) continue;
        int fd = openat(dirfd(dir), e->d_name, O_WRONLY);
        assert_int_equal(pwrite(fd, "\xaa\x55\xaa\x55\xaa\x55\xaa\x55", 8, at), 8);
        close(fd);
        n++;
    }
    closedir(dir);
    assert_int_equal(n, 1);
}

// The daemon's copy of a good file decays on its disk: it is made again.
static void test_decayed_copy_is_made_again(void **state)
{
    char path[200];
    struct relight_error error;
    struct relight_colors colors;
    struct relight_light light = {.env = "constant:2,1,1"};
    struct relight_colors_request request = {.model = "stone", .n_light = 1, .lights = &light};
    in_models("stone.prt", path);
    copy_file(baked, path);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    ask_red(client, "stone", 1);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
    damage_copy(baked_bytes / 2); // seen by the check of all bytes, behind the request
    daemon_start(&d, NULL);
    client = client_open(d.address);
    ask_red(client, "stone", 1);
    assert_true(log_says(&d, "is damaged and was removed", 10000));
    ask_red(client, "stone", 3);
    OK(relight_unload(client, "stone", false, NULL, &error));
    damage_copy(16); // in the header: seen when it is opened
    int status = relight_colors(client, &request, &colors, &error);
    for (int i = 0; i < 100 && status == -RELIGHT_E_BUSY; i++) {
        sleep_ms(20);
        status = relight_colors(client, &request, &colors, &error);
    }
    OK(status);
    relight_colors_finish(&colors);
    ask_red(client, "stone", 4);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

static void test_links_and_paths(void **state)
{
    char path[200], folder[200], id[ID_SIZE], first[400];
    struct relight_error error;
    struct relight_model info;
    struct relight_loaded loaded;
    in_models("sub", folder);
    assert_int_equal(mkdir(folder, 0700), 0);
    in_models("sub/stone.prt", path);
    copy_file(baked, path);
    in_models("inner.prt", path);
    assert_int_equal(symlink("sub/stone.prt", path), 0);
    in_models("outside.prt", path);
    assert_int_equal(symlink(baked, path), 0);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    assert_true(id_of(client, "inner", NULL, id));
    assert_int_equal(relight_info(client, "outside", &info, &error), -RELIGHT_E_NOT_FOUND);
    struct relight_load load = {.path = "inner.prt"};
    OK(relight_load(client, &load, &loaded, &error));
    assert_string_equal(loaded.model, id);
    relight_loaded_finish(&loaded);
    // One text for what leads out and for what is not there.
    static const char *const wrong[] = {"outside.prt", "../../../../etc/passwd",
                                        "nothing.glb", "../../../../etc/nothing",
                                        "/etc/passwd", "sub"};
    for (int i = 0; i < 6; i++) {
        load.path = wrong[i];
        load.material = "marble";
        expect(relight_load(client, &load, &loaded, &error), RELIGHT_E_FORBIDDEN, &error, NULL);
        const char *text = strchr(error.text, ':');
        assert_non_null(text);
        if (i) assert_string_equal(text, first);
        else snprintf(first, sizeof first, "%s", text);
    }
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// A file's name may hold any bytes; what is shown is printable.
static void test_odd_file_names(void **state)
{
    char path[200];
    struct relight_error error;
    struct relight_list list;
    in_models("a\x1b[31m\xff.prt", path);
    FILE *to = fopen(path, "w"), *from = fopen(baked, "r");
    for (int c; (c = getc(from)) != EOF;) putc(c, to);
    fclose(from);
    fclose(to);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    OK(relight_list(client, true, &list, &error));
    assert_int_equal(list.n_model, 1);
    assert_string_equal(list.model[0].name, "a\\x1b[31m\\xff.prt");
    assert_int_equal(list.n_file, 1);
    assert_string_equal(list.file[0], "a\\x1b[31m\\xff.prt");
    relight_list_finish(&list);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// A .gltf comes with the files it refers to, whose names are per-cent coded.
static void test_gltf_with_buffers(void **state)
{
    static const float position[] = {1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1};
    static const uint16_t index[] = {0, 2, 4, 2, 1, 4, 1, 3, 4, 3, 0, 4,
                                     2, 0, 5, 1, 2, 5, 3, 1, 5, 0, 3, 5};
    char path[200], folder[200];
    in_models("parts", folder);
    assert_int_equal(mkdir(folder, 0700), 0);
    in_models("parts/a b.bin", path);
    FILE *file = fopen(path, "w");
    fwrite(position, sizeof position, 1, file);
    fwrite(index, sizeof index, 1, file);
    fclose(file);
    in_models("eight.gltf", path);
    write_text(path,
               "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],"
               "\"nodes\":[{\"mesh\":0}],\"meshes\":[{\"primitives\":[{\"attributes\":"
               "{\"POSITION\":0},\"indices\":1}]}],\"buffers\":[{\"uri\":\"parts/a%20b.bin\","
               "\"byteLength\":120}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":72},"
               "{\"buffer\":0,\"byteOffset\":72,\"byteLength\":48}],\"accessors\":["
               "{\"bufferView\":0,\"componentType\":5126,\"count\":6,\"type\":\"VEC3\","
               "\"min\":[-1,-1,-1],\"max\":[1,1,1]},"
               "{\"bufferView\":1,\"componentType\":5123,\"count\":24,\"type\":\"SCALAR\"}]}");
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_loaded loaded;
    struct relight_model info;
    struct relight_load load = {
        .path = "eight.gltf", .material = "marble", .size_mm = 10, .preview = true};
    OK(relight_load(client, &load, &loaded, &error));
    OK(relight_info(client, loaded.model, &info, &error));
    assert_int_equal(info.n_vertex, OCTAHEDRON_VERTICES);
    relight_model_finish(&info);
    relight_loaded_finish(&loaded);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

static void *load_big(void *arg)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_loaded loaded;
    struct relight_load load = {.path = arg, .material = "marble", .preview = true};
    int status = relight_load(client, &load, &loaded, &error);
    if (!status) relight_loaded_finish(&loaded);
    relight_close(client);
    return (void *)(intptr_t)status;
}

static unsigned log_count(const char *word)
{
    char *text = read_text(d.log);
    unsigned n = 0;
    for (const char *at = text; (at = strstr(at, word)); at++) n++;
    free(text);
    return n;
}

static void sparse_file(const char *name, off_t bytes)
{
    char path[200];
    in_models(name, path);
    int fd = open(path, O_CREAT | O_WRONLY, 0600);
    assert_int_equal(ftruncate(fd, bytes), 0);
    close(fd);
}

// Requests for one file share one copying, and each is answered as one that comes alone;
// without any that wait it ends.
static void test_copying_is_shared_and_ends(void **state)
{
    enum { N = 6 };
    pthread_t thread[N];
    unsigned n;
    sparse_file("big.glb", 64 << 20);
    sparse_file("huge.glb", 600 << 20);
    daemon_start(&d, NULL);
    for (int i = 0; i < N; i++)
        assert_int_equal(pthread_create(&thread[i], NULL, load_big, "big.glb"), 0);
    void *status[N];
    for (int i = 0; i < N; i++) pthread_join(thread[i], &status[i]);
    void *alone = load_big("big.glb");
    for (int i = 0; i < N; i++) assert_ptr_equal(status[i], alone);
    assert_int_equal(log_count("import path=big.glb"), 1);
    pid_t pid = fork();
    if (!pid) {
        load_big("huge.glb");
        _exit(0);
    }
    assert_true(log_says(&d, "conn=8", 5000));
    sleep_ms(100);
    kill(pid, SIGKILL);
    waitpid(pid, NULL, 0);
    struct relight_client *client = client_open(d.address);
    load_big("big.glb"); // its turn comes when the other copying has ended
    assert_int_equal(log_count("import path=huge.glb"), 0);
    assert_true(bytes_in("imports", "", &n) < 100 << 20);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// The folder is looked at by the clock, however many unknown names are asked for.
static void test_unknown_names_cost_no_scan(void **state)
{
    static const char *const extra[] = {"--log", "trace", NULL};
    struct relight_error error;
    struct relight_model info;
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    unsigned before = log_count("looked at");
    for (int i = 0; i < 40; i++) {
        assert_int_equal(relight_info(client, "nothing", &info, &error), -RELIGHT_E_NOT_FOUND);
        sleep_ms(100);
    }
    unsigned looks = log_count("looked at") - before;
    assert_true(looks >= 1 && looks <= 3);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// ---- names and ids

static void test_names_belong_to_principals(void **state)
{
    struct relight_error error;
    struct relight_model info;
    char one[ID_SIZE], same[ID_SIZE], two[ID_SIZE], id[ID_SIZE], short_id[17];
    daemon_start(&d, NULL);
    struct relight_client *local = client_open(d.address), *remote = open_tcp();
    OK(load_preview(local, "bunny", 10, one, &error));
    assert_int_equal(strlen(one), 32);
    OK(load_preview(remote, "mine", 10, same, &error));
    assert_string_equal(one, same);
    OK(relight_info(local, "bunny", &info, &error));
    assert_string_equal(info.name, "bunny"); // not renamed
    relight_model_finish(&info);
    OK(relight_info(remote, "mine", &info, &error));
    assert_string_equal(info.name, "mine");
    assert_string_equal(info.id, one);
    relight_model_finish(&info);
    // A name means one's own model first.
    OK(load_preview(remote, "bunny", 11, two, &error));
    assert_true(id_of(local, "bunny", NULL, id));
    assert_string_equal(id, one);
    assert_true(id_of(remote, "bunny", NULL, id));
    assert_string_equal(id, two);
    snprintf(short_id, sizeof short_id, "%.16s", two);
    assert_true(id_of(local, short_id, NULL, id));
    assert_string_equal(id, two);
    // Two of one's own: neither is answered, and the text lists both.
    OK(load_preview(local, "twin", 12, one, &error));
    OK(load_preview(local, "twin", 13, two, &error));
    expect(relight_info(local, "twin", &info, &error), RELIGHT_E_NOT_FOUND, &error, "2 models");
    snprintf(short_id, sizeof short_id, "%.16s", one);
    assert_non_null(strstr(error.text, short_id));
    snprintf(short_id, sizeof short_id, "%.16s", two);
    assert_non_null(strstr(error.text, short_id));
    expect(relight_info(remote, "twin", &info, &error), RELIGHT_E_NOT_FOUND, &error,
           "2 models");
    relight_close(local);
    relight_close(remote);
    assert_int_equal(daemon_stop(&d), 0);
    // The second principal's own name of the first model outlives the daemon.
    daemon_start(&d, NULL);
    remote = open_tcp();
    assert_true(id_of(remote, "mine", NULL, id));
    assert_string_equal(id, same);
    relight_close(remote);
    assert_int_equal(daemon_stop(&d), 0);
}

// A LOAD of a file of --models is kept whole, with what this daemon does not know, to be
// repeated when the file changes. The longest that is taken is read again at the next start.
static void test_long_load_is_remembered(void **state)
{
    enum { UNKNOWN = 1000 << 10, ROOM = UNKNOWN + 1000 };
    Relight__LoadRequest load = RELIGHT__LOAD_REQUEST__INIT;
    // Field 1000, of so many bytes.
    const uint8_t tag[] = {0xc2, 0x3e, (UNKNOWN & 127) | 128, (UNKNOWN >> 7 & 127) | 128,
                           UNKNOWN >> 14};
    uint8_t *header = calloc(1, ROOM);
    char path[200], id[ID_SIZE];
    in_models("long.obj", path);
    write_text(path, octahedron);
    load.path = "long.obj";
    load.size_mm = 10;
    load.material = "marble";
    load.preview = true;
    size_t n = relight__load_request__pack(&load, header);
    memcpy(header + n, tag, sizeof tag);
    daemon_start(&d, NULL);
    struct frames *f = frames_open(&d);
    frames_add_raw(f, RELIGHT_TYPE_LOAD, 2, header, n + sizeof tag + UNKNOWN);
    frames_send(f);
    assert_int_equal(frames_wait(f, 2).code, 0);
    free(header);
    frames_close(f);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    assert_true(id_of(client, "long", NULL, id));
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// A name that two principals gave is each one's own: it stays where the other renames the model
// or gives the name to a second one.
static void test_a_shared_name_stays(void **state)
{
    struct relight_error error;
    char one[ID_SIZE], same[ID_SIZE], two[ID_SIZE], id[ID_SIZE];
    daemon_start(&d, NULL);
    struct relight_client *local = client_open(d.address), *remote = open_tcp();
    OK(load_preview(local, "bunny", 10, one, &error));
    OK(load_preview(remote, "bunny", 10, same, &error));
    assert_string_equal(one, same);
    OK(load_preview(local, "bunny", 11, two, &error));
    assert_true(id_of(remote, "bunny", NULL, id));
    assert_string_equal(id, one);
    OK(load_preview(local, "rabbit", 10, same, &error));
    for (int i = 0; i < 2; i++) {
        assert_true(id_of(remote, "bunny", NULL, id));
        assert_string_equal(id, one);
        assert_true(id_of(local, "bunny", NULL, id));
        assert_string_equal(id, two);
        relight_close(local);
        relight_close(remote);
        assert_int_equal(daemon_stop(&d), 0);
        daemon_start(&d, NULL);
        local = client_open(d.address), remote = open_tcp();
    }
    relight_close(local);
    relight_close(remote);
    assert_int_equal(daemon_stop(&d), 0);
}

static void catalogue(const char *id, const char *name, int age_s)
{
    char path[300], text[300];
    snprintf(path, sizeof path, "%s/models/%s.json", d.data, id);
    snprintf(text, sizeof text, "{\"id\":\"%s\",\"name\":\"%s\",\"pinned\":false}", id, name);
    write_text(path, text);
    snprintf(path, sizeof path, "%s/bakes/%s.prt", d.data, id);
    copy_file(baked, path);
    struct timespec now, when[2];
    clock_gettime(CLOCK_REALTIME, &now);
    when[0] = when[1] = (struct timespec){now.tv_sec - age_s, now.tv_nsec};
    assert_int_equal(utimensat(AT_FDCWD, path, when, 0), 0);
}

static void data_folders(void)
{
    static const char *const name[] = {"", "/models", "/bakes", "/work", "/previews"};
    char path[200];
    for (int i = 0; i < 5; i++) {
        snprintf(path, sizeof path, "%s%s", d.data, name[i]);
        assert_int_equal(mkdir(path, 0700), 0);
    }
}

// A folder of the version before: ids were half as long, killed daemons left work behind.
// Loads that differ in one setting are two models: none is answered by the other's bake.
static void test_settings_name_the_model(void **state)
{
    enum { N = 22 };
    struct relight_load load[N];
    struct relight_error error;
    struct relight_loaded loaded;
    char hash[65], id[N][ID_SIZE];
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    OK(relight_upload(client, "a.obj", octahedron, strlen(octahedron), NULL, NULL, hash, NULL,
                      &error));
    struct relight_file file = {"a.obj", hash};
    for (int i = 0; i < N; i++)
        load[i] = (struct relight_load){
            .n_file = 1, .files = &file, .size_mm = 10, .material = "marble", .preview = true};
    load[1].size_mm = 11;
    load[2].size_mm = 0, load[2].mm_per_unit = 10;
    load[3].material = "skin1";
    load[4].up_z = true;
    load[5].bake.transport = RELIGHT_TRANSPORT_JOINT;
    load[6].bake.storage = RELIGHT_STORAGE_SPARSE;
    load[7].bake.scattering = RELIGHT_SCATTERING_WALK;
    load[8].bake.scattering = RELIGHT_SCATTERING_WALK, load[8].bake.walks = 512;
    load[9].bake.samples = 1000;
    load[10].bake.cube = 16;
    load[11].bake.coeffs = 16;
    load[12].bake.rank = 16;
    load[13].bake.phase_terms = 4;
    load[14].bake.single_points = 3;
    load[15].bake.no_single = true;
    load[16].bake.exit_planes = true;
    load[17].bake.any_eta = true;
    load[18].bake.max_error = 0.01f;
    load[19].bake.seed = 1;
    load[20].bake.env = "constant";
    load[21].bake.env = "constant", load[21].bake.rotate_deg = 90;
    for (int i = 0; i < N; i++) {
        if (relight_load(client, &load[i], &loaded, &error)) fail_msg("%d: %s", i, error.text);
        snprintf(id[i], ID_SIZE, "%s", loaded.model);
        relight_loaded_finish(&loaded);
        for (int k = 0; k < i; k++)
            if (!strcmp(id[k], id[i])) fail_msg("loads %d and %d are one model", k, i);
    }
    OK(relight_load(client, &load[0], &loaded, &error)); // the same again is the same
    assert_string_equal(loaded.model, id[0]);
    relight_loaded_finish(&loaded);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

static void test_earlier_data_folder(void **state)
{
    char id[ID_SIZE], path[200];
    unsigned n;
    data_folders();
    catalogue("0123456789abcdef", "old.obj", 0);
    snprintf(path, sizeof path, "%s/work/0123.00000001", d.data);
    assert_int_equal(mkdir(path, 0700), 0);
    snprintf(path, sizeof path, "%s/work/0123.00000001/sub", d.data);
    assert_int_equal(mkdir(path, 0700), 0);
    snprintf(path, sizeof path, "%s/work/0123.00000001/sub/a.bin", d.data);
    write_text(path, "left");
    daemon_start(&d, NULL);
    bytes_in("work", "", &n);
    assert_int_equal(n, 0);
    struct relight_client *client = client_open(d.address);
    assert_true(id_of(client, "old", NULL, id));
    assert_int_equal(strlen(id), 32);
    assert_true(log_says(&d, "0123456789abcdef is now", 0));
    ask_red(client, "old", 1);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// INFO tells the first 64 warnings of a model, however many its bake had.
static void test_many_warnings(void **state)
{
    enum { N = 70 };
    static const char id[] = "0123456789abcdef0123456789abcdef";
    char path[300], text[2000];
    data_folders();
    catalogue(id, "many.obj", 0);
    int n =
        snprintf(text, sizeof text, "{\"id\":\"%s\",\"name\":\"many.obj\",\"warnings\":\"", id);
    for (int i = 0; i < N; i++)
        n += snprintf(text + n, sizeof text - (size_t)n, "warning %d\\n", i);
    snprintf(text + n, sizeof text - (size_t)n, "\"}");
    snprintf(path, sizeof path, "%s/models/%s.json", d.data, id);
    write_text(path, text);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_model info;
    OK(relight_info(client, id, &info, &error));
    assert_int_equal(info.n_warning, 64);
    assert_string_equal(info.warning[0], "warning 0");
    assert_string_equal(info.warning[63], "warning 63");
    relight_model_finish(&info);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// ---- LOAD requests that are refused

static void test_bake_env_is_no_path(void **state)
{
    static const char *const wrong[] = {"constantX/../../../../../../etc/passwd",
                                        "constant/x",
                                        "constantx",
                                        "constant:1,2",
                                        "constant:1,2,3,4",
                                        "/etc/passwd",
                                        "env:../../x",
                                        "constant:1,2,3/../x"};
    struct relight_error error;
    struct relight_loaded loaded;
    char hash[65];
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    OK(relight_upload(client, "a.obj", octahedron, strlen(octahedron), NULL, NULL, hash, NULL,
                      &error));
    struct relight_file file[] = {{"a.obj", hash}, {"constantX/p", hash}};
    struct relight_load load = {.n_file = 2, .files = file, .size_mm = 10};
    load.bake.transport = RELIGHT_TRANSPORT_POLYNOMIAL;
    for (int i = 0; i < 8; i++) {
        load.bake.env = wrong[i];
        expect(relight_load(client, &load, &loaded, &error), RELIGHT_E_BAD_REQUEST, &error,
               "bake.env");
    }
    load.bake.env = "constant:1,2,-3";
    expect(relight_load(client, &load, &loaded, &error), RELIGHT_E_OUT_OF_RANGE, &error,
           "bake.env");
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

static void test_files_of_one_name(void **state)
{
    struct relight_error error;
    struct relight_loaded loaded;
    char hash[65], other[65];
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    OK(relight_upload(client, "a.obj", octahedron, strlen(octahedron), NULL, NULL, hash, NULL,
                      &error));
    OK(relight_upload(client, "b", "other", 5, NULL, NULL, other, NULL, &error));
    const struct relight_file clash[][3] = {{{"a.obj", hash}, {"b", hash}, {"b/c", hash}},
                                            {{"a.obj", hash}, {"b/c", hash}, {"b", hash}},
                                            {{"a.obj", hash}, {"b", hash}, {"b", other}},
                                            {{"a.obj", hash}, {"a.obj/b", hash}, {"c", hash}}};
    for (int i = 0; i < 4; i++) {
        struct relight_load load = {
            .n_file = 3, .files = clash[i], .size_mm = 10, .material = "marble"};
        expect(relight_load(client, &load, &loaded, &error), RELIGHT_E_BAD_REQUEST, &error,
               "one name");
    }
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

static void test_bakes_of_one_client(void **state)
{
    static const char *const extra[] = {"--client-jobs", "1", NULL};
    struct relight_error error;
    struct relight_loaded loaded, other;
    daemon_start(&d, extra);
    struct relight_client *local = client_open(d.address), *remote = open_tcp();
    OK(load_small(local, &d, "long.obj", 1, 3000000, &loaded, &error));
    expect(load_small(local, &d, "long.obj", 2, 200, &other, &error), RELIGHT_E_BUSY, &error,
           "--client-jobs");
    OK(load_small(remote, &d, "long.obj", 3, 200, &other, &error)); // another may
    relight_loaded_finish(&other);
    OK(relight_unload(local, loaded.model, true, NULL, &error)); // which ends its bake
    relight_loaded_finish(&loaded);
    int status = -1;
    for (int i = 0; i < 100 && status; i++) {
        status = load_small(local, &d, "long.obj", 4, 200, &loaded, &error);
        if (status) sleep_ms(50);
    }
    assert_int_equal(status, 0);
    relight_loaded_finish(&loaded);
    relight_close(local);
    relight_close(remote);
    assert_int_equal(daemon_stop(&d), 0);
}

// ---- room on disk

// Previews of one principal take no more than the disk has, and no bake of anybody.
static void test_previews_leave_room(void **state)
{
    static const char *const extra[] = {"--disk", "200k", NULL};
    struct relight_error error;
    struct relight_model info;
    char id[ID_SIZE], bake[ID_SIZE], hash[65];
    unsigned n;
    daemon_start(&d, extra);
    struct relight_client *local = client_open(d.address), *remote = open_tcp();
    bake_small(remote, &d, bake);
    for (int i = 0; i < 120; i++) OK(load_preview(local, NULL, 10 + (float)i / 8, id, &error));
    double disk = 0;
    uint64_t bytes = 0;
    for (int i = 0; i < 250; i++) {
        disk = metric(local, "relightd_disk_bytes");
        bytes = bytes_in("previews", ".prt", &n);
        if (disk <= 200 << 10 && bytes <= 200 << 10) break;
        sleep_ms(20);
    }
    assert_true(disk <= 200 << 10 && bytes <= 200 << 10);
    assert_true(n >= 10);                       // they are used, not cleared
    OK(relight_info(local, id, &info, &error)); // the last one is there
    relight_model_finish(&info);
    OK(relight_upload(local, "five", "bytes", 5, NULL, NULL, hash, NULL, &error));
    OK(relight_info(remote, bake, &info, &error));
    assert_int_equal(info.state, RELIGHT_MODEL_READY);
    relight_model_finish(&info);
    assert_true(metric(local, "relightd_bakes_evicted_total") == 0);
    relight_close(local);
    relight_close(remote);
    assert_int_equal(daemon_stop(&d), 0);
}

// 0 is no limit, for uploads, previews, copies and bakes alike.
static void test_disk_without_limit(void **state)
{
    static const char *const extra[] = {"--disk", "0", NULL};
    struct relight_error error;
    char path[200], id[ID_SIZE], bake[ID_SIZE], hash[65];
    in_models("stone.prt", path);
    copy_file(baked, path);
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    ask_red(client, "stone", 1);
    bake_small(client, &d, bake);
    OK(load_preview(client, "glance", 12, id, &error));
    OK(relight_upload(client, "five", "bytes", 5, NULL, NULL, hash, NULL, &error));
    assert_known(client, id);
    assert_known(client, bake);
    assert_true(metric(client, "relightd_bakes_evicted_total") == 0);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// A principal's share: its own old previews go, and a model above it is refused.
static void test_share_of_a_principal(void **state)
{
    static const char *const extra[] = {"--client-disk", "40k", "--client-models", "6", NULL};
    static const char *const none[] = {"--client-disk", "1k", NULL};
    struct relight_error error;
    char first[ID_SIZE], id[ID_SIZE];
    struct relight_model info;
    daemon_start(&d, extra);
    struct relight_client *local = client_open(d.address), *remote = open_tcp();
    OK(load_preview(remote, "theirs", 9, first, &error));
    for (int i = 0; i < 20; i++) OK(load_preview(local, NULL, 10 + (float)i, id, &error));
    OK(relight_info(remote, first, &info, &error)); // the oldest of all, but not of that client
    relight_model_finish(&info);
    struct relight_list list;
    OK(relight_list(local, false, &list, &error));
    assert_true(list.n_model <= 7 && list.n_model >= 3);
    relight_list_finish(&list);
    relight_close(local);
    relight_close(remote);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, none);
    local = client_open(d.address);
    expect(load_preview(local, NULL, 50, id, &error), RELIGHT_E_LIMIT, &error, "client-disk");
    relight_close(local);
    assert_int_equal(daemon_stop(&d), 0);
}

// The octahedron in a file of --models of so many bytes, loaded by its path.
static int load_large_file(struct relight_client *client, const char *name, size_t bytes,
                           struct relight_error *error)
{
    struct relight_load load = {
        .path = name, .size_mm = 10, .material = "marble", .preview = true};
    struct relight_loaded loaded;
    char path[200], *text = malloc(bytes + 1);
    assert_non_null(text);
    memset(text, name[0], bytes); // of other bytes than another name's
    text[bytes] = 0;
    snprintf(text, bytes, "%s#", octahedron);
    text[strlen(text)] = '#';
    in_models(name, path);
    write_text(path, text);
    free(text);
    int status = relight_load(client, &load, &loaded, error);
    if (!status) relight_loaded_finish(&loaded);
    return status;
}

// A copy of a file of --models counts to the client that loaded it: two that each keep within
// their limits have more than one client's together.
static void test_copies_count_to_who_loads(void **state)
{
    static const char *const extra[] = {"--client-disk", "60k", NULL};
    struct relight_error error;
    unsigned n;
    daemon_start(&d, extra);
    struct relight_client *local = client_open(d.address), *remote = open_tcp();
    OK(load_large_file(local, "ours.obj", 40 << 10, &error));
    OK(load_large_file(remote, "theirs.obj", 40 << 10, &error));
    assert_true(bytes_in("imports", "", &n) >= 80 << 10);
    expect(load_large_file(local, "more.obj", 64 << 10, &error), RELIGHT_E_LIMIT, &error,
           "client-disk");
    relight_close(local);
    relight_close(remote);
    assert_int_equal(daemon_stop(&d), 0);
}

// The one who holds more than its share gives way, though what the other has is older.
static void test_greedy_gives_way(void **state)
{
    static const char *const extra[] = {"--disk", "64k", NULL};
    struct relight_error error;
    struct relight_model info;
    char first[ID_SIZE], second[ID_SIZE], id[ID_SIZE];
    struct relight_list list;
    daemon_start(&d, extra);
    struct relight_client *greedy = client_open(d.address), *modest = open_tcp();
    OK(load_preview(modest, "first", 8, first, &error));
    for (int i = 0; i < 20; i++) OK(load_preview(greedy, NULL, 10 + (float)i, id, &error));
    OK(load_preview(modest, "second", 9, second, &error));
    OK(relight_list(modest, false, &list, &error));
    assert_true(list.n_model < 20); // some had to go
    relight_list_finish(&list);
    OK(relight_info(modest, first, &info, &error));
    relight_model_finish(&info);
    OK(relight_info(modest, second, &info, &error));
    relight_model_finish(&info);
    relight_close(greedy);
    relight_close(modest);
    assert_int_equal(daemon_stop(&d), 0);
}

// Of eight models that the daemon may know, seven are one client's: it gives way to itself and
// to the other, whose first is the oldest of all.
static void test_share_of_models(void **state)
{
    static const char *const extra[] = {"--max-models", "8", NULL};
    struct relight_error error;
    char first[ID_SIZE], second[ID_SIZE], id[9][ID_SIZE];
    struct relight_model info;
    struct relight_list list;
    daemon_start(&d, extra);
    struct relight_client *greedy = client_open(d.address), *modest = open_tcp();
    OK(load_preview(modest, "first", 8, first, &error));
    for (int i = 0; i < 8; i++) OK(load_preview(greedy, NULL, 10 + (float)i, id[i], &error));
    assert_known(modest, first);
    expect(relight_info(greedy, id[0], &info, &error), RELIGHT_E_NOT_FOUND, &error, NULL);
    OK(load_preview(modest, "second", 9, second, &error));
    assert_known(modest, first);
    assert_known(modest, second);
    expect(relight_info(greedy, id[1], &info, &error), RELIGHT_E_NOT_FOUND, &error, NULL);
    for (int i = 2; i < 8; i++) assert_known(greedy, id[i]);
    OK(relight_list(modest, false, &list, &error));
    assert_int_equal(list.n_model, 8);
    relight_list_finish(&list);
    relight_close(greedy);
    relight_close(modest);
    assert_int_equal(daemon_stop(&d), 0);
}

// With a limit by client its own oldest goes, though the daemon has room and others have older
// ones.
static void test_own_preview_goes(void **state)
{
    static const char *const extra[] = {"--client-models", "3", NULL};
    struct relight_error error;
    struct relight_model info;
    char theirs[ID_SIZE], id[4][ID_SIZE];
    daemon_start(&d, extra);
    struct relight_client *local = client_open(d.address), *remote = open_tcp();
    OK(load_preview(remote, "theirs", 8, theirs, &error));
    for (int i = 0; i < 4; i++) OK(load_preview(local, NULL, 10 + (float)i, id[i], &error));
    assert_known(remote, theirs);
    expect(relight_info(local, id[0], &info, &error), RELIGHT_E_NOT_FOUND, &error, NULL);
    for (int i = 1; i < 4; i++) assert_known(local, id[i]);
    relight_close(local);
    relight_close(remote);
    assert_int_equal(daemon_stop(&d), 0);
}

// Files that cannot be read leave room for one that can.
static void test_failures_leave_room(void **state)
{
    static const char *const extra[] = {"--client-models", "3", NULL};
    struct relight_error error;
    struct relight_loaded loaded;
    struct relight_load load = small_bake(0, 200);
    char path[160], id[ID_SIZE], last[ID_SIZE];
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    OK(load_preview(client, "good", 9, id, &error));
    snprintf(path, sizeof path, "%s/broken.glb", d.folder);
    for (int i = 0; i < 4; i++) {
        char text[20];
        snprintf(text, sizeof text, "no model %d", i);
        write_text(path, text);
        OK(relight_load_file(client, path, &load, NULL, NULL, &loaded, &error));
        int status = relight_watch(client, loaded.job, NULL, NULL, &error);
        expect(status, RELIGHT_E_JOB_FAILED, &error, NULL);
        relight_loaded_finish(&loaded);
    }
    OK(load_preview(client, "another", 10, last, &error));
    assert_known(client, id);
    assert_known(client, last);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// Uploads that are new stay for a while: one who fills the disk with them is refused, and the
// other, who keeps within its share, loses nothing.
static void test_greedy_uploads_are_refused(void **state)
{
    static const char *const extra[] = {"--disk", "64k", NULL};
    struct relight_error error;
    struct relight_model info;
    char id[ID_SIZE], hash[65], text[20];
    int n = 0, status = 0;
    daemon_start(&d, extra);
    struct relight_client *greedy = client_open(d.address), *modest = open_tcp();
    OK(load_preview(modest, "theirs", 9, id, &error));
    for (; !status && n < 20; n++) {
        snprintf(text, sizeof text, "bytes %d", n);
        status =
            relight_upload(greedy, "b", text, strlen(text), NULL, NULL, hash, NULL, &error);
    }
    expect(status, RELIGHT_E_LIMIT, &error, "--disk");
    assert_true(n > 4); // it got its share, half of the disk, and more
    OK(relight_info(modest, id, &info, &error));
    relight_model_finish(&info);
    relight_close(greedy);
    relight_close(modest);
    assert_int_equal(daemon_stop(&d), 0);
}

static struct frames_answer put_first(struct frames *f, uint64_t id, uint64_t size,
                                      const char *bytes, size_t n)
{
    Relight__PutBlobRequest put = RELIGHT__PUT_BLOB_REQUEST__INIT;
    put.hash = "00000000000000000000000000000000000000000000000000000000000000ff";
    put.size = size;
    frames_add(f, RELIGHT_TYPE_PUT_BLOB, id, &put.base, bytes, n);
    frames_send(f);
    return frames_wait(f, id);
}

// Room is made once for an upload, when it begins: not for one that is refused, and not when
// its first chunk comes again.
static void test_uploads_take_room_once(void **state)
{
    static const char *const extra[] = {"--client-disk", "1M", "--max-blob", "800k", NULL};
    static char bytes[64 << 10];
    char id[ID_SIZE];
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    struct frames *f = frames_open(&d);
    bake_small(client, &d, id);
    assert_int_equal(put_first(f, 2, 1000 << 10, bytes, 1).code,
                     RELIGHT__ERROR_CODE__ERROR_LIMIT);
    for (uint64_t n = 3; n < 6; n++)
        assert_int_equal(put_first(f, n, 600 << 10, bytes, sizeof bytes).code, 0);
    assert_known(client, id);
    assert_int_equal((int)metric(client, "relightd_bakes_evicted_total"), 0);
    frames_close(f);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// Room for two of three bakes: the longest unused goes, the others stay.
static void test_longest_unused_bake_goes(void **state)
{
    static const char *const id[] = {"aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa",
                                     "bbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbb",
                                     "cccccccccccccccccccccccccccccccc"};
    static const int age_s[] = {500, 5000, 50};
    struct relight_error error;
    struct relight_model info;
    char room[24];
    data_folders();
    for (int i = 0; i < 3; i++) catalogue(id[i], id[i], age_s[i]);
    snprintf(room, sizeof room, "%lld", (long long)baked_bytes * 5 / 2);
    const char *const extra[] = {"--bakes-disk", room, NULL};
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    OK(relight_info(client, id[0], &info, &error));
    relight_model_finish(&info);
    expect(relight_info(client, id[1], &info, &error), RELIGHT_E_NOT_FOUND, &error, NULL);
    OK(relight_info(client, id[2], &info, &error));
    relight_model_finish(&info);
    assert_true(metric(client, "relightd_bakes_evicted_total") == 1);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// Opening a bake counts as a use, also after a restart: the bake that was opened stays, though
// its file is the older one.
static void test_opening_is_a_use(void **state)
{
    static const char *const id[] = {"aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa",
                                     "bbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbb"};
    struct relight_error error;
    struct relight_model info;
    char room[24];
    data_folders();
    catalogue(id[0], id[0], 5000);
    catalogue(id[1], id[1], 500);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    ask_red(client, id[0], 1);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
    snprintf(room, sizeof room, "%lld", (long long)baked_bytes * 3 / 2);
    const char *const extra[] = {"--bakes-disk", room, NULL};
    daemon_start(&d, extra);
    client = client_open(d.address);
    expect(relight_info(client, id[1], &info, &error), RELIGHT_E_NOT_FOUND, &error, NULL);
    assert_known(client, id[0]);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// A bake that is open stays, though a closed one was used later: closing it would cost whoever
// works with it a new opening.
static void test_open_bake_stays(void **state)
{
    static const char evicted[] = "relightd_bakes_evicted_total";
    static const char *const id[] = {"aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa",
                                     "bbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbb"};
    struct relight_error error;
    struct relight_model info;
    char room[24], third[ID_SIZE];
    data_folders();
    for (int i = 0; i < 2; i++) catalogue(id[i], id[i], 500);
    snprintf(room, sizeof room, "%lld", (long long)baked_bytes * 5 / 2);
    const char *const extra[] = {"--bakes-disk", room, NULL};
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    ask_red(client, id[0], 1);
    ask_red(client, id[1], 1);
    OK(relight_unload(client, id[1], false, NULL, &error));
    bake_small(client, &d, third);
    // Once the third is open. An INFO before would open the second, too.
    for (int i = 0; i < 6000 && metric(client, evicted) < 1; i++) sleep_ms(20);
    assert_int_equal((int)metric(client, evicted), 1);
    OK(relight_info(client, id[0], &info, &error));
    assert_int_equal(info.state, RELIGHT_MODEL_READY);
    relight_model_finish(&info);
    int status = relight_info(client, id[1], &info, &error);
    expect(status, RELIGHT_E_NOT_FOUND, &error, NULL);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

int main(void)
{
#define TEST(f) cmocka_unit_test_setup_teardown(f, fresh_folder, after_each)
    const struct CMUnitTest tests[] = {
        TEST(test_original_may_be_destroyed),
        TEST(test_new_version_of_a_file),
        TEST(test_view_follows_a_new_version),
        TEST(test_copy_comes_back),
        TEST(test_damaged_replacement_is_told),
        TEST(test_decayed_copy_is_made_again),
        TEST(test_links_and_paths),
        TEST(test_odd_file_names),
        TEST(test_gltf_with_buffers),
        TEST(test_copying_is_shared_and_ends),
        TEST(test_unknown_names_cost_no_scan),
        TEST(test_names_belong_to_principals),
        TEST(test_long_load_is_remembered),
        TEST(test_a_shared_name_stays),
        TEST(test_settings_name_the_model),
        TEST(test_earlier_data_folder),
        TEST(test_many_warnings),
        TEST(test_bake_env_is_no_path),
        TEST(test_files_of_one_name),
        TEST(test_bakes_of_one_client),
        TEST(test_previews_leave_room),
        TEST(test_disk_without_limit),
        TEST(test_share_of_a_principal),
        TEST(test_copies_count_to_who_loads),
        TEST(test_greedy_gives_way),
        TEST(test_share_of_models),
        TEST(test_own_preview_goes),
        TEST(test_failures_leave_room),
        TEST(test_greedy_uploads_are_refused),
        TEST(test_uploads_take_room_once),
        TEST(test_longest_unused_bake_goes),
        TEST(test_opening_is_a_use),
        TEST(test_open_bake_stays),
    };
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("models", tests, setup, teardown);
}
