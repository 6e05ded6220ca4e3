// SPDX-License-Identifier: MIT
// The configuration of a daemon: what --check says, what a start refuses, what SIGHUP changes,
// and the mode, group and lock of unix sockets.
#include "daemon.h"

static struct daemon d;

static int setup(void **state)
{
    daemon_folder(&d);
    return 0;
}

static int teardown(void **state)
{
    daemon_remove(&d);
    return 0;
}

static int after_each(void **state)
{
    if (d.pid) daemon_stop(&d);
    return 0;
}

// Runs relightd with these arguments; its exit status, its output in text.
static int run(const char *const arguments[], char *text, size_t room)
{
    const char *argv[20] = {PRT_BINARY_DIR "/relightd"};
    int out[2], how;
    bool closed;
    for (int i = 0; arguments[i]; i++) argv[i + 1] = arguments[i];
    assert_int_equal(pipe(out), 0);
    pid_t pid = fork();
    if (pid == 0) {
        dup2(out[1], 1);
        dup2(out[1], 2);
        close(out[0]);
        close(out[1]);
        execv(argv[0], (char *const *)argv);
        _exit(127);
    }
    close(out[1]);
    text[raw_read(out[0], text, room - 1, 10000, &closed)] = 0;
    close(out[0]);
    if (!closed) kill(pid, SIGKILL);
    assert_int_equal(waitpid(pid, &how, 0), pid);
    return WIFEXITED(how) ? WEXITSTATUS(how) : -1;
}

// --check prints one line with `word` and leaves with `status`.
static void check(int status, const char *word, const char *const options[])
{
    const char *arguments[20] = {"--check"};
    char text[4096];
    for (int i = 0; options[i]; i++) arguments[i + 1] = options[i];
    int got = run(arguments, text, sizeof text);
    if (got != status || !strstr(text, word) || strchr(text, '\n') != text + strlen(text) - 1)
        fail_msg("status %d: %s", got, text);
}

#define CHECK(status, word, ...) check(status, word, (const char *const[]){__VA_ARGS__, NULL})

static void test_check(void **state)
{
    char token[128], own[128], data[160];
    snprintf(token, sizeof token, "%s/check-token", d.folder);
    snprintf(own, sizeof own, "%s/own", d.folder);
    snprintf(data, sizeof data, "%s/own/models", d.folder);
    mkdir(own, 0700);
    mkdir(data, 0700);
    CHECK(0, "fine", "--data", own, "--models", d.models, "--http", "localhost:0");
    CHECK(2, "no-such", "--models", "/no-such");
    CHECK(2, "no-such", "--page", "/no-such");
    CHECK(2, "no-such", "--data", "/no-such/data");
    CHECK(2, "outside --data", "--data", own, "--models", data);
    CHECK(2, "check-token", "--token-file", token);
    write_text(token, "\n");
    CHECK(2, "no token", "--token-file", token);
    write_text(token, "sesame\n");
    CHECK(0, "fine", "--token-file", token, "--listen", "tcp:*:0");
    CHECK(2, "HOST:PORT", "--http", "127.0.0.1");
    CHECK(2, "HOST:PORT", "--http", "127.0.0.1:70000");
    CHECK(2, "HOST:PORT", "--http", "::1:80");
    CHECK(2, "nowhere.invalid", "--listen", "tcp:nowhere.invalid:80");
    CHECK(2, "socket-mode", "--socket-mode", "0999");
    CHECK(2, "no such group", "--socket-group", "no-such-group", "--listen", "unix:/tmp/x");
    CHECK(2, "--log", "--log", "everything");
    CHECK(2, "no-such", "--config", "/no-such");
    char config[128];
    snprintf(config, sizeof config, "%s/check.conf", d.folder);
    write_text(config, "# a comment\naccept-anyone = perhaps\n");
    CHECK(2, "check.conf:2: accept-anyone", "--config", config);
    write_text(config, "accept-anyone = yes\nlisten = tcp:0.0.0.0:0\n");
    CHECK(0, "fine", "--config", config);
    static const char cut[] = "accept-anyone = yes\0\nlog = trace\n";
    FILE *file = fopen(config, "w");
    assert_non_null(file);
    assert_int_equal(fwrite(cut, 1, sizeof cut - 1, file), sizeof cut - 1);
    assert_int_equal(fclose(file), 0);
    CHECK(2, "zero byte", "--config", config);
    // A start refuses what --check refuses.
    char text[4096];
    const char *const start[] = {"--data",          own, "--models", data, "--listen",
                                 "tcp:127.0.0.1:0", NULL};
    assert_int_equal(run(start, text, sizeof text), 1);
    assert_non_null(strstr(text, "outside --data"));
}

