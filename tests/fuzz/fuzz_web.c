// SPDX-License-Identifier: MIT
// Bytes to the HTTP port of a daemon that is built with the sanitizers: requests that are
// damaged, pipelined, cut or upgraded, and WebSockets that break every rule of framing. In
// between and at the end the daemon must answer /healthz and PING, and at SIGTERM end well.
//   fuzz_web http|websocket RELIGHTD [-s SECONDS] [-r SEED]
#include "messages.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <netinet/in.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

static struct rnd r;
static struct world world;
enum { LIFE_EVERY = 50 };
static struct bytes inputs[LIFE_EVERY]; // of the cases since the daemon was last seen alive
static struct bytes input;              // of the case under way
static uint64_t seed = 1;
static unsigned long n_case, n_answered;
static pid_t daemon_pid;
static char folder[64], log_path[96], unix_path[96];
static int port;

static void show_log(void)
{
    char command[200];
    snprintf(command, sizeof command, "grep -v ' level=' %s | tail -n 80 >&2", log_path);
    if (system(command)) fprintf(stderr, "%s cannot be shown\n", log_path);
}

static void fail(const char *what)
{
    char name[64], path[96];
    snprintf(name, sizeof name, "crash-%ld", (long)getpid());
    mkdir(name, 0777);
    for (unsigned i = 0; i < LIFE_EVERY; i++) {
        snprintf(path, sizeof path, "%s/%02u", name, i);
        FILE *file = inputs[i].n ? fopen(path, "wb") : NULL;
        if (file) fwrite(inputs[i].at, 1, inputs[i].n, file);
        if (file) fclose(file);
    }
    fprintf(stderr,
            "fuzz_web: %s; case %lu of seed %llu, what was sent lately is in %s/; the log "
            "ends:\n",
            what, n_case, (unsigned long long)seed, name);
    show_log();
    if (daemon_pid) kill(daemon_pid, SIGKILL);
    exit(1);
}

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

// ---- the daemon

static void start_daemon(const char *program)
{
    static const char mark[] = "listen address=http:127.0.0.1:";
    char address[128], data[96], log[8192];
    snprintf(log_path, sizeof log_path, "%s/log", folder);
    snprintf(unix_path, sizeof unix_path, "%s/s", folder);
    snprintf(address, sizeof address, "unix:%s", unix_path);
    snprintf(data, sizeof data, "%s/data", folder);
    daemon_pid = fork();
    if (!daemon_pid) {
        int fd = open(log_path, O_CREAT | O_APPEND | O_WRONLY, 0600);
        dup2(fd, 1);
        dup2(fd, 2);
        setenv("ASAN_OPTIONS", "detect_leaks=1:exitcode=99:handle_abort=1", 1);
        execl(program, program, "--data", data, "--http", "127.0.0.1:0", "--listen", address,
              "--log", "event", "--drain", "2", NULL);
        _exit(127);
    }
    for (double end = now_s() + 60; now_s() < end; usleep(20000)) {
        FILE *file = fopen(log_path, "r");
        size_t n = file ? fread(log, 1, sizeof log - 1, file) : 0;
        if (file) fclose(file);
        log[n] = 0;
        const char *at = strstr(log, mark);
        if (!at || !strstr(log, " start version")) continue;
        port = atoi(at + sizeof mark - 1);
        return;
    }
    fail("the daemon did not start");
}

static void stop_daemon(void)
{
    int how = 0;
    kill(daemon_pid, SIGTERM);
    for (double end = now_s() + 60; now_s() < end; usleep(20000))
        if (waitpid(daemon_pid, &how, WNOHANG) == daemon_pid) {
            daemon_pid = 0;
            if (how) fail("the daemon did not end with status 0");
            return;
        }
    fail("the daemon did not end within 60 s of SIGTERM");
}

// ---- connections

