// SPDX-License-Identifier: MIT
// A real relightd in a folder of its own, for the service tests.
#ifndef TESTS_SERVICE_DAEMON_H
#define TESTS_SERVICE_DAEMON_H

#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <poll.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

#include "relight/relight.h"

struct daemon {
    pid_t pid;
    char folder[64], data[96], models[96], socket[96], address[128], log[96];
    char tcp[64], http[64]; // "127.0.0.1:PORT", found in the log
};

/* Code under a sanitizer is several times slower: tests assert no speed there. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { INSTRUMENTED = 1 };
#else
enum { INSTRUMENTED = 0 };
#endif

static const char octahedron[] = "v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\n"
                                 "f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\n"
                                 "f 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n";
enum { OCTAHEDRON_VERTICES = 6, ID_SIZE = 40 }; // a model id is 32 hex digits

static inline void sleep_ms(int ms)
{
    struct timespec t = {ms / 1000, (long)(ms % 1000) * 1000000};
    nanosleep(&t, NULL);
}

static inline char *read_text(const char *path)
{
    FILE *file = fopen(path, "r");
    if (!file) return strdup("");
    char *text = calloc(1, 1 << 20);
    size_t n = fread(text, 1, (1 << 20) - 1, file);
    text[n] = 0;
    fclose(file);
    return text;
}

static inline void write_text(const char *path, const char *text)
{
    FILE *file = fopen(path, "w");
    assert_non_null(file);
    fputs(text, file);
    fclose(file);
}

// True when `word` comes to stand in the log within the time.
static inline bool log_says(const struct daemon *d, const char *word, int ms)
{
    for (;; ms -= 20) {
        char *text = read_text(d->log);
        bool there = strstr(text, word) != NULL;
        free(text);
        if (there || ms <= 0) return there;
        sleep_ms(20);
    }
}

static inline void find_address(const struct daemon *d, const char *mark, char *out, size_t n)
{
    char *text = read_text(d->log), *at = strstr(text, mark);
    out[0] = 0;
    if (at) snprintf(out, n, "%.*s", (int)strcspn(at + strlen(mark), " \n"), at + strlen(mark));
    free(text);
}

static inline void daemon_folder(struct daemon *d)
{
    memset(d, 0, sizeof *d);
    strcpy(d->folder, "/tmp/relightd-test-XXXXXX");
    assert_non_null(mkdtemp(d->folder));
    snprintf(d->data, sizeof d->data, "%s/data", d->folder);
    snprintf(d->models, sizeof d->models, "%s/models", d->folder);
    snprintf(d->socket, sizeof d->socket, "%s/s", d->folder);
    snprintf(d->address, sizeof d->address, "unix:%s", d->socket);
    snprintf(d->log, sizeof d->log, "%s/log", d->folder);
    mkdir(d->models, 0700);
}

// With $RELIGHT_TEST_POSTGRES (deploy/cluster/with_postgres) each folder's daemon keeps its
// rooms in a database of its own there; option is "" otherwise.
static inline void daemon_database(const struct daemon *d, char option[300])
{
    const char *server = getenv("RELIGHT_TEST_POSTGRES"), *name = strrchr(d->folder, '/') + 1;
    char command[400];
    option[0] = 0;
    if (!server) return;
    const char *query = strchr(server, '?');
    snprintf(command, sizeof command, "psql -qc 'CREATE DATABASE \"%s\"' '%s' >/dev/null 2>&1",
             name, server);
    (void)!system(command); // it is there after a restart
    snprintf(option, 300, "postgresql://relightd@/%s%s", name, query ? query : "");
}

// cmocka says when the end of a group fails, and yet the program exits with 0: this makes it
// exit with 1.
static inline void leave_failed(void)
{
    fflush(NULL);
    _exit(1);
}

static inline void fail_at_exit(void)
{
    static bool will;
    if (!will) atexit(leave_failed);
    will = true;
}

// Whether a sanitizer reported something of the daemon or one of its children, whose exit
// status the daemon may have taken for a broken file's. The test then fails whatever its cases
// make of it.
static inline bool sanitizer_reports(const struct daemon *d)
{
    FILE *file = fopen(d->log, "r");
    char *line = NULL;
    size_t size = 0;
    bool there = false;
    while (file && getline(&line, &size, file) > 0) {
        if (!there) there = strstr(line, "Sanitizer: ") || strstr(line, ": runtime error: ");
        if (there) fputs(line, stderr);
    }
    free(line);
    if (file) fclose(file);
    if (there) fail_at_exit();
    return there;
}

// extra: further options, NULL-terminated; NULL for none.
static inline pid_t daemon_spawn(struct daemon *d, const char *const extra[])
{
    const char *argv[40] = {PRT_BINARY_DIR "/relightd",
                            "--data",
                            d->data,
                            "--models",
                            d->models,
                            "--listen",
                            d->address,
                            "--listen",
                            "tcp:127.0.0.1:0",
                            "--preview-walks=no"}; // pictures that do not change by themselves
    int n = 10;
    char rooms[300];
    daemon_database(d, rooms);
    if (rooms[0]) {
        argv[n++] = "--rooms";
        argv[n++] = rooms;
    }
    for (int i = 0; extra && extra[i]; i++) argv[n++] = extra[i];
    pid_t pid = fork();
    if (pid == 0) {
        prctl(PR_SET_PDEATHSIG, SIGTERM); // ends with the test, however that ends
        int fd = open(d->log, O_CREAT | O_APPEND | O_WRONLY, 0600);
        dup2(fd, 2);
        execv(argv[0], (char *const *)argv);
        _exit(127);
    }
    return pid;
}

static inline void daemon_start(struct daemon *d, const char *const extra[])
{
    sanitizer_reports(d); // of one that was killed
    unlink(d->log);
    d->pid = daemon_spawn(d, extra);
    if (!log_says(d, " start version", 60000)) {
        char *text = read_text(d->log);
        print_message("%s", text);
        free(text);
        fail_msg("the daemon did not start");
    }
    find_address(d, "listen address=tcp:", d->tcp, sizeof d->tcp);
    find_address(d, "listen address=http:", d->http, sizeof d->http);
}

// SIGTERM; the exit status, -1 when it did not end in time, or -2 after a sanitizer's report.
// Under a sanitizer the daemon may wait 20 s for running work and then looks for leaks.
static inline int daemon_stop(struct daemon *d)
{
    const int most_ms = INSTRUMENTED ? 120000 : 20000;
    int how = 0;
    if (!d->pid) return 0;
    kill(d->pid, SIGTERM);
    for (int ms = 0; ms < most_ms; ms += 20) {
        if (waitpid(d->pid, &how, WNOHANG) == d->pid) {
            d->pid = 0;
            if (sanitizer_reports(d)) return -2;
            return WIFEXITED(how) ? WEXITSTATUS(how) : 1000 + WTERMSIG(how);
        }
        sleep_ms(20);
    }
    kill(d->pid, SIGKILL);
    waitpid(d->pid, &how, 0);
    d->pid = 0;
    return -1;
}

// Ends a group: the daemon is to drain and leave with 0, else its log is shown.
static inline int daemon_end(struct daemon *d)
{
    int status = daemon_stop(d);
    if (status) {
        fail_at_exit();
        char *text = read_text(d->log);
        size_t n = strlen(text);
        fprintf(stderr, "status %d; its log ends with:\n%s", status,
                n > 6000 ? text + n - 6000 : text);
        free(text);
    }
    return status;
}

static inline int remove_one(const char *path, const struct stat *st, int kind,
                             struct FTW *where)
{
    return remove(path);
}

static inline void daemon_remove(struct daemon *d)
{
    if (d->pid) daemon_stop(d);
    else sanitizer_reports(d);
    nftw(d->folder, remove_one, 16, FTW_DEPTH | FTW_PHYS);
}

static inline struct relight_client *client_open(const char *address)
{
    struct relight_client *client = NULL;
    struct relight_error error;
    struct relight_options options = {.timeout_s = 60};
    if (relight_connect(address, &options, &client, &error))
        fail_msg("connect %s: %s", address, error.text);
    return client;
}

#define OK(call)                                         \
    do {                                                 \
        if (call) fail_msg("%s: %s", #call, error.text); \
    } while (0)

// Loads the octahedron from a file of this name.
static inline int load_octahedron(struct relight_client *client, const struct daemon *d,
                                  const char *name, const struct relight_load *load,
                                  struct relight_loaded *out, struct relight_error *error)
{
    char path[160];
    snprintf(path, sizeof path, "%s/%s", d->folder, name);
    write_text(path, octahedron);
    return relight_load_file(client, path, load, NULL, NULL, out, error);
}

// The same, and waits for its bake.
static inline void bake_octahedron(struct relight_client *client, const struct daemon *d,
                                   const char *name, const struct relight_load *load,
                                   char id[ID_SIZE])
{
    struct relight_error error;
    struct relight_loaded loaded;
    OK(load_octahedron(client, d, name, load, &loaded, &error));
    snprintf(id, ID_SIZE, "%s", loaded.model);
    if (loaded.job[0]) OK(relight_watch(client, loaded.job, NULL, NULL, &error));
    relight_loaded_finish(&loaded);
}

// With settings that bake in seconds.
static inline struct relight_load small_bake(uint64_t seed, uint32_t samples)
{
    return (struct relight_load){
        .size_mm = 10,
        .material = "marble",
        .bake = {.samples = samples, .cube = 16, .single_points = 2, .seed = seed}};
}

static inline int load_small(struct relight_client *client, const struct daemon *d,
                             const char *name, uint64_t seed, uint32_t samples,
                             struct relight_loaded *out, struct relight_error *error)
{
    struct relight_load load = small_bake(seed, samples);
    return load_octahedron(client, d, name, &load, out, error);
}

// The one small bake that most tests use.
static inline void bake_small(struct relight_client *client, const struct daemon *d,
                              char id[ID_SIZE])
{
    struct relight_load load = small_bake(0, 200);
    bake_octahedron(client, d, "small.obj", &load, id);
}

static inline double metric(struct relight_client *client, const char *name)
{
    struct relight_error error;
    struct relight_stats stats;
    double value = -1;
    OK(relight_stats(client, &stats, &error));
    for (size_t i = 0; i < stats.n_metric; i++)
        if (!strcmp(stats.metric[i].name, name)) value = stats.metric[i].value;
    relight_stats_finish(&stats);
    return value;
}

// A raw connection to the unix socket.
static inline int raw_connect(const struct daemon *d)
{
    struct sockaddr_un a = {.sun_family = AF_UNIX};
    snprintf(a.sun_path, sizeof a.sun_path, "%s", d->socket);
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_true(fd >= 0);
    assert_int_equal(connect(fd, (struct sockaddr *)&a, sizeof a), 0);
    return fd;
}

// Bytes until the peer closes or the time is over; *closed tells which.
static inline size_t raw_read(int fd, void *out, size_t n, int ms, bool *closed)
{
    size_t have = 0;
    *closed = false;
    while (have < n) {
        struct pollfd p = {fd, POLLIN, 0};
        if (poll(&p, 1, ms) <= 0) break;
        ssize_t k = read(fd, (char *)out + have, n - have);
        if (k <= 0) {
            *closed = true;
            break;
        }
        have += (size_t)k;
    }
    return have;
}

#endif