// Beyond loopback a token is wanted, or to be told that none is.
static void test_open_to_anyone(void **state)
{
    char text[4096];
    static const char *const open_tcp[] = {"--listen", "tcp:0.0.0.0:0", NULL};
    static const char *const open_http[] = {"--listen", "tcp:127.0.0.1:0", "--http", "*:0",
                                            NULL};
    assert_int_equal(run(open_tcp, text, sizeof text), 1);
    assert_non_null(strstr(text, "--accept-anyone"));
    assert_int_equal(run(open_http, text, sizeof text), 1);
    assert_non_null(strstr(text, "--accept-anyone"));
    const char *const accepted[] = {"--listen", "tcp:0.0.0.0:0", "--accept-anyone", NULL};
    daemon_start(&d, accepted);
    assert_true(log_says(&d, "warning listen 0.0.0.0:", 100));
    assert_int_equal(daemon_stop(&d), 0);
    char token[128];
    snprintf(token, sizeof token, "%s/token", d.folder);
    write_text(token, "sesame\n");
    const char *const with_token[] = {"--listen", "tcp:0.0.0.0:0", "--token-file", token, NULL};
    daemon_start(&d, with_token);
    assert_false(log_says(&d, "warning listen", 0));
    assert_int_equal(daemon_stop(&d), 0);
}

static int say_hello_with(const char *token)
{
    struct relight_client *client;
    struct relight_error error;
    struct relight_options options = {.token = token};
    int status = relight_connect(d.address, &options, &client, &error);
    if (!status) relight_close(client);
    return status;
}

static int count_in_log(const char *word)
{
    char *text = read_text(d.log);
    int n = 0;
    for (const char *at = text; (at = strstr(at, word)); at++) n++;
    free(text);
    return n;
}

static void test_reload(void **state)
{
    char config[128], token[128], text[1024];
    snprintf(config, sizeof config, "%s/conf", d.folder);
    snprintf(token, sizeof token, "%s/token", d.folder);
    write_text(token, "first\n");
    snprintf(text, sizeof text, "token-file = %s\nlog = event\nqueue = 4096\n", token);
    write_text(config, text);
    // The command line goes before the file, at each reading.
    const char *const extra[] = {"--config", config, "--requests", "7", NULL};
    daemon_start(&d, extra);
    struct relight_client *client, *own = client_open(d.address);
    struct relight_error error;
    struct relight_options options = {.token = "first"};
    OK(relight_connect(d.address, &options, &client, &error));
    write_text(token, "second\n");
    snprintf(text, sizeof text,
             "token-file = %s\nlog = trace\nqueue = 5000\nhosts = new.example\nrequests = 9\n"
             "threads = 3\nbakes = 2\nlog-access = event\n",
             token);
    write_text(config, text);
    assert_int_equal(kill(d.pid, SIGHUP), 0);
    assert_true(log_says(&d, "reload done changed=5 needs_restart=2", 5000));
    static const char *const words[] = {
        "reload option=token value=\"(secret)\"",
        "reload option=log value=\"trace\"",
        "reload option=queue value=\"5000\"",
        "reload option=hosts value=\"new.example\"",
        "reload option=log-access value=\"event\"",
        "reload option=threads: the new value \"3\" needs a restart",
        "reload option=bakes: the new value \"2\" needs a restart"};
    for (size_t i = 0; i < sizeof words / sizeof *words; i++)
        if (!log_says(&d, words[i], 0)) fail_msg("the log does not say: %s", words[i]);
    assert_int_equal(count_in_log("second"), 0); // a secret
    double seconds;
    assert_int_equal(count_in_log(" event access "), 0);
    OK(relight_ping(own, &seconds, &error)); // who is in without a token stays in
    assert_true(
        log_says(&d, " event access request=", 5000)); // requests are logged as it says now
    assert_int_not_equal(relight_ping(client, &seconds, &error), 0); // its token has gone
    relight_close(client);
    OK(relight_connect(d.address, &(struct relight_options){.token = "second"}, &client,
                       &error));
    assert_int_equal(kill(d.pid, SIGHUP), 0); // with the same token
    assert_true(log_says(&d, "reload done changed=0", 5000));
    OK(relight_ping(client, &seconds, &error));
    relight_close(client);
    relight_close(own);
    assert_int_equal(say_hello_with("first"), -RELIGHT_E_FORBIDDEN);
    assert_int_equal(say_hello_with("second"), 0);
    // A fault changes nothing.
    write_text(config, "queue = many\n");
    assert_int_equal(kill(d.pid, SIGHUP), 0);
    assert_true(log_says(&d, "conf:1: queue: expected a number >= 0", 5000));
    write_text(config, "queue = 1\n"); // without its token file
    assert_int_equal(kill(d.pid, SIGHUP), 0);
    assert_true(log_says(&d, "removing the token needs a restart", 5000));
    unlink(config);
    assert_int_equal(kill(d.pid, SIGHUP), 0);
    assert_true(log_says(&d, "No such file", 5000));
    assert_int_equal(count_in_log("reload refused, nothing changed"), 3);
    assert_int_equal(say_hello_with("second"), 0);
    assert_int_equal(daemon_stop(&d), 0);
}

