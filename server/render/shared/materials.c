// SPDX-License-Identifier: MIT
// Materials by their text. Those with a profile of their own are parsed on a worker and cached,
// together with the others of their request; requests that name one wait for it.
#include "render/shared/materials.h"

#include "frame.h"
#include "relight.pb-c.h"
#include "net/request_wait.h"
#include "render/render.h"
#include "render/shared/cache_compute.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    MATERIAL_BYTES = 65536,
    QUICK_BYTES = 2048,
    HASHED_BYTES = 128 << 10, // payloads from here on are hashed by a worker
};

struct resolved {
    int status;
    bool preset;
    char error[300];
    char *text; // of resolved_list
    struct prt_material material;
};
// The materials of one request.
struct resolved_list {
    size_t n;
    struct resolved item[];
};

void material_texts_add(struct material_texts *texts, const char *text)
{
    if (text[0] && texts->n < MATERIAL_TEXTS) texts->text[texts->n++] = text;
}

void material_texts_of_objects(struct material_texts *texts, size_t n,
                               Relight__ObjectMaterial *const *entry)
{
    for (size_t i = 0; i < n; i++) material_texts_add(texts, entry[i]->material);
}

void material_texts_of_shade(struct material_texts *texts, const Relight__Shade *shade)
{
    if (!shade) return;
    material_texts_add(texts, shade->material);
    material_texts_of_objects(texts, shade->n_materials, shade->materials);
}

static void parse(const struct prt_context *ctx, const char *text, struct resolved *out)
{
    struct work keep = {.error = ""};
    struct prt_context own = *ctx;
    own.log = work_keep_error;
    own.log_user = &keep;
    out->status = prt_material_parse(&own, "material", text, strlen(text), &out->material);
    snprintf(out->error, sizeof out->error, "%s",
             keep.error[0] ? keep.error : prt_status_text(out->status));
}

// Four numbers for each channel are parsed in microseconds on the loop. A profile takes longer;
// the word may be written with escaped letters.
static bool is_slow(const char *text)
{
    return text[0] == '{' &&
           (strlen(text) > QUICK_BYTES || strstr(text, "profile") || strchr(text, '\\')) &&
           strlen(text) <= MATERIAL_BYTES;
}

static void texts_key(const struct material_texts *texts, char key[64])
{
    struct relight_sha256 sha;
    char hex[65];
    relight_sha256_init(&sha);
    for (size_t i = 0; i < texts->n; i++)
        relight_sha256_add(&sha, texts->text[i], strlen(texts->text[i]) + 1);
    relight_sha256_hex(&sha, hex);
    snprintf(key, 64, "material/%.32s", hex);
}

void material_key(const struct prt_material *m, char key[MATERIAL_KEY])
{
    struct relight_sha256 sha;
    size_t bytes = m->profile ? m->n_point * sizeof(float) : 0;
    const float optics[2] = {m->eta, m->roughness};
    char hex[65];
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, m->sigma_s_prime, sizeof m->sigma_s_prime);
    relight_sha256_add(&sha, m->sigma_a, sizeof m->sigma_a);
    relight_sha256_add(&sha, m->g, sizeof m->g);
    relight_sha256_add(&sha, optics, sizeof optics);
    relight_sha256_add(&sha, m->radius, bytes);
    for (int c = 0; c < 3; c++) relight_sha256_add(&sha, m->reflectance[c], bytes);
    relight_sha256_hex(&sha, hex);
    snprintf(key, MATERIAL_KEY, "%.32s", hex);
}

static void resolve(const struct prt_context *ctx, const char *text, struct resolved *out)
{
    char remedy[160] = "";
    const struct prt_material *found =
        text[0] == '{' ? NULL : prt_material_preset_named(text, remedy, sizeof remedy);
    out->status = PRT_OK;
    out->error[0] = 0;
    out->preset = found != NULL;
    if (found) {
        out->material = *found;
    } else if (text[0] != '{' || strlen(text) > MATERIAL_BYTES) {
        snprintf(out->error, sizeof out->error,
                 "material %.100s: neither a preset nor JSON text%s%s", text,
                 remedy[0] ? "; " : "", remedy);
        out->status = PRT_ARG;
    } else {
        parse(ctx, text, out);
    }
}

int material_resolve(const char *text, struct prt_material *material, bool *preset,
                     char error[300])
{
    struct prt_context ctx;
    struct resolved resolved;
    prt_context_init(&ctx);
    resolve(&ctx, text, &resolved);
    *material = resolved.material;
    *preset = resolved.preset;
    snprintf(error, 300, "%s", resolved.error);
    return resolved.status;
}

int material_of_request(struct request *request, const char *text,
                        struct prt_material *material, bool *preset, char error[300])
{
    const struct resolved_list *list = request->materials ? request->materials->value : NULL;
    for (size_t i = 0; list && i < list->n; i++) {
        const struct resolved *found = &list->item[i];
        if (strcmp(found->text, text)) continue;
        *preset = found->preset;
        *material = found->material;
        snprintf(error, 300, "%s", found->error);
        return found->status;
    }
    return material_resolve(text, material, preset, error);
}

void materials_used(struct request *request)
{
    cache_release(request->materials);
    request->materials = NULL;
}

// ---- on a worker

// Its value has the texts from the start on.
static int run_parse(struct cache_job *job, const struct prt_context *ctx)
{
    struct resolved_list *list = job->value;
    for (size_t i = 0; i < list->n; i++) resolve(ctx, list->item[i].text, &list->item[i]);
    return PRT_OK; // a refused material is a result, too: its error is cached
}

static const struct cache_job_kind kind = {
    .size = sizeof(struct cache_job), .run = run_parse, .destroy = free};

