// SPDX-License-Identifier: MIT
// Named poses: found by model and content, least recently used first out.
#include "render/shared/poses.h"

#include "net/request.h"
#include "prt/base.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>

// Generations of named poses begin here: those of models count up from 1.
static const uint64_t first_generation = UINT64_C(1) << 32;

// The table has a fixed size: poses are few, unless somebody sends millions of tiny ones.
enum { BUCKETS = 4096 };

struct named_pose {
    struct named_pose *older, *newer;
    struct named_pose *chain; // of the bucket of its name
    struct pose *pose;        // held
    char
        model[MODEL_ID + 12]; // its key; "": it was read from the disk, for the first that asks
};

// What a pose of a model costs beside its vertices: struct and blocks of the allocator.
enum { RECORD = sizeof(struct named_pose) + 16, POSE = sizeof(struct pose) + 3 * 16 };

struct poses {
    struct server *server;
    struct named_pose *oldest, *newest, *bucket[BUCKETS];
    uint64_t last, seed;
};

uint64_t poses_bytes(uint32_t n)
{
    return (uint64_t)n * 24 + POSE + RECORD;
}

int poses_create(struct server *server, struct poses **out)
{
    struct poses *poses = calloc(1, sizeof *poses);
    if (!poses) return -1;
    if (getrandom(&poses->seed, sizeof poses->seed, 0) != sizeof poses->seed) {
        free(poses);
        return -1;
    }
    poses->server = server;
    *out = poses;
    return 0;
}

static struct named_pose **bucket_of(const struct poses *poses, const char *name)
{
    uint64_t hash = prt_hash64(name, strlen(name), poses->seed);
    return (struct named_pose **)(uintptr_t)&poses->bucket[hash % BUCKETS];
}

static void unlink_pose(struct poses *poses, struct named_pose *p)
{
    *(p->older ? &p->older->newer : &poses->oldest) = p->newer;
    *(p->newer ? &p->newer->older : &poses->newest) = p->older;
}

static void link_newest(struct poses *poses, struct named_pose *p)
{
    p->newer = NULL;
    p->older = poses->newest;
    *(p->older ? &p->older->newer : &poses->oldest) = p;
    poses->newest = p;
}

static void enter(struct poses *poses, struct named_pose *p)
{
    struct named_pose **bucket = bucket_of(poses, p->pose->name);
    p->chain = *bucket;
    *bucket = p;
    link_newest(poses, p);
}

static void remove_pose(struct poses *poses, struct named_pose *p)
{
    struct named_pose **at = bucket_of(poses, p->pose->name);
    while (*at != p) at = &(*at)->chain;
    *at = p->chain;
    unlink_pose(poses, p);
    ledger_give(p->pose->principal, LEDGER_POSES, RECORD);
    pose_release(p->pose);
    free(p);
}

void poses_destroy(struct poses *poses)
{
    if (!poses) return;
    while (poses->oldest) remove_pose(poses, poses->oldest);
    free(poses);
}

static void forget_results(struct poses *poses, const struct named_pose *p)
{
    char prefix[96];
    snprintf(prefix, sizeof prefix, "%s/%llu/", p->model,
             (unsigned long long)p->pose->generation);
    cache_forget(poses->server->cache, prefix, false);
}

void poses_forget(struct poses *poses, const struct model *model)
{
    if (!poses) return;
    for (struct named_pose *p = poses->oldest, *next; p; p = next) {
        next = p->newer;
        if (!strcmp(p->model, model->key)) remove_pose(poses, p);
    }
}

// The models that have it: each holds a reference.
static unsigned n_models(const struct poses *poses, const struct pose *pose)
{
    unsigned n = 0;
    for (const struct named_pose *p = *bucket_of(poses, pose->name); p; p = p->chain)
        n += p->pose == pose;
    return n;
}

static bool is_used(const struct poses *poses, const struct pose *pose)
{
    return pose->refs > 1 && pose->refs > n_models(poses, pose);
}

// The least recently used pose that nothing draws, of this principal (NULL: of any). False
// where there is none. Those that something draws are used now.
static bool evict(struct poses *poses, const struct principal *of)
{
    const struct named_pose *last = poses->newest;
    for (struct named_pose *p = poses->oldest, *next; p; p = next) {
        next = p == last ? NULL : p->newer;
        if (of && p->pose->principal != of) continue;
        // Shapes of the cache hold it, too; the cache is searched for them alone.
        if (is_used(poses, p->pose)) forget_results(poses, p);
        if (!is_used(poses, p->pose)) {
            remove_pose(poses, p);
            return true;
        }
        unlink_pose(poses, p);
        link_newest(poses, p);
    }
    return false;
}

