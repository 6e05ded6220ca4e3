// SPDX-License-Identifier: MIT
// Profiles beyond the dipole: energy, closed forms of slabs, curves, and their fits. Above
// 600 lines: a list of laws, each read alone.
#include "medium/material.h"
#include "medium/profile.h"
#include "prt/profile.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "expect.h"

static struct prt_context quiet;
static char last_line[1024];

static void capture_log(void *user, enum prt_log_level level, const char *line)
{
    snprintf(last_line, sizeof last_line, "%s", line);
}

/* integral of 2 pi r R_d from a to b by midpoints in log r */
static double integral(const struct prt_profile *p, double a, double b)
{
    const int n = 20000;
    double sum = 0, lo = log(a), hi = log(b);
    for (int i = 0; i < n; i++) {
        double r = exp(lo + (hi - lo) * (i + 0.5) / n);
        sum += 2 * M_PI * r * r * prt_profile_rd(p, r) * (hi - lo) / n;
    }
    return sum;
}

/* Law: normalised diffusion integrates to its albedo (METHODS §1, CB15 eq 3, CB15 eq 6). */
static void test_burley(void **state)
{
    static const double row[][2] = {{0.1, 0.3}, {0.5, 2}, {0.8, 1}, {1, 12}};
    for (size_t i = 0; i < 4; i++) {
        struct prt_profile p;
        assert_int_equal(prt_profile_init_burley(&quiet, &p, row[i][0], row[i][1]), PRT_OK);
        expect_close("total", p.total, row[i][0], 1e-12);
        expect_close("tail from 0", prt_profile_tail(&p, 0), row[i][0], 1e-12);
        expect_close("integral", integral(&p, 1e-7, 1e4), row[i][0], 1e-5);
        expect_close("integral beyond 0.7 mm", integral(&p, 0.7, 1e4),
                     prt_profile_tail(&p, 0.7), 1e-5);
        assert_true(isfinite(prt_profile_rd(&p, 0)));
    }
    /* s = 1.1 at A = 0.8: R_d(1 mm) = 0.8 s (e^-s + e^(-s/3)) / 8 pi */
    struct prt_profile p;
    prt_profile_init_burley(&quiet, &p, 0.8, 1);
    expect_close("R_d(1)", prt_profile_rd(&p, 1),
                 0.8 * 1.1 * (exp(-1.1) + exp(-1.1 / 3)) / (8 * M_PI), 1e-12);
    assert_int_equal(prt_profile_init_burley(&quiet, &p, 1.2, 1), PRT_ARG);
    assert_non_null(strstr(last_line, "albedo is 1.2, allowed range 0.0001 to 1"));
    assert_int_equal(prt_profile_init_burley(&quiet, &p, 0.5, NAN), PRT_ARG);
}

/* Donner & Jensen eq 4: the slab's series of dipoles, summed one by one. */
static double slab_series(double s, double a, double d, double eta, double r)
{
    double st = s + a, tr = sqrt(3 * a * st), f = prt_fresnel_dr(eta);
    double l = 1 / st, zb = 2 * (1 + f) / (1 - f) / (3 * st), sum = 0;
    for (int i = -3000; i <= 3000; i++) {
        double zr = 2 * i * (d + 2 * zb) + l, zv = 2 * i * (d + 2 * zb) - l - 2 * zb;
        double dr = hypot(r, zr), dv = hypot(r, zv);
        sum += zr * (1 + tr * dr) * exp(-tr * dr) / (dr * dr * dr) -
               zv * (1 + tr * dv) * exp(-tr * dv) / (dv * dv * dv);
    }
    return s / st / (4 * M_PI) * sum;
}

