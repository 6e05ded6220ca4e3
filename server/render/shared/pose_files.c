// SPDX-License-Identifier: MIT
// Poses are read from uploads and written as uploads.
#include "render/shared/pose_files.h"

#include "core/log.h"
#include "frame.h"
#include "net/message_names.h"
#include "net/request_wait.h"
#include "render/shared/poses.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_POSES = 64 }; // that one message names
static const char mark[4] = "pose";

static uint64_t file_bytes(uint32_t n)
{
    return sizeof mark + 24 * (uint64_t)n;
}

// ---- reading

struct restoring {
    struct work work; // first
    struct server *server;
    struct principal *principal;
    struct pose *pose; // NULL: the file is not one of a pose
    uint64_t most;     // bytes of the largest that may be in memory
    char name[65], path[4096];
    void (*wake)(void *user);
    void *user;
};

// False without memory, or where the file has other bytes.
static bool read_arrays(FILE *file, const char *name, struct pose *pose)
{
    const size_t n = pose->n;
    char begin[sizeof mark], hash[65];
    struct relight_sha256 sha;
    pose->position = prt_alloc(n, sizeof *pose->position);
    pose->normal = prt_alloc(n, sizeof *pose->normal);
    if (!pose->position || !pose->normal || fread(begin, sizeof begin, 1, file) != 1 ||
        fread(pose->position, 12, n, file) != n || fread(pose->normal, 12, n, file) != n)
        return false;
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, begin, sizeof begin);
    relight_sha256_add(&sha, pose->position, n * 12);
    relight_sha256_add(&sha, pose->normal, n * 12);
    relight_sha256_hex(&sha, hash);
    snprintf(pose->name, sizeof pose->name, "%s", hash);
    return !memcmp(begin, mark, sizeof mark) && !strcmp(hash, name);
}

static int run_restoring(struct work *work, const struct prt_context *ctx)
{
    struct restoring *r = (struct restoring *)work;
    FILE *file = fopen(r->path, "rbe");
    struct pose *pose = file ? calloc(1, sizeof *pose) : NULL;
    long bytes = pose && !fseek(file, 0, SEEK_END) ? ftell(file) : 0;
    // Any upload may be named: a large one is not read.
    if (pose) {
        pose->refs = 1;
        pose->n = bytes > 0 && (uint64_t)bytes <= r->most ? (uint32_t)(bytes / 24) : 0;
        rewind(file);
    }
    if (pose && pose->n && (uint64_t)bytes == file_bytes(pose->n) &&
        read_arrays(file, r->name, pose))
        r->pose = pose;
    else pose_release(pose);
    if (file) fclose(file);
    return PRT_OK;
}

static void restored(struct work *work)
{
    struct restoring *r = (struct restoring *)work;
    char error[256] = "its file is damaged, or larger than --client-poses allows";
    int code = r->pose ? poses_restore(r->server->poses, r->pose, r->principal, error) : -1;
    if (code) log_line(LOG_WARN, "pose hash=%.12s could not be read: %s", r->name, error);
    principal_release(r->principal);
    r->wake(r->user);
    free(r);
}

static uint64_t most_bytes(const struct principal *principal)
{
    uint64_t mine = ledger_limit_client(principal, LEDGER_POSES);
    uint64_t all = ledger_limit_all(principal->ledger, LEDGER_POSES);
    if (!mine) mine = UINT64_MAX - sizeof mark;
    return (all && all < mine ? all : mine) + sizeof mark;
}

void pose_restore(struct server *server, const char *name, struct principal *principal,
                  void (*wake)(void *user), void *user)
{
    bool there = !poses_known(server->poses, name) && blobs_has(server->blobs, name);
    struct restoring *r = there ? calloc(1, sizeof *r) : NULL;
    if (!r) { // without memory the operation says that the pose is missing
        wake(user);
        return;
    }
    r->server = server;
    r->principal = principal;
    principal_hold(principal);
    r->most = most_bytes(principal);
    snprintf(r->name, sizeof r->name, "%s", name);
    blobs_touch(server->blobs, name);
    blobs_path(server->blobs, name, r->path, sizeof r->path);
    r->wake = wake;
    r->user = user;
    r->work.run = run_restoring;
    r->work.done = restored;
    work_submit(server->work, &r->work);
}

