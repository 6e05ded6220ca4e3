// SPDX-License-Identifier: MIT
// Clients that mean no good: broken frames, half frames, floods, and readers that do not read.
// Whatever they do, a well-behaved client beside them is served.
#include "daemon.h"

#include <sys/resource.h>

static struct daemon d;

static int setup(void **state)
{
    static const char *const extra[] = {
        "--frame-time", "1", "--send-buffer", "1M", "--connections", "200", NULL};
    daemon_folder(&d);
    daemon_start(&d, extra);
    return 0;
}

static int teardown(void **state)
{
    int status = daemon_end(&d);
    daemon_remove(&d);
    return status;
}

static void served(void)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    double seconds;
    OK(relight_ping(client, &seconds, &error));
    relight_close(client);
}

// A frame's fixed part.
static size_t frame(uint8_t *out, uint16_t type, uint64_t id, uint32_t header, uint64_t payload)
{
    memset(out, 0, 32);
    memcpy(out, "RLGT\1\2", 6);
    memcpy(out + 6, &type, 2);
    memcpy(out + 8, &id, 8);
    memcpy(out + 16, &header, 4);
    memcpy(out + 24, &payload, 8);
    return 32;
}

static const uint8_t hello_header[] = {0x0a, 1, 't', 0x10, 1, 0x18, 1};

static void say_hello(int fd)
{
    uint8_t bytes[64], answer[2048];
    bool closed;
    frame(bytes, 1, 1, sizeof hello_header, 0);
    memcpy(bytes + 32, hello_header, sizeof hello_header);
    assert_int_equal(write(fd, bytes, 32 + sizeof hello_header), 32 + sizeof hello_header);
    assert_true(raw_read(fd, answer, 32, 5000, &closed) == 32);
    uint32_t n;
    memcpy(&n, answer + 16, 4);
    assert_int_equal(raw_read(fd, answer, n, 5000, &closed), n);
}

// Sends bytes; expects BAD_FRAME (error code 1) under id 0 and the end.
static void expect_bad_frame(const void *bytes, size_t n, bool hello)
{
    uint8_t answer[4096];
    bool closed;
    int fd = raw_connect(&d);
    if (hello) say_hello(fd);
    assert_true(write(fd, bytes, n) == (ssize_t)n);
    size_t have = raw_read(fd, answer, sizeof answer, 5000, &closed);
    assert_true(closed);
    assert_true(have > 34);
    assert_memory_equal(answer, "RLGT\1\2\xff\xff\0\0\0\0\0\0\0\0", 16);
    assert_int_equal(answer[32], 0x08);
    assert_int_equal(answer[33], 1);
    close(fd);
    served();
}

static void test_garbage(void **state)
{
    uint8_t noise[512];
    unsigned x = 12345;
    for (size_t i = 0; i < sizeof noise; i++)
        noise[i] = (uint8_t)((x = x * 1103515245 + 12345) >> 16);
    expect_bad_frame(noise, sizeof noise, false);
    static const char http[] = "GET / HTTP/1.1\r\nHost: somebody\r\n\r\n";
    expect_bad_frame(http, sizeof http - 1, false);
    expect_bad_frame(noise, sizeof noise, true);
}

static void test_frames_beyond_the_limits(void **state)
{
    uint8_t bytes[32];
    frame(bytes, 2, 1, 0, UINT64_C(1) << 40);
    expect_bad_frame(bytes, 32, true);
    frame(bytes, 2, 1, 0xffffffff, 0);
    expect_bad_frame(bytes, 32, true);
    frame(bytes, 1, 1, 4097, 0); // before HELLO 4096 is the limit
    expect_bad_frame(bytes, 32, false);
    frame(bytes, 1, 1, 7, 1); // and no payload is taken
    expect_bad_frame(bytes, 32, false);
    frame(bytes, 1, 1, 7, 0);
    bytes[5] = 2 | 0x04; // an unknown flag that is no hint
    expect_bad_frame(bytes, 32, false);
    bytes[5] = 2 | 0x08;
    expect_bad_frame(bytes, 32, false);
    frame(bytes, 1, 1, 7, 0);
    bytes[4] = 2; // another version
    expect_bad_frame(bytes, 32, false);
}