/* Law: a slab reflects as its series of dipoles says (DJ05 eq 4, METHODS §1). */
static void test_slab(void **state)
{
    static const double row[][3] = {
        {1, 0.01, 2}, {2.19, 0.0021, 5}, {5, 0.5, 0.4}, {0.7, 0, 3}};
    for (size_t i = 0; i < 4; i++) {
        const double s = row[i][0], a = row[i][1], d = row[i][2];
        struct prt_layer layer = {d, s, a};
        struct prt_profile p;
        assert_int_equal(prt_profile_init_multipole(&quiet, &p, 1, &layer, 1.3), PRT_OK);
        const double r0 = slab_series(s, a, d, 1.3, 0);
        double worst = 0, mass = 0;
        for (double r = 0.01 / s; r < 40; r *= 1.07) {
            double exact = slab_series(s, a, d, 1.3, r), got = prt_profile_rd(&p, r);
            worst = fmax(worst, fabs(got - exact) / r0);
            mass += 2 * M_PI * r * r * 0.0677 * fabs(got - exact);
        }
        print_message("slab %g/%g/%g mm: largest error %.1e of R_d(0), L1 %.1e of total %.4f\n",
                      s, a, d, worst, mass / p.total, p.total);
        expect_below("largest error over R_d(0)", worst, 3e-6);
        expect_below("misplaced light over the total", mass / p.total, 3e-4);
        expect_close("integral", integral(&p, 1e-6, 300), p.total, 3e-4);
        double tail = p.total;
        for (double r = 1e-3; r < 200; r *= 1.1) { /* falling, never negative */
            double t = prt_profile_tail(&p, r);
            if (!(t >= 0 && t <= tail + 1e-5 * p.total && prt_profile_rd(&p, r) >= 0))
                fail_msg("tail %g after %g at %g mm", t, tail, r);
            tail = t;
        }
        /* METHODS §1: beyond the table R_d falls as r^-3, its integral as 1/r */
        const double end = p.r[p.n - 1], own = prt_diffusion_tail(&p.dipole, end);
        const double far =
            prt_profile_tail(&p, 3 * end) - prt_diffusion_tail(&p.dipole, 3 * end);
        expect_near("tail at three times the table", far, (prt_profile_tail(&p, end) - own) / 3,
                    1e-12);
        if (a == 0) { /* nothing absorbed: R = 1 - (l + z_b)/(d + 2 z_b) */
            double f = prt_fresnel_dr(1.3), zb = 2 * (1 + f) / (1 - f) / (3 * s);
            expect_close("total without absorption", p.total, 1 - (1 / s + zb) / (d + 2 * zb),
                         1e-5);
        }
        prt_profile_finish(&p);
    }
}

/* One face of a slab at spatial frequency 0: light that enters there leaves again there
 * (reflectance) or on the far side (transmittance), as sums over the poles of DJ05 eq 4. A pole
 * at depth z carries albedo'/2 sign(z) e^(-sigma_tr |z|) through a plane. */
struct face {
    double reflectance, transmittance;
};

static double pole_flux(double tr, double z)
{
    return z < 0 ? -exp(tr * z) : exp(-tr * z);
}

/* eta_near, eta_far: refractive index relative to the neighbour; 1: no reflection there. */
static struct face face_of(const struct prt_layer *layer, double eta_near, double eta_far)
{
    const double st = layer->sigma_s_prime + layer->sigma_a, l = 1 / st;
    const double tr = sqrt(3 * layer->sigma_a * st), d = layer->thickness_mm;
    const double f = prt_fresnel_dr(eta_near), g = prt_fresnel_dr(eta_far);
    const double near = 2 / (3 * st) * (eta_near == 1 ? 1 : (1 + f) / (1 - f));
    const double far = 2 / (3 * st) * (eta_far == 1 ? 1 : (1 + g) / (1 - g));
    struct face face = {0, 0};
    for (int i = -400; i <= 400; i++) {
        double zr = 2 * i * (d + near + far) + l;
        double zv = 2 * i * (d + near + far) - l - 2 * near;
        face.reflectance += pole_flux(tr, zr) - pole_flux(tr, zv);
        face.transmittance += pole_flux(tr, d - zr) - pole_flux(tr, d - zv);
    }
    face.reflectance *= layer->sigma_s_prime / st / 2;
    face.transmittance *= layer->sigma_s_prime / st / 2;
    return face;
}

/* Law: layers join as R1 + T1 R2 T1'/(1 - R1' R2) (METHODS §1, layered slabs; DJ05 eq 4).
 * Light that enters the top layer bounces between it and the layers below: the sum over
 * bounces, each one by one, is the stack's total reflectance. The top layer reflects by the
 * refractive index above and not below, so its two faces differ. */
static void test_bounces(void **state)
{
    /* not 1: there the polynomial of F_dr gives the dipole 0.0016 in place of the slab's 0 */
    static const double eta[] = {1.1, 1.3, 1.5};
    static const struct prt_layer stack[][3] = {
        {{1.2, 1, 0.05}, {3, 2, 0.01}, {5, 0.5, 0.2}},
        {{0.5, 3, 0.02}, {1, 6, 0.1}, {2, 1, 0.02}},
        {{2, 0.9, 0.3}, {0.8, 4, 0.05}, {1.5, 8, 0.4}},
    };
    for (size_t e = 0; e < 3; e++)
        for (size_t k = 0; k < 3; k++)
            for (unsigned n = 2; n <= 3; n++) {
                const struct prt_layer *layer = stack[k];
                double below = face_of(&layer[n - 1], 1, eta[e]).reflectance;
                for (unsigned i = n - 1; i-- > 0;) {
                    double top = i ? 1 : eta[e];
                    struct face down = face_of(&layer[i], top, 1);
                    struct face up = face_of(&layer[i], 1, top);
                    double sum = down.reflectance, in = down.transmittance;
                    for (int bounce = 0; bounce < 200; bounce++) {
                        sum += in * below * up.transmittance;
                        in *= below * up.reflectance;
                    }
                    below = sum;
                }
                struct prt_profile p;
                assert_int_equal(prt_profile_init_multipole(&quiet, &p, n, layer, eta[e]),
                                 PRT_OK);
                expect_close("total over all bounces", p.total, below, 1e-6);
                prt_profile_finish(&p);
            }
}

