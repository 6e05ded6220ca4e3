// SPDX-License-Identifier: MIT
// GEOMETRY with `coarse`: the coarse order of a bake's mesh. Clients of one model share the
// bytes.
#include "net/request_wait.h"
#include "ops/geometry_textures.h"
#include "render/evaluation.h"

#include <stdlib.h>

static void release_entry(void *entry)
{
    cache_release(entry);
}

static void ordered(struct request_wait *wait, struct request *request)
{
    struct cache_entry *entry = wait->entry;
    if (request && entry->state == CACHE_READY) {
        const struct coarse_order *c = entry->value;
        Relight__GeometryAnswer out = RELIGHT__GEOMETRY_ANSWER__INIT;
        struct payload payload = {c->bytes, c->size, entry, release_entry};
        out.n_vertex = c->n;
        out.n_coarse_root = c->n_root;
        out.coarse_parents_offset = c->parents;
        out.coarse_order = c->hash;
        cache_hold(entry);
        request_answer(request, &out.base, &payload);
    } else if (request) {
        request_fail(request, entry->error_code, "%s", entry->error);
    }
    cache_release(entry);
    free(wait);
}

static void file_ready(struct request *request, struct model *m, struct cache_entry *file)
{
    struct request_wait *wait = calloc(1, sizeof *wait);
    if (wait) request_await_entry(request, wait, coarse_order_get(m, file), ordered);
    else request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
}

void op_geometry_coarse(struct request *request)
{
    with_model(request, ((const Relight__GeometryRequest *)request->message)->model,
               file_ready);
}
