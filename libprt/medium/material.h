/* SPDX-License-Identifier: MIT */
/* Internal to materials: limits, range checks, JSON readers, the table of a profile. */
#ifndef MEDIUM_MATERIAL_H
#define MEDIUM_MATERIAL_H

#include "prt/medium.h"

#include <cjson/cJSON.h>
#include <string.h>

enum { MATERIAL_MAX_BYTES = 1 << 16 }; /* of JSON; a curve of 4 x 256 points takes 24 KiB */
#define MATERIAL_MIN_SIGMA_S 1e-5      /* mm^-1: a mean free path of 100 m */
#define MATERIAL_MAX_SIGMA 1000.0      /* mm^-1: a mean free path of 1 um */
#define MATERIAL_MAX_SIGMA_T \
    5000.0 /* mm^-1: shorter steps than any surface sampling resolves */
#define MATERIAL_MAX_G 0.95
#define MATERIAL_MIN_ROUGHNESS 0.01
#define MEDIUM_LEAST_ROUGHNESS 0.0100001 /* the same, also after rounding to float */

/* A material in doubles, so that a message shows the number that the user gave (1e39). */
struct material_values {
    double sigma_s_prime[3], sigma_a[3], g[3], eta, roughness;
};

/* PRT_OK if lo <= value <= hi, else PRT_ARG and a log line with parameter, value, range and
 * unit. channel -1: the parameter has no channels. */
struct material_range {
    const char *parameter;
    double lo, hi;
    const char *unit;
};
int prt_material_range(const struct prt_context *ctx, const char *what,
                       const struct material_range *range, int channel, double value);
int prt_material_check_values(const struct prt_context *ctx, const char *what,
                              const struct material_values *v);

/* The table of a dipole that has one: R_d at r, its integral beyond r, R_d at sqrt(r2[i]). */
double prt_material_table_rd(const struct prt_diffusion *dipole, double r_mm);
double prt_material_table_tail(const struct prt_diffusion *dipole, double r_mm);
void prt_material_table_array(const struct prt_diffusion *dipole, size_t n, const float *r2_mm2,
                              float *out);
/* optics->channel as optics->material's profile; logs when its points are too few for it. */
struct prt_optics;
int prt_material_from_optics(const struct prt_context *ctx, const char *what,
                             struct prt_optics *optics);
int prt_material_check_profile(const struct prt_context *ctx, const struct prt_material *m);

/* Parses one JSON object of at most MATERIAL_MAX_BYTES; no trailing bytes. Caller deletes. */
int prt_material_json_object(const struct prt_context *ctx, const char *what, const char *json,
                             size_t n, cJSON **out);
/* PRT_FORMAT for keys not in `allowed` (NULL-terminated, listed in the message) or repeated. */
int prt_material_json_keys(const struct prt_context *ctx, const char *what, const cJSON *object,
                           const char *const *allowed);
/* Reads [r,g,b], or one number for all three when `scalar`. Absent: PRT_FORMAT if `required`,
 * else out is left as it is. */
int prt_material_json_rgb(const struct prt_context *ctx, const char *what, const cJSON *object,
                          const char *key, bool scalar, bool required, double out[3]);
int prt_material_json_number(const struct prt_context *ctx, const char *what,
                             const cJSON *object, const char *key, double *out);
int prt_material_json_name(const struct prt_context *ctx, const char *what, const cJSON *object,
                           char out[32]);

#endif
