// SPDX-License-Identifier: MIT
// Making a radial basis: the smallest that keeps the error target, or one from a stored table.
#include "prt/profile.h"
#include "radial.h"

#include <math.h>
#include <string.h>

/* METHODS §4: range of media to cover. Families: dipole, extinction. */
static const double whole_range[2][2][2] = {{{0.02, 25}, {0, 2}}, {{0.02, 50}, {0, 0}}};

static int check_options(const struct prt_context *ctx, const struct prt_radial_options *o)
{
    if ((unsigned)o->kind > PRT_RADIAL_X07 || (unsigned)o->family > PRT_FAMILY_EXTINCTION)
        return prt_fail(ctx, PRT_ARG, "radial basis: unknown kind %u or family %u",
                        (unsigned)o->kind, (unsigned)o->family);
    if (o->family == PRT_FAMILY_DIPOLE && !(o->eta >= 1 && o->eta <= 3))
        return prt_fail(ctx, PRT_ARG, "radial basis: eta is %g, allowed range 1 to 3", o->eta);
    if (o->n_eta_more > PRT_RADIAL_MORE_ETA)
        return prt_fail(ctx, PRT_ARG, "radial basis: %u values of eta, at most %d",
                        o->n_eta_more + 1, PRT_RADIAL_MORE_ETA + 1);
    for (uint32_t i = 0; o->family == PRT_FAMILY_DIPOLE && i < o->n_eta_more; i++)
        if (!(o->eta_more[i] >= 1 && o->eta_more[i] <= 3))
            return prt_fail(ctx, PRT_ARG, "radial basis: eta is %g, allowed range 1 to 3",
                            o->eta_more[i]);
    if (!(o->sigma_lo >= 0 && o->sigma_hi >= o->sigma_lo && o->sigma_hi <= 5000 &&
          o->sigma_a_lo >= 0 && o->sigma_a_hi >= o->sigma_a_lo && o->sigma_a_hi <= 1000))
        return prt_fail(ctx, PRT_ARG, "radial basis: range sigma %g..%g, sigma_a %g..%g mm^-1",
                        o->sigma_lo, o->sigma_hi, o->sigma_a_lo, o->sigma_a_hi);
    if (!(o->radius_mm >= 0 && o->radius_mm <= 1e5))
        return prt_fail(ctx, PRT_ARG, "radial basis: radius is %g, allowed range 0 to 1e5 mm",
                        o->radius_mm);
    if (o->n_function > RADIAL_MAX_FUNCTION)
        return prt_fail(ctx, PRT_ARG, "radial basis: %u functions, at most %d", o->n_function,
                        RADIAL_MAX_FUNCTION);
    if (!(o->max_error >= 0 && o->max_error < 1))
        return prt_fail(ctx, PRT_ARG, "radial basis: max_error is %g, allowed range 0 to 1",
                        o->max_error);
    if (o->degree > 2)
        return prt_fail(ctx, PRT_ARG, "radial basis: degree is %u, allowed range 1 to 2",
                        o->degree);
    if (o->n_extra && (o->n_extra > RADIAL_MAX_EXTRA || o->kind != PRT_RADIAL_REDUCED ||
                       o->family != PRT_FAMILY_DIPOLE))
        return prt_fail(ctx, PRT_ARG,
                        "radial basis: %u extra profiles; a reduced basis of the dipole family "
                        "takes up to %d",
                        o->n_extra, RADIAL_MAX_EXTRA);
    return PRT_OK;
}

