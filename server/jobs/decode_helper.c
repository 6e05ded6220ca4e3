// SPDX-License-Identifier: MIT
// Both ends of the decode helper. Messages are packets on a socket pair: a request is struct
// ask and its words with the open file passed along, a reply {number, status, sizes} + error
// text, with the pixels of an image in a memory file passed along.
#include "jobs/decode_helper.h"

#include "core/log.h"
#include "prt/transport.h"

#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <limits.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

extern char **environ;

enum { PACKET = 64 << 10, MAX_AT_ONCE = 4, MAX_RUNNING = 64, MAX_SIDE = 65536, MAX_WORD = 68 };

#define MAX_FILE ((uint64_t)2 << 30)

enum asked { ASK_ENV, ASK_MODEL, ASK_IMAGE };

struct ask {
    uint64_t number, memory_bytes, image_bytes;
    uint32_t n_word; // strings that follow: path, name, and for a model the .prt and the opaque
                     // names
    uint32_t model;  // enum asked
    double size_mm, mm_per_unit;
    struct prt_material material;
};

struct reply {
    uint64_t number;
    int32_t status;
    uint32_t kind, width, height, cube_n, n_negative, n_nonfinite;
    uint32_t crashed; // decoding processes ended by a signal
    float ms;
    char error[400];
    char warnings[2000]; // one a line
};

struct wait_for {
    struct wait_for *next;
    uint64_t number;
    decode_fn env_fn; // one of the two
    decode_model_fn model_fn;
    void *user;
    bool sent, lost;
    size_t size; // of the packet
    char packet[];
};

struct decoder {
    struct loop *loop;
    struct loop_watch watch; // fd -1: no helper is running
    pid_t pid;
    struct decoder_limits limits;
    unsigned at_once;
    uint64_t *n_crashed, last_number;
    struct wait_for *waiting;
    unsigned n_sent;
};

// ---- the helper's side

static void keep_error(void *user, enum prt_log_level level, const char *line)
{
    struct reply *reply = user;
    size_t n = strlen(reply->warnings);
    if (level == PRT_LOG_ERROR && !reply->error[0])
        snprintf(reply->error, sizeof reply->error, "%s", line);
    if (level == PRT_LOG_WARNING)
        snprintf(reply->warnings + n, sizeof reply->warnings - n, "%s\n", line);
}

static size_t pixel_bytes(uint32_t kind, uint32_t width, uint32_t height, uint32_t cube_n)
{
    return kind == PRT_ENV_CUBE ? (size_t)6 * cube_n * cube_n * 12
                                : (size_t)width * height * 12;
}

// Frees pages as soon as they are copied, so that memory holds one copy of a large image.
static int write_pixels(const struct prt_env *env, size_t n)
{
    const size_t piece = 8 << 20, page = (size_t)sysconf(_SC_PAGESIZE);
    int fd = memfd_create("environment", MFD_CLOEXEC | MFD_ALLOW_SEALING);
    if (fd < 0) return -1;
    char *pixels = (char *)(env->kind == PRT_ENV_CUBE ? env->cube.texel : env->latlong.rgb);
    for (size_t put = 0; put < n;) {
        ssize_t done = write(fd, pixels + put, n - put < piece ? n - put : piece);
        if (done < 0 && errno == EINTR) continue;
        if (done <= 0) {
            close(fd);
            return -1;
        }
        uintptr_t begin = ((uintptr_t)(pixels + put) + page - 1) & ~(uintptr_t)(page - 1);
        put += (size_t)done;
        uintptr_t end = (uintptr_t)(pixels + put) & ~(uintptr_t)(page - 1);
        if (begin < end) madvise((void *)begin, end - begin, MADV_DONTNEED);
    }
    if (fcntl(fd, F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_WRITE | F_SEAL_SEAL)) {
        close(fd);
        return -1;
    }
    return fd;
}

// False when the other end is closed or its buffer is full.
static bool send_packet(int socket_fd, const void *bytes, size_t n, int passed_fd)
{
    struct iovec iov = {(void *)bytes, n};
    union {
        struct cmsghdr head;
        char room[CMSG_SPACE(sizeof(int))];
    } control = {0};
    struct msghdr message = {.msg_iov = &iov, .msg_iovlen = 1};
    if (passed_fd >= 0) {
        message.msg_control = &control;
        message.msg_controllen = sizeof control.room;
        control.head = (struct cmsghdr){.cmsg_len = CMSG_LEN(sizeof(int)),
                                        .cmsg_level = SOL_SOCKET,
                                        .cmsg_type = SCM_RIGHTS};
        memcpy(CMSG_DATA(&control.head), &passed_fd, sizeof passed_fd);
    }
    ssize_t sent;
    while ((sent = sendmsg(socket_fd, &message, MSG_NOSIGNAL)) < 0 && errno == EINTR) continue;
    return sent >= 0;
}

