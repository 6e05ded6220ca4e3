// SPDX-License-Identifier: MIT
// Whose entries a cache has, and whose go first: those of an owner that has more than an equal
// share of the budget.
#include "store/cache_private.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void cache_set_owner(struct cache_entry *e, const char *name)
{
    struct cache *cache = e->cache;
    struct cache_owner *o = cache->owner;
    if (e->owner || e->state != CACHE_PENDING) return;
    while (o && strcmp(o->name, name)) o = o->next;
    if (!o) {
        if (!(o = calloc(1, sizeof *o))) return;
        snprintf(o->name, sizeof o->name, "%s", name);
        o->next = cache->owner;
        cache->owner = o;
    }
    o->n_entry++;
    e->owner = o;
}

void cache_leave_owner(struct cache *cache, struct cache_entry *e)
{
    struct cache_owner *o = e->owner, **at = &cache->owner;
    if (!o) return;
    o->bytes -= e->bytes;
    if (--o->n_entry) return;
    while (*at != o) at = &(*at)->next;
    *at = o->next;
    free(o);
}

static size_t held(const struct cache_owner *o, const struct cache_asker *asker)
{
    return o->bytes + o->promised + (o == asker->owner ? asker->bytes : 0);
}

static size_t share_of(const struct cache *cache, const struct cache_asker *asker)
{
    size_t n = 0;
    for (const struct cache_owner *o = cache->owner; o; o = o->next) n += held(o, asker) > 0;
    return cache->budget / (n ? n : 1);
}

static bool is_above(const struct cache_entry *e, const struct cache_asker *asker, size_t share)
{
    return e && e->owner && held(e->owner, asker) > share;
}

struct cache_entry *cache_above_share(const struct cache *cache,
                                      const struct cache_asker *asker)
{
    size_t share = share_of(cache, asker);
    struct cache_entry *e = cache->owner ? cache->oldest : NULL;
    while (e && !is_above(e, asker, share)) e = e->newer;
    return e;
}

// The file that a holder's value holds: MODEL or MODEL/mesh, where its key begins with MODEL/.
static struct cache_entry *held_file(const struct cache *files,
                                     const struct cache_entry *holder)
{
    char key[128];
    size_t n = cache_beginning(holder->key, 0);
    if (!n || n > 100) return NULL;
    snprintf(key, sizeof key, "%.*s", (int)n - 1, holder->key);
    struct cache_entry *e = cache_look_up(files, key);
    if (e && e->refs) return e;
    snprintf(key, sizeof key, "%.*smesh", (int)n, holder->key);
    return cache_look_up(files, key);
}

struct cache_entry *cache_holder_above_share(const struct cache *files,
                                             const struct cache_asker *asker)
{
    size_t share = share_of(files, asker);
    struct cache_entry *e =
        files->owner && files->holders ? files->holders->oldest_holder : NULL;
    while (e && !is_above(held_file(files, e), asker, share)) e = e->newer_holder;
    return e;
}