// ---- unix sockets

static void test_socket_mode_and_group(void **state)
{
    struct stat st;
    daemon_start(&d, NULL);
    assert_int_equal(stat(d.socket, &st), 0);
    assert_int_equal(st.st_mode & 0777, 0660);
    assert_int_equal(daemon_stop(&d), 0);
    char group[32];
    gid_t gid = getuid() ? getgid() : 65534;
    snprintf(group, sizeof group, "%u", (unsigned)gid);
    const char *const extra[] = {"--socket-mode", "0602", "--socket-group", group, NULL};
    daemon_start(&d, extra);
    assert_int_equal(stat(d.socket, &st), 0);
    assert_int_equal(st.st_mode & 0777, 0602);
    assert_int_equal(st.st_gid, gid);
    assert_int_equal(daemon_stop(&d), 0);
}

// A lock file that somebody laid in the way is neither followed nor used.
static void test_lock_of_a_stranger(void **state)
{
    char lock[160], aim[160], text[4096];
    struct stat st;
    snprintf(lock, sizeof lock, "%s.lock", d.socket);
    snprintf(aim, sizeof aim, "%s/aim", d.folder);
    const char *const arguments[] = {"--listen", d.address, NULL};
    assert_int_equal(symlink(aim, lock), 0);
    assert_int_equal(run(arguments, text, sizeof text), 1);
    assert_non_null(strstr(text, "a link"));
    assert_int_equal(lstat(aim, &st), -1); // it was not made
    unlink(lock);
    if (getuid()) return; // the rest gives a file away
    int fd = open(lock, O_CREAT | O_RDWR | O_CLOEXEC, 0666);
    assert_int_equal(fchown(fd, 65534, 65534), 0);
    assert_int_equal(run(arguments, text, sizeof text), 1);
    assert_non_null(strstr(text, "another user"));
    close(fd);
    unlink(lock);
}

// ---- systemd

// The words that the daemon sends to systemd, until `word` comes or the time is over.
static bool told(int fd, const char *word, int ms)
{
    for (struct pollfd p = {fd, POLLIN, 0}; poll(&p, 1, ms) > 0;) {
        char text[512];
        ssize_t n = recv(fd, text, sizeof text - 1, 0);
        text[n > 0 ? n : 0] = 0;
        if (strstr(text, word)) return true;
    }
    return false;
}

static void test_tells_systemd(void **state)
{
    char config[128];
    struct sockaddr_un a = {.sun_family = AF_UNIX};
    snprintf(a.sun_path, sizeof a.sun_path, "%s/notify", d.folder);
    snprintf(config, sizeof config, "%s/conf", d.folder);
    write_text(config, "queue = 100\n");
    int fd = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    assert_int_equal(bind(fd, (struct sockaddr *)&a, sizeof a), 0);
    setenv("NOTIFY_SOCKET", a.sun_path, 1);
    setenv("WATCHDOG_USEC", "400000", 1);
    const char *const extra[] = {"--config", config, NULL};
    daemon_start(&d, extra);
    unsetenv("NOTIFY_SOCKET");
    unsetenv("WATCHDOG_USEC");
    for (int i = 0; i < 3; i++) assert_true(told(fd, "WATCHDOG=1", 2000));
    assert_int_equal(kill(d.pid, SIGHUP), 0);
    assert_true(told(fd, "RELOADING=1", 2000));
    assert_true(told(fd, "READY=1", 2000));
    assert_int_equal(daemon_stop(&d), 0);
    assert_true(told(fd, "STOPPING=1", 2000));
    close(fd);
    unlink(a.sun_path);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_check),
        cmocka_unit_test_teardown(test_open_to_anyone, after_each),
        cmocka_unit_test_teardown(test_reload, after_each),
        cmocka_unit_test_teardown(test_socket_mode_and_group, after_each),
        cmocka_unit_test_teardown(test_lock_of_a_stranger, after_each),
        cmocka_unit_test_teardown(test_tells_systemd, after_each),
    };
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("reload", tests, setup, teardown);
}