// The bytes of a packet and the descriptor that came with it, -1 without one.
static ssize_t receive_packet(int socket_fd, void *bytes, size_t n, int *passed_fd)
{
    struct iovec iov = {bytes, n};
    union {
        struct cmsghdr head;
        char room[CMSG_SPACE(sizeof(int))];
    } control;
    struct msghdr message = {.msg_iov = &iov,
                             .msg_iovlen = 1,
                             .msg_control = &control,
                             .msg_controllen = sizeof control.room};
    *passed_fd = -1;
    ssize_t got = recvmsg(socket_fd, &message, MSG_DONTWAIT | MSG_CMSG_CLOEXEC);
    struct cmsghdr *head = got > 0 ? CMSG_FIRSTHDR(&message) : NULL;
    if (head && head->cmsg_type == SCM_RIGHTS)
        memcpy(passed_fd, CMSG_DATA(head), sizeof *passed_fd);
    return got;
}

// Removes the store's folder from an error: it means nothing to the client.
static void hide_folder(char *text, const char *folder)
{
    char with_slash[PATH_MAX + 2];
    snprintf(with_slash, sizeof with_slash, "%s/", folder);
    size_t n = strlen(with_slash);
    for (char *at = text; (at = strstr(at, with_slash));)
        memmove(at, at + n, strlen(at + n) + 1);
}

static int read_image(const struct prt_context *ctx, bool as_env, int fd, const char *name,
                      struct reply *reply)
{
    struct prt_env *env = NULL, plain = {.kind = PRT_ENV_LATLONG};
    struct prt_blob file = {NULL, 0};
    int status = prt_read_fd(ctx, name, fd, MAX_FILE, &file);
    if (!status)
        status = as_env
                     ? prt_env_load_memory(ctx, name, file.bytes, file.size, &env)
                     : prt_image_load_memory(ctx, name, file.bytes, file.size, &plain.latlong);
    prt_free(file.bytes);
    int pixels_fd = -1;
    if ((reply->status = status)) return -1;
    if (!as_env) env = &plain;
    reply->kind = env->kind;
    reply->width = env->latlong.width;
    reply->height = env->latlong.height;
    reply->cube_n = env->cube.n;
    reply->n_negative = env->n_negative;
    reply->n_nonfinite = env->n_nonfinite;
    pixels_fd =
        write_pixels(env, pixel_bytes(reply->kind, reply->width, reply->height, reply->cube_n));
    if (pixels_fd < 0) {
        reply->status = PRT_NOMEM;
        snprintf(reply->error, sizeof reply->error, "%s: no memory for its pixels", name);
    }
    return pixels_fd;
}

// Writes the mesh as a .prt with one empty tensor.
static int write_mesh(const struct prt_context *ctx, const char *out,
                      const struct prt_mesh *mesh, const struct prt_material *material)
{
    struct prt_cluster all = {.n_vertex = mesh->n_vertex};
    struct prt_transport t = {.mesh = *mesh,
                              .material = *material,
                              .cube = 16,
                              .engine = PRT_TRANSPORT_JOINT,
                              .n_tensor = 1,
                              .settings = "{}",
                              .errors = "{}"};
    uint32_t *order = prt_alloc(mesh->n_vertex, sizeof *order);
    if (!order) return prt_fail(ctx, PRT_NOMEM, "no memory for %u vertices", mesh->n_vertex);
    for (uint32_t i = 0; i < mesh->n_vertex; i++) order[i] = i;
    t.tensor[0] = (struct prt_tensor){.storage = PRT_STORAGE_RADIAL,
                                      .coupling = PRT_COUPLE_FULL,
                                      .n_vertex = mesh->n_vertex,
                                      .n_function = 1,
                                      .n_phase = 1,
                                      .n_radial = 1,
                                      .n_cluster = 1,
                                      .order = order,
                                      .cluster = &all};
    int status = prt_file_write(ctx, out, &t);
    prt_free(order);
    return status;
}