static int radial_init(const struct prt_context *ctx, const struct prt_radial_options *o,
                       struct radial **out)
{
    struct radial *radial = prt_calloc(1, sizeof *radial);
    if (!radial) return PRT_NOMEM;
    struct prt_radial *pub = &radial->pub;
    pub->kind = o->kind;
    pub->family = o->family;
    pub->eta = o->family == PRT_FAMILY_DIPOLE ? o->eta : 1;
    pub->n_eta_more = o->family == PRT_FAMILY_DIPOLE ? o->n_eta_more : 0;
    memcpy(pub->eta_more, o->eta_more, pub->n_eta_more * sizeof *o->eta_more);
    pub->eta_between = pub->n_eta_more && o->eta_between;
    radial->degree = o->kind == PRT_RADIAL_HAT || !o->degree ? 1 : o->degree;
    radial->cpu = ctx ? ctx->cpu : prt_cpu_detect();
    memcpy(pub->range, whole_range[o->family], sizeof pub->range);
    if (o->sigma_lo > 0) pub->range[0][0] = o->sigma_lo;
    if (o->sigma_hi > 0) pub->range[0][1] = o->sigma_hi;
    if (o->sigma_a_hi > 0) pub->range[1][0] = o->sigma_a_lo, pub->range[1][1] = o->sigma_a_hi;
    double radius = o->radius_mm > 0 ? o->radius_mm : 60;
    /* first radius: a tenth of the shortest mean free path, below which R_d is constant */
    double r_lo = fmin(0.1 / pub->range[0][1], radius / 64);
    if (pub->range[0][0] > pub->range[0][1]) {
        prt_free(radial);
        return prt_fail(ctx, PRT_ARG, "radial basis: sigma range %g to %g is empty",
                        o->sigma_lo, o->sigma_hi);
    }
    int err = prt_radial_grid_init(radial, fmax(r_lo, radius * 1e-7), radius);
    if (err < 0) {
        prt_radial_destroy(pub);
        return prt_fail(ctx, err, "radial basis: no grid from %g to %g mm", r_lo, radius);
    }
    *out = radial;
    return PRT_OK;
}

void prt_radial_destroy(struct prt_radial *pub)
{
    struct radial *radial = (struct radial *)pub;
    if (!radial) return;
    prt_radial_free_functions(radial);
    prt_free(pub->r);
    prt_free(radial->inv_step);
    prt_free(radial->quad_r2);
    prt_free(radial->measure32);
    prt_free(radial->quad_r);
    prt_free(radial->measure);
    prt_free(radial->weight);
    prt_free(radial);
}

/* Candidates for every size of basis: singular functions, or knots for each number of pieces.
 */
struct candidates {
    double *reduced;
    uint32_t n_reduced;
    uint32_t *knot, m_max;
};

static uint32_t count_functions(const struct radial *radial, uint32_t m)
{
    return radial->pub.kind == PRT_RADIAL_HAT ? m + 1 : m * (radial->degree + 1);
}

static int candidates_init(const struct radial *radial, struct candidates *c)
{
    if (!prt_radial_is_spline(radial)) {
        enum { N = 40 };
        c->reduced = prt_calloc((size_t)N * radial->pub.n_grid, sizeof *c->reduced);
        return c->reduced ? prt_radial_reduced(radial, N, c->reduced, &c->n_reduced)
                          : PRT_NOMEM;
    }
    c->m_max = 1;
    while (count_functions(radial, c->m_max + 1) <= RADIAL_MAX_FUNCTION) c->m_max++;
    c->knot = prt_calloc((size_t)(c->m_max + 1) * (c->m_max + 1), sizeof *c->knot);
    return c->knot ? prt_radial_knots(radial, c->m_max, c->knot) : PRT_NOMEM;
}

/* `size` counts singular functions, or intervals. */
static int build_size(struct radial *radial, const struct candidates *c, uint32_t size)
{
    struct radial_functions f = {.n_fit = size, .n_function = size};
    int err;
    if (prt_radial_is_spline(radial)) {
        err = prt_radial_spline(radial, size, c->knot + (size_t)size * (c->m_max + 1), &f);
    } else {
        size_t n = (size_t)size * radial->pub.n_grid;
        f.fit = prt_alloc(n, sizeof *f.fit);
        err = f.fit ? PRT_OK : PRT_NOMEM;
        if (f.fit) memcpy(f.fit, c->reduced, n * sizeof *f.fit);
    }
    if (err == PRT_OK) err = prt_radial_build(radial, &f);
    prt_radial_functions_finish(&f);
    return err == PRT_OK ? prt_radial_measure(radial) : err;
}

