// SPDX-License-Identifier: MIT
// The laws of one medium: dipole, Fresnel, refraction, phase functions, and material files.
#include "prt/medium.h"

#include <lapacke.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "expect.h"

/* ---- dipole ---- */

/* Law: R_d and rho_d of the dipole (METHODS §1, W05 eq 3): the values of its table. */
static void test_dipole_values(void **state)
{
    /* METHODS §1, JMLH01 red channels: sigma_s', sigma_a, eta, R_d at 0, 0.1, 1, 10 mm, rho_d
     */
    static const double row[][8] = {
        {2.19, 0.0021, 1.5, 3.907465e-1, 3.647715e-1, 3.484669e-2, 1.566956e-4, 0.8301915},
        {0.74, 0.032, 1.3, 4.443106e-2, 4.403511e-2, 2.201903e-2, 7.425801e-5, 0.4359564},
        {0.70, 0.0014, 1.3, 4.082255e-2, 4.053557e-2, 2.314369e-2, 3.604257e-4, 0.8149460},
        {0.18, 0.061, 1.3, 2.719942e-3, 2.717269e-3, 2.471434e-3, 7.313977e-5, 0.1638360},
    };
    for (size_t i = 0; i < sizeof row / sizeof row[0]; i++) {
        struct prt_diffusion d;
        prt_diffusion_init(&d, row[i][0], row[i][1], row[i][2]);
        expect_close("R_d(0)", prt_diffusion_rd(&d, 0), row[i][3], 2e-7);
        expect_close("R_d(0.1)", prt_diffusion_rd(&d, 0.1), row[i][4], 2e-7);
        expect_close("R_d(1)", prt_diffusion_rd(&d, 1), row[i][5], 2e-7);
        expect_close("R_d(10)", prt_diffusion_rd(&d, 10), row[i][6], 4e-7);
        expect_close("rho_d", d.rho_d, row[i][7], 1e-7);
    }
}

/* The integral of 2 pi r R_d from a, by midpoints in log r. */
static double integral_beyond(const struct prt_diffusion *d, double a)
{
    double sum = 0, lo = log(a > 0 ? a : 1e-7), hi = log(1e5), n = 40000;
    for (int i = 0; i < n; i++) {
        double r = exp(lo + (hi - lo) * (i + 0.5) / n);
        sum += 2 * M_PI * r * r * prt_diffusion_rd(d, r) * (hi - lo) / n;
    }
    return sum;
}

/* Law: int 2 pi r R_d dr from r on is the closed-form tail, from 0 on rho_d (METHODS §1). */
static void test_dipole_integral(void **state)
{
    for (unsigned i = 0; prt_material_preset(i); i++) {
        const struct prt_material *m = prt_material_preset(i);
        if (m->sigma_a[0] == 0) continue; /* its tail falls as 1/r: the cut would show */
        for (int c = 0; c < 3; c++) {
            struct prt_diffusion d;
            prt_diffusion_init(&d, m->sigma_s_prime[c], m->sigma_a[c], m->eta);
            expect_close("integral of R_d", integral_beyond(&d, 0), d.rho_d, 1e-5);
            expect_close("integral of R_d beyond 1.5 mm", integral_beyond(&d, 1.5),
                         prt_diffusion_tail(&d, 1.5), 1e-5);
            expect_close("tail from 0", prt_diffusion_tail(&d, 0), d.rho_d, 1e-12);
        }
    }
}

/* Law: of a slab lit evenly from both sides the dipole lets rho_d of the near side's light
 * leave and, of the far side's, what R_d has beyond the thickness: more than all (METHODS §9;
 * the dipole column of README's table). */
static void test_dipole_slab(void **state)
{
    static const struct {
        const char *medium;
        int channel;
        double want;
    } row[] = {
        {"marble", 0, 1.19}, {"skimmilk", 0, 1.40}, {"skin1", 0, 0.66}, {"skin1", 1, 0.28}};
    for (int i = 0; i < 4; i++) {
        struct prt_context quiet = {0};
        struct prt_material m;
        struct prt_diffusion d;
        int c = row[i].channel;
        assert_int_equal(prt_material_load(&quiet, row[i].medium, &m), PRT_OK);
        prt_diffusion_init(&d, m.sigma_s_prime[c], m.sigma_a[c], m.eta);
        expect_near(expect_name("2 mm of %s, channel %d", row[i].medium, c),
                    d.rho_d + prt_diffusion_tail(&d, 2), row[i].want, 0.005);
    }
}