static struct named_pose *find(const struct poses *poses, const struct model *model,
                               const char *name)
{
    struct named_pose *p = *bucket_of(poses, name);
    while (p && (strcmp(p->pose->name, name) || strcmp(p->model, model->key))) p = p->chain;
    return p;
}

// Of any model.
static struct named_pose *find_any(const struct poses *poses, const char *name)
{
    struct named_pose *p = *bucket_of(poses, name);
    while (p && strcmp(p->pose->name, name)) p = p->chain;
    return p;
}

const struct pose *poses_known(const struct poses *poses, const char *name)
{
    const struct named_pose *p = find_any(poses, name);
    return p ? p->pose : NULL;
}

static struct pose *use(struct poses *poses, struct named_pose *p)
{
    unlink_pose(poses, p);
    link_newest(poses, p);
    p->pose->refs++;
    return p->pose;
}

// One that rooms keep is any model's that asks for it: which has its vertices, the shape says.
static struct named_pose *find_kept(struct poses *poses, const struct model *model,
                                    const char *name)
{
    struct named_pose *p = find_any(poses, name), *own = NULL;
    if (!p || !blobs_has(poses->server->blobs, name)) return NULL;
    if (!*p->model) own = p;
    else if ((own = calloc(1, sizeof *own))) {
        own->pose = p->pose;
        own->pose->refs++;
        ledger_force(own->pose->principal, LEDGER_POSES, RECORD);
        enter(poses, own);
    }
    if (own) snprintf(own->model, sizeof own->model, "%s", model->key);
    return own;
}

struct pose *poses_find(struct poses *poses, const struct model *model, const char *name,
                        int *code, char error[256])
{
    struct named_pose *p = find(poses, model, name);
    if (p || (p = find_kept(poses, model, name))) return use(poses, p);
    *code = RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
    if (!relight_hash_valid(name)) {
        *code = RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST;
        snprintf(error, 256, "pose %.20s: not 64 lower-case hex digits", name);
    } else {
        snprintf(error, 256,
                 "pose %.12s… of %.60s was never sent, or its room was needed: send it again "
                 "(PUT_POSE)",
                 name, model->name);
    }
    return NULL;
}

static int charge(struct poses *poses, struct pose *pose, struct principal *principal,
                  char error[256])
{
    uint64_t bytes = poses_bytes(pose->n);
    enum ledger_refusal refusal;
    while ((refusal = ledger_take(principal, LEDGER_POSES, bytes, error))) {
        if (refusal_code(principal, LEDGER_POSES, bytes) == RELIGHT__ERROR_CODE__ERROR_LIMIT)
            return RELIGHT__ERROR_CODE__ERROR_LIMIT;
        if (!evict(poses, refusal == LEDGER_CLIENT_FULL ? principal : NULL))
            return RELIGHT__ERROR_CODE__ERROR_BUSY;
    }
    pose->principal = principal;
    principal_hold(principal);
    pose->resource = LEDGER_POSES;
    pose->charged = bytes - RECORD; // that of its record goes with it
    return 0;
}

// Takes over the pose, with its name.
static int add(struct poses *poses, const char *model, struct pose *pose,
               struct principal *principal, char error[256])
{
    struct named_pose *p = NULL;
    int code = charge(poses, pose, principal, error);
    if (!code && !(p = calloc(1, sizeof *p))) {
        code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
        snprintf(error, 256, "not enough memory");
    }
    if (code) {
        if (pose->principal) ledger_give(principal, LEDGER_POSES, RECORD);
        pose_release(pose);
        return code;
    }
    pose->generation = first_generation + ++poses->last;
    p->pose = pose;
    snprintf(p->model, sizeof p->model, "%s", model);
    enter(poses, p);
    return 0;
}

int poses_add(struct poses *poses, struct model *model, struct pose *pose,
              struct principal *principal, struct pose **out, char error[256])
{
    struct named_pose *p = find(poses, model, pose->name);
    if (p) {
        pose_release(pose);
        *out = use(poses, p);
        return 0;
    }
    int code = add(poses, model->key, pose, principal, error);
    if (code) return code;
    pose->refs++;
    *out = pose;
    return 0;
}

int poses_restore(struct poses *poses, struct pose *pose, struct principal *principal,
                  char error[256])
{
    if (!poses_known(poses, pose->name)) return add(poses, "", pose, principal, error);
    pose_release(pose);
    return 0;
}
