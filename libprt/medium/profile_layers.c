// SPDX-License-Identifier: MIT
// Layered slabs (DJ05 eq 4). A pole at depth z has the two-dimensional Fourier transform
// e^(-s|z|), s = sqrt(k^2 + sigma_tr^2), so a slab's infinite series of poles is geometric in
// the frequency domain, where layers are joined by products.
#include "material.h"
#include "profile.h"

#include <math.h>
#include <stdio.h>

struct slab {
    double sigma_tr2, albedo, depth, l; /* l = 1/sigma_t' */
    double z_top, z_bottom;             /* extrapolation lengths 2 A D, mm */
};

static void slab_init(struct slab *slab, const struct prt_layer *layer, double eta_top,
                      double eta_bottom)
{
    double sigma_t = layer->sigma_s_prime + layer->sigma_a, d = 1 / (3 * sigma_t);
    double top = prt_fresnel_dr(eta_top), bottom = prt_fresnel_dr(eta_bottom);
    *slab = (struct slab){
        .sigma_tr2 = 3 * layer->sigma_a * sigma_t,
        .albedo = layer->sigma_s_prime / sigma_t,
        .depth = layer->thickness_mm,
        .l = 1 / sigma_t,
        .z_top = 2 * d * (eta_top == 1 ? 1 : (1 + top) / (1 - top)),
        .z_bottom = 2 * d * (eta_bottom == 1 ? 1 : (1 + bottom) / (1 - bottom)),
    };
}

/* Transformed reflectance and transmittance for light on the top. Poles lie at 2iP + l and
 * 2iP - l - 2 z_top, P = depth + z_top + z_bottom: with q = e^(-2sP) the sums over i are
 * geometric. T = 0 and q = 0 without a bottom. */
static void slab_transform(const struct slab *slab, double k, double *r, double *t)
{
    double s = fmax(sqrt(k * k + slab->sigma_tr2), 1e-7), l = slab->l, d = slab->depth;
    double zv = l + 2 * slab->z_top, p2 = 2 * (d + slab->z_top + slab->z_bottom);
    if (isinf(d)) {
        *r = slab->albedo / 2 * (exp(-s * l) + exp(-s * zv));
        *t = 0;
        return;
    }
    double scale = slab->albedo / 2 / -expm1(-s * p2);
    *r = scale * (exp(-s * l) - exp(-s * (p2 - l)) + exp(-s * zv) - exp(-s * (p2 - zv)));
    *t = scale * (exp(-s * (d - l)) - exp(-s * (p2 + l - d)) - exp(-s * (d + zv)) +
                  exp(-s * (p2 - zv - d)));
}

static void slab_flip(const struct slab *slab, struct slab *out)
{
    *out = *slab;
    out->z_top = slab->z_bottom;
    out->z_bottom = slab->z_top;
}

/* From the bottom up: R = R_top + T_down R_below T_up / (1 - R_up R_below). */
static double stack_transform(unsigned n, const struct slab *slab, double k)
{
    double below = 0, unused;
    slab_transform(&slab[n - 1], k, &below, &unused);
    for (unsigned i = n - 1; i-- > 0;) {
        struct slab flipped;
        double r_down, t_down, r_up, t_up;
        slab_flip(&slab[i], &flipped);
        slab_transform(&slab[i], k, &r_down, &t_down);
        slab_transform(&flipped, k, &r_up, &t_up);
        below = r_down + t_down * below * t_up / (1 - r_up * below);
    }
    return below;
}

static double bessel_j2(double x)
{
    if (x < 0.5) {
        double y = x * x / 4;
        return y / 2 * (1 - y / 3 * (1 - y / 8 * (1 - y / 15)));
    }
    return 2 * j1(x) / x - j0(x);
}

/* (1/2pi) integral g(k) J0(kr) k dk with g linear in k^2 between nodes. Integration by parts
 * leaves the slopes b of g against k^2: the sum of -b [k^2 J2(kr)]/(pi r^2), exact for every r.
 */
static double inverse_transform(unsigned n, const double *k, const double *g, double r)
{
    double sum = 0, before = 0;
    for (unsigned i = 0; i + 1 < n; i++) {
        double k2 = k[i + 1] * k[i + 1], x = k[i + 1] * r;
        double slope = (g[i + 1] - g[i]) / (k2 - k[i] * k[i]);
        double after = r > 0 ? k2 * bessel_j2(x) / (r * r) : k2 * k2 / 8;
        sum -= slope * (after - before);
        before = after;
    }
    return sum / M_PI;
}