/* Law: every instruction set gives R_d (METHODS §1) to 1e-5, and writes nothing past the end.
 */
static void test_dipole_array(void **state)
{
    static const double medium[][2] = {{2.19, 0.0021}, {25, 2},   {0.02, 2},
                                       {0.02, 0},      {7, 2e-4}, {900, 1000}};
    static const unsigned masks[] = {PRT_CPU_C, PRT_CPU_AVX2, PRT_CPU_AVX2 | PRT_CPU_AVX512};
    enum { N = 4137, GUARD = 8 }; // longer than a piece of 2048 of three channels
    static float r2[N], out[3][N + GUARD];
    for (int i = 0; i < N; i++) r2[i] = i ? (float)pow(10, -6 + 10.0 * i / N) : 0;
    for (size_t m = 0; m < sizeof medium / sizeof medium[0]; m++)
        for (size_t k = 0; k < 3; k++) {
            if ((masks[k] & prt_cpu_detect()) != masks[k]) continue;
            struct prt_diffusion d[3];
            for (int c = 0; c < 3; c++)
                prt_diffusion_init(&d[c], medium[m][0] * (1 + c), medium[m][1], 1.3);
            size_t n = (size_t)(N - (int)m);
            for (int c = 0; c < 3; c++) memset(out[c], 0xff, sizeof out[c]);
            if (m & 1) prt_diffusion_rd3_array(d, masks[k], n, r2, out[0], out[1], out[2]);
            else
                for (int c = 0; c < 3; c++)
                    prt_diffusion_rd_array(&d[c], masks[k], n, r2, out[c]);
            for (int c = 0; c < 3; c++) {
                for (size_t i = 0; i < n; i++) {
                    double r = sqrt((double)r2[i]), exact = prt_diffusion_rd(&d[c], r);
                    if (d[c].sigma_tr * hypot(r, d[c].z_r) <= 40)
                        expect_close("R_d of an array", out[c][i], exact, 1e-5);
                    else
                        expect_near("R_d of an array, far away", out[c][i], exact,
                                    1e-16 * prt_diffusion_rd(&d[c], 0));
                }
                for (int g = 0; g < GUARD; g++) {
                    uint32_t bits;
                    memcpy(&bits, &out[c][n + (size_t)g], 4);
                    assert_int_equal(bits, 0xffffffffu);
                }
            }
        }
}

/* ---- boundary ---- */

/* Law: F_t at normal incidence and at Brewster's angle, its mean, and F_dr (METHODS §1). */
static void test_fresnel(void **state)
{
    expect_near("mean F_t at 1.3", prt_fresnel_mean_transmittance(1.3), 0.938868, 5e-7);
    expect_near("mean F_t at 1.5", prt_fresnel_mean_transmittance(1.5), 0.908222, 5e-7);
    expect_near("E at 1.3", M_PI * prt_fresnel_mean_transmittance(1.3), 2.949541, 1e-6);
    expect_near("E at 1.5", M_PI * prt_fresnel_mean_transmittance(1.5), 2.853264, 1e-6);
    expect_close("mean F_t at 1", prt_fresnel_mean_transmittance(1), 1, 1e-9);
    /* normal incidence: 1 - ((eta-1)/(eta+1))^2; Brewster: the parallel part passes whole */
    expect_close("F_t at normal incidence", prt_fresnel_transmittance(1.5, 1), 0.96, 1e-12);
    double brewster = atan(1.5), ts = cos(brewster), tt = sqrt(1 - (1 - ts * ts) / 2.25);
    double rs = (ts - 1.5 * tt) / (ts + 1.5 * tt);
    expect_close("F_t at Brewster's angle", prt_fresnel_transmittance(1.5, ts), 1 - rs * rs / 2,
                 1e-12);
    expect_near("F_t along the surface", prt_fresnel_transmittance(1.5, 0), 0, 0);
    expect_near("F_t from below", prt_fresnel_transmittance(1.5, -0.5), 0, 0);
    expect_near("F_dr at 1, where 0 is exact", prt_fresnel_dr(1), 0, 0.0017);
    expect_close("F_dr", prt_fresnel_dr(1.3), -1.44 / 1.69 + 0.71 / 1.3 + 0.668 + 0.0636 * 1.3,
                 1e-14);
}