/* Law: a deep layer is the dipole; brighter floors reflect more (DJ05 eq 4, METHODS §1). */
static void test_layers(void **state)
{
    struct prt_diffusion dipole;
    struct prt_profile p;
    prt_diffusion_init(&dipole, 1.5, 0.03, 1.4);
    /* no bottom, and a bottom out of reach, are the dipole */
    struct prt_layer deep[2] = {{INFINITY, 1.5, 0.03}, {0}};
    for (int k = 0; k < 2; k++) {
        if (k) deep[0].thickness_mm = 40;
        assert_int_equal(prt_profile_init_multipole(&quiet, &p, 1, deep, 1.4), PRT_OK);
        expect_close("total of a deep layer", p.total, dipole.rho_d, 1e-6);
        for (double r = 0; r < 8; r += 0.5)
            expect_close("R_d of a deep layer", prt_profile_rd(&p, r),
                         prt_diffusion_rd(&dipole, r), 1e-3);
        prt_profile_finish(&p);
    }
    /* the same medium cut in two: layering is approximate, but not by much */
    struct prt_layer cut[2] = {{2, 1.5, 0.03}, {INFINITY, 1.5, 0.03}};
    assert_int_equal(prt_profile_init_multipole(&quiet, &p, 2, cut, 1.4), PRT_OK);
    print_message("medium cut in two layers: total %.4f, whole %.4f\n", p.total, dipole.rho_d);
    expect_close("total of a medium cut in two", p.total, dipole.rho_d, 0.01);
    double whole = p.total;
    prt_profile_finish(&p);
    /* a brighter floor reflects more, a darker one less; an absorber tends to the lone slab */
    double total[3];
    for (int k = 0; k < 3; k++) {
        cut[1].sigma_a = (double[]){1e-4, 0.3, 300}[k];
        assert_int_equal(prt_profile_init_multipole(&quiet, &p, 2, cut, 1.4), PRT_OK);
        total[k] = p.total;
        expect_close("integral over two layers", integral(&p, 1e-6, 300), p.total, 3e-3);
        prt_profile_finish(&p);
    }
    expect_above("a brighter floor over the same", total[0] / whole, 1);
    expect_below("a darker floor over the same", total[1] / whole, 1);
    expect_below("a black floor over a darker one", total[2] / total[1], 1);
    /* faults */
    struct prt_layer thin[2] = {{0.2, 1.5, 0.03}, {INFINITY, 1.5, 0.03}};
    assert_int_equal(prt_profile_init_multipole(&quiet, &p, 2, thin, 1.4), PRT_ARG);
    assert_non_null(strstr(last_line, "layer 0: thickness is 0.2, allowed range 0.65"));
    struct prt_layer open[2] = {{INFINITY, 1.5, 0.03}, {1, 1.5, 0.03}};
    assert_int_equal(prt_profile_init_multipole(&quiet, &p, 2, open, 1.4), PRT_ARG);
    assert_int_equal(prt_profile_init_multipole(&quiet, &p, 9, open, 1.4), PRT_ARG);
}

/* Law: a curve's total is the volume under straight lines (METHODS §1, other profiles). */
static void test_curve(void **state)
{
    const double r[] = {0, 2}, rd[] = {0.1, 0}, flat[] = {0.05, 0.05}, r_late[] = {1, 2};
    struct prt_profile p;
    assert_int_equal(prt_profile_init_curve(&quiet, "cone", &p, 2, r, rd), PRT_OK);
    expect_close("total of a cone", p.total, M_PI * 4 * 0.1 / 3, 1e-12); /* a cone's volume */
    expect_close("R_d between points", prt_profile_rd(&p, 1), 0.05, 1e-12);
    expect_close("tail", prt_profile_tail(&p, 1), integral(&p, 1, 2), 1e-6);
    assert_true(prt_profile_rd(&p, 2.1) == 0 && prt_profile_tail(&p, 2.1) == 0);
    prt_profile_finish(&p);
    assert_int_equal(prt_profile_init_curve(&quiet, "late", &p, 2, r_late, flat), PRT_OK);
    expect_close("constant inside the first point", prt_profile_tail(&p, 0), M_PI * 4 * 0.05,
                 1e-12); /* constant inside the first */
    expect_close("integral from 0", integral(&p, 1e-6, 2), p.total, 1e-6);
    expect_close("tail inside the first point", prt_profile_tail(&p, 0.5), integral(&p, 0.5, 2),
                 1e-6);
    prt_profile_finish(&p);
    const double loud[] = {1, 1}, negative[] = {0.1, -0.1}, back[] = {2, 1};
    assert_int_equal(prt_profile_init_curve(&quiet, "x", &p, 2, r, loud), PRT_ARG);
    assert_non_null(strstr(last_line, "reflects 12.5"));
    assert_int_equal(prt_profile_init_curve(&quiet, "x", &p, 2, r, negative), PRT_ARG);
    assert_int_equal(prt_profile_init_curve(&quiet, "x", &p, 2, back, flat), PRT_ARG);
    assert_int_equal(prt_profile_init_curve(&quiet, "x", &p, 1, r, flat), PRT_ARG);
}