// Intact frames with nonsense inside are answered under their id, and the connection lives on.
// VIEW_ACK and ROOM_PRESENCE are one-way: the next answer is that of the frame behind them.
static void test_headers_that_do_not_parse(void **state)
{
    enum { VIEW_ACK = 24, ROOM_PRESENCE = 33 };
    uint8_t bytes[64], answer[512];
    bool closed;
    int fd = raw_connect(&d);
    say_hello(fd);
    for (uint16_t type = 0; type < 64; type++) {
        frame(bytes, type, 100u + type, 4, 0);
        memcpy(bytes + 32, "\xff\xff\xff\xff", 4);
        assert_int_equal(write(fd, bytes, 36), 36);
        if (type == VIEW_ACK || type == ROOM_PRESENCE) continue;
        assert_int_equal(raw_read(fd, answer, 32, 5000, &closed), 32);
        assert_memory_equal(answer + 6, "\xff\xff", 2);
        uint64_t id;
        uint32_t n;
        memcpy(&id, answer + 8, 8);
        memcpy(&n, answer + 16, 4);
        assert_int_equal(id, 100 + type);
        assert_true(n < sizeof answer);
        assert_int_equal(raw_read(fd, answer, n, 5000, &closed), n);
    }
    close(fd);
    served();
}

static void test_nothing_before_hello(void **state)
{
    uint8_t bytes[64], answer[512];
    bool closed;
    int fd = raw_connect(&d);
    frame(bytes, 3, 5, 0, 0); // LIST
    assert_int_equal(write(fd, bytes, 32), 32);
    assert_true(raw_read(fd, answer, 34, 5000, &closed) == 34);
    assert_int_equal(answer[33], 4); // FORBIDDEN
    close(fd);
}

// Half frames are dropped after --frame-time, however slowly they drip.
static void test_half_open_connections(void **state)
{
    enum { N = 100 };
    int fd[N];
    uint8_t bytes[32], answer[64];
    frame(bytes, 1, 1, 7, 0);
    for (int i = 0; i < N; i++) {
        fd[i] = raw_connect(&d);
        assert_int_equal(write(fd[i], bytes, (size_t)(i % 31) + 1), i % 31 + 1);
    }
    served();
    sleep_ms(1500);
    for (int i = 0; i < N; i++) {
        bool closed;
        raw_read(fd[i], answer, sizeof answer, 3000, &closed);
        assert_true(closed);
        close(fd[i]);
    }
    served();
}

static void test_connection_limit(void **state)
{
    enum { N = 260 };
    static int fd[N];
    uint8_t answer[1024];
    int refused = 0;
    for (int i = 0; i < N; i++) fd[i] = raw_connect(&d);
    for (int i = N - 1; i >= 0; i--) {
        bool closed;
        struct pollfd p = {fd[i], POLLIN, 0};
        if (poll(&p, 1, i == N - 1 ? 3000 : 0) <= 0) continue;
        raw_read(fd[i], answer, sizeof answer, 100, &closed);
        refused += closed;
    }
    assert_true(refused >= N - 200);
    for (int i = 0; i < N; i++) close(fd[i]);
    sleep_ms(200);
    served();
}

static long resident_kb(void)
{
    char path[64], *text, *at;
    snprintf(path, sizeof path, "/proc/%d/status", (int)d.pid);
    text = read_text(path);
    at = strstr(text, "VmRSS:");
    long kb = at ? atol(at + 6) : 0;
    free(text);
    return kb;
}

// AddressSanitizer does not give back what was freed.
#ifdef __SANITIZE_ADDRESS__
enum { KEEPS_FREED = 1 };
#else
enum { KEEPS_FREED = 0 };
#endif

// A client that asks and never reads: nothing more is read from it, and memory stays bounded.
static void test_reader_that_does_not_read(void **state)
{
    enum { PAYLOAD = 64 << 10, N = 2000 };
    uint8_t *bytes = calloc(1, 64 + PAYLOAD);
    int fd = raw_connect(&d);
    say_hello(fd);
    fcntl(fd, F_SETFL, O_NONBLOCK);
    long before = resident_kb();
    size_t sent = 0;
    int stuck = 0;
    for (uint64_t i = 0; i < N && stuck < 20; i++) {
        frame(bytes, 2, i + 10, 0, PAYLOAD);
        for (size_t at = 0; at < 64 + PAYLOAD && stuck < 20;) {
            ssize_t n = write(fd, bytes + at, 64 + PAYLOAD - at);
            if (n > 0) {
                at += (size_t)n;
                sent += (size_t)n;
                stuck = 0;
            } else {
                stuck++;
                sleep_ms(10);
            }
        }
    }
    assert_int_equal(stuck, 20);   // back pressure reached us
    assert_true(sent < 64u << 20); // long before all was taken
    assert_true(KEEPS_FREED || resident_kb() - before < 64 << 10);
    served();
    close(fd);
    free(bytes);
    served();
}