/* Law: a refracted direction keeps its length and obeys Snell's law (METHODS §1, boundary). */
static void test_refraction(void **state)
{
    struct prt_rng rng;
    prt_rng_init(&rng, 7, 0);
    for (int k = 0; k < 2000; k++) {
        double v[2][3];
        for (int i = 0; i < 2; i++) {
            double z = 2 * prt_rng_f32(&rng) - 1.0, phi = 2 * M_PI * prt_rng_f32(&rng);
            double s = sqrt(1 - z * z);
            v[i][0] = s * cos(phi), v[i][1] = s * sin(phi), v[i][2] = z;
        }
        double c = v[0][0] * v[1][0] + v[0][1] * v[1][1] + v[0][2] * v[1][2];
        double eta = 1 + 0.7 * prt_rng_f32(&rng), flip = c < 0 ? -1 : 1;
        float n[3], w[3], t[3];
        for (int i = 0; i < 3; i++) n[i] = (float)v[0][i], w[i] = (float)(flip * v[1][i]);
        prt_refract_in(eta, n, w, t);
        double nt = 0, tt = 0, cross_w[3], cross_t[3];
        for (int i = 0; i < 3; i++) {
            int a = (i + 1) % 3, b = (i + 2) % 3;
            nt += (double)n[i] * t[i], tt += (double)t[i] * t[i];
            cross_w[i] = (double)n[a] * w[b] - (double)n[b] * w[a];
            cross_t[i] = (double)n[a] * t[b] - (double)n[b] * t[a];
        }
        expect_close("squared length", tt, 1, 1e-6);
        expect_below("cosine to the normal", nt, 0);
        /* Snell, in the plane of incidence: n x w = -eta n x t */
        for (int i = 0; i < 3; i++) expect_near("n x w", cross_w[i], -eta * cross_t[i], 1e-6);
    }
}

/* ---- phase ---- */

static const double gauss_x[8] = {-0.9602898564975363, -0.7966664774136267, -0.5255324099163290,
                                  -0.1834346424956498, 0.1834346424956498,  0.5255324099163290,
                                  0.7966664774136267,  0.9602898564975363};
static const double gauss_w[8] = {0.1012285362903763, 0.2223810344533745, 0.3137066458778873,
                                  0.3626837833783620, 0.3626837833783620, 0.3137066458778873,
                                  0.2223810344533745, 0.1012285362903763};

/* The integral over the sphere of f(cosine), 200 panels of eight Gauss points. */
static double sphere_integral(double (*f)(double c, const void *arg), const void *arg)
{
    double sum = 0;
    for (int i = 0; i < 200; i++)
        for (int k = 0; k < 8; k++) {
            double c = -1 + (2 * i + 1 + gauss_x[k]) / 200;
            sum += 2 * M_PI * gauss_w[k] / 200 * f(c, arg);
        }
    return sum;
}

struct phase_pair {
    const struct prt_phase *phase;
    double g;
};
static double f_phase(double c, const void *arg)
{
    return prt_phase_eval(((const struct phase_pair *)arg)->phase, c);
}
static double f_phase_cos(double c, const void *arg)
{
    return -c * f_phase(c, arg); /* the scattering cosine is minus the outward one */
}
static double f_hg(double c, const void *arg)
{
    return prt_hg_eval(((const struct phase_pair *)arg)->g, c);
}
static double f_hg_cos(double c, const void *arg)
{
    return c * f_hg(c, arg);
}
static double f_hg2(double c, const void *arg)
{
    return f_hg(c, arg) * f_hg(c, arg);
}
static double f_error2(double c, const void *arg)
{
    double e = f_hg(-c, arg) - f_phase(c, arg);
    return e * e;
}

/* Law: a phase function integrates to 1 and its mean cosine is g (METHODS §3.7, HG41). */
static void test_phase_moments(void **state)
{
    static const double gs[] = {-0.9, -0.4, 0, 0.25, 0.6, 0.9};
    static const unsigned terms[] = {1, 4, 9, 16};
    for (size_t i = 0; i < 6; i++)
        for (size_t k = 0; k < 4; k++) {
            struct prt_phase phase;
            assert_int_equal(prt_phase_hg(&phase, gs[i], terms[k]), PRT_OK);
            struct phase_pair pair = {&phase, gs[i]};
            expect_close("integral of p", sphere_integral(f_phase, &pair), 1, 1e-9);
            expect_close("integral of HG", sphere_integral(f_hg, &pair), 1, 1e-8);
            expect_near("mean cosine of HG", sphere_integral(f_hg_cos, &pair), gs[i], 1e-8);
            expect_near("mean cosine of p", sphere_integral(f_phase_cos, &pair), k ? gs[i] : 0,
                        1e-8);
        }
    struct prt_phase phase;
    assert_int_equal(prt_phase_hg(&phase, 0.5, 5), PRT_ARG);
    assert_int_equal(prt_phase_hg(&phase, 1, 4), PRT_ARG);
    assert_int_equal(prt_phase_hg(&phase, NAN, 4), PRT_ARG);
}