// Every kind of profile has a line here. eta is 1.3. Limits: what a basis of 20 functions
// misplaces, and the table of 256 points inside a material.
static const struct profile_case {
    const char *name, *json;
    double fit_limit, table_limit;
} cases[] = {
    {"preset", "{\"sigma_s_prime\":[0.74,0.88,1.01],\"sigma_a\":[0.032,0.17,0.48]}", 0.0002, 0},
    {"burley",
     "{\"name\":\"wax\",\"profile\":\"burley\",\"albedo\":[0.8,0.5,0.3],"
     "\"mean_free_path\":[3,1.5,0.8],\"eta\":1.3}",
     0.03, 2e-3},
    {"slab",
     "{\"profile\":\"multipole\",\"layers\":[{\"thickness\":3,\"sigma_s_prime\":"
     "[1,1.2,1.5],\"sigma_a\":[0.01,0.03,0.1]}]}",
     0.02, 2e-3},
    {"two layers",
     "{\"profile\":\"multipole\",\"layers\":[{\"thickness\":1.2,"
     "\"sigma_s_prime\":[1,1.2,1.5],\"sigma_a\":[0.05,0.2,0.5]},"
     "{\"sigma_s_prime\":[2,2,2],\"sigma_a\":[0.003,0.02,0.1]}]}",
     0.02, 2e-3},
    {"curve",
     "{\"profile\":\"curve\",\"radius\":[0,0.5,1,2,4,8],\"rd\":[[0.05,0.045,0.03,0.01,"
     "0.001,0],[0.04,0.03,0.02,0.005,0.0005,0],[0.03,0.02,0.01,0.001,0,0]],\"roughness\":0.5}",
     0.15, 1e-5},
};

/* Law: tail is the integral of 2 pi r R_d beyond r, and total that from 0, in each channel
 * (METHODS §1, other profiles). */
static void test_every_tail(void **state)
{
    bool seen[PRT_PROFILE_N_KIND] = {false};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct prt_optics o;
        assert_int_equal(
            prt_optics_parse(&quiet, "m", NULL, cases[i].json, strlen(cases[i].json), &o),
            PRT_OK);
        seen[o.kind] = true;
        for (int c = 0; c < 3; c++) {
            const struct prt_profile *p = &o.channel[c];
            expect_near("total", prt_profile_tail(p, 0), p->total, 1e-6);
            for (double r = 0.05; r < 8; r *= 2)
                expect_near("light between r and 200 mm", integral(p, r, 200),
                            prt_profile_tail(p, r) - prt_profile_tail(p, 200), 3e-4);
        }
        for (int c = 1; c < 3; c++)
            assert_true(prt_profile_tail(&o.channel[c], 0.5) !=
                        prt_profile_tail(&o.channel[0], 0.5));
        prt_optics_finish(&o);
    }
    for (uint32_t kind = 0; kind < PRT_PROFILE_N_KIND; kind++)
        if (!seen[kind]) fail_msg("%s has no line in cases[]", prt_profile_type(kind)->word);
}

static struct prt_radial *whole_range(void)
{
    struct prt_radial_options o = {.eta = 1.3, .n_function = 20};
    struct prt_radial *radial = NULL;
    assert_int_equal(prt_radial_create(&quiet, &o, &radial), PRT_OK);
    return radial;
}

/* integral |sum c B - R| 2 pi r dr / total up to 60 mm, on radii of this test's own */
static double fit_error(const struct prt_radial *radial, const struct prt_optics *o,
                        const float *coef)
{
    double worst = 0, lo = log(1e-4), hi = log(60);
    const int n = 3000;
    for (int c = 0; c < 3; c++) {
        double error = 0, mass = 0;
        for (int i = 0; i < n; i++) {
            double r = exp(lo + (hi - lo) * (i + 0.5) / n), sum = 0;
            float b[64], rf = (float)r;
            prt_radial_eval(radial, 1, &rf, b);
            for (uint32_t j = 0; j < radial->n_function; j++)
                sum += (double)coef[3 * j + c] * b[j];
            double exact = prt_profile_rd(&o->channel[c], r), mu = r * r;
            error += mu * fabs(sum - exact);
            mass += mu * exact;
        }
        worst = fmax(worst, error / mass);
    }
    return worst;
}

