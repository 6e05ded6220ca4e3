/* SPDX-License-Identifier: MIT */
/* Radial bases at bake time: evaluation at squared distances, training materials. */
#ifndef PRT_BAKE_RADIALS_H
#define PRT_BAKE_RADIALS_H

#include "bake/run.h"

#include "prt/radial.h"

/* The bases a joint or polynomial bake works with, over METHODS §4's whole material range. */
struct bases {
    struct prt_radial *reflectance, *extinction;
    struct extinction_table *integral;
    float *train; /* [n_train][functions], for factor_plan */
    uint32_t n_train;
};
int bases_create(struct bake *b, struct bases *out);
void bases_finish(struct bases *s);
/* radial_set over the reflectance basis. */
struct radial_set bases_radial_set(const struct bases *s);
/* Training combinations of multiple scattering: materials over the range, each over its answer
 * to constant irradiance. */
int bases_train_reflectance(struct bake *b, struct bases *s);
/* Of single scattering: extinctions over the range, each plane of the phase function apart. */
int bases_train_extinction(struct bake *b, struct bases *s, uint32_t n_phase);
/* Copies a basis into a tensor, for the fit at run time. */
int bases_record(const struct prt_radial *radial, uint32_t n_phase, struct prt_tensor *tensor);

#endif