/* Nodes in frequency and points in radius. With these, test_slab measures errors of at
 * most 1.5e-6 of R_d(0) and an L1 error of at most 1.5e-4 of the total. */
enum { N_FREQUENCY = 2400, N_RADIUS = 420 };

/* The table over radius of the stack's R_d minus the dipole of its top layer. */
static int layers_table(struct prt_profile *profile, unsigned n, const struct slab *slab)
{
    struct slab top = slab[0];
    top.depth = INFINITY;
    double *k = prt_alloc(N_FREQUENCY, sizeof *k), *g = prt_alloc(N_FREQUENCY, sizeof *g);
    int err = k && g ? prt_profile_table_alloc(profile, N_RADIUS) : PRT_NOMEM;
    if (err == PRT_OK) {
        /* the difference falls at least as e^(-2 k (depth - l/2)) */
        const double k_lo = 1e-4, k_hi = 60 / slab[0].depth, r_lo = 0.01 * slab[0].l;
        double largest = 0;
        for (unsigned i = 0; i < N_FREQUENCY; i++) {
            double alone, unused;
            k[i] = i ? k_lo * pow(k_hi / k_lo, (i - 1) / (N_FREQUENCY - 2.0)) : 0;
            slab_transform(&top, k[i], &alone, &unused);
            g[i] = stack_transform(n, slab, k[i]) - alone;
            largest = fmax(largest, fabs(g[i]));
        }
        g[N_FREQUENCY - 1] = 0;
        const double r_hi = 300;
        for (unsigned i = 0; i < N_RADIUS; i++) {
            profile->r[i] = i ? r_lo * pow(r_hi / r_lo, (i - 1) / (N_RADIUS - 2.0)) : 0;
            profile->rd[i] = inverse_transform(N_FREQUENCY, k, g, profile->r[i]);
        }
        prt_profile_table_integrate(profile);
        /* Beyond the last radius R_d falls as r^-3 at the slowest, and without absorption the
         * table must cancel the dipole's slow tail there. g(0) is the exact integral: the part
         * that linear interpolation loses (1e-4) is distributed in proportion. */
        double beyond =
            fmax(0, prt_diffusion_rd(&profile->dipole, r_hi) + profile->rd[N_RADIUS - 1]);
        double end =
            2 * M_PI * r_hi * r_hi * beyond - prt_diffusion_tail(&profile->dipole, r_hi);
        double all = profile->outside[0], missing = g[0] - all - end;
        for (unsigned i = 0; i < N_RADIUS && all != 0; i++)
            profile->outside[i] += missing * (profile->outside[i] / all) + end;
        profile->total = profile->dipole.rho_d + g[0];
    }
    prt_free(k);
    prt_free(g);
    return err;
}

static int check_layer(const struct prt_context *ctx, unsigned i, unsigned n,
                       const struct prt_layer *layer)
{
    char what[32];
    snprintf(what, sizeof what, "layer %u", i);
    int err;
    if ((err =
             prt_material_range(ctx, what,
                                &(struct material_range){"sigma_s_prime", MATERIAL_MIN_SIGMA_S,
                                                         MATERIAL_MAX_SIGMA, "mm^-1"},
                                -1, layer->sigma_s_prime)) < 0 ||
        (err = prt_material_range(
             ctx, what, &(struct material_range){"sigma_a", 0, MATERIAL_MAX_SIGMA, "mm^-1"}, -1,
             layer->sigma_a)) < 0)
        return err;
    if (i + 1 == n && isinf(layer->thickness_mm) && layer->thickness_mm > 0) return PRT_OK;
    /* the source of the diffusion approximation is one mean free path deep */
    return prt_material_range(
        ctx, what,
        &(struct material_range){"thickness", 1 / (layer->sigma_s_prime + layer->sigma_a), 1e4,
                                 "mm"},
        -1, layer->thickness_mm);
}

