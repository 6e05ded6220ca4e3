// SPDX-License-Identifier: MIT
// Requests that wait for their inputs. What a connection says of its views keeps its order: a
// request that is ready runs when those before it have run.
#include "render/shared/inputs.h"

#include "frame.h"
#include "net/request_wait.h"
#include "render/render.h"
#include "render/shared/materials.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { QUICK_BYTES = 128 << 10 }; // so many are named in less than a millisecond

struct input_wait {
    struct request_wait wait;  // its work names the cubes; its entry, or NULL, is the material
    struct input_wait *next;   // of the connection's views, in their order
    struct connection *conn;   // NULL: not about a view, or closed
    unsigned missing;          // inputs that are not known yet
    struct held_bytes *texels; // while they are read
    unsigned n_light;
    size_t bytes[RENDER_MAX_LIGHTS]; // of each light's cube, one after another
    struct cube_digests *digests;
    void (*run)(struct request *request);
};

static void run_wait(struct input_wait *w)
{
    struct request *request = request_resume(&w->wait);
    if (request) w->run(request);
    cache_release(w->wait.entry); // held so long: it cannot be evicted before it is used
    free(w->digests);
    free(w);
}

static void run_ready(struct connection *conn)
{
    while (!conn->dead && conn->waits && !conn->waits->missing) {
        struct input_wait *w = conn->waits;
        conn->waits = w->next;
        run_wait(w);
    }
}

static void one_less(struct input_wait *w)
{
    if (--w->missing) return;
    if (w->conn) run_ready(w->conn);
    else run_wait(w);
}

static void resolved(struct cache_waiter *waiter)
{
    one_less((struct input_wait *)((char *)waiter - offsetof(struct input_wait, wait.waiter)));
}

bool texels_in_range(const float *texels, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (!(texels[i] >= 0 && texels[i] <= 1e9f)) return false;
    return true;
}

static int run_naming(struct work *work, const struct prt_context *ctx)
{
    struct input_wait *w = (struct input_wait *)work;
    const char *at = w->texels->bytes;
    w->digests->out_of_range =
        !texels_in_range(w->texels->bytes, w->texels->size / sizeof(float));
    for (unsigned i = 0; i < w->n_light; at += w->bytes[i], i++) {
        struct relight_sha256 sha;
        if (!w->bytes[i]) continue;
        relight_sha256_init(&sha);
        relight_sha256_add(&sha, at, w->bytes[i]);
        relight_sha256_hex(&sha, w->digests->hex[i]);
    }
    return PRT_OK;
}

static void named(struct work *work)
{
    struct input_wait *w = (struct input_wait *)work;
    struct request *request = w->wait.request;
    if (request) {
        request_return_payload(request, w->texels);
        request->digests = w->digests;
        w->digests = NULL;
    } else {
        held_bytes_release(w->texels);
    }
    w->texels = NULL;
    one_less(w);
}

// Whether the payload is the cubes of these lights, and too large to be read by the loop; what
// does not fit is refused by the operation.
static bool large_cubes(const struct request *request, size_t n_light,
                        Relight__Light *const *lights)
{
    size_t bytes = 0;
    if (request->payload_size <= QUICK_BYTES || n_light > RENDER_MAX_LIGHTS) return false;
    for (size_t i = 0; i < n_light; i++) {
        if (lights[i]->cube_n > 128) return false;
        bytes += (size_t)72 * lights[i]->cube_n * lights[i]->cube_n;
    }
    return bytes == request->payload_size;
}

static bool begin_naming(struct input_wait *w, struct request *request, size_t n_light,
                         Relight__Light *const *lights)
{
    w->digests = calloc(1, sizeof *w->digests + n_light * sizeof *w->digests->hex);
    w->texels = w->digests ? request_take_payload(request) : NULL;
    if (!w->texels) return false;
    w->n_light = (unsigned)n_light;
    for (size_t i = 0; i < n_light; i++)
        w->bytes[i] = (size_t)72 * lights[i]->cube_n * lights[i]->cube_n;
    w->wait.work.run = run_naming;
    w->wait.work.done = named;
    w->missing++;
    work_submit(request->server->work, &w->wait.work);
    return true;
}

void inputs_drop(struct connection *conn)
{
    for (struct input_wait *w = conn->waits, *next; w; w = next) {
        next = w->next;
        w->conn = NULL;
        w->wait.request = NULL;
        if (!w->missing) run_wait(w);
    }
    conn->waits = NULL;
}

void inputs_then(struct request *request, const char *material, size_t n_light,
                 Relight__Light *const *lights, bool views,
                 void (*run)(struct request *request))
{
    struct connection *conn = request->conn;
    struct cache_entry *entry = material_prepare(request->server, material);
    bool pending = entry && entry->state == CACHE_PENDING;
    bool large = large_cubes(request, n_light, lights);
    if (!pending && !large && !(views && conn->waits)) {
        run(request);
        cache_release(entry);
        return;
    }
    struct input_wait *w = calloc(1, sizeof *w);
    if (!w || (large && !begin_naming(w, request, n_light, lights))) {
        if (w) free(w->digests);
        free(w);
        cache_release(entry);
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    w->wait.waiter.wake = resolved;
    w->wait.entry = entry;
    w->run = run;
    w->conn = views ? conn : NULL;
    request_park(request, &w->wait);
    struct input_wait **last = &conn->waits;
    while (views && *last) last = &(*last)->next;
    if (views) *last = w;
    if (!pending) return;
    w->missing++;
    cache_wait(entry, &w->wait.waiter);
}
