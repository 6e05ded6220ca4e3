// SPDX-License-Identifier: MIT
// Columns of the rows of models that many lights are asked of.
#include "render/shared/row_columns.h"

#include "core/log.h"
#include "core/work.h"
#include "net/request.h"

#include <stdlib.h>

enum { LIGHTS_BEFORE = 64 }; // their passes took about as long as making the columns takes

struct making {
    struct work work;
    struct model *model;
    struct cache_entry *file;
    uint64_t before; // bytes
};

static int run_making(struct work *work, const struct prt_context *ctx)
{
    return prt_file_columns(ctx, ((struct making *)work)->file->value);
}

static void done_making(struct work *work)
{
    struct making *m = (struct making *)work;
    const uint64_t bytes = prt_file_memory(m->file->value);
    if (bytes > m->before) cache_grow(m->file, (size_t)(bytes - m->before));
    log_line(LOG_EVENT, "model id=%s columns ms=%.1f bytes=%llu", m->model->id,
             (double)(work->ended_ns - work->started_ns) * 1e-6,
             (unsigned long long)(bytes - m->before));
    m->model->making_columns = false;
    cache_release(m->file);
    model_release(m->model);
    free(m);
}

// Half of --memory stays for models that are opened later: no columns are dropped for them.
static bool has_room(const struct model *m, const struct prt_file *file)
{
    struct cache_counts counts;
    cache_count(m->server->files, &counts);
    const size_t most = cache_budget(m->server->files) / 2;
    return counts.bytes <= most && prt_file_bytes(file) <= most - counts.bytes;
}

void row_columns_count(struct model *model, struct cache_entry *file, unsigned n_light)
{
    const struct prt_file *f = file->value;
    if (prt_file_transport(f)->engine != PRT_TRANSPORT_WAVELET) return;
    const unsigned before = model->n_contracted;
    model->n_contracted += n_light;
    if (before >= LIGHTS_BEFORE || model->n_contracted < LIGHTS_BEFORE) return;
    struct making *m =
        !model->making_columns && has_room(model, f) ? calloc(1, sizeof *m) : NULL;
    if (!m) {
        model->n_contracted = 0; // later, perhaps
        return;
    }
    model->making_columns = true;
    m->work.class = WORK_BACKGROUND;
    m->work.run = run_making;
    m->work.done = done_making;
    m->before = prt_file_memory(f);
    model_hold(m->model = model);
    cache_hold(m->file = file);
    struct work_actor actor = work_act_for(model->server->work, "", WORK_BACKGROUND);
    work_submit(model->server->work, &m->work);
    work_act(model->server->work, actor);
}