/* Law: relative RMS error of Henyey-Greenstein cut after l = 1, 2, 3 (METHODS §3.7). */
static void test_phase_truncation(void **state)
{
    static const double row[][4] = {{0.25, 0.1330, 0.0392, 0.0111},
                                    {0.4, 0.3158, 0.1480, 0.0667},
                                    {-0.4, 0.3158, 0.1480, 0.0667},
                                    {0.6, 0.6112, 0.4224, 0.2829}};
    for (size_t i = 0; i < 4; i++)
        for (unsigned l = 1; l <= 3; l++) {
            struct prt_phase phase;
            prt_phase_hg(&phase, row[i][0], (l + 1) * (l + 1));
            struct phase_pair pair = {&phase, row[i][0]};
            double e = sqrt(sphere_integral(f_error2, &pair) / sphere_integral(f_hg2, &pair));
            expect_near("relative RMS error of the cut series", e, row[i][l], 6e-5);
        }
}

static void directions(unsigned n_phi, float (*dir)[3], double *weight)
{
    for (unsigned k = 0; k < 8; k++)
        for (unsigned j = 0; j < n_phi; j++) {
            double phi = 2 * M_PI * (j + 0.3) / n_phi, s = sqrt(1 - gauss_x[k] * gauss_x[k]);
            float *d = dir[k * n_phi + j];
            d[0] = (float)(s * cos(phi)), d[1] = (float)(s * sin(phi)),
            d[2] = (float)gauss_x[k];
            weight[k * n_phi + j] = gauss_w[k] * 2 * M_PI / n_phi;
        }
}

/* Law: Y_lm are orthonormal and add up to Legendre series (METHODS §3.7, addition theorem). */
static void test_spherical_harmonics(void **state)
{
    enum { N_PHI = 16, N = 8 * N_PHI };
    static float dir[N][3], y[N][16];
    static double weight[N];
    directions(N_PHI, dir, weight);
    for (int i = 0; i < N; i++) prt_sh_eval(4, dir[i], y[i]);
    for (int a = 0; a < 16; a++) /* orthonormal: the rule is exact to degree 15 */
        for (int b = 0; b < 16; b++) {
            double sum = 0;
            for (int i = 0; i < N; i++) sum += weight[i] * y[i][a] * y[i][b];
            expect_near("product of two harmonics", sum, a == b, 2e-6);
        }
    struct prt_phase phase; /* the addition theorem */
    prt_phase_hg(&phase, 0.7, 16);
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j += 5) {
            double c = 0, sum = 0;
            for (int k = 0; k < 3; k++) c += (double)dir[i][k] * dir[j][k];
            for (int l = 0; l < 4; l++)
                for (int m = l * l; m < (l + 1) * (l + 1); m++)
                    sum += phase.a[l] * y[i][m] * y[j][m];
            expect_near("addition theorem", sum, prt_phase_eval(&phase, c), 1e-6);
        }
}

/* Law: the singular values of p over pairs of directions are |a_l|, each 2l+1 times (W05 eq 9).
 */
static void test_phase_svd(void **state)
{
    enum { N_PHI = 16, N = 8 * N_PHI };
    static float dir[N][3];
    static double weight[N], m[N * N], value[N], superb[N];
    struct prt_phase phase;
    prt_phase_hg(&phase, -0.6, 16);
    directions(N_PHI, dir, weight);
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) {
            double c = 0;
            for (int k = 0; k < 3; k++) c += (double)dir[i][k] * dir[j][k];
            m[i * N + j] = sqrt(weight[i] * weight[j]) * prt_phase_eval(&phase, c);
        }
    assert_int_equal(
        LAPACKE_dgesvd(LAPACK_ROW_MAJOR, 'N', 'N', N, N, m, N, value, NULL, 1, NULL, 1, superb),
        0);
    for (int l = 0; l < 4; l++)
        for (int k = l * l; k < (l + 1) * (l + 1); k++)
            expect_near("singular value", value[k], pow(0.6, l), 1e-6);
    expect_below("singular value beyond the series", value[16], 1e-6);
}

