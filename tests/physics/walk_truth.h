/* SPDX-License-Identifier: MIT */
/* walk_truth.h owns the comparison of a bake's colours with walks of the reference engine. Two
 * references of other random numbers are taken: the mean product of the differences from both
 * holds the noise of neither. What is left of that noise in the mean is known from the standard
 * errors that the references state, and counts against the bake: a check whose noise could hide
 * its bound fails. */
#ifndef PHYSICS_WALK_TRUTH_H
#define PHYSICS_WALK_TRUTH_H

#include "bake_files.h"
#include "prt/reference.h"

#include <math.h>

enum { MOST_PICKED = 96 };
struct walk_truth {
    uint32_t n, vertex[MOST_PICKED]; /* of the mesh */
    float color[2][MOST_PICKED][3], error[2][MOST_PICKED][3];
};

/* Vertices spread over the mesh, or those that `wanted` names. */
static inline void walk_truth_pick(struct walk_truth *t, const struct prt_mesh *mesh,
                                   bool (*wanted)(const float position[3]))
{
    uint32_t n_wanted = 0, seen = 0;
    for (uint32_t v = 0; v < mesh->n_vertex; v++)
        n_wanted += !wanted || wanted(mesh->position[v]);
    const uint32_t n = n_wanted < MOST_PICKED ? n_wanted : MOST_PICKED;
    t->n = 0;
    for (uint32_t v = 0; v < mesh->n_vertex && t->n < n; v++) {
        if (wanted && !wanted(mesh->position[v])) continue;
        if ((uint64_t)seen++ * n >= (uint64_t)t->n * n_wanted) t->vertex[t->n++] = v;
    }
    assert_int_equal(t->n, n);
    assert_true(n > 0);
}

/* The picked vertices' colours by n_walk walks of either reference; n_walk 0: by the dipole,
 * into color[0] alone. */
static inline void walk_truth_take(struct walk_truth *t, const struct prt_mesh *mesh,
                                   const struct prt_material *medium,
                                   const struct prt_cube *light, enum prt_reference_term term,
                                   uint32_t n_walk)
{
    const struct prt_media media = prt_media_one(medium);
    for (unsigned i = 0; i < (n_walk ? 2 : 1); i++) {
        float(*error)[3] = t->error[i];
        const struct prt_reference_options o = {.term = term,
                                                .n_sample = 12000,
                                                .n_ray = 384,
                                                .seed = 51 + i,
                                                .vertex = t->vertex,
                                                .n_vertex = t->n,
                                                .n_walk = n_walk,
                                                .standard_error = n_walk ? &error : NULL};
        assert_int_equal(prt_reference_colors(&context, mesh, &media, light, &o, t->color[i]),
                         PRT_OK);
    }
}

/* The relative RMSE of got [vertex of the mesh] without the references' noise, and the least
 * and greatest that two standard errors of its square leave. */
struct walk_error {
    double error, least, most;
};
static inline struct walk_error walk_truth_error(const struct walk_truth *t,
                                                 const float (*got)[3])
{
    double square = 0, all = 0, variance = 0;
    for (uint32_t i = 0; i < t->n; i++)
        for (int c = 0; c < 3; c++) {
            double d[2], s[2];
            for (int k = 0; k < 2; k++) {
                d[k] = (double)got[t->vertex[i]][c] - (double)t->color[k][i][c];
                s[k] = (double)t->error[k][i][c] * (double)t->error[k][i][c];
            }
            square += d[0] * d[1];
            all += (double)t->color[0][i][c] * (double)t->color[1][i][c];
            variance += s[0] * s[1] + d[0] * d[1] * (s[0] + s[1]);
        }
    const double noise = 2 * sqrt(fmax(variance, 0));
    return (struct walk_error){sqrt(fmax(square, 0) / all), sqrt(fmax(square - noise, 0) / all),
                               sqrt(fmax(square + noise, 0) / all)};
}

/* The error, with what noise may hide of it, is below the bound. */
static inline void expect_walk_error(const char *name, const struct walk_truth *t,
                                     const float (*got)[3], double bound)
{
    const struct walk_error e = walk_truth_error(t, got);
    print_message("  %s: %.2f %%, from %.2f to %.2f %% within the noise of the references\n",
                  name, 100 * e.error, 100 * e.least, 100 * e.most);
    expect_below(name, e.most, bound);
}

#endif
