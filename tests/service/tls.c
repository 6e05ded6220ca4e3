// SPDX-License-Identifier: MIT
// TLS on TCP, HTTP and WebSocket, with certificates that the test makes.
#include "ask.h"
#include "frames.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/ssl.h>
#include <openssl/x509v3.h>

static struct daemon d;
static char cert[128], key[128], other_cert[128], other_key[128];

// ---- certificates

// Self-signed, for this subject alternative name ("IP:127.0.0.1,DNS:localhost").
static void make_certificate(const char *cert_path, const char *key_path, const char *name,
                             const char *san)
{
    EVP_PKEY *pair = EVP_EC_gen("P-256");
    X509 *x = X509_new();
    assert_true(pair && x);
    X509_set_version(x, 2);
    ASN1_INTEGER_set(X509_get_serialNumber(x), 1);
    X509_gmtime_adj(X509_getm_notBefore(x), -60);
    X509_gmtime_adj(X509_getm_notAfter(x), 86400);
    X509_set_pubkey(x, pair);
    X509_NAME *subject = X509_get_subject_name(x);
    X509_NAME_add_entry_by_txt(subject, "CN", MBSTRING_ASC, (const unsigned char *)name, -1, -1,
                               0);
    X509_set_issuer_name(x, subject);
    X509_EXTENSION *extension = X509V3_EXT_conf_nid(NULL, NULL, NID_subject_alt_name, san);
    assert_non_null(extension);
    X509_add_ext(x, extension, -1);
    assert_true(X509_sign(x, pair, EVP_sha256()) > 0);
    FILE *file = fopen(cert_path, "w");
    assert_non_null(file);
    assert_int_equal(PEM_write_X509(file, x), 1);
    fclose(file);
    file = fopen(key_path, "w");
    assert_non_null(file);
    assert_int_equal(PEM_write_PrivateKey(file, pair, NULL, NULL, 0, NULL, NULL), 1);
    fclose(file);
    X509_EXTENSION_free(extension);
    X509_free(x);
    EVP_PKEY_free(pair);
}

static int setup(void **state)
{
    daemon_folder(&d);
    snprintf(cert, sizeof cert, "%s/cert.pem", d.folder);
    snprintf(key, sizeof key, "%s/key.pem", d.folder);
    snprintf(other_cert, sizeof other_cert, "%s/other-cert.pem", d.folder);
    snprintf(other_key, sizeof other_key, "%s/other-key.pem", d.folder);
    return 0;
}

static int teardown(void **state)
{
    daemon_remove(&d);
    return 0;
}

static int before_each(void **state)
{
    make_certificate(cert, key, "first", "IP:127.0.0.1,DNS:localhost");
    make_certificate(other_cert, other_key, "second", "IP:127.0.0.1,DNS:localhost");
    return 0;
}

static int after_each(void **state)
{
    if (d.pid) daemon_stop(&d);
    return 0;
}

static char tls_address[80];

// extra may be NULL; at most four words.
static void start(const char *const extra[])
{
    const char *all[16] = {"--http", "127.0.0.1:0", "--tls-cert", cert, "--tls-key", key};
    for (int i = 0; extra && extra[i]; i++) all[6 + i] = extra[i];
    daemon_start(&d, all);
    find_address(&d, "listen address=tls:", d.tcp, sizeof d.tcp);
    find_address(&d, "listen address=https:", d.http, sizeof d.http);
    snprintf(tls_address, sizeof tls_address, "tls:%s", d.tcp);
}

static int connect_raw(const char *name)
{
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    a.sin_port = htons((uint16_t)atoi(strrchr(name, ':') + 1));
    int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_int_equal(connect(fd, (struct sockaddr *)&a, sizeof a), 0);
    return fd;
}

static int open_tls(const char *ca, struct relight_client **out, struct relight_error *error)
{
    struct relight_options options = {.ca = ca, .timeout_s = 20};
    return relight_connect(tls_address, &options, out, error);
}

