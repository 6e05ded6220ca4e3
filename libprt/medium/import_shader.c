// SPDX-License-Identifier: MIT
// The medium under an artist's shader: OpenPBR, standard_surface and Principled have the same
// interiors under other names (METHODS §10).
#include "import.h"

#include <math.h>
#include <stdarg.h>

static double clamp(double x, double lo, double hi)
{
    return x >= lo ? x <= hi ? x : hi : lo; // NaN: lo
}

double prt_import_ior(double ior, double factor)
{
    double root = (ior - 1) / (ior + 1), f0 = clamp(factor, 0, 1e6) * root * root;
    root = sqrt(clamp(f0, 0, 0.25)); // 0.25: an index of 3
    return (1 + root) / (1 - root);
}

void prt_import_append(char list[256], const char *fmt, ...)
{
    size_t n = strlen(list);
    va_list args;
    va_start(args, fmt);
    if (n) n += (size_t)snprintf(list + n, 256 - n, ", ");
    if (n < 256) vsnprintf(list + n, 256 - n, fmt, args);
    va_end(args);
}

void prt_import_lost(struct import_shader *shader, const char *feature, double amount)
{
    if (amount > 0) prt_import_append(shader->lost, "%s", feature);
}

void prt_import_coefficients(const struct import_list *list, struct prt_import *item,
                             const double sigma_s[3], const double sigma_a[3], double g)
{
    struct prt_material *m = &item->material;
    bool moved = fabs(g) > MATERIAL_MAX_G;
    g = clamp(g, -MATERIAL_MAX_G, MATERIAL_MAX_G);
    for (int c = 0; c < 3; c++) {
        double s = clamp(sigma_s[c], 0, 1e30) * (1 - g), a = clamp(sigma_a[c], 0, 1e30);
        double most =
            fmin(MATERIAL_MAX_SIGMA / fmax(s, a), MATERIAL_MAX_SIGMA_T / (s / (1 - g) + a));
        double scale = 0.999 * most < 1 ? 0.999 * most : 1; // both alike: keeps the albedo
        moved |= scale < 1 || s < MATERIAL_MIN_SIGMA_S;
        m->sigma_s_prime[c] = (float)fmax(s * scale, 1.001 * MATERIAL_MIN_SIGMA_S);
        m->sigma_a[c] = (float)(a * scale);
        m->g[c] = (float)g;
    }
    item->has_medium = true;
    if (moved)
        prt_import_warn(list, item,
                        "its coefficients are beyond what prt takes, 1e-5 to "
                        "1000 mm^-1 and |g| <= 0.95, and were moved there");
}

// sigma_t and the part of it that scatters, in mm^-1; a negative rest lifts all channels alike.
static void transmissive(const struct import_list *list, const struct import_shader *shader,
                         struct prt_import *item)
{
    double s[3], a[3], lowest = 0, scatters = 0;
    for (int c = 0; c < 3; c++) {
        s[c] = clamp(shader->scatter[c], 0, 1e6) / shader->depth;
        a[c] = -log(clamp(shader->transmission_color[c], 1e-4, 1)) / shader->depth - s[c];
        lowest = fmin(lowest, a[c]);
        scatters = fmax(scatters, s[c]);
    }
    if (!(scatters > 0)) {
        prt_import_none(item, "it is clear: nothing inside scatters light");
        return;
    }
    for (int c = 0; c < 3; c++) a[c] -= lowest;
    prt_import_coefficients(list, item, s, a, shader->scatter_g);
}

// An albedo and a mean free path. Where the interior is mixed with the opaque base, the albedo
// is that of the mixture, and the mean free path the mean of both, the base's being 0.
static void dense(const struct import_list *list, const struct import_shader *shader,
                  struct prt_import *item)
{
    double w = clamp(shader->subsurface, 0, 1);
    struct prt_dense in = {
        .g = (float)clamp(shader->subsurface_g, -MATERIAL_MAX_G, MATERIAL_MAX_G),
        .eta = item->material.eta,
        .roughness = item->material.roughness};
    for (int c = 0; c < 3; c++) {
        in.albedo[c] =
            (float)clamp(w * shader->subsurface_color[c] + (1 - w) * shader->base[c], 0, 1);
        in.free_path_mm[c] = (float)clamp(w * shader->free_path[c], 1e-9, 1e9);
    }
    memcpy(in.name, item->material.name, sizeof in.name);
    unsigned lowered = prt_material_from_dense(&in, &item->material);
    item->has_medium = true;
    if (w < 1)
        prt_import_warn(list, item,
                        "%.0f %% of it is opaque: one medium stands for the mixture, of "
                        "its colour and %.0f %% of the interior's mean free path",
                        100 * (1 - w), 100 * w);
    if (lowered & PRT_LOWERED_ALBEDO)
        prt_import_warn(list, item,
                        "an albedo above 0.98 is lowered to it; a medium that absorbs "
                        "nothing has no finite coefficients");
    if (lowered & PRT_LOWERED_RATE)
        prt_import_warn(list, item,
                        "its mean free path is beyond what prt takes, about 0.001 to "
                        "100000 mm, and was moved there");
}

void prt_import_shader(const struct import_list *list, const struct import_shader *shader,
                       struct prt_import *item)
{
    double through = clamp(shader->transmission, 0, 1);
    double below = (1 - through) * clamp(shader->subsurface, 0, 1);
    item->material.eta =
        (float)clamp(prt_import_ior(clamp(shader->ior, 1, 3), shader->specular), 1, 3);
    item->material.roughness = (float)clamp(shader->roughness, MEDIUM_LEAST_ROUGHNESS, 1);
    if (shader->metal >= 0.5) prt_import_none(item, "it is a metal");
    else if (!(through > 0 || below > 0))
        prt_import_none(item, "it is opaque: no subsurface and no transmission");
    else if (through >= below && !(shader->depth > 0))
        prt_import_none(item,
                        "it is clear: transmission without a depth colours the surface only");
    else if (through >= below) transmissive(list, shader, item);
    else dense(list, shader, item);
    if (!item->has_medium) return;
    if (through >= below && through < 1)
        prt_import_warn(list, item, "the %.0f %% of it that do not transmit are left out",
                        100 * (1 - through));
    else if (through > 0 && through < below)
        prt_import_warn(list, item, "its transmission of %.0f %% is left out", 100 * through);
    if (shader->unread[0])
        prt_import_warn(list, item,
                        "without a value that can be read, defaults stand for them: %s",
                        shader->unread);
    if (shader->varies[0])
        prt_import_warn(list, item,
                        "they vary over the surface; values at the origin stand for all: %s",
                        shader->varies);
    if (shader->lost[0])
        prt_import_warn(list, item, "a medium has no %s: left out", shader->lost);
}