static int choose_size(const struct prt_context *ctx, struct radial *radial,
                       const struct candidates *c, const struct prt_radial_options *o)
{
    uint32_t hi = prt_radial_is_spline(radial) ? c->m_max : c->n_reduced, lo = 1;
    if (o->n_function) {
        uint32_t size = 1;
        if (prt_radial_is_spline(radial))
            while (size < hi && count_functions(radial, size + 1) <= o->n_function) size++;
        else size = o->n_function < hi ? o->n_function : hi;
        return build_size(radial, c, size);
    }
    const double target = o->max_error > 0 ? o->max_error : 0.001;
    int err;
    while (lo < hi) { /* the error falls with the size, except for noise far below the target */
        uint32_t mid = (lo + hi) / 2;
        if ((err = build_size(radial, c, mid)) < 0) return err;
        if (radial->pub.worst_error <= target) hi = mid;
        else lo = mid + 1;
    }
    if ((err = build_size(radial, c, hi)) < 0) return err;
    if (radial->pub.worst_error > target)
        prt_log(ctx, PRT_LOG_WARNING,
                "radial basis: %u functions have an error of %.3g %%, the target is %.3g %%",
                radial->pub.n_function, 100 * radial->pub.worst_error, 100 * target);
    return PRT_OK;
}

/* Relative error below which a profile needs no function of its own: half the default error
 * target of a basis (0.001). */
#define MIN_EXTRA_ERROR 5e-4

/* Adds to the basis the residual of each extra profile, one after the other. */
static int add_extra(const struct prt_context *ctx, struct radial *radial,
                     const struct prt_radial_options *o)
{
    const size_t ng = radial->pub.n_grid;
    for (uint32_t k = 0; k < o->n_extra; k++) {
        const uint32_t n = radial->pub.n_function;
        struct radial_functions f = {.n_fit = n + 1, .n_function = n + 1};
        int err = PRT_OK;
        if (n == RADIAL_MAX_FUNCTION)
            return prt_fail(ctx, PRT_LIMIT, "radial basis: no room for extra profile %u", k);
        f.fit = prt_alloc((n + 1) * ng, sizeof *f.fit);
        if (!f.fit) return PRT_NOMEM;
        for (size_t i = 0; i < n * ng; i++) f.fit[i] = radial->pub.value[i];
        if (prt_radial_remainder(radial, &o->extra[k], f.fit + n * ng) >= MIN_EXTRA_ERROR)
            err = prt_radial_build(radial, &f);
        prt_radial_functions_finish(&f);
        if (err < 0) return err;
    }
    return o->n_extra ? prt_radial_measure(radial) : PRT_OK;
}

int prt_radial_create(const struct prt_context *ctx, const struct prt_radial_options *options,
                      struct prt_radial **out)
{
    struct radial *radial = NULL;
    struct candidates c = {0};
    int err = check_options(ctx, options);
    if (err < 0 || (err = radial_init(ctx, options, &radial)) < 0) return err;
    if ((err = candidates_init(radial, &c)) == PRT_OK)
        err = choose_size(ctx, radial, &c, options);
    if (err == PRT_OK) err = add_extra(ctx, radial, options);
    prt_free(c.reduced);
    prt_free(c.knot);
    if (err < 0) {
        prt_radial_destroy(&radial->pub);
        return prt_fail(ctx, err, "radial basis: could not be built: %s", prt_status_text(err));
    }
    *out = &radial->pub;
    return PRT_OK;
}

/* ---- a basis from a stored table ---- */

/* Piece k of a piecewise table begins at the first non-zero value of its first function. */
static int table_knots(const struct radial *radial, uint32_t n_function, const float *value,
                       uint32_t *m, uint32_t knot[RADIAL_MAX_FUNCTION + 1])
{
    const uint32_t ng = radial->pub.n_grid, width = radial->degree + 1;
    if (n_function % width) return PRT_FORMAT;
    *m = n_function / width;
    for (uint32_t k = 0; k < *m; k++) { /* Bernstein 0 is largest at its own knot */
        const float *f = value + (size_t)k * width * ng;
        uint32_t i = 0;
        while (i < ng && f[i] == 0) i++;
        if (i >= ng || (k && i <= knot[k - 1])) return PRT_FORMAT;
        knot[k] = i;
    }
    knot[*m] = ng - 1;
    return knot[0] == 0 && knot[*m - 1] < ng - 1 ? PRT_OK : PRT_FORMAT;
}

