// SPDX-License-Identifier: MIT
// The decode helper: a process of one thread that forks an isolated child for each file to be
// read. Requests are struct ask and its words with the open file passed along; a reply is
// {number, status, sizes} + error text, with the pixels of an image in a memory file.
#include "jobs/decode_messages.h"

#include "prt/media.h"
#include "prt/transport.h"

#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <limits.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>

static void keep_error(void *user, enum prt_log_level level, const char *line)
{
    struct reply *reply = user;
    size_t n = strlen(reply->warnings);
    if (level == PRT_LOG_ERROR && !reply->error[0])
        snprintf(reply->error, sizeof reply->error, "%s", line);
    if (level == PRT_LOG_WARNING)
        snprintf(reply->warnings + n, sizeof reply->warnings - n, "%s\n", line);
}

// Frees pages as soon as they are copied, so that memory holds one copy of a large image.
static bool write_all(int fd, const void *bytes, size_t n)
{
    const size_t piece = 8 << 20, page = (size_t)sysconf(_SC_PAGESIZE);
    const char *from = bytes;
    for (size_t put = 0; put < n;) {
        ssize_t done = write(fd, from + put, n - put < piece ? n - put : piece);
        if (done < 0 && errno == EINTR) continue;
        if (done <= 0) return false;
        uintptr_t begin = ((uintptr_t)(from + put) + page - 1) & ~(uintptr_t)(page - 1);
        put += (size_t)done;
        uintptr_t end = (uintptr_t)(from + put) & ~(uintptr_t)(page - 1);
        if (begin < end) madvise((void *)begin, end - begin, MADV_DONTNEED);
    }
    return true;
}

// A sealed memory file of both pieces; the second may be empty.
static int memory_file(const void *a, size_t n_a, const void *b, size_t n_b)
{
    int fd = memfd_create("decoded", MFD_CLOEXEC | MFD_ALLOW_SEALING);
    if (fd < 0) return -1;
    if (write_all(fd, a, n_a) && write_all(fd, b, n_b) &&
        !fcntl(fd, F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_WRITE | F_SEAL_SEAL))
        return fd;
    close(fd);
    return -1;
}

static int write_pixels(const struct prt_env *env, size_t n)
{
    return memory_file(env->kind == PRT_ENV_CUBE ? env->cube.texel : env->latlong.rgb, n, NULL,
                       0);
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
    pixels_fd = write_pixels(
        env, decode_pixel_bytes(reply->kind, reply->width, reply->height, reply->cube_n));
    if (pixels_fd < 0) {
        reply->status = PRT_NOMEM;
        snprintf(reply->error, sizeof reply->error, "%s: no memory for its pixels", name);
    }
    return pixels_fd;
}

// Writes the mesh as a .prt with one empty tensor, a cluster for each block.
static int write_mesh(const struct prt_context *ctx, const char *out,
                      const struct prt_mesh *mesh, const struct prt_media *media)
{
    struct prt_transport t = {.mesh = *mesh,
                              .media = *media,
                              .cube = 16,
                              .engine = PRT_TRANSPORT_JOINT,
                              .n_tensor = 1,
                              .settings = "{}",
                              .errors = "{}",
                              .mesh_hash = prt_mesh_hash(mesh)};
    uint32_t *order = prt_alloc(mesh->n_vertex, sizeof *order), n = 0, n_cluster = 0;
    struct prt_cluster *cluster = prt_calloc(mesh->n_block, sizeof *cluster);
    int status = order && cluster
                     ? PRT_OK
                     : prt_fail(ctx, PRT_NOMEM, "no memory for %u vertices", mesh->n_vertex);
    for (uint32_t b = 0; b < mesh->n_block && !status; b++) {
        const struct prt_block *block = &mesh->block[b];
        if (!block->n_vertex) continue;
        cluster[n_cluster++] =
            (struct prt_cluster){.vertex_begin = n, .n_vertex = block->n_vertex};
        for (uint32_t i = 0; i < block->n_vertex; i++) order[n++] = block->vertex_begin + i;
    }
    t.tensor[0] = (struct prt_tensor){.storage = PRT_STORAGE_RADIAL,
                                      .coupling = PRT_COUPLE_FULL,
                                      .n_vertex = mesh->n_vertex,
                                      .n_function = 1,
                                      .n_phase = 1,
                                      .n_radial = 1,
                                      .n_cluster = n_cluster,
                                      .order = order,
                                      .cluster = cluster};
    if (!status) status = prt_file_write(ctx, out, &t);
    prt_free(order);
    prt_free(cluster);
    return status;
}

// What --material says, then the file's own media, then the first preset, as prt bake does.
static int choose_media(const struct prt_context *ctx, const struct prt_mesh *mesh, uint32_t n,
                        char *const *text, struct prt_material *material,
                        struct prt_material *own, const struct prt_material *of_block[])
{
    struct prt_media_entry entry[PRT_MEDIA_MAX + 1];
    char name[PRT_MEDIA_MAX + 1][128];
    int status = n <= PRT_MEDIA_MAX + 1 ? PRT_OK : PRT_LIMIT;
    for (uint32_t i = 0; i < n && !status; i++) {
        const size_t length = prt_media_name_length(text[i]);
        status = prt_material_load(ctx, text[i] + (length ? length + 1 : 0), &material[i]);
        snprintf(name[i], sizeof name[i], "%.*s", length < 127 ? (int)length : 127, text[i]);
        entry[i] = (struct prt_media_entry){name[i], &material[i]};
    }
    if (!status) status = prt_media_assign(ctx, mesh, n, entry, of_block);
    if (status) return status;
    prt_media_own(ctx, mesh, own, of_block);
    for (uint32_t i = 0; i < mesh->n_block; i++)
        if (!of_block[i]) of_block[i] = prt_material_preset(0);
    return PRT_OK;
}