/* Law: the error of a fit is the light that it misplaces (METHODS §4.2, X07 eq 8). */
static void test_optics_fit(void **state)
{
    struct prt_radial *radial = whole_range();
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        const struct profile_case *row = &cases[i];
        struct prt_optics o;
        float coef[3 * 64];
        double error;
        assert_int_equal(prt_optics_parse(&quiet, "m", NULL, row->json, strlen(row->json), &o),
                         PRT_OK);
        assert_int_equal(prt_radial_fit_material(radial, &o.material, coef, &error), PRT_OK);
        double own = fit_error(radial, &o, coef);
        print_message("%-10s fit error %.3f %%, measured %.3f %%\n", row->name, 100 * error,
                      100 * own);
        expect_below(expect_name("%s: fit error", row->name), error, row->fit_limit);
        expect_near("fit error against the measured one", error, own, 0.1 * error + 1e-3);
        assert_int_equal(prt_material_check(&quiet, &o.material), PRT_OK);
        for (int c = 0; c < 3 && o.kind != PRT_PROFILE_DIPOLE; c++) {
            /* the dipole that stands in: same total, same half-energy radius */
            struct prt_diffusion d;
            prt_diffusion_init(&d, o.material.sigma_s_prime[c], o.material.sigma_a[c], 1.3);
            expect_close("total of the dipole that stands in", d.rho_d, o.channel[c].total,
                         1e-3);
            double r = 1;
            for (int k = 0; k < 200; k++)
                r *= prt_diffusion_tail(&d, r) > d.rho_d / 2 ? 1.01 : 0.99;
            expect_close("energy beyond its median radius", prt_profile_tail(&o.channel[c], r),
                         o.channel[c].total / 2, 0.03);
        }
        prt_optics_finish(&o);
    }
    /* a dipole written out as a curve gives the dipole's own coefficients */
    struct prt_optics o = {.kind = PRT_PROFILE_CURVE, .material = *prt_material_preset(8)};
    const struct prt_material skin = o.material;
    static double r[4000], rd[4000];
    for (int c = 0; c < 3; c++) {
        struct prt_diffusion d;
        prt_diffusion_init(&d, o.material.sigma_s_prime[c], o.material.sigma_a[c], 1.3);
        for (int k = 0; k < 4000; k++) {
            r[k] = k ? 1e-3 * pow(1e5, (k - 1) / 3998.0) : 0;
            rd[k] = prt_diffusion_rd(&d, r[k]);
        }
        assert_int_equal(prt_profile_init_curve(&quiet, "skin", &o.channel[c], 4000, r, rd),
                         PRT_OK);
    }
    float curve[3 * 64], exact[3 * 64], largest = 0;
    assert_int_equal(prt_material_from_optics(&quiet, "skin", &o), PRT_OK);
    assert_int_equal(prt_radial_fit_material(radial, &o.material, curve, NULL), PRT_OK);
    assert_int_equal(prt_radial_fit_material(radial, &skin, exact, NULL), PRT_OK);
    for (uint32_t j = 0; j < 3 * radial->n_function; j++)
        largest = fmaxf(largest, fabsf(exact[j]));
    for (uint32_t j = 0; j < 3 * radial->n_function; j++)
        expect_below("coefficient of the curve against the dipole's",
                     fabsf(curve[j] - exact[j]) / largest, 1e-3);
    prt_optics_finish(&o);
    prt_radial_destroy(radial);
}

