/* SPDX-License-Identifier: MIT */
/* Results of rays on disk (options.cache), from which a later bake of the same mesh takes what
 * it would trace again. A folder has one file for each thing that is remembered, named by its
 * kind and content address. A file is a header and records with hashes; it is checked whole
 * before any of it is used, and what is damaged is traced again. Every function may be called
 * with a NULL store. */
#ifndef PRT_BAKE_RAY_STORE_H
#define PRT_BAKE_RAY_STORE_H

#include "prt/base.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct ray_store;
/* Opens DIR/KIND-KEY.rays, or begins it; DIR is made where it is missing. A file that is
 * damaged, cut short, of another version or of another key is used as far as it is whole, with
 * one warning. Files of the folder that were not used for longest are removed while all
 * together take more than `budget` bytes. NULL: no store, with one warning; the bake goes on
 * without. The caller ends it with prt_ray_store_close. */
struct ray_store *prt_ray_store_open(const struct prt_context *ctx, const char *dir,
                                     const char *kind, uint64_t key, uint64_t budget);
/* An existing file, to be read alone, whether or not another process writes it. NULL: it is not
 * there. The caller ends it with prt_ray_store_close. */
struct ray_store *prt_ray_store_reopen(const struct prt_context *ctx, const char *dir,
                                       const char *kind, uint64_t key);
/* Calls fn with the first record of each file of a kind, where it is whole and has at most
 * `most` bytes. */
typedef void ray_store_fn(void *user, uint64_t key, uint32_t slot, const void *data,
                          size_t bytes);
void prt_ray_store_each(const char *dir, const char *kind, size_t most, ray_store_fn *fn,
                        void *user);
void prt_ray_store_close(struct ray_store *store);
/* The data of record (slot, id), to prt_free(): *bytes of them and the ray count that came with
 * them. NULL: the store has none, or not whole. Thread-safe. */
void *prt_ray_store_get(struct ray_store *store, uint32_t slot, uint32_t id, size_t *bytes,
                        uint64_t *rays);
/* Whether it had such a record when it was opened; its data may be damaged. Thread-safe. */
bool prt_ray_store_has(const struct ray_store *store, uint32_t slot, uint32_t id);
/* Appends a record; does nothing where the store is full or another process writes it.
 * Thread-safe. */
void prt_ray_store_put(struct ray_store *store, uint32_t slot, uint32_t id, const void *data,
                       size_t bytes, uint64_t rays);

#endif