/* ---- materials ---- */

struct capture {
    char line[1024];
};
static void capture_log(void *user, enum prt_log_level level, const char *line)
{
    snprintf(((struct capture *)user)->line, sizeof((struct capture *)user)->line, "%s", line);
}

static int load(struct capture *capture, const char *text, struct prt_material *m)
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = capture_log;
    ctx.log_user = capture;
    capture->line[0] = 0;
    return prt_material_load(&ctx, text, m);
}

/* Contract of prt_material_load: a preset by name, and printing loses nothing (JMLH01 fig. 5).
 */
static void test_material_presets(void **state)
{
    static const char *const names[] = {"apple",   "chicken1", "chicken2",   "cream",
                                        "ketchup", "marble",   "potato",     "skimmilk",
                                        "skin1",   "skin2",    "spectralon", "wholemilk"};
    struct capture capture;
    struct prt_material m;
    for (unsigned i = 0; i < 12; i++) {
        const struct prt_material *p = prt_material_preset(i);
        assert_string_equal(p->name, names[i]);
        assert_int_equal(prt_material_check(NULL, p), PRT_OK);
        assert_int_equal(load(&capture, names[i], &m), PRT_OK);
        assert_memory_equal(&m, p, sizeof m);
        expect_close("eta", p->eta, i == 5 ? 1.5 : 1.3, 1e-6);
        char text[512];
        assert_true(prt_material_print(p, text, sizeof text) < 512);
        memset(&m, 0, sizeof m);
        assert_int_equal(load(&capture, text, &m), PRT_OK); /* printing loses nothing */
        assert_memory_equal(&m, p, sizeof m);
    }
    assert_null(prt_material_preset(12));
    assert_int_equal(load(&capture, "SkinMilk", &m), PRT_ARG);
    assert_non_null(strstr(capture.line, "skimmilk"));
    assert_int_equal(load(&capture, "SkimMilk", &m), PRT_OK);
}

/* Law: the presets and their rho_d are the published measurements (JMLH01 fig. 5, METHODS §1).
 */
static void test_material_table(void **state)
{
    static const char path[] = PRT_SHARED_DATA "/materials/jensen2001.csv";
    want_data(path);
    FILE *file = fopen(path, "r");
    assert_non_null(file);
    char line[512], name[32];
    assert_non_null(fgets(line, sizeof line, file));
    unsigned n = 0;
    double v[13];
    while (fgets(line, sizeof line, file)) {
        assert_int_equal(sscanf(line,
                                "%31[^,],%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf",
                                name, v, v + 1, v + 2, v + 3, v + 4, v + 5, v + 6, v + 7, v + 8,
                                v + 9, v + 10, v + 11, v + 12),
                         14);
        const struct prt_material *p = prt_material_preset(n++);
        assert_string_equal(p->name, name);
        for (int c = 0; c < 3; c++) {
            struct prt_diffusion d;
            expect_close("sigma_s'", p->sigma_s_prime[c], v[c], 1e-6);
            expect_near("sigma_a", p->sigma_a[c], v[3 + c], 1e-7);
            prt_diffusion_init(&d, v[c], v[3 + c], v[9]);
            expect_near("rho_d", d.rho_d, v[10 + c], 6e-5);
        }
    }
    fclose(file);
    assert_int_equal(n, 12);
}