static int table_degree(uint32_t n_function, uint32_t n_grid, const float *value)
{
    /* the first node of the first piece is zero for all its functions but the first */
    const float *second = value + n_grid, *third = value + 2 * (size_t)n_grid;
    if (n_function < 2) return 0;
    uint32_t i = 1;
    if (second[i] == 0) return 0;
    return n_function >= 3 && third[i] != 0 ? 2 : 1;
}

static int same_table(const struct radial *radial, const float *value)
{
    for (size_t i = 0; i < (size_t)radial->pub.n_function * radial->pub.n_grid; i++)
        if (!(fabsf(radial->pub.value[i] - value[i]) <= 1e-4f * fabsf(value[i]) + 1e-30f))
            return PRT_FORMAT;
    return PRT_OK;
}

static int rebuild(struct radial *radial, uint32_t n_function, const float *value)
{
    struct radial_functions f = {.n_fit = n_function, .n_function = n_function};
    const bool pieces = prt_radial_is_spline(radial) && radial->pub.kind != PRT_RADIAL_HAT;
    uint32_t m, knot[RADIAL_MAX_FUNCTION + 1];
    int err;
    if (pieces) {
        radial->degree = (uint32_t)table_degree(n_function, radial->pub.n_grid, value);
        if (!radial->degree) return PRT_FORMAT;
        if ((err = table_knots(radial, n_function, value, &m, knot)) < 0 ||
            (err = prt_radial_spline(radial, m, knot, &f)) < 0)
            return err;
    } else {
        size_t n = (size_t)n_function * radial->pub.n_grid;
        f.fit = prt_alloc(n, sizeof *f.fit);
        if (!f.fit) return PRT_NOMEM;
        for (size_t i = 0; i < n; i++) f.fit[i] = value[i];
    }
    err = prt_radial_build(radial, &f);
    prt_radial_functions_finish(&f);
    if (err == PRT_OK && pieces) err = same_table(radial, value);
    return err == PRT_OK ? prt_radial_measure(radial) : err;
}

int prt_radial_from_table(const struct prt_context *ctx,
                          const struct prt_radial_options *options, uint32_t n_function,
                          uint32_t n_grid, const float *r, const float *value,
                          struct prt_radial **out)
{
    struct prt_radial_options o = *options;
    struct radial *radial = NULL;
    if (!n_function || n_function > RADIAL_MAX_FUNCTION || n_grid < 3 ||
        n_grid > RADIAL_MAX_GRID)
        return prt_fail(ctx, PRT_FORMAT, "radial basis: %u functions on %u radii", n_function,
                        n_grid);
    for (size_t i = 0; i < (size_t)n_function * n_grid; i++)
        if (!isfinite(value[i]))
            return prt_fail(ctx, PRT_FORMAT, "radial basis: value %zu is not finite", i);
    if (!isfinite(r[n_grid - 1]) || !(r[1] > 1e-8f && r[1] < r[n_grid - 1]))
        return prt_fail(ctx, PRT_FORMAT, "radial basis: radii are not ascending");
    o.radius_mm = r[n_grid - 1];
    int err = check_options(ctx, &o);
    if (err < 0 || (err = radial_init(ctx, &o, &radial)) < 0) return err;
    /* the grid must be the one radial_grid_init makes from r[1] */
    prt_free(radial->pub.r);
    prt_free(radial->inv_step);
    prt_free(radial->quad_r2);
    prt_free(radial->measure32);
    prt_free(radial->quad_r);
    prt_free(radial->measure);
    prt_free(radial->weight);
    radial->pub.r = NULL;
    err = prt_radial_grid_init(radial, r[1], r[n_grid - 1]);
    if (err == PRT_OK &&
        (radial->pub.n_grid != n_grid || memcmp(radial->pub.r, r, n_grid * sizeof *r)))
        err = PRT_FORMAT;
    if (err == PRT_OK) err = rebuild(radial, n_function, value);
    if (err < 0) {
        prt_radial_destroy(&radial->pub);
        return prt_fail(ctx, err,
                        "radial basis: the stored table was not made by this program");
    }
    *out = &radial->pub;
    return PRT_OK;
}
