/* SPDX-License-Identifier: MIT */
/* Random walks in place of the dipole (METHODS §9): the matrix K between the vertices of a
 * cluster and the rows that it gathers, and what becomes of its noise. */
#ifndef PRT_BAKE_WALKS_H
#define PRT_BAKE_WALKS_H

#include "bake/run.h"
#include "prt/walk.h"

struct walk_bake {
    struct prt_walk_space *space;
    struct prt_surface_strata *strata;
    uint32_t *place;    /* [n_sample] position of each sample in the tree */
    uint8_t *walked;    /* [n_object] 0: the dipole serves, because too many walks escape */
    double leaked;      /* largest share of walks that escape, of the objects that are walked */
    uint32_t n_walk;    /* a vertex and channel, in the mean */
    double (*noise)[2]; /* [n_cluster] energy of the noise that smoothing left, and of the
                           answers, over the probes */
};
/* Walks a vertex and channel, or level where the medium is free: the options', or chosen. */
uint32_t prt_walks_each(const struct prt_bake_options *options, uint32_t n_vertex);
/* Makes b->walk and tests every object with some walks; a line is logged for each that leaks.
 * Needs scene, surface, hierarchy, clusters. PRT_ARG: nothing encloses a volume. */
int prt_walks_create(struct bake *b);
void prt_walks_destroy(struct walk_bake *walk);
/* Whether a cluster's light is computed by walks. */
bool prt_walks_in(const struct bake *b, uint32_t cluster);

/* A cluster's walks: their answers to the lights of the tensor in two halves, which share no
 * random number. */
struct walk_answers {
    uint32_t n_vertex, n_light, n_channel;
    float *half[2];   /* [n_channel][n_vertex][n_light] means */
    uint32_t *n_walk; /* [n_channel][n_vertex] of both halves */
};
/* Overwrites cut->k [3][n_column][n_vertex] with that of the walks of two scatterings or more,
 * each adding e^(-sigma_a L)/(pi N) where it leaves. Half of the walks are spread evenly, the
 * other half by the difference of the halves. job->lit holds the rows times the lights. */
int prt_walks_fill(const struct tensor_job *job, uint32_t cluster, struct cut *cut,
                   struct walk_answers *out);
/* The column of a cut that gathers each sample, by its place in the tree; UINT32_MAX: none.
 * NULL without memory; the caller prt_free()s it. */
uint32_t *prt_walk_columns(const struct bake *b, const struct cut *cut);
void prt_walk_answers_finish(struct walk_answers *answers);
/* How alike a cluster's vertices are by position and normal, for every pair of parameters that
 * smoothing chooses from, [..][n_vertex][n_vertex]. NULL without memory; the caller
 * prt_free()s it. */
float *prt_walk_likeness(const struct bake *b, uint32_t cluster);
/* Smoothing matrices of a cluster, [n_channel][n_vertex][n_vertex] (walk_smooth.c): the answers
 * of the dipole [n_channel][n_vertex][n_light] say which vertices are alike, with the likeness
 * of the cluster. factor [n_vertex]: of the answers of M K, at creases that are finer than M
 * resolves. noise: as in struct walk_bake. The caller prt_free()s *out. */
int prt_walks_smooth(const struct bake *b, const float *like, const float *dipole,
                     const struct walk_answers *walks, float **out, float *factor,
                     double noise[2]);
/* Ranges: light that crosses a cluster without a scattering; the second for a free medium, with
 * the extinction's functions of the path (struct prt_radial) as the job's user. */
int prt_bake_unscattered_range(void *tensor_job, size_t begin, size_t end, unsigned worker);
int prt_bake_free_unscattered_range(void *tensor_job, size_t begin, size_t end,
                                    unsigned worker);
/* Calls `sink` for each exit of straight paths from one vertex of a cluster, as prt_walk_run:
 * an exit's weight over pi and the number of paths is its share of the light. */
void prt_bake_unscattered_paths(const struct bake *b, uint32_t cluster, uint32_t vertex,
                                float sigma_t,
                                void (*sink)(void *arg, const struct prt_walk_exit *exit),
                                void *arg);
/* The least extinction of a free medium [mm^-1]: paths end where it leaves little light. */
#define PRT_LEAST_EXTINCTION 0.02f
/* A vertex. A dented ball in a clear medium (tests/physics/walk_bake.c) errs by 1.9 % with 256,
 * 1.4 % with 512 and 1.3 % with 1024. */
enum { PRT_UNSCATTERED_PATHS = 512 };
/* The share of noise in the answers of all clusters, relative RMS; 0 without walks. */
double prt_walks_noise(const struct bake *b);

#endif
