// SPDX-License-Identifier: MIT
// The daemon's side of the decode helper: starts it, sends it as many files as its memory
// allows, maps the results.
#include "jobs/decode_messages.h"

#include "core/log.h"

#include <errno.h>
#include <fcntl.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>

struct wait_for {
    struct wait_for *next;
    uint64_t number;
    decode_fn env_fn; // one of the four
    decode_model_fn model_fn;
    decode_pose_fn pose_fn;
    decode_material_fn material_fn;
    void *user;
    bool sent, lost;
    char request[65]; // id of the request that it is for; others may wait for it, too
    size_t size;      // of the packet
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

void decoded_env_destroy(void *value)
{
    struct decoded_env *env = value;
    if (!env) return;
    prt_env_cache_destroy(&env->env);
    if (env->map) munmap(env->map, env->map_bytes);
    free(env);
}

void decoded_pose_destroy(struct decoded_pose *pose)
{
    if (!pose) return;
    munmap(pose->map, pose->map_bytes);
    free(pose);
}

// result: of env_fn, pose_fn or material_fn, whose text is freed afterwards.
static void finish(struct decoder *decoder, struct wait_for *w, void *result, int status,
                   const char *error, const struct reply *reply)
{
    struct wait_for **at = &decoder->waiting;
    while (*at != w) at = &(*at)->next;
    *at = w->next;
    decoder->n_sent -= w->sent;
    if (w->env_fn) w->env_fn(w->user, result, status, error);
    else if (w->pose_fn) w->pose_fn(w->user, result, status, error);
    else if (w->material_fn)
        w->material_fn(w->user, result, status, error, reply ? reply->warnings : "");
    else
        w->model_fn(w->user, status, error, reply ? reply->warnings : "",
                    reply ? reply->ms : 0);
    if (w->material_fn) free(result);
    free(w);
}

static struct decoded_env *map_pixels(const struct reply *reply, int fd)
{
    bool cube = reply->kind == PRT_ENV_CUBE;
    if (cube ? reply->cube_n < 1 || reply->cube_n > MAX_SIDE
             : !reply->width || reply->width > MAX_SIDE || !reply->height ||
                   reply->height > MAX_SIDE)
        return NULL;
    size_t n = decode_pixel_bytes(reply->kind, reply->width, reply->height, reply->cube_n);
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
    if (!prt_env_cache_create(&env->env)) // without it rotating only takes longer
        env->cache_bytes = PRT_ENV_TURNED_BYTES(32) + PRT_ENV_TURNED_BYTES(16) +
                           (cube ? (size_t)384 * reply->cube_n * reply->cube_n : 0);
    if (cube) env->env.cube = (struct prt_cube){reply->cube_n, env->map};
    else env->env.latlong = (struct prt_image){reply->width, reply->height, env->map};
    return env;
}

static struct decoded_pose *map_pose(const struct reply *reply, int fd)
{
    const size_t n = (size_t)reply->n_vertex * 24;
    off_t size = lseek(fd, 0, SEEK_END);
    if (!n || size < 0 || (size_t)size != n) return NULL;
    struct decoded_pose *pose = calloc(1, sizeof *pose);
    if (!pose) return NULL;
    *pose = (struct decoded_pose){.n = reply->n_vertex, .map_bytes = n};
    pose->map = mmap(NULL, n, PROT_READ, MAP_SHARED, fd, 0);
    pose->values = pose->map;
    if (pose->map != MAP_FAILED) return pose;
    free(pose);
    return NULL;
}

static char *read_text(int fd)
{
    char *text = malloc(PRT_MATERIAL_TEXT);
    ssize_t n = text ? pread(fd, text, PRT_MATERIAL_TEXT - 1, 0) : -1;
    if (n <= 0) {
        free(text);
        return NULL;
    }
    text[n] = 0;
    return text;
}

static void take_reply(struct decoder *decoder, const struct reply *reply, int fd)
{
    struct wait_for *w = decoder->waiting;
    while (w && w->number != reply->number) w = w->next;
    if (!w) return;
    *decoder->n_crashed += reply->crashed;
    void *result = NULL;
    int status = reply->status;
    const char *error = reply->error;
    if (!status && !w->model_fn && fd >= 0)
        result = w->env_fn    ? (void *)map_pixels(reply, fd)
                 : w->pose_fn ? (void *)map_pose(reply, fd)
                              : (void *)read_text(fd);
    if (!status && !w->model_fn && !result) {
        status = PRT_NOMEM;
        error = "no memory for what was decoded";
    }
    if (status)
        log_line(LOG_EVENT, "decode request=%s crashed=%u error=\"%s\"", w->request,
                 reply->crashed, error);
    finish(decoder, w, result, status, error, reply);
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
        log_line(LOG_WARN, "decode request=%s error=\"the decoding process died\"", w->request);
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
        ssize_t n = decode_receive_packet(watch->fd, &reply, sizeof reply, &fd);
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
        bool sent = decode_send_packet(decoder->watch.fd, w->packet, w->size, fd);
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
    snprintf(ask->request, sizeof ask->request, "%s", log_request());
    strcpy(w->request, ask->request);
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
                      .up_z = m->up_z,
                      .flip_v = m->flip_v,
                      .n_material = (uint32_t)m->n_material};
    snprintf(ask.variant, sizeof ask.variant, "%s", m->variant);
    for (size_t i = 0; i < m->n_material && n < MAX_WORD; i++) word[n++] = m->material[i];
    for (size_t i = 0; i < m->n_opaque && n < MAX_WORD; i++) word[n++] = m->opaque[i];
    struct wait_for *w = new_wait(decoder, &ask, word, n);
    if (!w) {
        fn(user, PRT_LIMIT, "the names of opaque parts and materials are too long", "", 0);
        return;
    }
    w->model_fn = fn;
    w->user = user;
    enqueue(decoder, w);
}

void decoder_pose(struct decoder *decoder, const char *path, const char *name,
                  const char *animation, double time_s, bool up_z, decode_pose_fn fn,
                  void *user)
{
    const char *const word[] = {path, name, animation};
    struct ask ask = {.model = ASK_POSE, .time_s = time_s, .up_z = up_z};
    struct wait_for *w = new_wait(decoder, &ask, word, 3);
    if (!w) {
        fn(user, NULL, PRT_NOMEM, "not enough memory");
        return;
    }
    w->pose_fn = fn;
    w->user = user;
    enqueue(decoder, w);
}

void decoder_material(struct decoder *decoder, const char *path, const char *name,
                      const char *material, decode_material_fn fn, void *user)
{
    const char *const word[] = {path, name, material};
    struct ask ask = {.model = ASK_MATERIAL};
    struct wait_for *w = new_wait(decoder, &ask, word, 3);
    if (!w) {
        fn(user, NULL, PRT_NOMEM, "not enough memory", "");
        return;
    }
    w->material_fn = fn;
    w->user = user;
    enqueue(decoder, w);
}

void decoder_withdraw(struct decoder *decoder, const void *user)
{
    struct wait_for *w = decoder->waiting;
    while (w && (w->sent || w->user != user)) w = w->next;
    if (w) finish(decoder, w, NULL, PRT_CANCELLED, "nobody waits for it any more", NULL);
}

bool decoder_reap(struct decoder *decoder, int pid)
{
    if (!decoder || pid != decoder->pid) return false;
    log_line(LOG_WARN, "decode helper=%d died; the next image starts another", pid);
    ++*decoder->n_crashed;
    helper_gone(decoder);
    return true;
}
