// SPDX-License-Identifier: MIT
// Which bake goes first: of those that are not open the one whose file was opened longest ago,
// then of the open ones. Files carry the time themselves, so that it survives a restart.
#include "store/bake_eviction.h"

#include "core/log.h"
#include "store/disk.h"
#include "store/models.h"
#include "relight.pb-c.h"

#include <fcntl.h>
#include <sys/stat.h>

static bool is_bake(const struct model *m, struct stat *st)
{
    return !m->foreign && m->state == RELIGHT__MODEL_STATE__MODEL_READY && m->prt[0] &&
           !stat(m->prt, st);
}

uint64_t bakes_bytes(const struct server *server)
{
    struct stat st;
    uint64_t bytes = 0;
    for (struct model *m = NULL; (m = models_next(server->models, m));)
        if (is_bake(m, &st)) bytes += (uint64_t)st.st_size;
    return bytes;
}

static struct model *oldest(const struct server *server, const struct model *newest, bool open)
{
    struct model *found = NULL;
    struct timespec when = {0};
    for (struct model *m = NULL; (m = models_next(server->models, m));) {
        struct stat st;
        if (m == newest || m->pinned || !is_bake(m, &st)) continue;
        if ((model_state(m) == RELIGHT__MODEL_STATE__MODEL_READY) != open) continue;
        bool older = st.st_mtim.tv_sec < when.tv_sec ||
                     (st.st_mtim.tv_sec == when.tv_sec && st.st_mtim.tv_nsec < when.tv_nsec);
        if (found && !older) continue;
        found = m;
        when = st.st_mtim;
    }
    return found;
}

void bakes_make_room(struct server *server, const struct model *newest)
{
    const struct options *o = &server->options;
    uint64_t bytes = bakes_bytes(server);
    while (bytes && (bytes > o->bakes_disk || disk_bytes(server->ledger) > o->disk)) {
        struct model *m = oldest(server, newest, false);
        if (!m) m = oldest(server, newest, true);
        if (!m) return; // pinned, or not ours: an administrator's choice
        log_line(LOG_EVENT, "model id=%s name=\"%s\" bake dropped for room", m->id, m->name);
        server->stats.bakes_evicted++;
        model_unload(m, true); // who computes with it goes on: the file stays until then
        bytes = bakes_bytes(server);
    }
}

void bakes_touch(const struct model *model)
{
    if (!model->foreign) utimensat(AT_FDCWD, model->prt, NULL, 0);
}
