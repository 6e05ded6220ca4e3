// SPDX-License-Identifier: MIT
// Normalised diffusion (CB15 eq 3): albedo is A, shape_mm is d = mean free path / s(A) (CB15 eq
// 6).
#include "material.h"
#include "profile.h"

#include <math.h>

int prt_profile_init_burley(const struct prt_context *ctx, struct prt_profile *profile,
                            double albedo, double mean_free_path_mm)
{
    int err;
    if ((err = prt_material_range(ctx, "burley",
                                  &(struct material_range){"albedo", 1e-4, 1, "(no unit)"}, -1,
                                  albedo)) < 0 ||
        (err = prt_material_range(ctx, "burley",
                                  &(struct material_range){"mean_free_path", 1e-3, 1e4, "mm"},
                                  -1, mean_free_path_mm)) < 0)
        return err;
    double s = 1.9 - albedo + 3.5 * (albedo - 0.8) * (albedo - 0.8);
    *profile = (struct prt_profile){.kind = PRT_PROFILE_BURLEY,
                                    .albedo = albedo,
                                    .shape_mm = mean_free_path_mm / s,
                                    .total = albedo};
    return PRT_OK;
}

/* A (e^(-r/d) + e^(-r/3d)) / (8 pi d r); infinite at 0, so r is at least 1e-6 d. */
static double burley_rd(const struct prt_profile *p, double r)
{
    double d = p->shape_mm, x = fmax(r, 1e-6 * d);
    return p->albedo * (exp(-x / d) + exp(-x / (3 * d))) / (8 * M_PI * d * x);
}

static double burley_tail(const struct prt_profile *p, double r)
{
    return p->albedo * (exp(-r / p->shape_mm) + 3 * exp(-r / (3 * p->shape_mm))) / 4;
}

static int parse_burley(const struct prt_context *ctx, const char *what, const char *folder,
                        const cJSON *object, struct prt_optics *o)
{
    static const char *const keys[] = {"name", "profile",   "albedo", "mean_free_path",
                                       "eta",  "roughness", NULL};
    double albedo[3], path[3];
    int err;
    if ((err = prt_material_json_keys(ctx, what, object, keys)) < 0 ||
        (err = prt_material_json_rgb(ctx, what, object, "albedo", true, true, albedo)) < 0 ||
        (err = prt_material_json_rgb(ctx, what, object, "mean_free_path", true, true, path)) <
            0)
        return err;
    for (int c = 0; c < 3; c++)
        if ((err = prt_profile_init_burley(ctx, &o->channel[c], albedo[c], path[c])) < 0)
            return err;
    return PRT_OK;
}

const struct prt_profile_type prt_profile_type_burley = {.word = "burley",
                                                         .parse = parse_burley,
                                                         .rd = burley_rd,
                                                         .tail = burley_tail,
                                                         .is_singular = true};