/* Contract of prt_material_load: every fault is refused by name, range and unit. */
static void test_material_faults(void **state)
{
#define SA "\"sigma_a\":[0,0.1,1]"
#define SS "\"sigma_s_prime\":[1,2,3]"
    static const struct {
        const char *json;
        int status;
        const char *says;
    } fault[] = {
        {"{" SS "," SA ",\"sigma_t\":1}", PRT_FORMAT,
         "unknown key \"sigma_t\"; allowed: name, "},
        {"{" SA "}", PRT_FORMAT, "\"sigma_s_prime\" is missing"},
        {"{" SS "}", PRT_FORMAT, "\"sigma_a\" is missing"},
        {"{" SS "," SS "," SA "}", PRT_FORMAT, "twice"},
        {"{\"sigma_s_prime\":[1,2]," SA "}", PRT_FORMAT, "three numbers"},
        {"{\"sigma_s_prime\":[1,2,\"3\"]," SA "}", PRT_FORMAT, "three numbers"},
        {"{\"sigma_s_prime\":2," SA "}", PRT_FORMAT, "must be three numbers"},
        {"{\"sigma_s_prime\":[1,-2,3]," SA "}", PRT_ARG,
         "sigma_s_prime[1] is -2, allowed range 1e-05 to 1000 mm^-1"},
        {"{\"sigma_s_prime\":[1,2,0]," SA "}", PRT_ARG, "sigma_s_prime[2] is 0"},
        {"{\"sigma_s_prime\":[1,2,1e999]," SA "}", PRT_ARG, "is inf"},
        {"{\"sigma_s_prime\":[NaN,2,3]," SA "}", PRT_FORMAT, "not valid JSON"},
        {"{" SS ",\"sigma_a\":[0,0,-1e-9]}", PRT_ARG, "sigma_a[2]"},
        {"{" SS ",\"sigma_a\":[1e39,0,0]}", PRT_ARG, "is 1e+39, allowed range 0 to 1000 mm^-1"},
        {"{" SS "," SA ",\"g\":1}", PRT_ARG, "g[0] is 1, allowed range -0.95 to 0.95"},
        {"{" SS "," SA ",\"g\":[0,0,-2]}", PRT_ARG, "g[2] is -2"},
        {"{\"sigma_s_prime\":[1,1,900]," SA ",\"g\":0.9}", PRT_ARG, "extinction"},
        {"{" SS "," SA ",\"eta\":0.9}", PRT_ARG, "eta is 0.9, allowed range 1 to 3"},
        {"{" SS "," SA ",\"eta\":\"1.3\"}", PRT_FORMAT, "\"eta\" must be a number"},
        {"{" SS "," SA ",\"roughness\":0}", PRT_ARG, "roughness is 0"},
        {"{" SS "," SA ",\"name\":\"a name that is far too long to keep\"}", PRT_FORMAT, "31"},
        {"{" SS "," SA "} x", PRT_FORMAT, "follow"},
        {"{" SS "," SA, PRT_FORMAT, "not valid JSON"},
        {"{}", PRT_FORMAT, "missing"},
    };
    struct capture capture;
    struct prt_material m, before;
    memset(&m, 0x5a, sizeof m);
    before = m;
    for (size_t i = 0; i < sizeof fault / sizeof fault[0]; i++) {
        int status = load(&capture, fault[i].json, &m);
        if (status != fault[i].status || !strstr(capture.line, fault[i].says))
            fail_msg("%s: status %d, said \"%s\"", fault[i].json, status, capture.line);
        assert_memory_equal(&m, &before, sizeof m);
    }
    struct prt_material bad = *prt_material_preset(0);
    bad.sigma_a[1] = NAN;
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = capture_log;
    ctx.log_user = &capture;
    assert_int_equal(prt_material_check(&ctx, &bad), PRT_ARG);
    assert_non_null(strstr(capture.line, "apple: sigma_a[1] is "));
    /* files: found, too large */
    char path[] = "/tmp/prt-material-XXXXXX";
    int fd = mkstemp(path);
    assert_true(fd >= 0);
    const char *json =
        "  {" SS "," SA ",\"g\":[0.1,0.2,0.3],\"eta\":1.4,\"name\":\"a\\\"b\"}\n";
    assert_int_equal(write(fd, json, strlen(json)), (ssize_t)strlen(json));
    assert_int_equal(load(&capture, path, &m), PRT_OK);
    expect_close("g", m.g[2], 0.3, 1e-6);
    assert_string_equal(m.name, "a\"b");
    assert_int_equal(ftruncate(fd, 1 << 20), 0);
    assert_true(load(&capture, path, &m) < 0);
    close(fd);
    unlink(path);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_dipole_values),
        cmocka_unit_test(test_dipole_integral),
        cmocka_unit_test(test_dipole_slab),
        cmocka_unit_test(test_dipole_array),
        cmocka_unit_test(test_fresnel),
        cmocka_unit_test(test_refraction),
        cmocka_unit_test(test_phase_moments),
        cmocka_unit_test(test_phase_truncation),
        cmocka_unit_test(test_spherical_harmonics),
        cmocka_unit_test(test_phase_svd),
        cmocka_unit_test(test_material_presets),
        cmocka_unit_test(test_material_table),
        cmocka_unit_test(test_material_faults),
    };
    return run_physics_tests(tests, NULL, NULL);
}