static int connect_http(void)
{
    struct sockaddr_in a = {.sin_family = AF_INET,
                            .sin_port = htons((uint16_t)port),
                            .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (fd < 0 || connect(fd, (struct sockaddr *)&a, sizeof a)) fail("no connection");
    return fd;
}

// What comes until there is a pause of ms, the peer closes, or the room is full.
static size_t receive(int fd, char *out, size_t room, int ms)
{
    size_t n = 0;
    while (n < room) {
        struct pollfd p = {fd, POLLIN, 0};
        if (poll(&p, 1, ms) <= 0) break;
        ssize_t got = recv(fd, out + n, room - n, MSG_DONTWAIT);
        if (got <= 0) break;
        n += (size_t)got;
    }
    return n;
}

// In one or several writes; the daemon may close before the end.
static void transmit(int fd, const void *bytes, size_t n)
{
    const char *at = bytes;
    bool pieces = rnd_chance(&r, 3);
    while (n) {
        size_t take = pieces ? 1 + rnd(&r, 200) : n;
        if (take > n) take = n;
        struct pollfd p = {fd, POLLOUT, 0};
        if (poll(&p, 1, 1000) <= 0) return;
        ssize_t sent = send(fd, at, take, MSG_NOSIGNAL | MSG_DONTWAIT);
        if (sent <= 0) return;
        at += sent;
        n -= (size_t)sent;
    }
}

static void hang_up(int fd)
{
    struct linger at_once = {1, 0};
    if (rnd_chance(&r, 3)) setsockopt(fd, SOL_SOCKET, SO_LINGER, &at_once, sizeof at_once);
    else if (rnd_chance(&r, 3)) shutdown(fd, SHUT_WR);
    close(fd);
}

static void expect_health(void)
{
    static const char ask[] = "GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n";
    char answer[2048];
    int fd = connect_http();
    if (send(fd, ask, sizeof ask - 1, MSG_NOSIGNAL) < 0) fail("/healthz takes no request");
    size_t n = 0;
    for (double end = now_s() + 20; now_s() < end;) {
        n += receive(fd, answer + n, sizeof answer - 1 - n, 100);
        answer[n] = 0;
        if (strstr(answer, "ok\n")) break;
    }
    close(fd);
    if (n < 16 || strncmp(answer, "HTTP/1.1 200", 12)) fail("/healthz is not answered");
}

static void expect_ping(void)
{
    struct sockaddr_un a = {.sun_family = AF_UNIX};
    struct bytes ask = {0};
    uint8_t ping[RELIGHT_FRAME_FIXED];
    struct relight_frame frame = {.type = RELIGHT_TYPE_PING, .id = 2};
    char answer[8192];
    strcpy(a.sun_path, unix_path);
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (connect(fd, (struct sockaddr *)&a, sizeof a)) fail("no connection to the unix socket");
    message_hello(&world, 1, true, &ask);
    relight_frame_put_fixed(&frame, ping);
    bytes_add(&ask, ping, sizeof ping);
    if (send(fd, ask.at, ask.n, MSG_NOSIGNAL) < 0) fail("the unix socket takes no request");
    free(ask.at);
    size_t n = 0;
    for (double end = now_s() + 20; now_s() < end;) {
        n += receive(fd, answer + n, sizeof answer - n, 100);
        for (size_t i = 0; i + 8 <= n; i++)
            if (!memcmp(answer + i, "RLGT\x01\x02\x02\x80", 8)) {
                close(fd);
                return;
            }
    }
    fail("PING is not answered");
}

static void expect_life(void)
{
    int how;
    if (waitpid(daemon_pid, &how, WNOHANG) == daemon_pid) {
        daemon_pid = 0;
        fail("the daemon is dead");
    }
    expect_health();
    expect_ping();
}

// ---- HTTP

static const char *const request[] = {
    "GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "GET /metrics HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n",
    "HEAD / HTTP/1.0\r\n\r\n",
    "GET /../../etc/passwd HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "GET /%2e%2e/%00%ff?a=b&c#d HTTP/1.1\r\nHost: localhost\r\nRange: bytes=0-0,5-1\r\n\r\n",
    "POST /healthz HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\n\r\nhello",
    "POST / HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\nContent-Length: 3\r\n\r\n"
    "5\r\nhello\r\n0\r\n\r\n",
    "GET /ws HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Protocol: relight.v1\r\n\r\n",
    "GET /ws HTTP/1.1\r\nHost: localhost\r\nUpgrade: h2c\r\nConnection: Upgrade, HTTP2-Settings\r\n"
    "HTTP2-Settings: AAMAAABkAAQAAP__\r\nOrigin: null\r\n\r\n",
    "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    "OPTIONS * HTTP/1.1\r\nHost: a\r\nHost: b\r\nExpect: 100-continue\r\nAuthorization: Basic "
    "%%%%\r\n\r\n",
    "\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
    "GET /readyz HTTP/1.1\r\nHost: localhost\r\nX-Request-Id: abc-1\r\n\r\n",
    "GET /v1/openapi.json HTTP/1.1\r\nHost: localhost\r\nIf-None-Match: *\r\n\r\n",
    "GET /v1/models?deadline_ms=5 HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "DELETE /v1/models/nothing?forget=yes HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "GET /v1/models/a/b/image.png?env=constant:1,2,3&size=8x8&rotate=-1e3&camera=1,2,3:0,0,0::40&"
    "eye=1,2,3&gain=1,1,1&background=0,0,0&tone=none&term=single&material=%7B%22g%22%3A0%7D "
    "HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "GET /v1/models/x/colors.csv?env=constant&format=npy&exposure=1 HTTP/1.1\r\nHost: localhost\r\n"
    "\r\n",
    "POST /v1/models/x/image HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
    "Content-Length: 62\r\n\r\n{\"lights\":[{\"env\":\"constant\"}],\"shade\":{\"material\":{\"g\":[0]}}}",
    "POST /v1/models?name=a.obj&size_mm=1&preview HTTP/1.1\r\nHost: localhost\r\nContent-Length: 12"
    "\r\n\r\nv 0 0 0\nf 1\n",
    "POST /v1/models?path=a.prt HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "POST /v1/blobs?name=a HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nExpect: 100-continue"
    "\r\n\r\nhello",
    "PUT /v1/blobs/2cf24dba5fb0a30e26e83b2ac5b9e29e1b161e5c1fa7425e73043362938b9824?offset=1&size=5 "
    "HTTP/1.1\r\nHost: localhost\r\nContent-Length: 4\r\n\r\nello",
    "GET /v1/blobs/2cf24dba5fb0a30e26e83b2ac5b9e29e1b161e5c1fa7425e73043362938b9824?size=5 HTTP/1.1"
    "\r\nHost: localhost\r\n\r\n",
    "GET /v1/jobs/job-1/events?token=x HTTP/1.1\r\nHost: localhost\r\nLast-Event-ID: 1\r\n\r\n",
    "DELETE /v1/jobs/job-1 HTTP/1.1\r\nHost: localhost\r\n\r\n",
};

static void mutate(struct bytes *b, size_t from)
{
    static const char *const word[] = {"\r\n",
                                       "\n",
                                       ":",
                                       " ",
                                       "%",
                                       "\0",
                                       "HTTP/1.1",
                                       "Host: ",
                                       "Content-Length: -1\r\n",
                                       "Connection: Upgrade\r\n",
                                       "Transfer-Encoding: chunked\r\n",
                                       "Origin: ",
                                       "&",
                                       "=",
                                       "%2f",
                                       "[",
                                       "{\"",
                                       "X-Request-Id: a\r\n"};
    char long_text[6000];
    for (uint32_t k = rnd(&r, 5); k && b->n > from; k--) {
        size_t at = from + rnd(&r, (uint32_t)(b->n - from)), n = 0;
        const char *insert = long_text;
        switch (rnd(&r, 5)) {
        case 0:
            b->at[at] = (uint8_t)rnd(&r, 256);
            continue;
        case 1:
            b->at[at] ^= (uint8_t)(1u << rnd(&r, 8));
            continue;
        case 2:
            if (rnd_chance(&r, 3)) b->n = at;
            continue;
        case 3: // a header that does not fit
            n = rnd_chance(&r, 6) ? rnd(&r, sizeof long_text) : rnd(&r, 300);
            memset(long_text, 'a' + (int)rnd(&r, 20), n);
            break;
        default:
            insert = RND_PICK(&r, word);
            n = strlen(insert) ? strlen(insert) : 1;
        }
        char *tail = malloc(b->n - at + 1);
        size_t n_tail = b->n - at;
        memcpy(tail, b->at + at, n_tail);
        b->n = at;
        bytes_add(b, insert, n);
        bytes_add(b, tail, n_tail);
        free(tail);
    }
}

static void http_case(void)
{
    char answer[16384];
    for (uint32_t k = 1 + rnd(&r, rnd_chance(&r, 4) ? 6 : 1); k; k--) {
        size_t from = input.n;
        const char *text = RND_PICK(&r, request);
        bytes_add(&input, text, strlen(text));
        if (!rnd_chance(&r, 6)) mutate(&input, from);
    }
    int fd = connect_http();
    transmit(fd, input.at, input.n);
    n_answered += receive(fd, answer, sizeof answer, rnd_chance(&r, 8) ? 30 : 2) > 0;
    hang_up(fd);
}

// ---- WebSocket

static bool shake_hands(int fd)
{
    const char *text = request[7];
    char answer[2048];
    struct bytes ask = {0};
    bytes_add(&ask, text, strlen(text));
    bool odd = rnd_chance(&r, 8);
    if (odd) mutate(&ask, 0);
    transmit(fd, ask.at, ask.n);
    free(ask.at);
    size_t n = 0;
    for (double end = now_s() + (odd ? 0.01 : 20); now_s() < end && n < sizeof answer - 1;) {
        n += receive(fd, answer + n, sizeof answer - 1 - n, 5);
        answer[n] = 0;
        if (strstr(answer, "\r\n\r\n")) break;
    }
    bool upgraded = n >= 12 && !strncmp(answer, "HTTP/1.1 101", 12);
    if (!odd && !upgraded) fail("a good handshake is refused");
    return upgraded;
}

// One WebSocket frame around bytes; what its head says is wrong now and then.
static void add_ws_frame(unsigned opcode, bool last, const uint8_t *bytes, size_t n)
{
    uint8_t head[14] = {(uint8_t)((last ? 0x80 : 0) | opcode)}, mask[4] = {0};
    uint64_t says = n;
    size_t n_head = 2;
    bool masked = !rnd_chance(&r, 40);
    if (rnd_chance(&r, 40)) says = rnd_bits(&r) >> rnd(&r, 64);
    if (rnd_chance(&r, 60)) head[0] |= (uint8_t)(16 << rnd(&r, 3)); // a reserved bit
    bool wide = says > 65535 || rnd_chance(&r, 60), middle = says > 125 || rnd_chance(&r, 60);
    head[1] = (uint8_t)((masked ? 0x80 : 0) | (wide ? 127 : middle ? 126 : says));
    int n_length = wide ? 8 : middle ? 2 : 0;
    for (int i = n_length - 1; i >= 0; i--) head[n_head++] = (uint8_t)(says >> (8 * i));
    if (masked) {
        for (int i = 0; i < 4; i++) head[n_head++] = mask[i] = (uint8_t)rnd(&r, 256);
    }
    bytes_add(&input, head, n_head);
    for (size_t i = 0; i < n; i++) {
        uint8_t byte = bytes[i] ^ mask[i % 4];
        bytes_add(&input, &byte, 1);
    }
}

static void add_message(const struct bytes *message)
{
    static const unsigned other[] = {0, 1, 3, 7, 8, 9, 10, 11, 15};
    size_t at = 0;
    bool split = rnd_chance(&r, 3);
    unsigned opcode = rnd_chance(&r, 30) ? RND_PICK(&r, other) : 2;
    do {
        size_t n = split ? rnd(&r, 200) : message->n;
        if (n > message->n - at) n = message->n - at;
        add_ws_frame(opcode, at + n == message->n, message->at + at, n);
        at += n;
        opcode = 0;
        // A control frame in between, at times a long one, which no control frame may be.
        if (rnd_chance(&r, 12))
            add_ws_frame(8 + rnd(&r, 3), !rnd_chance(&r, 20), message->at,
                         message->n < 125 || rnd_chance(&r, 10) ? message->n : 100);
    } while (at < message->n);
}

static void websocket_case(void)
{
    char answer[16384];
    int fd = connect_http();
    if (shake_hands(fd)) {
        struct bytes message = {0};
        message_hello(&world, 1, !rnd_chance(&r, 10), &message);
        add_message(&message);
        for (uint32_t k = rnd(&r, 8); k; k--) {
            message.n = 0;
            message_random(&world, 2 + rnd(&r, 10), 10, &message);
            if (rnd_chance(&r, 10) && message.n)
                message.at[rnd(&r, (uint32_t)message.n)] ^= 0x40;
            if (rnd_chance(&r, 30)) message.n = rnd(&r, (uint32_t)message.n);
            add_message(&message);
        }
        free(message.at);
        transmit(fd, input.at, rnd_chance(&r, 6) ? rnd(&r, (uint32_t)input.n) : input.n);
        n_answered += receive(fd, answer, sizeof answer, rnd_chance(&r, 8) ? 50 : 5) > 0;
    }
    hang_up(fd);
}

static int remove_one(const char *path, const struct stat *st, int kind, struct FTW *where)
{
    return remove(path);
}

int main(int argc, char **argv)
{
    double seconds = 5;
    int option;
    while ((option = getopt(argc, argv, "s:r:")) != -1) {
        if (option == 's') seconds = atof(optarg);
        else if (option == 'r') seed = strtoull(optarg, NULL, 0);
        else return 2;
    }
    if (argc - optind != 2) return 2;
    void (*one_case)(void) = strcmp(argv[optind], "http") ? websocket_case : http_case;
    signal(SIGPIPE, SIG_IGN);
    strcpy(folder, "/tmp/relight-fuzz-XXXXXX");
    if (!mkdtemp(folder)) return perror(folder), 1;
    rnd_seed(&r, seed);
    world_init(&world, &r);
    start_daemon(argv[optind + 1]);
    for (double end = now_s() + seconds; now_s() < end; n_case++) {
        input.n = 0;
        one_case();
        struct bytes *kept = &inputs[n_case % LIFE_EVERY];
        kept->n = 0;
        bytes_add(kept, input.at, input.n);
        if (n_case % LIFE_EVERY == LIFE_EVERY - 1) expect_life();
    }
    expect_life();
    stop_daemon();
    nftw(folder, remove_one, 16, FTW_DEPTH | FTW_PHYS);
    free(input.at);
    for (unsigned i = 0; i < LIFE_EVERY; i++) free(inputs[i].at);
    printf("%lu cases, %lu answered\n", n_case, n_answered);
    return n_answered ? 0 : 1;
}
