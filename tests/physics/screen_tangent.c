// SPDX-License-Identifier: MIT
// screen/: M03's radii.
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

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(tangent_radii_follow_rd),
    };
    return run_physics_tests(tests, screen_setup, screen_teardown);
}