static int read_model(const struct prt_context *ctx, const struct ask *ask, int fd,
                      const char *folder, char *const *word)
{
    struct prt_mesh_options options = {.opaque = (const char *const *)word + 3};
    struct prt_mesh *mesh = NULL;
    int status = prt_mesh_load_fd(ctx, word[1], fd, folder, &options, &mesh);
    if (!status) status = prt_mesh_scale(ctx, mesh, ask->size_mm, ask->mm_per_unit);
    if (!status) status = write_mesh(ctx, word[2], mesh, &ask->material);
    prt_mesh_destroy(mesh);
    return status;
}

// word: path, name, ... and NULL at the end.
static void serve(int socket_fd, const struct ask *ask, int fd, char *const *word)
{
    struct reply reply = {.number = ask->number};
    char copy[PATH_MAX];
    snprintf(copy, sizeof copy, "%s", word[0]);
    const char *folder = dirname(copy);
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = keep_error;
    ctx.log_user = &reply;
    ctx.memory_limit = ask->memory_bytes;
    ctx.image_limit = ask->image_bytes;
    double start = prt_time_s();
    int pixels_fd = -1;
    if (ask->model == ASK_MODEL) reply.status = read_model(&ctx, ask, fd, folder, word);
    else pixels_fd = read_image(&ctx, ask->model == ASK_ENV, fd, word[1], &reply);
    if (reply.status && !reply.error[0])
        snprintf(reply.error, sizeof reply.error, "%s: %s", word[1],
                 prt_status_text(reply.status));
    hide_folder(reply.error, folder);
    hide_folder(reply.warnings, folder);
    reply.crashed = prt_isolate_crashes();
    reply.ms = (float)((prt_time_s() - start) * 1e3);
    send_packet(socket_fd, &reply, sizeof reply, pixels_fd);
}

// Splits a packet into its strings; false when some are missing.
static bool split_words(char *packet, size_t n, const struct ask *ask, char *word[MAX_WORD + 1])
{
    size_t at = sizeof *ask;
    if (ask->n_word > MAX_WORD || ask->n_word < (ask->model == ASK_MODEL ? 3u : 2u))
        return false;
    for (uint32_t i = 0; i < ask->n_word; i++) {
        size_t length = strnlen(packet + at, n - at);
        if (at + length >= n) return false;
        word[i] = packet + at;
        at += length + 1;
    }
    word[ask->n_word] = NULL;
    return at == n;
}

struct running {
    pid_t pid;
    uint64_t number;
};

static void on_child(int signal)
{
}

// Replies in place of decoding processes that died.
static void reap(int fd, struct running *running)
{
    int how;
    for (pid_t pid; (pid = waitpid(-1, &how, WNOHANG)) > 0;)
        for (int i = 0; i < MAX_RUNNING; i++) {
            if (running[i].pid != pid) continue;
            running[i].pid = 0;
            if (WIFEXITED(how) && !WEXITSTATUS(how)) continue;
            struct reply reply = {.number = running[i].number,
                                  .status = PRT_FORMAT,
                                  .crashed = 1,
                                  .error = "the process that read the file died"};
            send_packet(fd, &reply, sizeof reply, -1);
        }
}

static void start_decoding(int fd, char *packet, ssize_t n, int file_fd,
                           struct running *running)
{
    struct ask ask;
    char *word[MAX_WORD + 1];
    memcpy(&ask, packet, sizeof ask);
    if (!split_words(packet, (size_t)n, &ask, word)) return;
    pid_t helper = getpid(), pid = fork();
    if (pid == 0) {
        if (prctl(PR_SET_PDEATHSIG, SIGKILL) || getppid() != helper) _exit(1);
        signal(SIGCHLD, SIG_DFL); // prt_isolate() waits for its own child
        sigset_t none;
        sigemptyset(&none);
        sigprocmask(SIG_SETMASK, &none, NULL);
        serve(fd, &ask, file_fd, word);
        _exit(0);
    }
    if (pid < 0) {
        struct reply reply = {.number = ask.number,
                              .status = PRT_NOMEM,
                              .error = "no process could be started to read the file"};
        send_packet(fd, &reply, sizeof reply, -1);
        return;
    }
    for (int i = 0; i < MAX_RUNNING; i++)
        if (!running[i].pid) {
            running[i] = (struct running){pid, ask.number};
            break;
        }
}

