// SPDX-License-Identifier: MIT
// Bakes survive the daemon: its queue is on disk, a bake that SIGKILL or SIGTERM interrupted
// goes on from its finished work, and the .prt has the bytes of an undisturbed bake.
#include "daemon.h"

#include <dirent.h>

static struct daemon d, calm; // calm: never disturbed
static char link_path[160];

// Path of the checkpoint of the only bake under way; false while there is none.
static bool find_checkpoint(char path[500])
{
    char work[128];
    bool found = false;
    snprintf(work, sizeof work, "%s/work", d.data);
    DIR *dir = opendir(work);
    for (struct dirent *e; dir && (e = readdir(dir));) {
        if (e->d_name[0] == '.') continue;
        snprintf(path, 500, "%s/%s/.checkpoint", work, e->d_name);
        if (!access(path, R_OK)) {
            found = true;
            break;
        }
    }
    if (dir) closedir(dir);
    return found;
}

struct piece { // of the file that prt bake --checkpoint writes
    uint32_t slot, cluster, rank, n_component;
    uint64_t rays;
    double noise[2];
    uint64_t bytes, hash, check;
};

// Number of finished pieces; fails when one is there twice.
static unsigned count_pieces(const char *path)
{
    enum { MOST = 4096, HEADER = 16, ROWS = 1000 };
    static uint32_t seen[MOST][2];
    unsigned n = 0;
    struct piece p;
    off_t at = HEADER;
    int fd = open(path, O_RDONLY);
    while (fd >= 0 && n < MOST && pread(fd, &p, sizeof p, at) == (ssize_t)sizeof p) {
        for (unsigned i = 0; i < n; i++)
            assert_false(seen[i][0] == p.slot && seen[i][1] == p.cluster);
        seen[n][0] = p.slot, seen[n++][1] = p.cluster;
        at += (off_t)(sizeof p + (p.slot == ROWS ? 0 : p.bytes));
    }
    if (fd >= 0) close(fd);
    return n;
}

// Waits until the bake has finished so many pieces; a link keeps the file for later.
static void wait_for_pieces(unsigned n)
{
    char path[500];
    for (int i = 0; i < 6000; i++) {
        if (find_checkpoint(path) && count_pieces(path) >= n) {
            unlink(link_path);
            assert_int_equal(link(path, link_path), 0);
            return;
        }
        sleep_ms(10);
    }
    fail_msg("the bake finished no %u pieces", n);
}

static void kill_daemon(void)
{
    kill(d.pid, SIGKILL);
    assert_int_equal(waitpid(d.pid, NULL, 0), d.pid);
    d.pid = 0;
}

static void bake_path(const struct daemon *which, const char *id, char path[200])
{
    snprintf(path, 200, "%s/bakes/%s.prt", which->data, id);
}

static void same_file(const char *one, const char *other)
{
    FILE *a = fopen(one, "rb"), *b = fopen(other, "rb");
    assert_non_null(a);
    assert_non_null(b);
    int x, y;
    do {
        x = fgetc(a), y = fgetc(b);
        assert_int_equal(x, y);
    } while (x != EOF);
    fclose(a);
    fclose(b);
}

static void wait_for_job(struct relight_client *client, const char *job)
{
    struct relight_error error;
    if (relight_watch(client, job, NULL, NULL, &error)) fail_msg("%s: %s", job, error.text);
}

static unsigned count_entries(const char *folder)
{
    char path[160];
    unsigned n = 0;
    snprintf(path, sizeof path, "%s/%s", d.data, folder);
    DIR *dir = opendir(path);
    for (struct dirent *e; dir && (e = readdir(dir));) n += e->d_name[0] != '.';
    if (dir) closedir(dir);
    return n;
}

// The folder of a bake goes after the record of its end, which is synced to the disk.
static void wait_for_no_work(void)
{
    for (int i = 0; i < 3000 && count_entries("work"); i++) sleep_ms(10);
    assert_int_equal(count_entries("work"), 0);
}

enum { LONG = 60000 };

