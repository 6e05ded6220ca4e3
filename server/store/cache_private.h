/* SPDX-License-Identifier: MIT */
/* cache_private.h owns the cache's fields, for its two files. */
#ifndef RELIGHTD_CACHE_PRIVATE_H
#define RELIGHTD_CACHE_PRIVATE_H

#include "store/cache.h"

struct cache {
    struct cache_entry **bucket, **begin[CACHE_BEGINNINGS]; /* [n_bucket] each */
    size_t n_bucket;
    uint64_t seed;
    struct cache_entry *newest, *oldest;
    struct cache_entry *newest_holder, *oldest_holder;
    size_t budget;
    struct cache_counts counts;
    struct cache_owner *owner;
    struct cache *files;   /* entries of it are held by values of this one */
    struct cache *holders; /* the other way round */
    bool relieving;
    size_t values, promised; /* bytes of all values; of admissions without their value */
    struct cache_admission *admission, **last_admission;
    bool admitting;
    struct cache_entry no_memory; /* returned where no entry can be allocated; never freed */
    struct work_pool *workers;    /* NULL: values are destroyed at once */
};

/* What an owner asks for: it counts as held already. */
struct cache_asker {
    const struct cache_owner *owner; /* NULL: nobody */
    size_t bytes;
};

/* cache.c */
struct cache_entry *cache_look_up(const struct cache *cache, const char *key);
/* Bytes of MODEL/, or of MODEL/NUMBER/ (which: 1); 0 where the text does not begin so. */
size_t cache_beginning(const char *text, int which);

/* cache_owners.c */
void cache_leave_owner(struct cache *cache, struct cache_entry *entry);
/* The least recently used of those that nobody holds whose owner has more than its share; NULL:
 * there is none. */
struct cache_entry *cache_above_share(const struct cache *cache,
                                      const struct cache_asker *asker);
/* The same of the holders that hold a file of such an owner. */
struct cache_entry *cache_holder_above_share(const struct cache *files,
                                             const struct cache_asker *asker);

#endif