/* Law: a profile that a basis was made with is in its span (METHODS §5, §4.2). */
static void test_extra_functions(void **state)
{
    static const char json[] =
        "{\"profile\":\"curve\",\"radius\":[0,0.5,1,2,4,8],\"rd\":[[0.05,0.045,0.03,0.01,0.001,0],"
        "[0.04,0.03,0.02,0.005,0.0005,0],[0.03,0.02,0.01,0.001,0,0]]}";
    struct prt_optics o, burley;
    assert_int_equal(prt_optics_parse(&quiet, "m", NULL, json, strlen(json), &o), PRT_OK);
    struct prt_radial_options options = {
        .eta = 1.3, .n_function = 16, .extra = o.channel, .n_extra = 3};
    struct prt_radial *radial = NULL, *back = NULL;
    float coef[3 * 64];
    double error;
    assert_int_equal(prt_radial_create(&quiet, &options, &radial), PRT_OK);
    assert_int_equal(radial->n_function, 19);
    assert_int_equal(prt_radial_fit_material(radial, &o.material, coef, &error), PRT_OK);
    print_message("curve with its own functions: fit error %.4f %%\n", 100 * error);
    expect_below("fit error", error, 0.001);
    expect_below("fit error as measured", fit_error(radial, &o, coef), 0.0015);
    for (uint32_t j = 0; j < 57; j++) expect_below("coefficient", fabsf(coef[j]), 5);
    assert_int_equal(prt_radial_from_table(&quiet, &options, 19, radial->n_grid, radial->r,
                                           radial->value, &back),
                     PRT_OK);
    assert_int_equal(prt_radial_fit_material(back, &o.material, coef, &error), PRT_OK);
    expect_below("fit error after reading", error, 0.001);
    /* the other materials lose nothing, and what is in the span already adds nothing */
    struct prt_material skin = *prt_material_preset(8);
    assert_int_equal(prt_radial_fit_material(radial, &skin, coef, &error), PRT_OK);
    expect_below("fit error of skin1", error, 0.003);
    prt_radial_destroy(back);
    prt_radial_destroy(radial);
    prt_optics_finish(&o);
    assert_int_equal(prt_optics_load(&quiet, "skin1", &o), PRT_OK);
    options.extra = o.channel;
    options.n_function = 20;
    assert_int_equal(prt_radial_create(&quiet, &options, &radial), PRT_OK);
    assert_int_equal(radial->n_function, 20);
    prt_radial_destroy(radial);
    static const char soft[] =
        "{\"profile\":\"burley\",\"albedo\":[0.8,0.5,0.3],\"mean_free_path\":[3,1.5,0.8]}";
    assert_int_equal(prt_optics_parse(&quiet, "m", NULL, soft, strlen(soft), &burley), PRT_OK);
    options.extra = burley.channel;
    assert_int_equal(prt_radial_create(&quiet, &options, &radial), PRT_OK);
    assert_int_equal(prt_radial_fit_material(radial, &burley.material, coef, &error), PRT_OK);
    print_message("burley with its own functions: fit error %.4f %%\n", 100 * error);
    expect_below("fit error of burley", error,
                 0.004); /* 1/r inside the first 4 um, which no grid resolves */
    prt_radial_destroy(radial);
    prt_optics_finish(&burley);
}

/* Contract of prt_optics_load: files, presets, and faults by name. */
static void test_optics_files(void **state)
{
    char folder[] = "/tmp/prt-profile-XXXXXX", path[128], csv[128];
    struct prt_optics o;
    assert_non_null(mkdtemp(folder));
    snprintf(path, sizeof path, "%s/m.json", folder);
    snprintf(csv, sizeof csv, "%s/c.csv", folder);
    FILE *f = fopen(csv, "w");
    assert_non_null(f);
    fputs("r,R_d\n# measured\n0, 0.1\n\n1,0.05\r\n2,0\n", f);
    fclose(f);
    f = fopen(path, "w");
    assert_non_null(f);
    fputs("{\"profile\":\"curve\",\"file\":\"c.csv\",\"eta\":1.4,\"name\":\"wax\"}", f);
    fclose(f);
    assert_int_equal(prt_optics_load(&quiet, path, &o), PRT_OK);
    assert_int_equal(o.kind, PRT_PROFILE_CURVE);
    assert_int_equal(o.channel[2].n, 3);
    assert_string_equal(o.material.name, "wax");
    expect_close("total of a file", o.channel[1].total, M_PI * 4 * 0.1 / 3, 1e-9);
    prt_optics_finish(&o);
    static const char *const bad[][2] = {{"0,0.1\n1;0.1,2\n", "has 3 columns"},
                                         {"0,0.1\nx,2\n", "line 2: expected r,R_d"},
                                         {"0,0.1\n1 0\n", "expected a comma"},
                                         {"0,0.1\n1,1e999\n", "allowed range"},
                                         {"r,R_d\n", "a curve of 0 points"}};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        f = fopen(csv, "w");
        fputs(bad[i][0], f);
        fclose(f);
        if (prt_optics_load(&quiet, path, &o) >= 0 || !strstr(last_line, bad[i][1]))
            fail_msg("%s: said \"%s\"", bad[i][0], last_line);
    }
    unlink(csv);
    assert_true(prt_optics_load(&quiet, path, &o) < 0);
    unlink(path);
    rmdir(folder);
    assert_int_equal(prt_optics_load(&quiet, "Marble", &o), PRT_OK);
    expect_close("total of marble", o.channel[0].total, 0.8301915, 1e-6);
    prt_optics_finish(&o);

    static const struct {
        const char *json, *says;
    } fault[] = {
        {"{\"profile\":\"phong\"}", "allowed: burley, multipole, curve"},
        {"{\"profile\":\"burley\",\"albedo\":0.5}", "\"mean_free_path\" is missing"},
        {"{\"profile\":\"burley\",\"albedo\":0.5,\"mean_free_path\":-1}", "allowed range"},
        {"{\"profile\":\"burley\",\"albedo\":0.5,\"mean_free_path\":1,\"sigma_a\":1}",
         "unknown key"},
        {"{\"profile\":\"burley\",\"albedo\":0.5,\"mean_free_path\":1,\"eta\":7}", "eta is 7"},
        {"{\"profile\":\"multipole\",\"layers\":[]}", "1 to 8 layers"},
        {"{\"profile\":\"multipole\",\"layers\":[1]}", "a layer is an object"},
        {"{\"profile\":\"multipole\",\"layers\":[{\"sigma_s_prime\":1,\"sigma_a\":1},"
         "{\"sigma_s_prime\":1,\"sigma_a\":1}]}",
         "\"thickness\" [mm] is missing"},
        {"{\"profile\":\"curve\",\"file\":\"/etc/passwd\"}", "not allowed here"},
        {"{\"profile\":\"curve\",\"radius\":[0,1],\"rd\":[[1,1],[1,1]]}", "three lists"},
        {"{\"profile\":\"curve\",\"radius\":[0,1],\"rd\":[[0.1,0],[0.1,0],[0.1]]}",
         "1 values for 2"},
    };
    for (size_t i = 0; i < sizeof fault / sizeof fault[0]; i++)
        if (prt_optics_parse(&quiet, "m", NULL, fault[i].json, strlen(fault[i].json), &o) >=
                0 ||
            !strstr(last_line, fault[i].says))
            fail_msg("%s: said \"%s\"", fault[i].json, last_line);
}

