/* SPDX-License-Identifier: MIT */
/* Radial bases of a free material, and the training media that a joint bake serves. */
#ifndef PRT_BAKE_RADIALS_H
#define PRT_BAKE_RADIALS_H

#include "bake/run.h"

#include "prt/radial.h"

/* Bases over the whole material range of METHODS §4. */
struct bases {
    struct prt_radial *reflectance, *extinction; /* of R_d; of e^(-sigma_t r) or NULL */
    struct extinction_table *integral;           /* of extinction's functions, or NULL */
    /* Of the term whose train function ran last: one for each eta, or one. */
    struct training training[PRT_RADIAL_MORE_ETA + 1];
    uint32_t n_training;
};
int prt_bases_create(const struct bake *b, struct bases *out);
void prt_bases_finish(struct bases *s);
void prt_bases_drop_training(struct bases *s);
/* The reflectance basis as the functions of a cut; refers to s. */
struct radial_set prt_bases_radial_set(const struct bases *s);
/* Fills s->training for multiple scattering, for each eta of the bake's media in the order of
 * prt_media_etas, or one for any index: media over the range, each divided by its response
 * to constant irradiance, so that all errors are relative. */
int prt_bases_train_reflectance(const struct bake *b, struct bases *s);
/* The same for single scattering: extinctions over the range, each plane of the phase function
 * apart. */
int prt_bases_train_extinction(const struct bake *b, struct bases *s, uint32_t n_phase);
/* Copies a basis into a tensor: answers fit their material to it. */
int prt_bases_record(const struct prt_radial *radial, uint32_t n_phase,
                     struct prt_tensor *tensor);
/* After it, of a joint bake for any index: the nodes of eta, at each of which the tensor has
 * the basis' functions. */
int prt_bases_record_eta(const struct bake *b, struct prt_tensor *tensor);

#endif