// Many small requests in one write come back complete, in whatever order.
static void test_flood_of_pings(void **state)
{
    enum { N = 200 };
    static uint8_t bytes[N * 32], answer[1 << 16];
    int fd = raw_connect(&d);
    bool closed;
    say_hello(fd);
    for (int i = 0; i < N; i++) frame(bytes + 32 * i, 2, (uint64_t)i + 2, 0, 0);
    assert_int_equal(write(fd, bytes, sizeof bytes), sizeof bytes);
    int n_answer = 0;
    while (n_answer < N) {
        assert_int_equal(raw_read(fd, answer, 32, 5000, &closed), 32);
        uint32_t n;
        memcpy(&n, answer + 16, 4);
        assert_int_equal(raw_read(fd, answer, n, 5000, &closed), n);
        n_answer++;
    }
    close(fd);
}

static double now_ms(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec * 1e3 + (double)t.tv_nsec * 1e-6;
}

// Many cheap requests in one piece take turns with the others' frames: 4000 LISTs, some tenths
// of a second of work, were answered before anybody else's ping.
static void test_flood_of_lists(void **state)
{
    enum { N = 4000, MODELS = 60 };
    static uint8_t bytes[N * 32], answer[1 << 16];
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_loaded loaded;
    char hash[65], text[64];
    OK(relight_upload(client, "o.obj", octahedron, strlen(octahedron), NULL, NULL, hash, NULL,
                      &error));
    struct relight_file file = {"o.obj", hash};
    for (int i = 0; i < MODELS; i++) {
        struct relight_load load = {.files = &file,
                                    .n_file = 1,
                                    .size_mm = 10 + (float)i / 8,
                                    .material = "marble",
                                    .preview = true};
        snprintf(text, sizeof text, "model %d", i);
        load.name = text;
        OK(relight_load(client, &load, &loaded, &error));
        relight_loaded_finish(&loaded);
    }
    int fd = raw_connect(&d);
    say_hello(fd);
    for (int i = 0; i < N; i++) frame(bytes + 32 * i, 3, (uint64_t)i + 2, 0, 0);
    pid_t reader = fork();
    if (!reader) {
        while (read(fd, answer, sizeof answer) > 0) continue;
        _exit(0);
    }
    double begin = now_ms(), longest = 0, seconds;
    assert_int_equal(write(fd, bytes, sizeof bytes), sizeof bytes);
    while (now_ms() - begin < 1000) {
        OK(relight_ping(client, &seconds, &error));
        if (seconds * 1e3 > longest) longest = seconds * 1e3;
    }
    print_message("the longest ping took %.0f ms\n", longest);
    kill(reader, SIGKILL);
    waitpid(reader, NULL, 0);
    close(fd);
    relight_close(client);
    assert_true(longest < 150);
}

static void test_upload_of_other_bytes(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    double seconds;
    OK(relight_ping(client, &seconds, &error));
    // PUT_BLOB by hand: the promised hash is not the bytes'
    uint8_t bytes[256] = {0}, answer[512];
    bool closed;
    int fd = raw_connect(&d);
    say_hello(fd);
    uint8_t header[80] = {0x0a, 64};
    memset(header + 2, 'a', 64);
    header[66] = 0x10; // size
    header[67] = 4;
    frame(bytes, 4, 9, 68, 4);
    memcpy(bytes + 32, header, 68);
    memcpy(bytes + 128, "data", 4); // 32 + 68 rounded up to 64s
    assert_int_equal(write(fd, bytes, 132), 132);
    assert_int_equal(raw_read(fd, answer, 34, 5000, &closed), 34);
    assert_memory_equal(answer + 6, "\xff\xff", 2);
    assert_int_equal(answer[33], 13); // HASH
    close(fd);
    relight_close(client);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_garbage),
        cmocka_unit_test(test_frames_beyond_the_limits),
        cmocka_unit_test(test_headers_that_do_not_parse),
        cmocka_unit_test(test_nothing_before_hello),
        cmocka_unit_test(test_half_open_connections),
        cmocka_unit_test(test_connection_limit),
        cmocka_unit_test(test_reader_that_does_not_read),
        cmocka_unit_test(test_flood_of_pings),
        cmocka_unit_test(test_flood_of_lists),
        cmocka_unit_test(test_upload_of_other_bytes),
    };
    signal(SIGPIPE, SIG_IGN);
    struct rlimit files = {4096, 4096};
    setrlimit(RLIMIT_NOFILE, &files);
    return cmocka_run_group_tests_name("hostile", tests, setup, teardown);
}