int decode_helper_main(int fd)
{
    static char packet[PACKET];
    struct running running[MAX_RUNNING] = {0};
    sigset_t child, none;
    sigemptyset(&none);
    sigemptyset(&child);
    sigaddset(&child, SIGCHLD);
    sigprocmask(SIG_SETMASK, &child, NULL);
    signal(SIGPIPE, SIG_IGN);
    signal(SIGINT, SIG_IGN); // a terminal sends ^C to the whole group: the daemon handles it
    struct sigaction act = {.sa_handler = on_child};
    sigaction(SIGCHLD, &act, NULL);
    for (;;) {
        reap(fd, running);
        struct pollfd poll_fd = {fd, POLLIN, 0};
        if (ppoll(&poll_fd, 1, NULL, &none) < 0) continue;
        int file_fd;
        ssize_t n = receive_packet(fd, packet, sizeof packet, &file_fd);
        if (n < 0 && (errno == EINTR || errno == EAGAIN)) continue;
        if (n < (ssize_t)sizeof(struct ask) || file_fd < 0) return 0; // the daemon has exited
        start_decoding(fd, packet, n, file_fd, running);
        close(file_fd);
    }
}

// ---- the daemon's side

void decoded_env_destroy(void *value)
{
    struct decoded_env *env = value;
    if (!env) return;
    prt_env_cache_destroy(&env->env);
    if (env->map) munmap(env->map, env->map_bytes);
    free(env);
}

static void finish(struct decoder *decoder, struct wait_for *w, struct decoded_env *env,
                   int status, const char *error, const struct reply *reply)
{
    struct wait_for **at = &decoder->waiting;
    while (*at != w) at = &(*at)->next;
    *at = w->next;
    decoder->n_sent -= w->sent;
    if (w->env_fn) w->env_fn(w->user, env, status, error);
    else
        w->model_fn(w->user, status, error, reply ? reply->warnings : "",
                    reply ? reply->ms : 0);
    free(w);
}

static struct decoded_env *map_pixels(const struct reply *reply, int fd)
{
    bool cube = reply->kind == PRT_ENV_CUBE;
    if (cube ? reply->cube_n < 1 || reply->cube_n > MAX_SIDE
             : !reply->width || reply->width > MAX_SIDE || !reply->height ||
                   reply->height > MAX_SIDE)
        return NULL;
    size_t n = pixel_bytes(reply->kind, reply->width, reply->height, reply->cube_n);
    off_t size = lseek(fd, 0, SEEK_END);
    if (size < 0 || (size_t)size != n) return NULL;
    struct decoded_env *env = calloc(1, sizeof *env);
    if (!env) return NULL;
    // Pages are mapped at first use, by a worker: reading them here would block the loop.
    env->map = mmap(NULL, n, PROT_READ, MAP_SHARED, fd, 0);
    if (env->map == MAP_FAILED) {
        free(env);
        return NULL;
    }
    env->map_bytes = n;
    env->decode_ms = reply->ms;
    env->env.kind = cube ? PRT_ENV_CUBE : PRT_ENV_LATLONG;
    env->env.n_negative = reply->n_negative;
    env->env.n_nonfinite = reply->n_nonfinite;
    if (cube && !prt_env_cache_create(&env->env)) // without it rotating only takes longer
        env->cache_bytes = (size_t)384 * reply->cube_n * reply->cube_n;
    if (cube) env->env.cube = (struct prt_cube){reply->cube_n, env->map};
    else env->env.latlong = (struct prt_image){reply->width, reply->height, env->map};
    return env;
}

static void take_reply(struct decoder *decoder, const struct reply *reply, int fd)
{
    struct wait_for *w = decoder->waiting;
    while (w && w->number != reply->number) w = w->next;
    if (!w) return;
    *decoder->n_crashed += reply->crashed;
    struct decoded_env *env = NULL;
    int status = reply->status;
    const char *error = reply->error;
    if (!status && w->env_fn && (fd < 0 || !(env = map_pixels(reply, fd)))) {
        status = PRT_NOMEM;
        error = "no memory for the decoded image";
    }
    finish(decoder, w, env, status, error, reply);
}

static void send_waiting(struct decoder *decoder);