static int give_media(const struct prt_context *ctx, struct prt_mesh *mesh, uint32_t n,
                      char *const *text, struct prt_media **out)
{
    struct prt_material *material = prt_alloc(n + 1, sizeof *material);
    struct prt_material *own = prt_alloc(mesh->n_surface, sizeof *own);
    const struct prt_material **of_block = prt_calloc(mesh->n_block, sizeof *of_block);
    int status = material && own && of_block
                     ? choose_media(ctx, mesh, n, text, material, own, of_block)
                     : prt_fail(ctx, PRT_NOMEM, "no memory for the media");
    if (!status) status = prt_media_divide(ctx, mesh, of_block);
    if (!status) status = prt_media_create(ctx, mesh, of_block, out);
    prt_free(material);
    prt_free(own);
    prt_free(of_block);
    return status;
}

static int read_model(const struct prt_context *ctx, const struct ask *ask, int fd,
                      const char *folder, char *const *word)
{
    struct prt_mesh_options options = {.opaque =
                                           (const char *const *)word + 3 + ask->n_material,
                                       .up_z = ask->up_z != 0,
                                       .flip_v = ask->flip_v != 0,
                                       .variant = ask->variant[0] ? ask->variant : NULL};
    struct prt_mesh *mesh = NULL;
    struct prt_media *media = NULL;
    int status = prt_mesh_load_fd(ctx, word[1], fd, folder, &options, &mesh);
    if (!status) status = prt_mesh_scale(ctx, mesh, ask->size_mm, ask->mm_per_unit);
    if (!status) status = give_media(ctx, mesh, ask->n_material, word + 3, &media);
    if (!status) status = write_mesh(ctx, word[2], mesh, media);
    prt_free(media);
    prt_mesh_destroy(mesh);
    return status;
}

static int read_pose(const struct prt_context *ctx, const struct ask *ask, int fd,
                     const char *folder, char *const *word, struct reply *reply)
{
    const struct prt_mesh_options options = {.up_z = ask->up_z != 0,
                                             .no_textures = true,
                                             .animation = word[2],
                                             .time_s = ask->time_s};
    struct prt_mesh *mesh = NULL;
    reply->status = prt_mesh_load_fd(ctx, word[1], fd, folder, &options, &mesh);
    if (reply->status) return -1;
    const size_t n = (size_t)mesh->n_vertex * 12;
    int out = memory_file(mesh->position, n, mesh->normal, n);
    reply->n_vertex = mesh->n_vertex;
    if (out < 0) reply->status = PRT_NOMEM;
    prt_mesh_destroy(mesh);
    return out;
}

static int read_material(const struct prt_context *ctx, int fd, char *const *word,
                         struct reply *reply)
{
    struct prt_material material;
    char *text = prt_alloc(PRT_MATERIAL_TEXT, 1);
    int out = -1, n = -1;
    reply->status =
        text ? prt_material_load_foreign_fd(ctx, word[1], fd, word[2], &material) : PRT_NOMEM;
    if (!reply->status) n = prt_material_print(&material, text, PRT_MATERIAL_TEXT);
    if (n > 0) out = memory_file(text, (size_t)n, NULL, 0);
    if (!reply->status && out < 0) reply->status = PRT_NOMEM;
    prt_free(text);
    return out;
}

// word: path, name, ... and NULL at the end.
// False when the reply could not be sent.
static bool serve(int socket_fd, const struct ask *ask, int fd, char *const *word)
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
    else if (ask->model == ASK_POSE) pixels_fd = read_pose(&ctx, ask, fd, folder, word, &reply);
    else if (ask->model == ASK_MATERIAL) pixels_fd = read_material(&ctx, fd, word, &reply);
    else pixels_fd = read_image(&ctx, ask->model == ASK_ENV, fd, word[1], &reply);
    if (reply.status && !reply.error[0])
        snprintf(reply.error, sizeof reply.error, "%s: %s", word[1],
                 prt_status_text(reply.status));
    hide_folder(reply.error, folder);
    hide_folder(reply.warnings, folder);
    reply.crashed = prt_isolate_crashes();
    reply.ms = (float)((prt_time_s() - start) * 1e3);
    return decode_send_packet(socket_fd, &reply, sizeof reply, pixels_fd);
}

// Splits a packet into its strings; false when some are missing.
static bool split_words(char *packet, size_t n, const struct ask *ask, char *word[MAX_WORD + 1])
{
    size_t at = sizeof *ask;
    const uint32_t least = ask->model == ASK_MODEL ? 3 + ask->n_material
                           : ask->model == ASK_POSE || ask->model == ASK_MATERIAL ? 3
                                                                                  : 2;
    if (ask->n_word > MAX_WORD || ask->n_word < least) return false;
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
            decode_send_packet(fd, &reply, sizeof reply, -1);
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
        _exit(serve(fd, &ask, file_fd, word) ? 0 : 1); // 1: reap() replies
    }
    if (pid < 0) {
        struct reply reply = {.number = ask.number,
                              .status = PRT_NOMEM,
                              .error = "no process could be started to read the file"};
        decode_send_packet(fd, &reply, sizeof reply, -1);
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
        ssize_t n = decode_receive_packet(fd, packet, sizeof packet, &file_fd);
        if (n < 0 && (errno == EINTR || errno == EAGAIN)) continue;
        if (n < (ssize_t)sizeof(struct ask) || file_fd < 0) return 0; // the daemon has exited
        start_decoding(fd, packet, n, file_fd, running);
        close(file_fd);
    }
}