// ---- writing

struct keeping {
    struct request_wait wait; // first
    void (*run)(struct request *request);
    unsigned pending;
    int code; // of the first that could not be written
    char error[256];
};

struct kept {
    struct blob_put put; // first
    struct keeping *keeping;
    struct principal *principal; // held: charged for the bytes
};

struct wanted {
    const struct server *server;
    size_t n;
    const char *name[MOST_POSES];
    const char *missing; // neither on the disk nor in memory
};

static void want(void *user, enum message_name kind, const char *name)
{
    struct wanted *w = user;
    if (kind != NAME_POSE || blobs_has(w->server->blobs, name)) return;
    for (size_t i = 0; i < w->n; i++)
        if (!strcmp(w->name[i], name)) return;
    if (!poses_known(w->server->poses, name) || w->n == MOST_POSES) w->missing = name;
    else w->name[w->n++] = name;
}

static void one_kept(struct keeping *k)
{
    if (--k->pending) return;
    struct request *request = request_resume(&k->wait);
    if (request && k->code) request_fail(request, k->code, "%s", k->error);
    else if (request) k->run(request);
    free(k);
}

static void was_put(struct blob_put *put)
{
    struct kept *one = (struct kept *)put;
    struct keeping *k = one->keeping;
    if (put->code && !k->code) {
        k->code = put->code;
        snprintf(k->error, sizeof k->error, "pose %.12s… was not kept: %.200s", put->hash,
                 put->error);
    }
    free(put->bytes);
    ledger_give(one->principal, LEDGER_PAYLOAD, put->n);
    principal_release(one->principal);
    free(one);
    one_kept(k);
}

static void keep(struct keeping *k, struct request *request, const char *name)
{
    const struct pose *pose = poses_known(request->server->poses, name);
    const uint64_t size = file_bytes(pose->n);
    const size_t part = (size_t)pose->n * 12;
    // A client may ask for many copies of one pose before the first is on the disk.
    if (ledger_take(request->principal, LEDGER_PAYLOAD, size, k->error)) {
        k->code = refusal_code(request->principal, LEDGER_PAYLOAD, size);
        return;
    }
    struct kept *one = calloc(1, sizeof *one);
    char *bytes = one ? malloc(size) : NULL;
    if (!bytes) {
        free(one);
        ledger_give(request->principal, LEDGER_PAYLOAD, size);
        k->code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
        snprintf(k->error, sizeof k->error, "not enough memory");
        return;
    }
    memcpy(bytes, mark, sizeof mark);
    memcpy(bytes + sizeof mark, pose->position, part);
    memcpy(bytes + sizeof mark + part, pose->normal, part);
    struct blob_put *put = &one->put;
    snprintf(put->principal, sizeof put->principal, "%s", request->principal->name);
    snprintf(put->hash, sizeof put->hash, "%s", name);
    put->size = put->n = size;
    put->bytes = bytes;
    put->done = was_put;
    one->keeping = k;
    principal_hold(one->principal = request->principal);
    k->pending++;
    blobs_put(request->server->blobs, put);
}

void poses_keep_then(struct request *request, void (*run)(struct request *request))
{
    struct wanted wanted = {.server = request->server};
    message_names(request->message, want, &wanted);
    if (wanted.missing) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                     "pose %.12s… is not there any more: send it again (PUT_POSE)",
                     wanted.missing);
        return;
    }
    struct keeping *k = wanted.n ? calloc(1, sizeof *k) : NULL;
    if (!k) {
        if (!wanted.n) run(request);
        else request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    k->run = run;
    k->pending = 1; // none ends before all have begun
    request_park(request, &k->wait);
    for (size_t i = 0; i < wanted.n; i++) keep(k, request, wanted.name[i]);
    one_kept(k);
}