/* A curve's file of four columns has one for each channel. */
static void test_file_of_channels(void **state)
{
    char path[] = "/tmp/prt-profile-XXXXXX", json[128];
    struct prt_optics o;
    const int file = mkstemp(path);
    FILE *f = file < 0 ? NULL : fdopen(file, "w");
    assert_non_null(f);
    fputs("r,R,G,B\n0,0.1,0.05,0.02\n2;0;0.01;0.02\n", f);
    fclose(f);
    snprintf(json, sizeof json, "{\"profile\":\"curve\",\"file\":\"%s\"}", path);
    assert_int_equal(prt_optics_parse(&quiet, "m", "", json, strlen(json), &o), PRT_OK);
    static const double want[3][2] = {{0.1, 0}, {0.05, 0.01}, {0.02, 0.02}};
    for (int c = 0; c < 3; c++)
        for (int k = 0; k < 2; k++)
            expect_near("R_d of a column", prt_profile_rd(&o.channel[c], k * (2 - 1e-9)),
                        want[c][k], 1e-9);
    prt_optics_finish(&o);
    unlink(path);
}

/* Law: at most 256 points hold a profile and keep its total (METHODS §1, other profiles). */
static void test_material_table(void **state)
{
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        const struct profile_case *row = &cases[i];
        struct prt_material m, back;
        struct prt_optics o;
        struct prt_diffusion d[3];
        static char text[PRT_MATERIAL_TEXT];
        assert_int_equal(prt_optics_parse(&quiet, "m", NULL, row->json, strlen(row->json), &o),
                         PRT_OK);
        if (o.kind == PRT_PROFILE_DIPOLE) continue; // it has no table
        assert_int_equal(prt_material_load(&quiet, row->json, &m), PRT_OK);
        assert_int_equal(m.profile, o.kind);
        assert_int_equal(prt_material_check(&quiet, &m), PRT_OK);
        prt_material_dipoles(&m, d);
        double worst = 0;
        for (int c = 0; c < 3; c++) {
            double error = 0, before = 1e-7;
            for (int k = 0; k < 4000; k++) {
                double next = 1e-7 * pow(1e10, (k + 1) / 4000.0), r = sqrt(before * next);
                error += fabs(prt_diffusion_rd(&d[c], r) - prt_profile_rd(&o.channel[c], r)) *
                         M_PI * (next * next - before * before);
                before = next;
            }
            worst = fmax(worst, error / o.channel[c].total);
            expect_near("total", d[c].rho_d, o.channel[c].total, 2e-5);
            for (int k = 0; k < 30; k++) {
                double r = 0.01 * pow(1.4, k);
                expect_near("tail", prt_diffusion_tail(&d[c], r),
                            prt_profile_tail(&o.channel[c], r), 5e-4);
                float r2 = (float)(r * r), one, all[3];
                prt_diffusion_rd_array(&d[c], prt_cpu_detect(), 1, &r2, &one);
                prt_diffusion_rd3_array(d, prt_cpu_detect(), 1, &r2, &all[0], &all[1], &all[2]);
                assert_true(one == all[c]);
                expect_near("R_d of an array", one, prt_diffusion_rd(&d[c], r),
                            1e-4 * one + 1e-9);
            }
        }
        printf("%-10s %u points hold it to %.4f %%\n", row->name, m.n_point, 100 * worst);
        expect_below(expect_name("%s: misplaced light", row->name), worst, row->table_limit);
        int n = prt_material_print(&m, text, sizeof text);
        assert_true(n > 0 && n < PRT_MATERIAL_TEXT);
        assert_int_equal(prt_material_parse(&quiet, "again", text, (size_t)n, &back), PRT_OK);
        assert_int_equal(back.n_point, m.n_point);
        assert_memory_equal(back.radius, m.radius, m.n_point * sizeof *m.radius);
        for (int c = 0; c < 3; c++)
            assert_memory_equal(back.reflectance[c], m.reflectance[c],
                                m.n_point * sizeof(float));
        assert_string_equal(back.name, m.name);
        assert_true(prt_material_summary(&m, text, sizeof text) < 512);
        uint64_t hash = prt_material_hash(&m);
        m.name[0] = 'x';
        assert_true(prt_material_hash(&m) == hash);
        m.reflectance[1][0] *= 1.001f;
        assert_true(prt_material_hash(&m) != hash);
        m.reflectance[2][1] = NAN;
        assert_int_equal(prt_material_check(&quiet, &m), PRT_ARG);
        assert_non_null(strstr(last_line, "mm^-2"));
        prt_optics_finish(&o);
    }
}