// ---- a TLS client of its own, for HTTP

struct secure {
    SSL_CTX *context;
    SSL *ssl;
    int fd;
};

// False: the handshake failed. max_version 0: any.
static bool secure_open(struct secure *s, const char *name, int max_version)
{
    struct timeval patience = {.tv_sec = 5};
    s->context = SSL_CTX_new(TLS_client_method());
    SSL_CTX_set_cipher_list(s->context, "DEFAULT@SECLEVEL=0");
    if (max_version) {
        SSL_CTX_set_min_proto_version(s->context, TLS1_VERSION);
        SSL_CTX_set_max_proto_version(s->context, max_version);
    }
    s->ssl = SSL_new(s->context);
    s->fd = connect_raw(name);
    setsockopt(s->fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    SSL_set_fd(s->ssl, s->fd);
    return SSL_connect(s->ssl) == 1;
}

static void secure_close(struct secure *s)
{
    SSL_free(s->ssl);
    SSL_CTX_free(s->context);
    close(s->fd);
    ERR_clear_error();
}

// The common name of the server's certificate.
static void served_name(const char *name, char out[64])
{
    struct secure s;
    assert_true(secure_open(&s, name, 0));
    X509 *x = SSL_get1_peer_certificate(s.ssl);
    assert_non_null(x);
    X509_NAME_get_text_by_NID(X509_get_subject_name(x), NID_commonName, out, 64);
    X509_free(x);
    secure_close(&s);
}

// The answer to a request over TLS.
static void secure_ask(const char *ask, char *out, size_t n)
{
    struct secure s;
    size_t have = 0;
    assert_true(secure_open(&s, d.http, 0));
    assert_int_equal(SSL_write(s.ssl, ask, (int)strlen(ask)), strlen(ask));
    while (have + 1 < n && !memmem(out, have, "\r\n\r\n", 4)) {
        int k = SSL_read(s.ssl, out + have, (int)(n - have - 1));
        if (k <= 0) break;
        have += (size_t)k;
    }
    out[have] = 0;
    secure_close(&s);
}

// ---- cases

// Plain text is not served on any address of a daemon with a certificate, also not by mistake.
static void test_plain_text_is_refused(void **state)
{
    char text[2048];
    bool closed;
    start(NULL);
    struct frames hello = {0};
    frames_add_hello(&hello, "plain");
    int fd = connect_raw(d.tcp);
    assert_int_equal(send(fd, hello.bytes, hello.n, MSG_NOSIGNAL), hello.n);
    size_t n = raw_read(fd, text, sizeof text, 3000, &closed);
    assert_true(closed);
    assert_null(memmem(text, n, "RLGT", 4));
    close(fd);
    free(hello.bytes);
    static const char ask[] = "GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n";
    fd = connect_raw(d.http);
    assert_int_equal(send(fd, ask, sizeof ask - 1, MSG_NOSIGNAL), sizeof ask - 1);
    n = raw_read(fd, text, sizeof text, 3000, &closed);
    assert_true(closed);
    assert_null(memmem(text, n, "HTTP/1.1 200", 12));
    assert_null(memmem(text, n, "ok\n", 3));
    close(fd);
    secure_ask(ask, text, sizeof text); // the same, encrypted
    assert_non_null(strstr(text, "HTTP/1.1 200"));
    relight_close(client_open(d.address)); // unix sockets need none
    assert_int_equal(daemon_stop(&d), 0);
}

// The API over TLS: uploads, one of them in chunks, and a list.
static void test_api(void **state)
{
    char text[8192];
    start(NULL);
    secure_ask("POST /v1/blobs?name=sky.hdr HTTP/1.1\r\nHost: localhost\r\n"
               "Content-Length: 4\r\nConnection: close\r\n\r\nblob",
               text, sizeof text);
    assert_non_null(strstr(text, "HTTP/1.1 201"));
    secure_ask("POST /v1/blobs HTTP/1.1\r\nHost: localhost\r\n"
               "Transfer-Encoding: chunked\r\n\r\n4\r\nBLOB\r\n0\r\n\r\n",
               text, sizeof text);
    assert_non_null(strstr(text, "HTTP/1.1 201"));
    secure_ask("GET /v1/models HTTP/1.1\r\nHost: localhost\r\n\r\n", text, sizeof text);
    assert_non_null(strstr(text, "HTTP/1.1 200"));
    assert_non_null(strstr(text, "application/json"));
    assert_int_equal(daemon_stop(&d), 0);
}

static void test_websocket(void **state)
{
    char text[2048];
    start(NULL);
    secure_ask("GET /ws HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n"
               "Connection: Upgrade\r\nOrigin: https://localhost\r\n"
               "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
               "Sec-WebSocket-Protocol: relight.v1\r\n\r\n",
               text, sizeof text);
    assert_non_null(strstr(text, "HTTP/1.1 101"));
    assert_int_equal(daemon_stop(&d), 0);
}

// The certificate is checked: its signer, its name, and never left out.
static void test_certificate_is_verified(void **state)
{
    struct relight_client *client;
    struct relight_error error;
    start(NULL);
    OK(open_tls(cert, &client, &error));
    relight_close(client);
    expect(open_tls(NULL, &client, &error), RELIGHT_E_UNREACHABLE, &error, "not trusted");
    expect(open_tls(other_cert, &client, &error), RELIGHT_E_UNREACHABLE, &error, "not trusted");
    expect(open_tls("/no/such", &client, &error), RELIGHT_E_FILE, &error, "/no/such");
    assert_int_equal(daemon_stop(&d), 0);
    make_certificate(cert, key, "elsewhere", "DNS:elsewhere.example,IP:127.0.0.2");
    start(NULL);
    expect(open_tls(cert, &client, &error), RELIGHT_E_UNREACHABLE, &error, "not trusted");
    assert_int_equal(daemon_stop(&d), 0);
    // A server that speaks plain text is no TLS server, and the client says nothing to it.
    const char *const plain[] = {NULL};
    daemon_start(&d, plain);
    snprintf(tls_address, sizeof tls_address, "tls:%s", d.tcp);
    expect(open_tls(cert, &client, &error), RELIGHT_E_UNREACHABLE, &error, "TLS");
    assert_int_equal(daemon_stop(&d), 0);
}

// The same bytes as over a unix socket: an upload of several records, colours, many pings.
static void test_bytes_survive(void **state)
{
    enum { N = 5000000 };
    struct relight_error error;
    struct relight_client *client, *local;
    struct relight_light light = {.env = "constant"};
    char id[ID_SIZE], hash[65], again[65];
    float rgb[N_COLOR], same[N_COLOR];
    uint64_t sent;
    start(NULL);
    OK(open_tls(cert, &client, &error));
    local = client_open(d.address);
    bake_small(client, &d, id);
    struct relight_colors_request colors = {.model = id, .lights = &light, .n_light = 1};
    OK(ask_colors(client, &colors, rgb, NULL, &error));
    OK(ask_colors(local, &colors, same, NULL, &error));
    assert_memory_equal(rgb, same, sizeof rgb);
    unsigned char *big = malloc(N);
    for (size_t i = 0; i < N; i++) big[i] = (unsigned char)(i * 2654435761u >> 13);
    OK(relight_upload(client, "big.bin", big, N, NULL, NULL, hash, &sent, &error));
    assert_int_equal(sent, N);
    OK(relight_upload(local, "big.bin", big, N, NULL, NULL, again, &sent, &error));
    assert_int_equal(sent, 0);
    assert_string_equal(hash, again);
    free(big);
    double seconds;
    for (int i = 0; i < 200; i++) OK(relight_ping(client, &seconds, &error));
    relight_close(local);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// A large answer to several requests at once: more than TLS holds in a record.
static void test_large_answers(void **state)
{
    struct relight_error error;
    struct relight_client *client;
    struct relight_light light = {.env = "constant"};
    struct relight_image image;
    char id[ID_SIZE];
    start(NULL);
    OK(open_tls(cert, &client, &error));
    bake_small(client, &d, id);
    struct relight_image_request request = {.model = id, .lights = &light, .n_light = 1};
    request.picture.width = 1024;
    request.picture.height = 1024;
    request.picture.format = RELIGHT_IMAGE_RGB8;
    uint64_t pending[4];
    for (int i = 0; i < 4; i++)
        OK(relight_image_begin(client, &request, 30, &pending[i], &error));
    for (int i = 3; i >= 0; i--) {
        OK(relight_image_end(client, pending[i], &image, &error));
        assert_int_equal(image.n_byte, 1024 * 1024 * 3);
        relight_image_finish(&image);
    }
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// A daemon that inherits its listening socket, whose clients' sockets have small send buffers:
// writing has to wait again and again.
static void start_with_small_buffers(void)
{
    const char *argv[] = {PRT_BINARY_DIR "/relightd",
                          "--data",
                          d.data,
                          "--listen",
                          d.address,
                          "--tls-cert",
                          cert,
                          "--tls-key",
                          key,
                          NULL};
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    socklen_t n = sizeof a;
    int fd = socket(AF_INET, SOCK_STREAM, 0), small = 32 << 10;
    assert_int_equal(bind(fd, (struct sockaddr *)&a, sizeof a), 0);
    assert_int_equal(setsockopt(fd, SOL_SOCKET, SO_SNDBUF, &small, sizeof small), 0);
    assert_int_equal(listen(fd, 16), 0);
    assert_int_equal(getsockname(fd, (struct sockaddr *)&a, &n), 0);
    snprintf(d.tcp, sizeof d.tcp, "127.0.0.1:%u", ntohs(a.sin_port));
    unlink(d.log);
    if (!(d.pid = fork())) {
        char self[20];
        snprintf(self, sizeof self, "%d", (int)getpid());
        setenv("LISTEN_PID", self, 1);
        setenv("LISTEN_FDS", "1", 1);
        prctl(PR_SET_PDEATHSIG, SIGTERM);
        dup2(open(d.log, O_CREAT | O_APPEND | O_WRONLY, 0600), 2);
        if (dup2(fd, 3) == 3) execv(argv[0], (char *const *)argv);
        _exit(127);
    }
    close(fd);
    assert_true(log_says(&d, " start version", 60000));
}

// PINGs 1 to n with a payload of `size` bytes, which are to be answered within deadline_ms.
static void add_pings(struct frames *f, uint64_t n, uint32_t deadline_ms, size_t size)
{
    char *payload = calloc(1, size);
    Relight__PingRequest ping = RELIGHT__PING_REQUEST__INIT;
    assert_non_null(payload);
    for (uint64_t id = 2; id < 2 + n; id++) {
        struct relight_frame frame = {.flags = RELIGHT_FRAME_LAST,
                                      .type = RELIGHT_TYPE_PING,
                                      .id = id,
                                      .deadline_ms = deadline_ms,
                                      .payload_size = size};
        uint8_t *head;
        size_t n_head;
        memset(payload, (int)id, size);
        assert_int_equal(relight_frame_pack(&frame, &ping.base, 0, 0, &head, &n_head), 0);
        f->bytes = realloc(f->bytes, f->n + n_head + size);
        assert_non_null(f->bytes);
        memcpy(f->bytes + f->n, head, n_head);
        memcpy(f->bytes + f->n + n_head, payload, size);
        f->n += n_head + size;
        free(head);
    }
    free(payload);
}

// The next frame of the stream: its number, and whether it is the answer or says that it is too
// late for that.
static uint64_t next_answer(struct secure *s, struct frames *f, bool *late)
{
    for (int status = 0; !status;) {
        size_t used = 0;
        status = relight_decoder_feed(&f->decoder, f->in + f->at, f->end - f->at, &used);
        f->at += used;
        if (status < 0) fail_msg("the stream has no frame: %d", status);
        if (status) break;
        int n = SSL_read(s->ssl, f->in, sizeof f->in);
        if (n <= 0) fail_msg("the connection has ended");
        f->at = 0;
        f->end = (size_t)n;
    }
    const struct relight_frame *frame = &f->decoder.frame;
    *late = frame->type == RELIGHT_TYPE_ERROR;
    for (size_t i = 0; i < frame->payload_size; i++)
        if (frame->payload[i] != (uint8_t)frame->id) fail_msg("bytes of another answer");
    return frame->id;
}

// Answers that become too late while they wait for a slow reader are replaced, but for what TLS
// has encrypted already: the reader gets whole frames, in their order.
static void test_answers_too_late(void **state)
{
    enum { N = 60, SIZE = 64000, ROUNDS = 8, DEADLINE_MS = 1000 };
    const struct relight_frame_limits limits = {1 << 24, UINT64_C(1) << 32, false};
    unsigned n_late = 0;
    start_with_small_buffers();
    for (int round = 0; round < ROUNDS; round++) {
        struct secure s = {0};
        struct frames *f = calloc(1, sizeof *f);
        bool late;
        assert_true(f && secure_open(&s, d.tcp, 0));
        relight_decoder_init(&f->decoder, &limits);
        frames_add_hello(f, "slow");
        add_pings(f, N, DEADLINE_MS, SIZE + 190 * (size_t)round);
        for (size_t at = 0; at < f->n;) {
            int n = SSL_write(s.ssl, f->bytes + at, (int)(f->n - at));
            assert_true(n > 0);
            at += (size_t)n;
        }
        sleep_ms(DEADLINE_MS + 200);
        for (uint64_t id = 1; id < 2 + N; id++) {
            assert_int_equal(next_answer(&s, f, &late), id);
            n_late += late;
        }
        relight_decoder_finish(&f->decoder);
        free(f->bytes);
        free(f);
        secure_close(&s);
    }
    print_message("%u answers were too late\n", n_late);
    assert_true(n_late > 0);
    assert_int_equal(daemon_stop(&d), 0);
}

static int served_chain(const char *name)
{
    struct secure s;
    assert_true(secure_open(&s, name, 0));
    int n = sk_X509_num(SSL_get_peer_cert_chain(s.ssl));
    secure_close(&s);
    return n;
}

// The certificates that follow the daemon's own in its file, those of its signers, come with it
// on both carriers.
static void test_chain_is_served(void **state)
{
    char *chain = read_text(cert), *signer = read_text(other_cert), text[8192];
    snprintf(text, sizeof text, "%s%s", chain, signer);
    write_text(cert, text);
    free(chain);
    free(signer);
    start(NULL);
    assert_int_equal(served_chain(d.tcp), 2);
    assert_int_equal(served_chain(d.http), 2);
    assert_int_equal(daemon_stop(&d), 0);
}

// SIGHUP serves the new certificate to new connections; open ones stay. A faulty one changes
// nothing.
static void test_reload(void **state)
{
    struct relight_client *client, *next;
    struct relight_error error;
    char name[64];
    double seconds;
    start(NULL);
    OK(open_tls(cert, &client, &error));
    served_name(d.http, name);
    assert_string_equal(name, "first");
    write_text(cert, "no certificate\n");
    assert_int_equal(kill(d.pid, SIGHUP), 0);
    assert_true(log_says(&d, "reload refused, nothing changed: --tls-cert", 5000));
    served_name(d.tcp, name);
    assert_string_equal(name, "first");
    assert_int_equal(rename(other_cert, cert), 0);
    assert_int_equal(rename(other_key, key), 0);
    assert_int_equal(kill(d.pid, SIGHUP), 0);
    assert_true(log_says(&d, "reload certificate=\"/CN=second", 5000));
    served_name(d.tcp, name);
    assert_string_equal(name, "second");
    served_name(d.http, name);
    assert_string_equal(name, "second");
    OK(relight_ping(client, &seconds, &error));
    OK(open_tls(cert, &next, &error));
    relight_close(next);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// A handshake that drips is ended by --handshake, on both carriers; one that does not begin,
// too.
static void test_slow_handshake(void **state)
{
    // The record of a ClientHello of 512 bytes, of which one comes at a time.
    static const uint8_t hello[] = {22, 3, 1, 2, 0, 1, 0, 1, 252, 3, 3};
    static const char *const quick[] = {"--handshake", "1", NULL};
    start(quick);
    const char *const names[] = {d.tcp, d.http};
    for (int i = 0; i < 4; i++) {
        int fd = connect_raw(names[i % 2]);
        bool closed = false;
        char bytes[256];
        for (int k = 0; k < 40 && !closed; k++) {
            uint8_t byte = k < (int)sizeof hello ? hello[k] : 0;
            if (i < 2) send(fd, &byte, 1, MSG_NOSIGNAL);
            raw_read(fd, bytes, sizeof bytes, 100, &closed);
        }
        if (!closed) fail_msg("%s is open after 4 s", names[i % 2]);
        close(fd);
    }
    assert_int_equal(daemon_stop(&d), 0);
}

static void test_old_versions(void **state)
{
    start(NULL);
    const char *const names[] = {d.tcp, d.http};
    for (int i = 0; i < 2; i++) {
        struct secure s = {0};
        assert_false(secure_open(&s, names[i], TLS1_1_VERSION));
        secure_close(&s);
        assert_true(secure_open(&s, names[i], TLS1_2_VERSION));
        secure_close(&s);
        assert_true(secure_open(&s, names[i], 0));
        secure_close(&s);
    }
    assert_int_equal(daemon_stop(&d), 0);
}

// --tls-loopback no: plain text for probes of this machine.
static void test_plain_loopback(void **state)
{
    const char *const extra[] = {"--tls-loopback=no", NULL};
    char address[80];
    start(extra);
    find_address(&d, "listen address=tcp:", d.tcp, sizeof d.tcp);
    snprintf(address, sizeof address, "tcp:%s", d.tcp);
    relight_close(client_open(address));
    assert_int_equal(daemon_stop(&d), 0);
}

static void refused_at_start(const char *const extra[], const char *word)
{
    int how;
    unlink(d.log);
    pid_t pid = daemon_spawn(&d, extra);
    assert_int_equal(waitpid(pid, &how, 0), pid);
    assert_true(WIFEXITED(how) && WEXITSTATUS(how));
    if (!log_says(&d, word, 1000)) fail_msg("the log does not say: %s", word);
}

static void test_faulty_files(void **state)
{
    const char *const wrong_key[] = {"--tls-cert", cert, "--tls-key", other_key, NULL};
    const char *const no_key[] = {"--tls-cert", cert, NULL};
    const char *const no_file[] = {"--tls-cert", "/no/cert", "--tls-key", key, NULL};
    const char *const no_cert[] = {"--listen", "tls:127.0.0.1:0", NULL};
    refused_at_start(wrong_key, "--tls-key");
    refused_at_start(no_key, "belong together");
    refused_at_start(no_file, "/no/cert");
    refused_at_start(no_cert, "needs --tls-cert");
}

int main(void)
{
#define CASE(name) cmocka_unit_test_setup_teardown(name, before_each, after_each)
    const struct CMUnitTest tests[] = {
        CASE(test_plain_text_is_refused),
        CASE(test_websocket),
        CASE(test_api),
        CASE(test_certificate_is_verified),
        CASE(test_bytes_survive),
        CASE(test_large_answers),
        CASE(test_answers_too_late),
        CASE(test_reload),
        CASE(test_chain_is_served),
        CASE(test_slow_handshake),
        CASE(test_old_versions),
        CASE(test_plain_loopback),
        CASE(test_faulty_files),
    };
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("tls", tests, setup, teardown);
}