static void helper_gone(struct decoder *decoder)
{
    if (decoder->watch.fd < 0) return;
    loop_watch_remove(decoder->loop, &decoder->watch);
    close(decoder->watch.fd);
    decoder->watch.fd = -1;
    for (struct wait_for *w = decoder->waiting; w; w = w->next) w->lost = w->sent;
    // Callbacks may send new requests to the next helper: the list is searched again each time.
    for (;;) {
        struct wait_for *w = decoder->waiting;
        while (w && !w->lost) w = w->next;
        if (!w) return;
        finish(decoder, w, NULL, PRT_FORMAT, "the decoding process died", NULL);
    }
}

static void helper_ready(struct loop_watch *watch, uint32_t events)
{
    struct decoder *decoder =
        (struct decoder *)((char *)watch - offsetof(struct decoder, watch));
    for (;;) {
        struct reply reply;
        int fd;
        ssize_t n = receive_packet(watch->fd, &reply, sizeof reply, &fd);
        if (n < 0 && (errno == EAGAIN || errno == EINTR)) break;
        if (n <= 0) {
            helper_gone(decoder);
            break;
        }
        reply.error[sizeof reply.error - 1] = 0;
        reply.warnings[sizeof reply.warnings - 1] = 0;
        if (n == (ssize_t)sizeof reply) take_reply(decoder, &reply, fd);
        if (fd >= 0) close(fd);
    }
    send_waiting(decoder);
}

static int start_helper(struct decoder *decoder)
{
    int pair[2];
    if (socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, pair)) return -errno;
    char word[16];
    posix_spawn_file_actions_t actions;
    posix_spawnattr_t attr;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, pair[1], 3);
    posix_spawnattr_init(&attr);
    sigset_t none;
    sigemptyset(&none);
    posix_spawnattr_setsigmask(&attr, &none);
    posix_spawnattr_setflags(&attr, POSIX_SPAWN_SETSIGMASK);
    snprintf(word, sizeof word, "%d", 3);
    char *argv[] = {"relightd", "--decode-helper", word, NULL};
    int err = posix_spawn(&decoder->pid, "/proc/self/exe", &actions, &attr, argv, environ);
    posix_spawn_file_actions_destroy(&actions);
    posix_spawnattr_destroy(&attr);
    close(pair[1]);
    if (err) {
        close(pair[0]);
        return -err;
    }
    decoder->watch = (struct loop_watch){pair[0], helper_ready};
    loop_watch_add(decoder->loop, &decoder->watch, EPOLLIN);
    return 0;
}

// Opens a file of the store or of --models. Its path was resolved before, so a link here was
// created since, and is refused.
static int open_input(const char *path, char error[256])
{
    struct stat st;
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK | O_NOCTTY);
    if (fd >= 0 && !fstat(fd, &st) && S_ISREG(st.st_mode)) return fd;
    snprintf(error, 256, "the file cannot be opened: %s",
             fd < 0 ? strerror(errno) : "not a regular file");
    if (fd >= 0) close(fd);
    return -1;
}

// Sends waiting requests up to the helper's limit; restarts a helper that died.
static void send_waiting(struct decoder *decoder)
{
    for (;;) {
        struct wait_for *w = decoder->waiting;
        while (w && w->sent) w = w->next;
        if (!w || decoder->n_sent >= decoder->at_once) return;
        if (decoder->watch.fd < 0 && start_helper(decoder)) {
            finish(decoder, w, NULL, PRT_INTERNAL, "the decoding process cannot be started",
                   NULL);
            continue;
        }
        char error[256];
        int fd = open_input(w->packet + sizeof(struct ask), error);
        if (fd < 0) {
            finish(decoder, w, NULL, PRT_IO, error, NULL);
            continue;
        }
        bool sent = send_packet(decoder->watch.fd, w->packet, w->size, fd);
        close(fd);
        if (!sent) {
            finish(decoder, w, NULL, PRT_INTERNAL, "the decoding process does not answer",
                   NULL);
            continue;
        }
        w->sent = true;
        decoder->n_sent++;
    }
}

