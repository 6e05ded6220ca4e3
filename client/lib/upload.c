// SPDX-License-Identifier: MIT
// Uploads by content address: queries the state, then sends the missing bytes in pipelined
// chunks.
#include "internal.h"

#include <cjson/cJSON.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

enum { CHUNK = 1 << 20, IN_FLIGHT = 4, MAX_FILE = 64 };

void relight_hash(const void *bytes, size_t n, char hash[65])
{
    struct relight_sha256 sha;
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, bytes, n);
    relight_sha256_hex(&sha, hash);
}

static int put_begin(struct relight_client *client, Relight__PutBlobRequest *m,
                     const void *bytes, size_t n, uint64_t *id, struct relight_error *error)
{
    struct iovec piece = {(void *)(uintptr_t)bytes, n};
    return relight_start(client, RELIGHT_TYPE_PUT_BLOB, &m->base, &piece, n ? 1 : 0,
                         relight_timeout(client), false, id, error);
}

static int put_end(struct relight_client *client, uint64_t id, bool *complete,
                   uint64_t *received, struct relight_error *error)
{
    struct answer *answer;
    int status = relight_end(client, id, RELIGHT_TYPE_PUT_BLOB, &answer, error);
    if (status) return status;
    const Relight__PutBlobAnswer *a = (Relight__PutBlobAnswer *)answer->message;
    *complete = a->complete;
    *received = a->received;
    relight_answer_free(answer);
    return 0;
}

// Sends [m->offset, n) in chunks, at most IN_FLIGHT of them unanswered.
static int put_rest(struct relight_client *client, Relight__PutBlobRequest *m,
                    const uint8_t *bytes, uint64_t n, relight_progress_fn fn, void *user,
                    struct relight_error *error)
{
    const struct relight_server *server = relight_server(client);
    uint64_t chunk = server->chunk ? server->chunk : CHUNK, ids[IN_FLIGHT];
    uint64_t received = m->offset;
    unsigned depth = IN_FLIGHT, head = 0, outstanding = 0;
    if (server->max_payload && chunk > server->max_payload) chunk = server->max_payload;
    if (server->max_in_flight && depth > server->max_in_flight) depth = server->max_in_flight;
    bool complete = false;
    int status = 0;
    double begin_s = relight_now_s(), first = (double)m->offset;
    while (!status && (m->offset < n || outstanding)) {
        if (m->offset < n && outstanding < depth) {
            uint64_t size = n - m->offset < chunk ? n - m->offset : chunk;
            status = put_begin(client, m, bytes + m->offset, size,
                               ids + (head + outstanding) % IN_FLIGHT, error);
            m->offset += size;
            outstanding += !status;
            continue;
        }
        status = put_end(client, ids[head++ % IN_FLIGHT], &complete, &received, error);
        outstanding--;
        double done = (double)received / (double)n, spent = relight_now_s() - begin_s;
        double rate = ((double)received - first) / (spent > 0 ? spent : 1);
        struct relight_progress p = {"upload", done,
                                     rate > 0 ? ((double)n - (double)received) / rate : -1,
                                     spent, RELIGHT_JOB_RUNNING};
        if (!status && fn && fn(user, &p))
            status =
                relight_fail(error, RELIGHT_E_CANCELLED, "", "%s: upload stopped", m->name);
    }
    while (outstanding--) relight_forget(client, ids[head++ % IN_FLIGHT]);
    if (!status && !complete)
        status = relight_fail(error, RELIGHT_E_PROTOCOL, "try again",
                              "%s: the server says %llu of %llu bytes arrived", m->name,
                              (unsigned long long)received, (unsigned long long)n);
    return status;
}

int relight_upload(struct relight_client *client, const char *name, const void *bytes, size_t n,
                   relight_progress_fn fn, void *user, char hash[65], uint64_t *sent,
                   struct relight_error *error)
{
    char own[65];
    const struct relight_server *server = relight_server(client);
    if (!n) return relight_fail(error, RELIGHT_E_ARGUMENT, "", "%s: the file is empty", name);
    if (server->max_blob && n > server->max_blob)
        return relight_fail(error, RELIGHT_E_LIMIT, "", "%s: %zu bytes, the server takes %llu",
                            name, n, (unsigned long long)server->max_blob);
    relight_hash(bytes, n, own);
    Relight__PutBlobRequest m = RELIGHT__PUT_BLOB_REQUEST__INIT;
    m.hash = own;
    m.size = n;
    m.name = relight_text(name);
    uint64_t id, received = 0;
    bool complete = false;
    int status = put_begin(client, &m, NULL, 0, &id, error);
    if (!status) status = put_end(client, id, &complete, &received, error);
    if (status) return status;
    if (received > n) received = 0;
    if (!complete) {
        // All bytes there and yet not complete (a check that failed): send the last again.
        m.offset = received < n ? received : 0;
        received = m.offset;
        status = put_rest(client, &m, bytes, n, fn, user, error);
        if (status) return status;
    }
    if (sent) *sent = complete ? 0 : n - received;
    memcpy(hash, own, sizeof own);
    return 0;
}

