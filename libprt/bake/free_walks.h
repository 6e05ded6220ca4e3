/* SPDX-License-Identifier: MIT */
/* Random walks of a free medium (METHODS §9, free media): the answers of a grid of media, and
 * the few combinations of them that a joint or polynomial bake stores. */
#ifndef PRT_BAKE_FREE_WALKS_H
#define PRT_BAKE_FREE_WALKS_H

#include "bake/radials.h"
#include "bake/walks.h"

#include "prt/walk_grid.h"

/* Media of the grid are numbered level * n_node + node. The first n_walked media are walked; of
 * the levels above them the dipole answers, times the ratio of both at the last walked level.
 */
struct walk_pool {
    struct prt_walk_grid grid;
    uint32_t n_media, n_walked, last_level; /* the last walked one */
    uint32_t n_radial;                      /* functions of the reflectance basis */
    float *dipole;      /* [media.n][n_media][n_radial] each medium in that basis */
    float *ratio_mix;   /* [n_media - n_walked][n_node] the walk of a ratio, of the nodes of the
                           last walked level; its sigma_a has the albedo of the medium */
    float *ratio_basis; /* [media.n][n_media - n_walked][n_radial] the dipole of the ratio */
    /* Stored functions: the first n_own[0] are of clusters that are walked, the n_own[1] others
     * of clusters that the dipole serves; functions of the other kind are 0 in a cluster. */
    uint32_t n_function, n_own[2];
    float *mix;     /* [n_function][n_media] stored functions, of the media's answers */
    float *basis;   /* [n_function][n_media] the media, of the stored functions */
    float *norm[2]; /* [n_media] the answer to even light of either kind */
};
/* Makes the pool. It depends on the body, the settings and the seed alone: all parts of a bake
 * have the same. Needs b->walk and the bases. */
int prt_walk_pool_create(const struct bake *b, const struct bases *bases,
                         struct walk_pool *out);
void prt_walk_pool_finish(struct walk_pool *pool);
/* Copies the pool into a tensor: answers find their medium in it. */
int prt_walk_pool_record(const struct walk_pool *pool, struct prt_tensor *tensor);
/* Training media of the pool: each divided by its answer to even light. */
int prt_walk_pool_train(const struct walk_pool *pool, struct bases *s);

struct walk_hit {
    uint32_t column;
    float length_mm;
};
/* A cluster's walks at all levels. */
struct free_walks {
    const struct walk_pool *pool;
    uint32_t n_vertex, n_light;
    float *answer;         /* [n_media][n_vertex][n_light] smoothed */
    float *smooth;         /* [n_walked][n_vertex][n_vertex]; NULL: the dipole serves */
    float *ratio;          /* [n_media - n_walked][n_vertex] */
    uint32_t *walks;       /* [last_level + 1] a vertex */
    uint32_t *begin;       /* [(last_level + 1) n_vertex + 1] of hits */
    struct walk_hit *hits; /* by level, then vertex; NULL: not kept */
    double noise[2];       /* as in struct walk_bake */
};
/* The inputs of a cluster's walks. cut->k is that of the reflectance basis. */
struct free_walks_job {
    const struct bake *b;
    const struct walk_pool *pool;
    const struct cut *cut;
    const struct lit_rows *lit; /* the lights that they answer */
    struct work_meters *work;
    uint32_t cluster, n_walk; /* walks a vertex and level, in the mean */
    bool keep_hits;
};
int prt_free_walks_run(const struct free_walks_job *job, struct free_walks *out);
void prt_free_walks_finish(struct free_walks *walks);
/* Answers of the stored functions, [n_function][n_vertex][n_light]. */
void prt_free_walks_mix(const struct free_walks *walks, float *out);

/* A row source (struct row_source) of a cluster's walks. */
struct walk_rows {
    struct free_walks walks;
    const struct walk_pool *pool;
    struct product_rows *product; /* the dipole's, with the functions of the basis */
    uint32_t medium;              /* of the cluster */
};
int prt_walk_rows_multiply(void *user, const float *x, uint32_t m, float *out);
int prt_walk_rows_combine(void *user, const float *u, uint32_t r, uint32_t n, const float *w,
                          const uint32_t *row, float *out);

#endif