int decoder_create(struct loop *loop, const struct decoder_limits *limits, uint64_t *n_crashed,
                   struct decoder **out)
{
    struct decoder *decoder = calloc(1, sizeof *decoder);
    if (!decoder) return -ENOMEM;
    *decoder = (struct decoder){
        .loop = loop, .limits = *limits, .n_crashed = n_crashed, .watch.fd = -1};
    struct decoder_limits *l = &decoder->limits;
    if (!l->total_bytes)
        l->total_bytes =
            (uint64_t)sysconf(_SC_PHYS_PAGES) * (uint64_t)sysconf(_SC_PAGESIZE) / 2;
    if (l->memory_bytes > l->total_bytes) l->memory_bytes = l->total_bytes;
    uint64_t fit = l->memory_bytes ? l->total_bytes / l->memory_bytes : 1;
    decoder->at_once = fit < MAX_AT_ONCE ? (unsigned)fit : MAX_AT_ONCE;
    int err = start_helper(decoder);
    if (err) {
        free(decoder);
        return err;
    }
    *out = decoder;
    return 0;
}

void decoder_destroy(struct decoder *decoder)
{
    if (!decoder) return;
    while (decoder->waiting)
        finish(decoder, decoder->waiting, NULL, PRT_CANCELLED, "the daemon is stopping", NULL);
    if (decoder->watch.fd >= 0) {
        loop_watch_remove(decoder->loop, &decoder->watch);
        close(decoder->watch.fd); // the helper exits when its socket closes
        waitpid(decoder->pid, NULL, 0);
    }
    free(decoder);
}

// NULL without memory, or when the strings are too long.
static struct wait_for *new_wait(struct decoder *decoder, struct ask *ask,
                                 const char *const word[], size_t n_word)
{
    size_t size = sizeof *ask;
    for (size_t i = 0; i < n_word; i++) size += strlen(word[i]) + 1;
    struct wait_for *w =
        n_word <= MAX_WORD && size <= PACKET ? calloc(1, sizeof *w + size) : NULL;
    if (!w) return NULL;
    ask->number = w->number = ++decoder->last_number;
    ask->memory_bytes = decoder->limits.memory_bytes;
    ask->image_bytes = decoder->limits.image_bytes;
    ask->n_word = (uint32_t)n_word;
    memcpy(w->packet, ask, sizeof *ask);
    w->size = sizeof *ask;
    for (size_t i = 0; i < n_word; i++) {
        strcpy(w->packet + w->size, word[i]);
        w->size += strlen(word[i]) + 1;
    }
    return w;
}

static void enqueue(struct decoder *decoder, struct wait_for *w)
{
    struct wait_for **last = &decoder->waiting;
    while (*last) last = &(*last)->next;
    *last = w;
    send_waiting(decoder);
}

static void ask_pixels(struct decoder *decoder, enum asked what, const char *path,
                       const char *name, decode_fn fn, void *user)
{
    const char *const word[] = {path, name};
    struct ask ask = {.model = what};
    struct wait_for *w = new_wait(decoder, &ask, word, 2);
    if (!w) {
        fn(user, NULL, PRT_NOMEM, "not enough memory");
        return;
    }
    w->env_fn = fn;
    w->user = user;
    enqueue(decoder, w);
}

void decoder_env(struct decoder *decoder, const char *path, const char *name, decode_fn fn,
                 void *user)
{
    ask_pixels(decoder, ASK_ENV, path, name, fn, user);
}

void decoder_image(struct decoder *decoder, const char *path, const char *name, decode_fn fn,
                   void *user)
{
    ask_pixels(decoder, ASK_IMAGE, path, name, fn, user);
}

void decoder_model(struct decoder *decoder, const struct decode_model *m, decode_model_fn fn,
                   void *user)
{
    const char *word[MAX_WORD] = {m->path, m->name, m->out};
    size_t n = 3;
    struct ask ask = {.model = ASK_MODEL,
                      .size_mm = m->size_mm,
                      .mm_per_unit = m->mm_per_unit,
                      .material = *m->material};
    for (size_t i = 0; i < m->n_opaque && n < MAX_WORD; i++) word[n++] = m->opaque[i];
    struct wait_for *w = new_wait(decoder, &ask, word, n);
    if (!w) {
        fn(user, PRT_LIMIT, "the names of opaque parts are too long", "", 0);
        return;
    }
    w->model_fn = fn;
    w->user = user;
    enqueue(decoder, w);
}

bool decoder_reap(struct decoder *decoder, int pid)
{
    if (!decoder || pid != decoder->pid) return false;
    log_line(LOG_WARN, "decode helper=%d died; the next image starts another", pid);
    ++*decoder->n_crashed;
    helper_gone(decoder);
    return true;
}