// Three times killed, once stopped, at different places of one bake.
static void test_killed_bake_goes_on(void **state)
{
    struct relight_error error;
    struct relight_loaded loaded, undisturbed;
    char one[200], other[200], job[64], id[ID_SIZE];
    struct relight_client *client = client_open(calm.address);
    OK(load_small(client, &calm, "long.obj", 9, LONG, &undisturbed, &error));
    wait_for_job(client, undisturbed.job);
    relight_close(client);
    daemon_start(&d, NULL);
    client = client_open(d.address);
    OK(load_small(client, &d, "long.obj", 9, LONG, &loaded, &error));
    snprintf(job, sizeof job, "%s", loaded.job);
    snprintf(id, sizeof id, "%s", loaded.model);
    relight_loaded_finish(&loaded);
    for (unsigned round = 0; round < 4; round++) {
        wait_for_pieces(60 + 120 * round);
        if (round < 3) kill_daemon();
        else assert_int_equal(daemon_stop(&d), 0);
        relight_close(client);
        daemon_start(&d, NULL);
        assert_true(log_says(&d, "recalled", 0));
        client = client_open(d.address);
        assert_true(metric(client, "relightd_jobs_open") == 1);
        struct relight_model info;
        OK(relight_info(client, id, &info, &error));
        assert_int_equal(info.state, RELIGHT_MODEL_BAKING);
        relight_model_finish(&info);
    }
    wait_for_job(client, job);
    assert_true(count_pieces(link_path) > 420); // and none of them twice
    bake_path(&d, id, one);
    bake_path(&calm, undisturbed.model, other);
    same_file(one, other);
    wait_for_no_work();
    relight_loaded_finish(&undisturbed);
    // It is known, and done, over one more restart.
    relight_close(client);
    kill_daemon();
    daemon_start(&d, NULL);
    client = client_open(d.address);
    wait_for_job(client, job);
    relight_close(client);
    assert_int_equal(daemon_end(&d), 0);
}

// Where the log says that a job was started; NULL: nowhere.
static const char *started(const char *log, const char *job)
{
    char word[80];
    snprintf(word, sizeof word, "job id=%s ", job);
    for (const char *at = log; (at = strstr(at, word)); at++) {
        const char *end = strchr(at, '\n'), *is = strstr(at, " started");
        if (is && end && is < end) return at;
    }
    return NULL;
}

// LOAD was answered: whatever happens, the bake is there later. Queued jobs keep their order,
// a cancelled one does not come back.
static void test_queue_survives(void **state)
{
    struct relight_error error;
    struct relight_loaded loaded[3];
    char name[16];
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    for (unsigned i = 0; i < 3; i++) {
        snprintf(name, sizeof name, "q%u.obj", i);
        OK(load_small(client, &d, name, 20 + i, i ? 300 : LONG, &loaded[i], &error));
    }
    enum relight_job_state at;
    kill_daemon(); // at once
    relight_close(client);
    daemon_start(&d, NULL);
    client = client_open(d.address);
    OK(relight_cancel_job(client, loaded[2].job, &at, &error));
    kill_daemon();
    relight_close(client);
    daemon_start(&d, NULL);
    client = client_open(d.address);
    assert_true(metric(client, "relightd_jobs_open") >= 1);
    wait_for_job(client, loaded[0].job);
    wait_for_job(client, loaded[1].job);
    char *log = read_text(d.log);
    const char *first = started(log, loaded[0].job), *second = started(log, loaded[1].job);
    assert_true(!first || !second || first < second); // one may have ended before
    free(log);
    int status = relight_watch(client, loaded[2].job, NULL, NULL, &error);
    // Its end may have been lost with the daemon; then it was baked.
    assert_true(status == -RELIGHT_E_CANCELLED || status == 0);
    for (unsigned i = 0; i < 3; i++) relight_loaded_finish(&loaded[i]);
    relight_close(client);
    assert_int_equal(daemon_end(&d), 0);
}

