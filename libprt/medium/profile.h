/* SPDX-License-Identifier: MIT */
/* The table of profile kinds, the point tables behind some of them, and materials together with
 * the exact profiles that their own tables are made from. */
#ifndef MEDIUM_PROFILE_H
#define MEDIUM_PROFILE_H

#include "prt/profile.h"

#include <cjson/cJSON.h>
#include <math.h>

/* A material of any kind with the exact profiles of its channels. `material` is the user's
 * input (DIPOLE); for another kind it is the dipole medium of the same total reflectance and
 * the same half-energy radius, channel by channel, which gives the sample spacing, and carries
 * the profile as a table of at most PRT_MATERIAL_MAX_POINT points. */
struct prt_optics {
    enum prt_profile_kind kind;
    struct prt_material material;
    struct prt_profile channel[3];
};

/* One row of the table of kinds. */
struct prt_profile_type {
    const char *word; /* value of "profile" in a material's JSON; printed by summaries */
    /* Initialises out->channel[0..2] from `object`; out->material holds name, eta and roughness
     * already. Refuses keys that are not the kind's. `folder`: where files may lie; NULL
     * refuses files. NULL for the dipole, whose JSON has no "profile". */
    int (*parse)(const struct prt_context *ctx, const char *what, const char *folder,
                 const cJSON *object, struct prt_optics *out);
    double (*rd)(const struct prt_profile *profile, double r_mm);   /* mm^-2 */
    double (*tail)(const struct prt_profile *profile, double r_mm); /* int_r 2 pi r' R_d dr' */
    bool is_singular; /* R_d is infinite at 0; a grid takes its first cell's integral there */
    bool is_points;   /* r[] and rd[] are the whole profile, on radii common to all channels */
};
/* NULL for a kind that is not in the table. */
const struct prt_profile_type *prt_profile_type(uint32_t kind);

/* As prt_material_load and prt_material_parse, with the exact profiles. A curve's "file" is
 * relative to `folder`; NULL refuses files, for text from elsewhere. The caller finishes *out,
 * which is unchanged on failure. Thread-safe; prt_optics_load reads files. */
int prt_optics_load(const struct prt_context *ctx, const char *name_or_file,
                    struct prt_optics *out);
int prt_optics_parse(const struct prt_context *ctx, const char *what, const char *folder,
                     const char *json, size_t n, struct prt_optics *out);
void prt_optics_finish(struct prt_optics *optics);

/* Integral of 2 pi r f(r) from a to b, f the line through (a,fa) and (b,fb). */
static inline double prt_line_integral(double a, double fa, double b, double fb)
{
    return M_PI / 3 * (b - a) * (fa * (2 * a + b) + fb * (a + 2 * b));
}

/* Point tables: R_d is linear between points, rd[0] before the first, 0 beyond the last. */
int prt_profile_table_alloc(struct prt_profile *profile, uint32_t n); /* zeroed arrays */
/* Fills outside[] from r[] and rd[]; 0 at the last point. */
void prt_profile_table_integrate(struct prt_profile *profile);
double prt_profile_table_rd(const struct prt_profile *profile, double r_mm);
double prt_profile_table_tail(const struct prt_profile *profile, double r_mm);

#endif
