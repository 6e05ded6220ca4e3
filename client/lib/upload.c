// SPDX-License-Identifier: MIT
// Uploads by content address: queries the state, then sends the missing bytes in pipelined
// chunks.
#include "internal.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { CHUNK = 1 << 20, IN_FLIGHT = 4 };

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

static int too_large(const char *name, size_t n, uint64_t most, struct relight_error *error)
{
    return relight_fail(error, RELIGHT_E_LIMIT, "", "%s: %zu bytes, the server takes %llu",
                        name, n, (unsigned long long)most);
}

int relight_upload(struct relight_client *client, const char *name, const void *bytes, size_t n,
                   relight_progress_fn fn, void *user, char hash[65], uint64_t *sent,
                   struct relight_error *error)
{
    char own[65];
    const struct relight_server *server = relight_server(client);
    if (!n) return relight_fail(error, RELIGHT_E_ARGUMENT, "", "%s: the file is empty", name);
    if (server->max_blob && n > server->max_blob)
        return too_large(name, n, server->max_blob, error);
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

const char *relight_base_name(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

// Reads n bytes of a file. Returns NULL, or the error as text.
static const char *read_bytes(int fd, char *to, size_t n)
{
    for (size_t at = 0; at < n;) {
        const ssize_t got = read(fd, to + at, n - at);
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return strerror(errno);
        if (!got) return "it became shorter while it was read";
        at += (size_t)got;
    }
    return NULL;
}

int relight_read_file(const char *path, uint64_t most, struct relight_content *out,
                      struct relight_error *error)
{
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    struct stat st;
    if (fd < 0) return relight_fail(error, RELIGHT_E_FILE, "", "%s: %s", path, strerror(errno));
    const char *bad = NULL;
    if (fstat(fd, &st) || !S_ISREG(st.st_mode)) bad = "not a regular file";
    else if (!st.st_size) bad = "the file is empty";
    const size_t n = bad ? 0 : (size_t)st.st_size;
    const bool large = most && n > most;
    *out = (struct relight_content){bad || large ? NULL : malloc(n), n};
    if (out->bytes) bad = read_bytes(fd, out->bytes, n);
    close(fd);
    if (out->bytes && !bad) return 0;
    free(out->bytes);
    if (large) return too_large(path, n, most, error);
    if (bad) return relight_fail(error, RELIGHT_E_FILE, "", "%s: %s", path, bad);
    return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "%s: not enough memory to read it",
                        path);
}

int relight_upload_file(struct relight_client *client, const char *path, relight_progress_fn fn,
                        void *user, char hash[65], uint64_t *sent, struct relight_error *error)
{
    struct relight_content file;
    int status = relight_read_file(path, relight_server(client)->max_blob, &file, error);
    if (status) return status;
    status = relight_upload(client, relight_base_name(path), file.bytes, file.size, fn, user,
                            hash, sent, error);
    free(file.bytes);
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