// The list with its texts, which are to be resolved; NULL without memory.
static struct resolved_list *new_list(const struct material_texts *texts, size_t *bytes)
{
    *bytes = sizeof(struct resolved_list) + texts->n * sizeof(struct resolved);
    size_t at = *bytes;
    for (size_t i = 0; i < texts->n; i++) *bytes += strlen(texts->text[i]) + 1;
    struct resolved_list *list = calloc(1, *bytes);
    if (!list) return NULL;
    list->n = texts->n;
    for (size_t i = 0; i < texts->n; i++) {
        list->item[i].text = strcpy((char *)list + at, texts->text[i]);
        at += strlen(texts->text[i]) + 1;
    }
    return list;
}

// With a reference for the caller.
static struct cache_entry *resolved_get(struct server *server,
                                        const struct material_texts *texts)
{
    char key[64];
    struct cache_job *job;
    texts_key(texts, key);
    struct cache_entry *entry = cache_compute(server, key, &kind, &job);
    if (!job) return entry;
    job->value = new_list(texts, &job->bytes);
    if (job->value) cache_job_submit(job);
    else cache_job_complete(job, PRT_NOMEM);
    return entry;
}

static bool any_slow(const struct material_texts *texts)
{
    for (size_t i = 0; i < texts->n; i++)
        if (is_slow(texts->text[i])) return true;
    return false;
}

// ---- requests that wait

struct material_wait {
    struct request_wait wait;   // entry NULL: waits only for earlier requests
    struct material_wait *next; // in the connection's order
    struct connection *conn;    // NULL: not about a view, or its connection closed
    struct held_bytes *payload; // that a worker hashes; NULL: none
    char hash[65];
    size_t bad; // 1 + the index of its first float that is no radiance; 0: none
    bool ready;
    void (*run)(struct request *request);
};

// Takes the reference to the entry (NULL: none). Where parsing failed for lack of memory, run()
// parses again.
static void run_with(struct request *request, struct cache_entry *entry,
                     void (*run)(struct request *request))
{
    if (entry && entry->state == CACHE_READY) request->materials = entry;
    else cache_release(entry);
    run(request);
}

static void run_wait(struct material_wait *w)
{
    struct request *request = request_resume(&w->wait);
    struct cache_entry *entry = w->wait.entry;
    void (*run)(struct request * request) = w->run;
    if (w->payload && request) {
        request_return_payload(request, w->payload);
        memcpy(request->payload_hash, w->hash, sizeof w->hash);
        request->payload_bad = w->bad;
    } else {
        held_bytes_release(w->payload);
    }
    free(w);
    if (request) run_with(request, entry, run);
    else cache_release(entry);
}

static void run_ready(struct connection *conn)
{
    while (!conn->dead && conn->waits && conn->waits->ready) {
        struct material_wait *w = conn->waits;
        conn->waits = w->next;
        run_wait(w);
    }
}

static void ready(struct material_wait *w)
{
    w->ready = true;
    if (w->conn) run_ready(w->conn);
    else run_wait(w);
}

static void resolved(struct cache_waiter *waiter)
{
    ready(
        (struct material_wait *)((char *)waiter - offsetof(struct material_wait, wait.waiter)));
}

static int run_hash(struct work *work, const struct prt_context *ctx)
{
    struct material_wait *w = (struct material_wait *)work;
    struct relight_sha256 sha;
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, w->payload->bytes, w->payload->size);
    relight_sha256_hex(&sha, w->hash);
    size_t n = w->payload->size / sizeof(float);
    w->bad = render_first_bad_texel(w->payload->bytes, n) + 1;
    if (w->bad > n) w->bad = 0;
    return PRT_OK;
}

// The material, too, may be there by now.
static void hashed(struct work *work)
{
    struct material_wait *w = (struct material_wait *)work;
    if (w->wait.entry && w->wait.entry->state == CACHE_PENDING)
        cache_wait(w->wait.entry, &w->wait.waiter);
    else ready(w);
}

void materials_drop(struct connection *conn)
{
    for (struct material_wait *w = conn->waits, *next; w; w = next) {
        next = w->next;
        w->conn = NULL;
        w->wait.request = NULL;
        if (w->ready) run_wait(w);
    }
    conn->waits = NULL;
}

void material_then(struct request *request, const struct material_texts *texts, bool views,
                   void (*run)(struct request *request))
{
    struct connection *conn = request->conn;
    struct cache_entry *entry =
        texts && any_slow(texts) ? resolved_get(request->server, texts) : NULL;
    bool pending = entry && entry->state == CACHE_PENDING;
    bool hash = request->payload_size >= HASHED_BYTES && texts; // cubes of lights
    bool wait = pending || hash || (views && conn->waits);
    struct material_wait *w = wait ? calloc(1, sizeof *w) : NULL;
    if (!wait) {
        run_with(request, entry, run);
        return;
    }
    if (!w) {
        cache_release(entry);
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    *w = (struct material_wait){.wait.waiter.wake = resolved,
                                .wait.entry = entry,
                                .wait.work.run = run_hash,
                                .wait.work.done = hashed,
                                .payload = hash ? request_take_payload(request) : NULL,
                                .run = run,
                                .conn = views ? conn : NULL};
    w->ready = !pending && !w->payload; // without memory the loop hashes
    request_park(request, &w->wait);
    struct material_wait **last = &conn->waits;
    while (views && *last) last = &(*last)->next;
    if (views) *last = w;
    if (w->payload) work_submit(request->server->work, &w->wait.work);
    else if (pending) cache_wait(entry, &w->wait.waiter);
    else if (w->ready && views) run_ready(conn);
    else if (w->ready) run_wait(w);
}
