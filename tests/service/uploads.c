// SPDX-License-Identifier: MIT
// Uploads to a running daemon: workers do the work, principals do not meet, restarts lose
// nothing.
#include "daemon.h"

#include "frame.h"
#include "relight.pb-c.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <pthread.h>
#include <sys/resource.h>

static struct daemon d;
static const char *const options[] = {"--client-uploads", "3", NULL};

static int setup(void **state)
{
    daemon_folder(&d);
    daemon_start(&d, options);
    return 0;
}

static int teardown(void **state)
{
    int status = daemon_end(&d);
    daemon_remove(&d);
    return status;
}

static void restart(bool killed)
{
    if (killed) {
        kill(d.pid, SIGKILL);
        waitpid(d.pid, NULL, 0);
        d.pid = 0;
    } else {
        assert_int_equal(daemon_stop(&d), 0);
    }
    daemon_start(&d, options);
}

// ---- frames by hand: librelight sends chunks of 1 MiB

static void send_all(int fd, const void *bytes, size_t n)
{
    for (size_t sent = 0; sent < n;) {
        ssize_t k = write(fd, (const char *)bytes + sent, n - sent);
        if (k < 0 && errno == EINTR) continue;
        assert_true(k > 0);
        sent += (size_t)k;
    }
}

static void send_frame(int fd, uint16_t type, uint64_t id, const ProtobufCMessage *message,
                       const void *bytes, size_t n)
{
    struct relight_frame frame = {
        .flags = RELIGHT_FRAME_LAST, .type = type, .id = id, .payload_size = n};
    uint8_t *head;
    size_t size;
    assert_int_equal(relight_frame_pack(&frame, message, 0, 0, &head, &size), 0);
    send_all(fd, head, size);
    free(head);
    send_all(fd, bytes, n);
}

// Of the answer that was received last: bytes of its payload, and zeros before them.
static size_t payload_size, payload_pad;

// The next answer's type; its message is the caller's, and its payload is still to be read.
static uint16_t receive(int fd, uint64_t id, ProtobufCMessage **out)
{
    uint8_t fixed[32], header[4096];
    bool closed;
    struct relight_frame frame = {0};
    assert_int_equal(raw_read(fd, fixed, 32, 60000, &closed), 32);
    memcpy(&frame.type, fixed + 6, 2);
    memcpy(&frame.id, fixed + 8, 8);
    memcpy(&frame.header_size, fixed + 16, 4);
    assert_true(frame.header_size <= sizeof header);
    assert_int_equal(raw_read(fd, header, frame.header_size, 60000, &closed),
                     frame.header_size);
    assert_int_equal(frame.id, id);
    memcpy(&frame.payload_size, fixed + 24, 8);
    payload_size = frame.payload_size;
    payload_pad = -(sizeof fixed + frame.header_size) % RELIGHT_FRAME_ALIGN;
    frame.payload_size = 0;
    frame.header = header;
    assert_non_null(*out = relight_frame_unpack(&frame));
    return frame.type;
}

static void hello(int fd)
{
    Relight__HelloRequest m = RELIGHT__HELLO_REQUEST__INIT;
    ProtobufCMessage *answer;
    m.client = "uploads";
    m.version_min = m.version_max = RELIGHT_PROTOCOL_VERSION;
    send_frame(fd, RELIGHT_TYPE_HELLO, 1, &m.base, NULL, 0);
    assert_int_equal(receive(fd, 1, &answer), RELIGHT_TYPE_HELLO | RELIGHT_TYPE_ANSWER);
    protobuf_c_message_free_unpacked(answer, NULL);
}

// As the local user, or as the address 127.0.0.1.
static int open_local(void)
{
    int fd = raw_connect(&d);
    hello(fd);
    return fd;
}