static const char *base_name(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

struct map {
    void *bytes;
    size_t size;
};

static int map_file(const char *path, struct map *out, struct relight_error *error)
{
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    struct stat st;
    if (fd < 0) return relight_fail(error, RELIGHT_E_FILE, "", "%s: %s", path, strerror(errno));
    const char *bad = NULL;
    void *bytes = MAP_FAILED;
    if (fstat(fd, &st) || !S_ISREG(st.st_mode)) bad = "not a regular file";
    else if (!st.st_size) bad = "the file is empty";
    else bytes = mmap(NULL, (size_t)st.st_size, PROT_READ, MAP_PRIVATE, fd, 0);
    if (!bad && bytes == MAP_FAILED) bad = strerror(errno);
    close(fd);
    if (bad) return relight_fail(error, RELIGHT_E_FILE, "", "%s: %s", path, bad);
    *out = (struct map){bytes, (size_t)st.st_size};
    return 0;
}

int relight_upload_file(struct relight_client *client, const char *path, relight_progress_fn fn,
                        void *user, char hash[65], uint64_t *sent, struct relight_error *error)
{
    struct map map;
    int status = map_file(path, &map, error);
    if (status) return status;
    status = relight_upload(client, base_name(path), map.bytes, map.size, fn, user, hash, sent,
                            error);
    munmap(map.bytes, map.size);
    return status;
}

int relight_env_resolve(struct relight_client *client, const char *word, relight_progress_fn fn,
                        void *user, char env[80], struct relight_error *error)
{
    bool constant = !strcmp(word, "constant") || !strncmp(word, "constant:", 9);
    if (constant || (!strncmp(word, "env:", 4) && relight_hash_valid(word + 4))) {
        if (snprintf(env, 80, "%s", word) >= 80)
            return relight_fail(error, RELIGHT_E_ARGUMENT, "", "%s: expected constant:R,G,B",
                                word);
        return 0;
    }
    if (!strncmp(word, "env:", 4))
        return relight_fail(error, RELIGHT_E_ARGUMENT, "",
                            "%s: a hash has 64 lower-case hex digits", word);
    memcpy(env, "env:", 4);
    return relight_upload_file(client, word, fn, user, env + 4, NULL, error);
}

struct bundle {
    size_t n;
    struct relight_file file[MAX_FILE];
    char *name[MAX_FILE];
    char hash[MAX_FILE][65];
};

static int bundle_add(struct relight_client *client, struct bundle *bundle, const char *path,
                      const char *name, relight_progress_fn fn, void *user,
                      struct relight_error *error)
{
    if (bundle->n == MAX_FILE)
        return relight_fail(error, RELIGHT_E_LIMIT, "pack it as .glb",
                            "%s: names more than %d files", path, MAX_FILE);
    size_t i = bundle->n;
    int status = relight_upload_file(client, path, fn, user, bundle->hash[i], NULL, error);
    if (status) return status;
    if (!(bundle->name[i] = strdup(name)))
        return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
    bundle->file[i] = (struct relight_file){bundle->name[i], bundle->hash[i]};
    bundle->n++;
    return 0;
}

static int hex_digit(char c)
{
    return c >= '0' && c <= '9'   ? c - '0'
           : c >= 'a' && c <= 'f' ? c - 'a' + 10
           : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                  : -1;
}

static void unescape_uri(char *text)
{
    char *to = text;
    for (const char *at = text; *at; to++) {
        if (*at == '%' && hex_digit(at[1]) >= 0 && hex_digit(at[2]) >= 0) {
            *to = (char)(hex_digit(at[1]) * 16 + hex_digit(at[2]));
            at += 3;
        } else {
            *to = *at++;
        }
    }
    *to = 0;
}

// Uploads the files that `buffers` of a .gltf refers to.
static int add_buffers(struct relight_client *client, struct bundle *bundle, const char *path,
                       relight_progress_fn fn, void *user, struct relight_error *error)
{
    struct map map;
    int status = map_file(path, &map, error);
    if (status) return status;
    cJSON *json = cJSON_ParseWithLength(map.bytes, map.size);
    munmap(map.bytes, map.size);
    if (!json) return relight_fail(error, RELIGHT_E_FILE, "", "%s: is not JSON", path);
    const cJSON *buffer;
    cJSON_ArrayForEach(buffer, cJSON_GetObjectItemCaseSensitive(json, "buffers"))
    {
        const char *uri = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(buffer, "uri"));
        if (!uri || !strncmp(uri, "data:", 5)) continue;
        char *name = strdup(uri), *full = NULL;
        if (name) unescape_uri(name);
        if (!name || asprintf(&full, "%.*s%s", (int)(base_name(path) - path), path, name) < 0) {
            full = NULL;
            status = relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
        } else if (*name == '/' || strstr(name, "..")) {
            // A downloaded model must not make us send files from elsewhere.
            status =
                relight_fail(error, RELIGHT_E_FILE, "move the buffer beside the model",
                             "%s: buffer '%s' lies outside the model's folder", path, name);
        } else {
            status = bundle_add(client, bundle, full, uri, fn, user, error);
        }
        free(name);
        free(full);
        if (status) break;
    }
    cJSON_Delete(json);
    return status;
}

