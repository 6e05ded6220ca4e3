// SPDX-License-Identifier: MIT
// screen/: S09's splat radius; a light's view.
#include "screen_stage.h"

// Law (S09 eq 4, with the closed form of METHODS §1): the share of light beyond r_max is
// epsilon, tail(r_max) = epsilon rho_d, for the channel that reaches furthest and less for the
// others.
static void radius_leaves_epsilon_outside(void **state)
{
    struct model model;
    model_init(&model, 2000, 4000);
    add_sphere(&model, (float[3]){0, 0, 0}, 10, 12);
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct stage s;
    stage_init(&s, &model, camera, 12, 12);
    struct prt_material medium = marble;
    for (int c = 0; c < 3; c++) medium.sigma_a[c] = 0.1f * (float)(c + 1);
    static const float epsilon[4] = {0, 0.002f, 0.02f, 0.3f}; // 0: the default, 0.002
    for (int k = 0; k < 4; k++) {
        struct prt_screen_options options = {
            .engine = PRT_SCREEN_SPLAT, .n_sample = 32, .epsilon = epsilon[k]};
        struct prt_screen_report report;
        free(render(&s, &medium, NULL, &from_front, options, &report));
        double most = 0, share = k ? (double)epsilon[k] : 0.002;
        for (int c = 0; c < 3; c++) {
            struct prt_diffusion d;
            prt_diffusion_init(&d, medium.sigma_s_prime[c], medium.sigma_a[c], medium.eta);
            most = fmax(most, prt_diffusion_tail(&d, report.r_max_mm) / d.rho_d);
        }
        expect_near(expect_name("epsilon %.3f: share beyond r_max", share), most, share,
                    1e-4 * share);
    }
    stage_finish(&s);
    model_finish(&model);
}

// Law: with a split of 1 the irradiance of a surface whose base colour has the luminance a is a
// E (METHODS §10), in every engine, those that take it from a light's view included.
static void base_colours_scale_irradiance(void **state)
{
    struct model model;
    model_init(&model, 2000, 4000);
    add_sphere(&model, (float[3]){0, 0, 0}, 10, 12);
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct stage s;
    stage_init(&s, &model, camera, 24, 24);
    float(*color)[4] = calloc(model.mesh.n_vertex, sizeof *color);
    for (uint32_t v = 0; v < model.mesh.n_vertex; v++)
        for (int c = 0; c < 4; c++) color[v][c] = 0.6f;
    const double a = 0.6 * (double)model.surface[0].base_color[0];
    for (int e = 0; e <= PRT_SCREEN_REFERENCE + 1; e++) {
        const bool rings = e > PRT_SCREEN_REFERENCE; // of HYBRID
        struct prt_screen_options options = {.engine = rings ? PRT_SCREEN_HYBRID
                                                             : (enum prt_screen_engine)e,
                                             .n_sample = e == PRT_SCREEN_REFERENCE ? 4000 : 100,
                                             .rings = rings ? 8 : 0,
                                             .spokes = rings ? 8 : 0};
        pixels plain = render(&s, &marble, NULL, &from_front, options, NULL);
        model.mesh.color = color;
        model.mesh.texture_split = 1;
        pixels tinted = render(&s, &marble, NULL, &from_front, options, NULL);
        model.mesh.color = NULL;
        model.mesh.texture_split = 0;
        double sum[2] = {0, 0};
        for (uint32_t i = 0; i < s.g.n_point; i++)
            sum[0] += (double)plain[i][1], sum[1] += (double)tinted[i][1];
        // with maps or colours the pattern gives way to all points of the view
        expect_near(expect_name("%s%s: light over that of white", rings ? "rings, " : "",
                                prt_screen_engine_name(options.engine)),
                    sum[1] / sum[0] / a, 1, rings ? 4e-4 : 2e-7);
        free(plain);
        free(tinted);
    }
    free(color);
    stage_finish(&s);
    model_finish(&model);
}

// Law: a translucent sheet is dark where an opaque roof over it blocks a distant lamp, however
// far the roof is from the sheet (METHODS §6): the lamp's rays start outside all surface.
static void a_roof_casts_its_shadow(void **state)
{
    struct model m;
    struct stage s;
    struct prt_material dense = marble;
    const struct prt_camera aside = {.eye = {40, 0, 40}, .up = {0, 1, 0}, .fovy_deg = 30};
    for (int c = 0; c < 3; c++) dense.sigma_s_prime[c] = 3, dense.sigma_a[c] = 1;
    model_init(&m, 400, 800);
    struct prt_block *b = begin_block(&m, true);
    add_sheet(&m, (float[3]){0, 0, 0}, (float[3]){15, 0, 0}, (float[3]){0, 15, 0}, 10);
    end_block(&m, b);
    b = begin_block(&m, false);
    add_sheet(&m, (float[3]){0, 0, 10}, (float[3]){4, 0, 0}, (float[3]){0, 4, 0}, 2);
    end_block(&m, b);
    stage_init(&s, &m, aside, 64, 64);
    for (int e = 0; e <= PRT_SCREEN_REFERENCE; e++) {
        const struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                                   .n_sample =
                                                       e == PRT_SCREEN_REFERENCE ? 20000 : 0};
        pixels rgb = render(&s, &dense, NULL, &from_front, options, NULL);
        double sum[2] = {0, 0};
        unsigned n[2] = {0, 0};
        for (uint32_t i = 0; i < s.g.n_point; i++) {
            const float x = fabsf(s.g.position[0][i]), y = fabsf(s.g.position[1][i]);
            const bool under = x < 2 && y < 2;
            if (s.g.opaque[i] || (!under && x < 6 && y < 6) || x > 12 || y > 12) continue;
            sum[under] += (double)rgb[i][1];
            n[under]++;
        }
        assert_true(n[0] > 100 && n[1] > 10);
        expect_below(expect_name("%s: light under a roof",
                                 prt_screen_engine_name((enum prt_screen_engine)e)),
                     sum[1] / n[1] / (sum[0] / n[0]), 9e-4);
        free(rgb);
    }
    stage_finish(&s);
    model_finish(&m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_roof_casts_its_shadow),
        cmocka_unit_test(radius_leaves_epsilon_outside),
        cmocka_unit_test(base_colours_scale_irradiance),
    };
    return run_physics_tests(tests, screen_setup, screen_teardown);
}