// What no job needs is removed; a job whose files are gone fails with a reason.
static void test_leftovers(void **state)
{
    struct relight_error error;
    struct relight_loaded loaded;
    char path[500], command[700];
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    OK(load_small(client, &d, "gone.obj", 31, LONG, &loaded, &error));
    wait_for_pieces(1);
    kill_daemon();
    relight_close(client);
    assert_true(find_checkpoint(path));
    snprintf(command, sizeof command,
             "rm -rf '%s/work/'* && mkdir -p '%s/work/left/over' && echo x > '%s/jobs/x.json' "
             "&& echo '{\"id\":\"../../x\"}' > '%s/jobs/job-1.json'",
             d.data, d.data, d.data, d.data);
    assert_int_equal(system(command), 0);
    daemon_start(&d, NULL);
    assert_true(log_says(&d, "is no job and is removed", 0));
    client = client_open(d.address);
    assert_true(relight_watch(client, loaded.job, NULL, NULL, &error) != 0);
    assert_non_null(strstr(error.text, "load"));
    wait_for_no_work();
    relight_loaded_finish(&loaded);
    // The same load starts anew.
    OK(load_small(client, &d, "gone.obj", 31, LONG, &loaded, &error));
    OK(relight_cancel_job(client, loaded.job, NULL, &error));
    relight_loaded_finish(&loaded);
    relight_close(client);
    assert_int_equal(daemon_end(&d), 0);
}

// A record whose folder is all of work/, or of the data folder, is no job: nothing is removed.
static void test_records_that_lead_elsewhere(void **state)
{
    static const char *const folder[] = {"", ".", ".."};
    struct relight_error error;
    struct relight_loaded loaded;
    char path[200], text[400];
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    OK(load_small(client, &d, "beside.obj", 51, LONG / 4, &loaded, &error));
    wait_for_pieces(1);
    kill_daemon();
    relight_close(client);
    for (int i = 0; i < 3; i++) {
        snprintf(path, sizeof path, "%s/jobs/job-none-%d.json", d.data, i);
        snprintf(text, sizeof text,
                 "{\"id\":\"job-none-%d\",\"model\":\"\",\"owner\":\"\",\"folder\":\"%s\","
                 "\"order\":\"1\",\"state\":0,\"stage\":\"\",\"error\":\"\","
                 "\"warnings\":\"\",\"recipe\":\"\"}",
                 i, folder[i]);
        write_text(path, text);
    }
    daemon_start(&d, NULL);
    client = client_open(d.address);
    for (int i = 0; i < 3; i++) {
        snprintf(text, sizeof text, "job-none-%d", i);
        assert_int_equal(relight_watch(client, text, NULL, NULL, &error), -RELIGHT_E_NOT_FOUND);
    }
    wait_for_job(client, loaded.job);
    relight_loaded_finish(&loaded);
    relight_close(client);
    assert_int_equal(daemon_end(&d), 0);
}

// The finished work counts as disk of the one who ordered the bake, and is bounded.
static void test_checkpoint_is_charged(void **state)
{
    const char *const none[] = {"--bake-checkpoint", "0", NULL};
    struct relight_error error;
    struct relight_loaded loaded;
    char path[500];
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    double before = metric(client, "relightd_disk_bytes");
    OK(load_small(client, &d, "charged.obj", 41, 400000, &loaded, &error));
    wait_for_pieces(200);
    double during = 0;
    for (int i = 0; i < 500 && during < before + 1e6; i++) {
        sleep_ms(20);
        during = metric(client, "relightd_disk_bytes");
    }
    assert_true(during >= before + 1e6);
    OK(relight_cancel_job(client, loaded.job, NULL, &error));
    (void)relight_watch(client, loaded.job, NULL, NULL, &error);
    assert_true(metric(client, "relightd_disk_bytes") < during - 9e5);
    relight_loaded_finish(&loaded);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, none);
    client = client_open(d.address);
    OK(load_small(client, &d, "none.obj", 42, LONG, &loaded, &error));
    sleep_ms(500);
    assert_false(find_checkpoint(path));
    OK(relight_cancel_job(client, loaded.job, NULL, &error));
    relight_loaded_finish(&loaded);
    relight_close(client);
    assert_int_equal(daemon_end(&d), 0);
}

static int setup(void **state)
{
    daemon_folder(&d);
    daemon_folder(&calm);
    snprintf(link_path, sizeof link_path, "%s/kept", d.folder);
    daemon_start(&calm, NULL);
    return 0;
}

static int teardown(void **state)
{
    int status = daemon_end(&calm);
    daemon_remove(&calm);
    daemon_remove(&d);
    return status;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_killed_bake_goes_on),
        cmocka_unit_test(test_queue_survives),
        cmocka_unit_test(test_leftovers),
        cmocka_unit_test(test_records_that_lead_elsewhere),
        cmocka_unit_test(test_checkpoint_is_charged),
    };
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("resume", tests, setup, teardown);
}