static int open_remote(void)
{
    struct sockaddr_in a = {.sin_family = AF_INET,
                            .sin_port = htons((uint16_t)atoi(strchr(d.tcp, ':') + 1)),
                            .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_int_equal(connect(fd, (struct sockaddr *)&a, sizeof a), 0);
    hello(fd);
    return fd;
}

struct put {
    const char *hash, *name;
    uint64_t size, offset;
    const void *bytes;
    size_t n;
};

static void put_begin(int fd, uint64_t id, const struct put *p)
{
    Relight__PutBlobRequest m = RELIGHT__PUT_BLOB_REQUEST__INIT;
    m.hash = (char *)p->hash;
    m.name = p->name ? (char *)p->name : "";
    m.size = p->size;
    m.offset = p->offset;
    send_frame(fd, RELIGHT_TYPE_PUT_BLOB, id, &m.base, p->bytes, p->n);
}

// 0, or the error's code.
static int put_end(int fd, uint64_t id, uint64_t *received, bool *complete)
{
    ProtobufCMessage *message;
    int code = 0;
    *received = 0;
    *complete = false;
    if (receive(fd, id, &message) == RELIGHT_TYPE_ERROR) {
        code = (int)((Relight__Error *)message)->code;
        print_message("%s\n", ((Relight__Error *)message)->text);
    } else {
        *received = ((Relight__PutBlobAnswer *)message)->received;
        *complete = ((Relight__PutBlobAnswer *)message)->complete;
    }
    protobuf_c_message_free_unpacked(message, NULL);
    return code;
}

static int put(int fd, const struct put *p, uint64_t *received, bool *complete)
{
    static uint64_t id = 1000;
    put_begin(fd, ++id, p);
    return put_end(fd, id, received, complete);
}

// Asks for a range of an upload and compares what comes with `want` bytes from there on.
static int get_range(int fd, const char *hash, uint64_t offset, uint64_t size,
                     const uint8_t *bytes, size_t want)
{
    Relight__GetBlobRequest m = RELIGHT__GET_BLOB_REQUEST__INIT;
    ProtobufCMessage *message;
    uint8_t got[4096];
    bool closed;
    int code = 0;
    m.hash = (char *)hash;
    m.offset = offset;
    m.size = size;
    send_frame(fd, RELIGHT_TYPE_GET_BLOB, 20, &m.base, NULL, 0);
    if (receive(fd, 20, &message) == RELIGHT_TYPE_ERROR)
        code = (int)((Relight__Error *)message)->code;
    protobuf_c_message_free_unpacked(message, NULL);
    assert_int_equal(payload_size, want);
    if (!want) return code;
    assert_true(payload_pad + want <= sizeof got);
    assert_int_equal(raw_read(fd, got, payload_pad + want, 60000, &closed), payload_pad + want);
    assert_memory_equal(got + payload_pad, bytes + offset, want);
    return code;
}

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int by_size(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

// ---- scenarios

// On the loop's thread a chunk of 48 MiB took as long as its hash: 50 ms in which every client
// waited. A ping that is sent behind the chunk's last byte is answered while a worker hashes.
static void test_pings_during_large_chunks(void **state)
{
    enum { N = 9, CHUNK = 48 << 20 };
    static const char hash[] =
        "1111111111111111111111111111111111111111111111111111111111111111";
    char *bytes = malloc(CHUNK);
    assert_non_null(bytes);
    memset(bytes, 7, CHUNK);
    double ping[N], chunk[N];
    int fd = open_local(), other = open_local();
    for (int i = 0; i < N; i++) {
        uint64_t received;
        bool complete;
        ProtobufCMessage *answer;
        Relight__PingRequest m = RELIGHT__PING_REQUEST__INIT;
        struct put p = {.hash = hash,
                        .size = UINT64_C(1) << 30,
                        .offset = (uint64_t)i * CHUNK,
                        .bytes = bytes,
                        .n = CHUNK};
        put_begin(fd, 10, &p);
        double begin = now_s();
        send_frame(other, RELIGHT_TYPE_PING, 10, &m.base, NULL, 0);
        assert_int_equal(receive(other, 10, &answer), RELIGHT_TYPE_PING | RELIGHT_TYPE_ANSWER);
        ping[i] = now_s() - begin;
        protobuf_c_message_free_unpacked(answer, NULL);
        assert_int_equal(put_end(fd, 10, &received, &complete), 0);
        chunk[i] = now_s() - begin;
        assert_int_equal(received, (uint64_t)(i + 1) * CHUNK);
    }
    close(fd);
    close(other);
    free(bytes);
    qsort(ping, N, sizeof *ping, by_size);
    qsort(chunk, N, sizeof *chunk, by_size);
    print_message("pings behind chunks of 48 MiB: median %.2f ms, longest %.2f ms; the chunks: "
                  "median %.1f ms\n",
                  1e3 * ping[N / 2], 1e3 * ping[N - 1], 1e3 * chunk[N / 2]);
    // On a machine that does other things both get longer.
    assert_true(ping[N / 2] < 0.02 || ping[N / 2] < chunk[N / 2] / 2);
    assert_true(ping[N / 2] < chunk[N / 2]);
}

// A principal who promises another size, or never goes on, is in nobody's way.
static const char payload_held[] = "relightd_resource_held{resource=\"payload\"}";

// GET_BLOB sends the part that was asked for, to the end where no size or too much was.
static void test_parts_come_back(void **state)
{
    enum { N = 1000 };
    uint8_t bytes[N];
    char hash[65];
    struct relight_sha256 sha;
    uint64_t received;
    bool complete;
    for (int i = 0; i < N; i++) bytes[i] = (uint8_t)(i * 2654435761u >> 13);
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, bytes, N);
    relight_sha256_hex(&sha, hash);
    int fd = open_local();
    struct put p = {.hash = hash, .size = N, .bytes = bytes, .n = N};
    assert_int_equal(put(fd, &p, &received, &complete), 0);
    assert_true(complete);
    struct relight_client *client = client_open(d.address);
    const double before = metric(client, payload_held);
    assert_int_equal(get_range(fd, hash, 0, 0, bytes, N), 0);
    assert_int_equal(get_range(fd, hash, 0, 1, bytes, 1), 0);
    assert_int_equal(get_range(fd, hash, 100, 50, bytes, 50), 0);
    assert_int_equal(get_range(fd, hash, N - 5, 50, bytes, 5), 0);
    assert_int_equal(get_range(fd, hash, N, 0, bytes, 0), 0);
    assert_int_equal(get_range(fd, hash, N + 1, 0, bytes, 0),
                     RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE);
    // The memory that was charged for the answers is given back.
    assert_true(metric(client, payload_held) == before);
    relight_close(client);
    close(fd);
}

static void test_hash_of_another_upload(void **state)
{
    static const char text[] = "the bytes that both of them know";
    char hash[65];
    uint64_t received;
    bool complete;
    relight_hash(text, sizeof text, hash);
    int squatter = open_remote(), user = open_local();
    struct put wrong = {.hash = hash, .size = 5, .bytes = text, .n = 1};
    struct put half = {.hash = hash, .size = sizeof text, .bytes = text, .n = 9};
    struct put whole = {.hash = hash, .size = sizeof text, .bytes = text, .n = sizeof text};
    assert_int_equal(put(squatter, &wrong, &received, &complete), 0);
    assert_int_equal(put(squatter, &half, &received, &complete), 0);
    assert_int_equal(received, 9);
    assert_int_equal(put(user, &half, &received, &complete), 0);
    assert_int_equal(received, 9); // its own, not what the other sent
    assert_int_equal(put(user, &whole, &received, &complete), 0);
    assert_true(complete);
    half.offset = 9;
    half.n = 1;
    assert_int_equal(put(squatter, &half, &received, &complete), 0);
    assert_true(complete);
    assert_int_equal(received, sizeof text);
    close(squatter);
    close(user);
}

// --client-uploads bounds one principal; another goes on.
static void test_uploads_are_bounded_by_principal(void **state)
{
    char hash[65], bytes[2] = "..";
    uint64_t received;
    bool complete;
    int greedy = open_remote(), user = open_local(), refused = 0;
    for (int i = 0; i < 5; i++) {
        memset(hash, 'b', 64);
        hash[64] = 0;
        hash[0] = (char)('0' + i);
        struct put p = {.hash = hash, .size = 2, .bytes = bytes, .n = 1};
        int code = put(greedy, &p, &received, &complete);
        assert_true(code == 0 || code == RELIGHT__ERROR_CODE__ERROR_BUSY);
        refused += code != 0;
    }
    assert_true(refused >= 2);
    memset(hash, 'c', 64);
    struct put p = {.hash = hash, .size = 2, .bytes = bytes, .n = 1};
    assert_int_equal(put(user, &p, &received, &complete), 0);
    close(greedy);
    close(user);
}

static void continue_after(bool killed)
{
    static char bytes[300000];
    char hash[65];
    uint64_t received;
    bool complete;
    memset(bytes, killed ? 'k' : 't', sizeof bytes);
    relight_hash(bytes, sizeof bytes, hash);
    struct put p = {.hash = hash, .size = sizeof bytes, .bytes = bytes, .n = 100000};
    int fd = open_remote();
    assert_int_equal(put(fd, &p, &received, &complete), 0);
    close(fd);
    restart(killed);
    fd = open_remote();
    p.n = 0;
    assert_int_equal(put(fd, &p, &received, &complete), 0);
    assert_false(complete);
    assert_int_equal(received, 100000);
    p.offset = received;
    p.bytes = bytes + received;
    p.n = sizeof bytes - received;
    assert_int_equal(put(fd, &p, &received, &complete), 0);
    assert_true(complete);
    close(fd);
}

static void test_upload_goes_on_after_a_restart(void **state)
{
    restart(false); // the slots of earlier tests are still held: they are resumable, too
    daemon_stop(&d);
    daemon_remove(&d);
    setup(NULL);
    continue_after(false);
    continue_after(true);
}

// A power cut may leave a short file under a hash.
static void test_damaged_blob_is_not_used(void **state)
{
    static const char text[] = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    char hash[65], path[300];
    uint64_t sent;
    OK(relight_upload(client, "t.obj", text, sizeof text - 1, NULL, NULL, hash, NULL, &error));
    relight_close(client);
    snprintf(path, sizeof path, "%s/blobs/%s", d.data, hash);
    assert_int_equal(daemon_stop(&d), 0);
    assert_int_equal(truncate(path, 20), 0);
    daemon_start(&d, options);
    client = client_open(d.address);
    struct relight_file file = {"t.obj", hash};
    struct relight_load load = {
        .size_mm = 10, .material = "marble", .preview = true, .n_file = 1, .files = &file};
    struct relight_loaded loaded;
    assert_int_equal(relight_load(client, &load, &loaded, &error), -RELIGHT_E_NOT_FOUND);
    assert_non_null(strstr(error.text, "damaged"));
    OK(relight_upload(client, "t.obj", text, sizeof text - 1, NULL, NULL, hash, &sent, &error));
    assert_int_equal(sent, sizeof text - 1);
    OK(relight_load(client, &load, &loaded, &error));
    relight_loaded_finish(&loaded);
    relight_close(client);
}

static void *shorten(void *path)
{
    usleep(3000);
    assert_int_equal(truncate(path, 4096), 0);
    return NULL;
}

// A file that becomes shorter while it is uploaded is an error, and ends no program.
static void test_file_that_shrinks(void **state)
{
    enum { SIZE = 64 << 20 };
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    char hash[65], path[300];
    snprintf(path, sizeof path, "%s/shrinks.obj", d.folder);
    for (int turn = 0; turn < 4; turn++) {
        pthread_t thread;
        const int fd = open(path, O_CREAT | O_TRUNC | O_WRONLY | O_CLOEXEC, 0600);
        assert_true(fd >= 0);
        assert_int_equal(ftruncate(fd, SIZE), 0);
        close(fd);
        assert_int_equal(pthread_create(&thread, NULL, shorten, path), 0);
        const int status = relight_upload_file(client, path, NULL, NULL, hash, NULL, &error);
        pthread_join(thread, NULL);
        assert_true(!status || status == -RELIGHT_E_FILE);
        if (status) assert_non_null(strstr(error.text, "became shorter"));
    }
    unlink(path);
    relight_close(client);
}

// An upload whose file went away behind the daemon is not found when a model needs it.
static void test_file_of_an_upload_is_gone(void **state)
{
    static const char text[] = "v 0 0 0\nv 2 0 0\nv 0 2 0\nf 1 2 3\n";
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    char hash[65], path[300];
    OK(relight_upload(client, "gone.obj", text, sizeof text - 1, NULL, NULL, hash, NULL,
                      &error));
    snprintf(path, sizeof path, "%s/blobs/%s", d.data, hash);
    assert_int_equal(unlink(path), 0);
    struct relight_file file = {"gone.obj", hash};
    struct relight_load load = {
        .size_mm = 10, .material = "marble", .preview = true, .n_file = 1, .files = &file};
    struct relight_loaded loaded;
    assert_int_equal(relight_load(client, &load, &loaded, &error), -RELIGHT_E_NOT_FOUND);
    assert_non_null(strstr(error.text, "gone.obj"));
    assert_non_null(strstr(error.text, "upload it again"));
    relight_close(client);
}

// What ENV says about an upload that is no image.
static void env_error(int fd, const char *hash, char text[300])
{
    Relight__EnvRequest m = RELIGHT__ENV_REQUEST__INIT;
    ProtobufCMessage *answer;
    char env[80];
    snprintf(env, sizeof env, "env:%s", hash);
    m.env = env;
    send_frame(fd, RELIGHT_TYPE_ENV, 20, &m.base, NULL, 0);
    assert_int_equal(receive(fd, 20, &answer), RELIGHT_TYPE_ERROR);
    snprintf(text, 300, "%s", ((Relight__Error *)answer)->text);
    protobuf_c_message_free_unpacked(answer, NULL);
}

static void test_names_are_not_shown_to_others(void **state)
{
    static const char bytes[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 20 +X 40\nshort";
    char hash[65], text[300], digits[20];
    uint64_t received;
    bool complete;
    relight_hash(bytes, sizeof bytes, hash);
    snprintf(digits, sizeof digits, "%.12s", hash);
    int owner = open_local(), other = open_remote();
    struct put p = {.hash = hash,
                    .name = "merger.hdr",
                    .size = sizeof bytes,
                    .bytes = bytes,
                    .n = sizeof bytes};
    assert_int_equal(put(owner, &p, &received, &complete), 0);
    assert_true(complete);
    for (int i = 0; i < 2; i++) { // the second time after a restart
        env_error(owner, hash, text);
        assert_non_null(strstr(text, "merger.hdr"));
        env_error(other, hash, text);
        assert_null(strstr(text, "merger"));
        assert_non_null(strstr(text, digits));
        close(owner);
        close(other);
        if (i) break;
        restart(false);
        owner = open_local();
        other = open_remote();
    }
}

// Connections end while workers write their chunks.
static void test_disconnects_during_chunks(void **state)
{
    enum { CHUNK = 8 << 20 };
    char hash[65], *bytes = calloc(1, CHUNK);
    memset(hash, 'd', 64);
    hash[64] = 0;
    for (int i = 0; i < 12; i++) {
        int fd = open_local();
        for (unsigned k = 0; k < 3; k++) {
            struct put p = {.hash = hash,
                            .size = (uint64_t)CHUNK * 100,
                            .offset = (uint64_t)CHUNK * k,
                            .bytes = bytes,
                            .n = CHUNK};
            put_begin(fd, 30 + k, &p);
        }
        sleep_ms(i);
        close(fd);
    }
    free(bytes);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    double seconds;
    OK(relight_ping(client, &seconds, &error));
    relight_close(client);
}

// A file that may grow no further fails its upload. The system also sends SIGXFSZ then, which
// ended the daemon.
static void test_files_of_limited_size(void **state)
{
    enum { MOST = 1 << 20, SIZE = 2 * MOST };
    struct rlimit before, limit;
    uint64_t received;
    bool complete;
    char hash[65];
    char *bytes = calloc(1, SIZE);
    assert_non_null(bytes);
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &before), 0);
    limit = before;
    limit.rlim_cur = MOST;
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &limit), 0);
    restart(false);
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &before), 0);
    memset(hash, 'f', 64);
    hash[64] = 0;
    int fd = open_local();
    struct put p = {.hash = hash, .size = SIZE, .bytes = bytes, .n = SIZE};
    assert_int_not_equal(put(fd, &p, &received, &complete), 0);
    assert_false(complete);
    p = (struct put){.hash = "541b3e9daa09b20bf85fa273e5cbd3e80185aa4ec298e765db87742b70138a53",
                     .size = 1000,
                     .bytes = bytes,
                     .n = 1000};
    assert_int_equal(put(fd, &p, &received, &complete), 0);
    assert_true(complete);
    close(fd);
    free(bytes);
    restart(false);
}

// Every byte on disk is charged after a restart as before it.
static void test_charges_survive_a_restart(void **state)
{
    struct relight_client *client = client_open(d.address);
    double before = metric(client, "relightd_disk_bytes");
    relight_close(client);
    restart(true);
    client = client_open(d.address);
    double after = metric(client, "relightd_disk_bytes");
    relight_close(client);
    if (before != after) fail_msg("%g bytes before, %g after", before, after);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_pings_during_large_chunks),
        cmocka_unit_test(test_parts_come_back),
        cmocka_unit_test(test_hash_of_another_upload),
        cmocka_unit_test(test_uploads_are_bounded_by_principal),
        cmocka_unit_test(test_upload_goes_on_after_a_restart),
        cmocka_unit_test(test_damaged_blob_is_not_used),
        cmocka_unit_test(test_file_that_shrinks),
        cmocka_unit_test(test_file_of_an_upload_is_gone),
        cmocka_unit_test(test_names_are_not_shown_to_others),
        cmocka_unit_test(test_disconnects_during_chunks),
        cmocka_unit_test(test_files_of_limited_size),
        cmocka_unit_test(test_charges_survive_a_restart),
    };
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("uploads", tests, setup, teardown);
}