/* Contract of prt_profile_type: every kind has a row: a word of its own, functions, and a
 * material that keeps the kind. */
static void test_kinds(void **state)
{
    struct prt_material m = *prt_material_preset(0);
    m.n_point = 2;
    m.radius[1] = 1;
    for (int c = 0; c < 3; c++) m.reflectance[c][0] = m.reflectance[c][1] = 0.1f;
    for (uint32_t kind = 0; kind < PRT_PROFILE_N_KIND; kind++) {
        const struct prt_profile_type *type = prt_profile_type(kind);
        char text[PRT_MATERIAL_SUMMARY], expected[64];
        assert_non_null(type);
        assert_true(type->rd && type->tail && (type->parse || kind == PRT_PROFILE_DIPOLE));
        for (uint32_t other = 0; other < kind; other++)
            assert_string_not_equal(type->word, prt_profile_type(other)->word);
        if (!kind) continue;
        m.profile = kind;
        assert_int_equal(prt_material_check(&quiet, &m), PRT_OK);
        assert_true(prt_material_summary(&m, text, sizeof text) > 0);
        snprintf(expected, sizeof expected, "\"profile\":\"%s\"", type->word);
        assert_non_null(strstr(text, expected));
    }
    assert_null(prt_profile_type(PRT_PROFILE_N_KIND));
    m.profile = PRT_PROFILE_N_KIND;
    assert_int_equal(prt_material_check(&quiet, &m), PRT_ARG);
    assert_non_null(strstr(last_line, "unknown profile kind"));
}

/* Contract of prt_material_print: JSON that does not fit its buffer is an error, and the buffer
 * holds valid JSON all the same.
 */
static void test_print_limit(void **state)
{
    static char text[PRT_MATERIAL_TEXT];
    struct prt_material m = *prt_material_preset(0), back;
    int n = prt_material_print(&m, text, sizeof text);
    assert_int_equal(n, strlen(text));
    assert_int_equal(prt_material_print(&m, text, (size_t)n), PRT_LIMIT);
    assert_string_equal(text, "null");
    assert_int_equal(prt_material_print(&m, text, (size_t)n + 1), n);
    snprintf(m.name, sizeof m.name, "a\"b\\c\n\xc3\xa9");
    n = prt_material_print(&m, text, sizeof text);
    assert_non_null(strstr(text, "{\"name\":\"a\\\"b\\\\c\\n\xc3\xa9\",\"sigma_s_prime\":["
                                 "2.29,2.39,1.97],\"sigma_a\":[0.003,0.0034,0.046],\"g\":[0,0,"
                                 "0],\"eta\":1.3,\"roughness\":0.3}"));
    assert_int_equal(prt_material_parse(&quiet, "control character", text, (size_t)n, &back),
                     PRT_FORMAT);
}

int main(void)
{
    prt_context_init(&quiet);
    quiet.log = capture_log;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_burley),          cmocka_unit_test(test_slab),
        cmocka_unit_test(test_bounces),         cmocka_unit_test(test_layers),
        cmocka_unit_test(test_curve),           cmocka_unit_test(test_kinds),
        cmocka_unit_test(test_every_tail),      cmocka_unit_test(test_optics_fit),
        cmocka_unit_test(test_extra_functions), cmocka_unit_test(test_file_of_channels),
        cmocka_unit_test(test_optics_files),    cmocka_unit_test(test_material_table),
        cmocka_unit_test(test_print_limit),
    };
    return run_physics_tests(tests, NULL, NULL);
}
