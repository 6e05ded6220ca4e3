// SPDX-License-Identifier: MIT
// screen/: M03's radii and filter.
#include "screen_stage.h"

// Law: M03's radii have density 2 pi r R_d / rho_d, the mean over channels (METHODS §6, M03 eq
// 6).
static void tangent_radii_follow_rd(void **state)
{
    struct prt_diffusion d[3];
    for (int c = 0; c < 3; c++)
        prt_diffusion_init(&d[c], marble.sigma_s_prime[c], 0.01 + 0.03 * c, marble.eta);
    enum { BINS = 40, DRAWS = 40000 };
    double want[BINS], edge[BINS + 1];
    uint32_t got[BINS] = {0};
    for (int i = 0; i <= BINS; i++) edge[i] = i ? 0.03 * pow(2000, (double)i / BINS) : 0;
    for (int i = 0; i < BINS; i++) {
        want[i] = 0;
        for (int c = 0; c < 3; c++) {
            double in = prt_diffusion_tail(&d[c], edge[i]);
            double out = i + 1 < BINS ? prt_diffusion_tail(&d[c], edge[i + 1]) : 0;
            want[i] += DRAWS * (in - out) / d[c].rho_d / 3;
        }
    }
    struct prt_rng rng;
    prt_rng_init(&rng, 5, 0);
    for (int i = 0; i < DRAWS; i++) {
        double r = prt_screen_tangent_radius(d, (double)prt_rng_f32(&rng), 0);
        int k = 0;
        while (k + 1 < BINS && r >= edge[k + 1]) k++;
        got[k]++;
    }
    expect_chi_square("chi-square of the radii", want, got, BINS);
    // and the tails are those of the density itself: integrate it
    for (int c = 0; c < 3; c++) {
        double sum = 0;
        for (int i = 0; i < 20000; i++) {
            double r = (i + 0.5) * 1e-3;
            sum += 2 * M_PI * r * prt_diffusion_rd(&d[c], r) * 1e-3;
        }
        expect_close("integral of R_d and its tail", sum + prt_diffusion_tail(&d[c], 20),
                     d[c].rho_d, 1e-4);
    }
}

// Mean squared difference of pixels side by side, over that of their radiance.
static double roughness(const struct stage *s, pixels rgb)
{
    double change = 0, sum = 0;
    for (uint32_t i = 1; i < s->g.n_point; i++) {
        if (s->g.pixel[i] != s->g.pixel[i - 1] + 1) continue;
        for (int c = 0; c < 3; c++) {
            const double d = (double)rgb[i][c] - (double)rgb[i - 1][c];
            change += d * d;
            sum += (double)rgb[i][c] * (double)rgb[i][c];
        }
    }
    return change / sum;
}

// Law: the result is filtered over 5x5 pixels while a pixel has under 256 samples, 3x3 under
// 1024 (METHODS §6): one sample more, and neighbours differ more.
static void filtered_by_the_number_of_samples(void **state)
{
    struct model m;
    struct stage s;
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 24};
    static const uint32_t count[] = {255, 256, 1023, 1024};
    double rough[4];
    model_init(&m, 400, 800);
    add_box(&m, (float[3]){0, 0, 0}, (float[3]){9, 9, 2}, 6);
    stage_init(&s, &m, camera, 64, 64);
    for (int i = 0; i < 4; i++) {
        struct prt_screen_options options = {.engine = PRT_SCREEN_TANGENT,
                                             .n_sample = count[i]};
        struct prt_screen_report report;
        pixels rgb = render(&s, &marble, NULL, &from_front, options, &report);
        assert_int_equal(report.n_asked, count[i]);
        rough[i] = roughness(&s, rgb);
        free(rgb);
    }
    print_message("roughness %.3g %.3g, %.3g %.3g\n", rough[0], rough[1], rough[2], rough[3]);
    expect_above("roughness of 256 samples over that of 255", rough[1] / rough[0], 1.2);
    expect_above("roughness of 1024 samples over that of 1023", rough[3] / rough[2], 1.2);
    stage_finish(&s);
    model_finish(&m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(tangent_radii_follow_rd),
        cmocka_unit_test(filtered_by_the_number_of_samples),
    };
    return run_physics_tests(tests, screen_setup, screen_teardown);
}