// Uploads a model's file and what it refers to; the caller frees *out.
static int upload_bundle(struct relight_client *client, const char *path,
                         relight_progress_fn fn, void *user, struct bundle **out,
                         struct relight_error *error)
{
    struct bundle *bundle = calloc(1, sizeof *bundle);
    if (!bundle) return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
    size_t n = strlen(path);
    bool gltf = n > 5 && !strcasecmp(path + n - 5, ".gltf");
    int status = bundle_add(client, bundle, path, base_name(path), fn, user, error);
    if (!status && gltf) status = add_buffers(client, bundle, path, fn, user, error);
    *out = bundle;
    return status;
}

static void free_bundle(struct bundle *bundle)
{
    for (size_t i = 0; bundle && i < bundle->n; i++) free(bundle->name[i]);
    free(bundle);
}

int relight_load_file(struct relight_client *client, const char *path,
                      const struct relight_load *load, relight_progress_fn fn, void *user,
                      struct relight_loaded *out, struct relight_error *error)
{
    struct bundle *bundle = NULL;
    int status = upload_bundle(client, path, fn, user, &bundle, error);
    if (!status) {
        struct relight_load whole = *load;
        whole.n_file = bundle->n;
        whole.files = bundle->file;
        whole.path = NULL;
        status = relight_load(client, &whole, out, error);
    }
    free_bundle(bundle);
    return status;
}

int relight_put_animation(struct relight_client *client, const char *model, const char *path,
                          const char *animation, double time_s, bool up_z, char pose[65],
                          struct relight_error *error)
{
    Relight__PutPoseRequest m = RELIGHT__PUT_POSE_REQUEST__INIT;
    struct answer *answer;
    struct bundle *bundle = NULL;
    int status = upload_bundle(client, path, NULL, NULL, &bundle, error);
    const size_t n = status ? 0 : bundle->n;
    Relight__FileRef *ref = calloc(n + 1, sizeof *ref), **refs = calloc(n + 1, sizeof *refs);
    if (!status && (!ref || !refs))
        status = relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
    for (size_t i = 0; !status && i < n; i++) {
        relight__file_ref__init(refs[i] = ref + i);
        ref[i].name = relight_text(bundle->file[i].name);
        ref[i].blob = relight_text(bundle->file[i].hash);
    }
    m.model = relight_text(model);
    m.animation = relight_text(animation);
    m.time_s = (float)time_s;
    m.up_z = up_z;
    m.n_files = n;
    m.files = refs;
    if (!status) status = relight_call(client, RELIGHT_TYPE_PUT_POSE, &m.base, &answer, error);
    if (!status) {
        snprintf(pose, 65, "%s", ((Relight__PutPoseAnswer *)answer->message)->pose);
        relight_answer_free(answer);
    }
    free_bundle(bundle);
    free(ref);
    free(refs);
    return status;
}