int prt_profile_init_multipole(const struct prt_context *ctx, struct prt_profile *profile,
                               unsigned n_layer, const struct prt_layer *layer, double eta)
{
    struct slab slab[PRT_PROFILE_MAX_LAYER];
    struct prt_profile p = {.kind = PRT_PROFILE_MULTIPOLE};
    int err;
    if (n_layer < 1 || n_layer > PRT_PROFILE_MAX_LAYER)
        return prt_fail(ctx, PRT_ARG, "multipole: %u layers, allowed range 1 to %d", n_layer,
                        PRT_PROFILE_MAX_LAYER);
    if ((err = prt_material_range(
             ctx, "multipole",
             &(struct material_range){"eta", 1, 3, "(relative refractive index, no unit)"}, -1,
             eta)) < 0)
        return err;
    for (unsigned i = 0; i < n_layer; i++)
        if ((err = check_layer(ctx, i, n_layer, &layer[i])) < 0) return err;
    /* all layers have one refractive index, so only the outer faces reflect */
    for (unsigned i = 0; i < n_layer; i++)
        slab_init(&slab[i], &layer[i], i ? 1 : eta, i + 1 < n_layer ? 1 : eta);
    prt_diffusion_init(&p.dipole, layer[0].sigma_s_prime, layer[0].sigma_a, eta);
    p.total = p.dipole.rho_d;
    if (!isinf(layer[0].thickness_mm) && (err = layers_table(&p, n_layer, slab)) < 0)
        return prt_fail(ctx, err, "multipole: no memory");
    *profile = p;
    return PRT_OK;
}

static double multipole_rd(const struct prt_profile *profile, double r)
{
    return fmax(0, prt_diffusion_rd(&profile->dipole, r) + prt_profile_table_rd(profile, r));
}

static double multipole_tail(const struct prt_profile *profile, double r)
{
    return fmax(0,
                prt_diffusion_tail(&profile->dipole, r) + prt_profile_table_tail(profile, r));
}

static int read_layer(const struct prt_context *ctx, const char *what, const cJSON *item,
                      bool last, struct prt_layer out[3])
{
    static const char *const keys[] = {"thickness", "sigma_s_prime", "sigma_a", NULL};
    double s[3], a[3], thickness = NAN;
    int err;
    if (!cJSON_IsObject(item))
        return prt_fail(ctx, PRT_FORMAT, "%s: a layer is an object {…}", what);
    if ((err = prt_material_json_keys(ctx, what, item, keys)) < 0 ||
        (err = prt_material_json_rgb(ctx, what, item, "sigma_s_prime", true, true, s)) < 0 ||
        (err = prt_material_json_rgb(ctx, what, item, "sigma_a", true, true, a)) < 0 ||
        (err = prt_material_json_number(ctx, what, item, "thickness", &thickness)) < 0)
        return err;
    if (!cJSON_HasObjectItem(item, "thickness")) {
        if (!last)
            return prt_fail(
                ctx, PRT_FORMAT,
                "%s: \"thickness\" [mm] is missing; only the last layer has no bottom", what);
        thickness = INFINITY;
    } else if (!isfinite(thickness)) {
        return prt_fail(ctx, PRT_ARG, "%s: thickness is %g mm", what, thickness);
    }
    for (int c = 0; c < 3; c++) out[c] = (struct prt_layer){thickness, s[c], a[c]};
    return PRT_OK;
}

static int parse_multipole(const struct prt_context *ctx, const char *what, const char *folder,
                           const cJSON *object, struct prt_optics *o)
{
    static const char *const keys[] = {"name", "profile", "layers", "eta", "roughness", NULL};
    struct prt_layer layer[PRT_PROFILE_MAX_LAYER][3], one[PRT_PROFILE_MAX_LAYER];
    const cJSON *list = cJSON_GetObjectItemCaseSensitive(object, "layers");
    int err = prt_material_json_keys(ctx, what, object, keys), n = cJSON_GetArraySize(list);
    if (err < 0) return err;
    if (!cJSON_IsArray(list) || n < 1 || n > PRT_PROFILE_MAX_LAYER)
        return prt_fail(ctx, PRT_FORMAT, "%s: \"layers\" must be 1 to %d layers, top first",
                        what, PRT_PROFILE_MAX_LAYER);
    int i = 0;
    for (const cJSON *item = list->child; item; item = item->next, i++)
        if ((err = read_layer(ctx, what, item, i + 1 == n, layer[i])) < 0) return err;
    for (int c = 0; c < 3; c++) {
        for (i = 0; i < n; i++) one[i] = layer[i][c];
        if ((err = prt_profile_init_multipole(ctx, &o->channel[c], (unsigned)n, one,
                                              o->material.eta)) < 0)
            return err;
    }
    return PRT_OK;
}

const struct prt_profile_type prt_profile_type_multipole = {
    .word = "multipole", .parse = parse_multipole, .rd = multipole_rd, .tail = multipole_tail};
