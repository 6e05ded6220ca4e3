// SPDX-License-Identifier: MIT
// screen/: frames of a view: kernels, receivers, budgets, expected errors, running means.
#include "screen_stage.h"

// Law: the table is R_d, and every instruction set gives the C kernel's sums (METHODS §6,
// common parts).
static void pair_kernels_agree(void **state)
{
    struct prt_diffusion d[3];
    for (int c = 0; c < 3; c++) prt_diffusion_init(&d[c], 1 + c, 0.01, 1.3);
    struct radial_table t;
    prt_radial_table_fit(&t, prt_dipole_profile, d, d[2].z_r, 60);
    struct prt_rng rng;
    prt_rng_init(&rng, 2, 0);
    // the table: R_d where it matters
    for (int i = 0; i < 1000; i++) {
        double r = 0.01 * pow(2000, i / 1000.0), exact[3];
        float got[3];
        prt_dipole_profile(d, r, exact);
        prt_radial_table_eval(&t, (float)(r * r), got);
        for (int c = 0; c < 3; c++)
            expect_near("R_d from the table", got[c], exact[c],
                        0.02 * exact[c] + 1e-6 * d[c].rho_d);
    }
    struct emitters e = {0};
    assert_true(prt_emitters_reserve(&e, 3000));
    for (int i = 0; i < 2777; i++) {
        float p[3], w[3];
        for (int k = 0; k < 3; k++) {
            p[k] = 40 * prt_rng_f32(&rng);
            w[k] = prt_rng_f32(&rng);
        }
        emitters_push(&e, p, w);
    }
    struct {
        float p[3][64], sum[3][64];
    } __attribute__((aligned(64))) block;
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < 64; i++) block.p[k][i] = 40 * prt_rng_f32(&rng);
    const float *const p[3] = {block.p[0], block.p[1], block.p[2]};
    float *const sum[3] = {block.sum[0], block.sum[1], block.sum[2]};
    float first[3][64];
    static const char *const word[] = {"c", "avx2", "avx512"};
    for (int k = 0; k < 3; k++) {
        unsigned mask;
        assert_int_equal(prt_cpu_parse(word[k], &mask), PRT_OK);
        pair_fn run = prt_pair_kernel(mask & prt_cpu_detect());
        memset(block.sum, 0, sizeof block.sum);
        run(&t, &e, 3, 2771, 48, p, sum);
        if (!k) memcpy(first, block.sum, sizeof first);
        for (int c = 0; c < 3; c++) {
            for (int i = 0; i < 48; i++)
                expect_close(expect_name("sum, %s", word[k]), block.sum[c][i], first[c][i],
                             2e-4);
            for (int i = 48; i < 64; i++) assert_true(block.sum[c][i] == 0);
        }
        double t0 = prt_time_s();
        for (int r = 0; r < 20; r++) run(&t, &e, 0, 2777, 64, p, sum);
        print_message("pairs, %s: %.2f G/s\n", word[k],
                      20 * 2777 * 64 / (prt_time_s() - t0) / 1e9);
    }
    prt_emitters_finish(&e);
}

// Law: a pixel's weights over receivers add up to 1 and rebuild its position from receivers of
// its own object (METHODS §6, receivers).
static void receivers_stand_for_their_patch(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_box(&model, (float[3]){-6, 0, 0}, (float[3]){5, 6, 4}, 8);
    add_box(&model, (float[3]){-13, 0, 0}, (float[3]){2, 6, 4}, 8); // its faces go on
    add_sphere(&model, (float[3]){6, 0, 5}, 6, 24);
    struct prt_camera camera = {.eye = {10, 20, 60}, .up = {0, 1, 0}, .fovy_deg = 28};
    struct stage s;
    stage_init(&s, &model, camera, 128, 128);
    struct prt_screen_options options = {.engine = PRT_SCREEN_SPLAT};
    struct frame f = {.ctx = &quiet,
                      .screen = s.screen,
                      .vis = s.vis,
                      .options = &options,
                      .width = 128,
                      .height = 128,
                      .g = s.g,
                      .view_key = 77};
    uint32_t before = UINT32_MAX;
    for (uint32_t size = 1; size <= 4; size *= 2) {
        const struct view_cache *v, *again;
        assert_int_equal(prt_view_get(&f, size, &v), PRT_OK);
        assert_int_equal(prt_view_get(&f, size, &again), PRT_OK);
        assert_true(v == again && v->n_receiver < before && v->n_receiver <= s.g.n_point);
        before = v->n_receiver;
        uint32_t *object = malloc((v->n_column + 1) * sizeof *object);
        for (uint32_t t = 0; t < v->n_tile; t++)
            for (uint32_t i = v->begin[t]; i < v->begin[t + 1]; i++) object[i] = v->object[t];
        double worst = 0, mean = 0;
        for (uint32_t i = 0; i < s.g.n_point; i++) {
            float sum = 0, p[3] = {0, 0, 0}, d = 0;
            for (int k = 0; k < 4; k++) {
                uint32_t at = v->from[i][k];
                assert_true(at < v->n_column);
                assert_true(v->weight[i][k] == 0 ||
                            object[at] == model.block[s.g.block[i]].object);
                sum += v->weight[i][k];
                for (int j = 0; j < 3; j++) p[j] += v->weight[i][k] * v->p[j][at];
            }
            expect_near("sum of weights", sum, 1, 1e-5);
            for (int j = 0; j < 3; j++) d += powf(p[j] - s.g.position[j][i], 2);
            worst = fmax(worst, sqrt((double)d));
            mean += sqrt((double)d) / s.g.n_point;
        }
        // a pixel is 0.25 mm wide here
        expect_below(expect_name("receivers of %u pixels: distance [mm]", size), worst,
                     size == 1 ? 1e-5 : 0.9 * size);
        expect_below(expect_name("receivers of %u pixels: mean distance [mm]", size), mean,
                     size == 1 ? 1e-7 : 0.07 * size);
        free(object);
    }
    stage_finish(&s);
    model_finish(&model);
}

// Each further light costs shadow rays: in the same time a picture has fewer samples, or takes
// longer.
static void lights_cost_time(const struct stage *s, const struct prt_screen_input *input)
{
    struct prt_screen_light lights[8];
    for (int i = 0; i < 8; i++) lights[i] = from_front;
    for (int e = 0; e < 4; e++) {
        struct prt_screen_plan plan[2];
        for (int many = 0; many < 2; many++) {
            struct prt_screen_input in = *input;
            in.n_extra = many ? 8 : 1, in.extra = lights;
            assert_int_equal(prt_screen_plan(&quiet, s->screen, &in, (enum prt_screen_engine)e,
                                             50, NULL, &plan[many]),
                             PRT_OK);
        }
        assert_true(plan[1].n_sample < plan[0].n_sample ||
                    (plan[1].n_sample == plan[0].n_sample &&
                     plan[1].expected_ms > plan[0].expected_ms));
    }
}

// Law: more time gives more samples and less expected error (METHODS §6, expected error).
static void budgets_buy_samples(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 10, 24);
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct stage s;
    stage_init(&s, &model, camera, 100, 100);
    struct prt_screen_input input = {
        .visibility = s.vis, .media = {1, &marble, NULL}, .n_extra = 1, .extra = &from_front};
    for (int e = 0; e < 4; e++) {
        struct prt_screen_plan plan, before = {0};
        for (double ms = 2; ms < 500; ms *= 2) {
            struct prt_screen_options options = {0};
            assert_int_equal(prt_screen_plan(&quiet, s.screen, &input,
                                             (enum prt_screen_engine)e, ms, &options, &plan),
                             PRT_OK);
            assert_true(options.n_sample == plan.n_sample && (int)options.engine == e);
            assert_true(plan.expected_error > 0 && plan.expected_error <= 1);
            assert_true(plan.n_sample >= before.n_sample);
            assert_true(!before.n_sample || plan.expected_error <= before.expected_error);
            before = plan;
        }
        assert_true(before.n_sample > 200);
        // the options' own budget means the same
        struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                             .budget_ms = 20};
        struct prt_screen_report report;
        free(render(&s, &marble, NULL, &from_front, options, &report));
        assert_true(report.n_asked >= 16 && report.expected_error > 0);
    }
    lights_cost_time(&s, &input);
    struct prt_screen_options options = {0};
    struct prt_screen_plan plan;
    assert_int_equal(prt_screen_choose(&quiet, s.screen, &input, 50, &options, &plan), PRT_OK);
    assert_true(options.n_sample == plan.n_sample && options.engine == plan.engine);
    assert_int_equal(
        prt_screen_plan(&quiet, s.screen, &input, PRT_SCREEN_REFERENCE, 50, &options, &plan),
        PRT_ARG);
    static const double bad[] = {0, -1, NAN, INFINITY};
    for (int i = 0; i < 4; i++)
        assert_int_equal(prt_screen_choose(&quiet, s.screen, &input, bad[i], &options, &plan),
                         PRT_ARG);
    stage_finish(&s);
    model_finish(&model);
}

// Contract of prt_screen_plan: its times are those of first pictures. Later frames of a running
// mean, which draw more points to finer receivers than their count says, leave them alone.
static void later_frames_change_no_plan(void **state)
{
    struct model model;
    model_init(&model, 2000, 4000);
    add_sphere(&model, (float[3]){0, 0, 0}, 10, 12);
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct stage s;
    stage_init(&s, &model, camera, 40, 40);
    const struct prt_screen_input input = {
        .visibility = s.vis, .media = {1, &marble, NULL}, .n_extra = 1, .extra = &from_front};
    for (int e = 0; e < PRT_SCREEN_REFERENCE; e++) {
        struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                             .n_sample = 200};
        struct prt_screen_plan first, later;
        free(render(&s, &marble, NULL, &from_front, options, NULL));
        assert_int_equal(
            prt_screen_plan(&quiet, s.screen, &input, options.engine, 20, NULL, &first),
            PRT_OK);
        for (options.frame = 24; options.frame < 28; options.frame++)
            free(render(&s, &marble, NULL, &from_front, options, NULL));
        assert_int_equal(
            prt_screen_plan(&quiet, s.screen, &input, options.engine, 20, NULL, &later),
            PRT_OK);
        assert_int_equal(later.n_sample, first.n_sample);
        assert_true(later.expected_ms == first.expected_ms);
    }
    stage_finish(&s);
    model_finish(&model);
}

// Law: the expected error is the measured one to a factor of 1.5 (METHODS §6, expected error):
// the first frame is compared, later ones are corrected by it.
static void errors_are_foreseen(void **state)
{
    static const float sigma[3][2] = {{0.7f, 0.0014f}, {2.19f, 0.0021f}, {7.38f, 0.0002f}};
    static const uint32_t count[4][2] = {{64, 128}, {64, 192}, {400, 1600}, {200, 900}};
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 6, 32);
    add_box(&model, (float[3]){4, 4, 6}, (float[3]){1, 2, 0.5f}, 4); // an edge, and its shadow
    struct prt_camera camera = {.eye = {0, 3, 30}, .up = {0, 1, 0}, .fovy_deg = 30};
    struct prt_screen_light light = {{0.5f, 0.4f, 0.8f}, {5, 5, 5}, false};
    struct prt_cube cube = constant_cube(16, (float[3]){0.2f, 0.2f, 0.2f});
    for (int i = 0; i < 12; i++) cube.texel[(4 * 256 + 40) * 3 + i] = 90; // a small lamp
    double worst = 0, mean = 0;
    int n = 0;
    for (int l = 0; l < 2; l++) {
        struct stage s;
        stage_init(&s, &model, camera, 56, 56);
        for (int m = 0; m < 3; m++) {
            struct prt_material medium = marble;
            for (int c = 0; c < 3; c++) {
                medium.sigma_s_prime[c] = sigma[m][0];
                medium.sigma_a[c] = sigma[m][1] * (float)(1 + c);
            }
            struct prt_screen_options exact = {.engine = PRT_SCREEN_REFERENCE,
                                               .n_sample = 60000};
            const struct prt_cube *sky = l ? &cube : NULL;
            const struct prt_screen_light *sun = l ? NULL : &light;
            pixels want = render(&s, &medium, sky, sun, exact, NULL);
            for (int e = 0; e < 4; e++) {
                for (int k = 0; k < 2; k++) {
                    struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                                         .n_sample = count[e][k]};
                    struct prt_screen_report report;
                    pixels b = render(&s, &medium, sky, sun, options, &report);
                    double error = relative(b, want, s.g.n_point);
                    double ratio = error / report.expected_error;
                    if (ratio > 1.2 || ratio < 0.25)
                        print_message("%s %u, medium %d, light %d: %.2f %%, foreseen %.2f %%\n",
                                      prt_screen_engine_name(options.engine), options.n_sample,
                                      m, l, 100 * error, 100 * report.expected_error);
                    worst = fmax(worst, ratio);
                    mean += log(ratio);
                    n++;
                    free(b);
                }
            }
            free(want);
        }
        stage_finish(&s);
    }
    expect_below("measured over expected error, worst", worst, 1.5);
    expect_near("measured over expected error, mean", exp(mean / n), 0.7, 0.3);
    prt_cube_finish(&cube);
    model_finish(&model);
}

// Law: the mean of frames converges to the sum over all texels (METHODS §6, running mean).
static void frames_average_to_the_reference(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 5, 32);
    struct prt_camera camera = {.eye = {0, 3, 30}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct prt_screen_light light = {{0.3f, 0.8f, 0.5f}, {3, 3, 3}, false};
    static const uint32_t count[4] = {48, 16, 400, 100};
    struct stage s;
    stage_init(&s, &model, camera, 64, 64);
    struct prt_screen_options exact = {.engine = PRT_SCREEN_REFERENCE, .n_sample = 80000};
    pixels want = render(&s, &marble, NULL, &light, exact, NULL);
    pixels mean = malloc((s.g.n_point + 1) * sizeof *mean);
    for (int e = 0; e < 4; e++) {
        double before = 0, after = 0, change = 0;
        for (uint32_t k = 0; k < 24; k++) {
            struct prt_screen_options options = {
                .engine = (enum prt_screen_engine)e, .n_sample = count[e], .frame = k};
            struct prt_screen_report report;
            pixels b = render(&s, &marble, NULL, &light, options, &report);
            assert_int_equal(report.frame, k);
            change = prt_screen_mean_add(k, s.g.n_point, (const float(*)[3])b, mean);
            after = relative(mean, want, s.g.n_point);
            if (!k) {
                before = after;
                assert_memory_equal(mean, b, s.g.n_point * sizeof *b);
                assert_float_equal(change, 0, 0);
            }
            free(b);
        }
        print_message("24 frames, %s: %.2f %%, then %.2f %%; the last changed %.2f %%\n",
                      prt_screen_engine_name((enum prt_screen_engine)e), 100 * before,
                      100 * after, 100 * change);
        // tangent's irradiance is no finer than these pixels, however many the samples
        expect_below(expect_name("%s: error of 24 frames",
                                 prt_screen_engine_name((enum prt_screen_engine)e)),
                     after, e == PRT_SCREEN_TANGENT ? 0.022 : 0.009);
        expect_below("error of 24 frames over that of one", after / before, 0.8);
        expect_above("change by the last frame", change, 0);
        expect_below("change by the last frame over the first error", change / before, 1);
    }
    free(mean);
    free(want);
    stage_finish(&s);
    model_finish(&model);
}

// Law: frame k weighs k + 1 (METHODS §6, running mean): of 1, 2, 3 the mean is (1 + 4 + 9) / 6.
static void later_frames_weigh_more(void **state)
{
    float mean[1][3], black[1][3] = {{0}};
    for (uint32_t k = 0; k < 3; k++) {
        float picture[1][3] = {{(float)(k + 1), 2 * (float)(k + 1), 0}};
        double before = k ? (double)mean[0][0] : 0;
        double change = prt_screen_mean_add(k, 1, (const float(*)[3])picture, mean);
        assert_float_equal(
            change, k ? fabs((double)mean[0][0] / before - 1) * before / (double)mean[0][0] : 0,
            1e-6);
    }
    assert_float_equal(mean[0][0], 14.0 / 6, 1e-6);
    assert_float_equal(mean[0][1], 28.0 / 6, 1e-6);
    assert_true(prt_screen_mean_add(0, 1, (const float(*)[3])black, mean) < 0);
}

// Contract of prt_screen_radiance: a frame's number and seed determine its picture.
static void frames_repeat(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 5, 24);
    struct prt_camera camera = {.eye = {0, 3, 30}, .up = {0, 1, 0}, .fovy_deg = 24};
    static const uint32_t count[4] = {48, 16, 400, 100};
    struct stage s;
    stage_init(&s, &model, camera, 48, 48);
    for (int e = 0; e < 4; e++) {
        struct prt_screen_options options = {
            .engine = (enum prt_screen_engine)e, .n_sample = count[e], .frame = 5, .seed = 3};
        pixels a = render(&s, &marble, NULL, &from_front, options, NULL);
        pixels b = render(&s, &marble, NULL, &from_front, options, NULL);
        assert_memory_equal(a, b, s.g.n_point * sizeof *a);
        options.frame = 6;
        pixels c = render(&s, &marble, NULL, &from_front, options, NULL);
        assert_memory_not_equal(a, c, s.g.n_point * sizeof *a);
        free(a);
        free(b);
        free(c);
    }
    stage_finish(&s);
    model_finish(&model);
}

// Contract of prt_screen_radiance: what a screen drew before, of another frame, seed, number of
// samples, light or medium, changes no later picture.
static void pictures_have_no_past(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 5, 24);
    struct prt_camera camera = {.eye = {0, 3, 30}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct prt_material other = marble;
    other.sigma_a[1] *= 30;
    struct prt_cube cube[2] = {constant_cube(8, (float[3]){1, 2, 3}),
                               constant_cube(8, (float[3]){1, 2, 3})};
    for (int k = 0; k < 40; k++) cube[0].texel[k] = cube[1].texel[900 + k] = 90;
    const struct look {
        uint32_t n_sample, frame;
        uint64_t seed;
        const struct prt_material *material;
        struct prt_cube *cube;
    } before[] = {{40, 0, 3, &marble, &cube[0]}, {40, 5, 0, &marble, &cube[0]},
                  {40, 5, 4, &marble, &cube[0]}, {90, 5, 3, &marble, &cube[0]},
                  {40, 5, 3, &other, &cube[0]},  {40, 5, 3, &marble, &cube[1]},
                  {40, 5, 3, &marble, &cube[0]}};
    enum { N_LOOK = sizeof before / sizeof *before };
    for (int e = 0; e <= PRT_SCREEN_REFERENCE; e++) {
        struct stage fresh, used;
        stage_init(&fresh, &model, camera, 40, 40);
        stage_init(&used, &model, camera, 40, 40);
        const size_t bytes = fresh.g.n_point * sizeof(float[3]);
        pixels want = NULL;
        for (int k = N_LOOK - 1; k >= -1; k--) {
            const struct look *l = &before[k < 0 ? N_LOOK - 1 : k];
            struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                                 .n_sample = l->n_sample * (e > 1 ? 10 : 1),
                                                 .frame = l->frame,
                                                 .seed = l->seed};
            if (!want) {
                want = render(&fresh, l->material, l->cube, NULL, options, NULL);
                continue;
            }
            pixels got = render(&used, l->material, l->cube, NULL, options, NULL);
            if (k < 0) assert_memory_equal(want, got, bytes);
            else if (e != PRT_SCREEN_REFERENCE) assert_memory_not_equal(want, got, bytes);
            free(got);
            const struct look *last = &before[N_LOOK - 1];
            options.n_sample = last->n_sample * (e > 1 ? 10 : 1);
            options.frame = last->frame;
            options.seed = last->seed;
            got = render(&used, last->material, last->cube, NULL, options, NULL);
            if (memcmp(want, got, bytes))
                fail_msg("%s: the picture depends on the one before, number %d",
                         prt_screen_engine_name(options.engine), k);
            free(got);
        }
        free(want);
        stage_finish(&fresh);
        stage_finish(&used);
    }
    prt_cube_finish(&cube[0]);
    prt_cube_finish(&cube[1]);
    model_finish(&model);
}

// Law: a light that turns by half a degree changes the picture as the sum over all texels does
// (S09, no flicker; METHODS §6): samples stay where they were as far as they can.
static void samples_stay_from_frame_to_frame(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 10, 32);
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct stage s;
    stage_init(&s, &model, camera, 48, 48);
    pixels exact[2] = {NULL, NULL};
    for (int e = PRT_SCREEN_REFERENCE; e >= 0; e--) {
        static const uint32_t count[] = {0, 64, 2500, 900, 60000};
        struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                             .n_sample = count[e]};
        pixels b[2];
        for (int k = 0; k < 2; k++) {
            double a = 0.4 + k * M_PI / 360;
            struct prt_screen_light light = {
                {(float)sin(a), 0, (float)cos(a)}, {5, 5, 5}, false};
            b[k] = render(&s, &marble, NULL, &light, options, NULL);
            if (e == PRT_SCREEN_REFERENCE) exact[k] = b[k];
        }
        double moved = 0, all = 0;
        for (uint32_t i = 0; i < s.g.n_point; i++) {
            double own = (double)b[1][i][1] - b[0][i][1];
            double want = (double)exact[1][i][1] - exact[0][i][1];
            moved += (own - want) * (own - want);
            all += (double)exact[0][i][1] * exact[0][i][1];
        }
        expect_below(expect_name("%s: change that is not the sum's",
                                 prt_screen_engine_name(options.engine)),
                     sqrt(moved / all), 0.008);
        for (int k = 0; k < 2 && e != PRT_SCREEN_REFERENCE; k++) free(b[k]);
    }
    free(exact[0]);
    free(exact[1]);
    stage_finish(&s);
    model_finish(&model);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(pair_kernels_agree),
        cmocka_unit_test(receivers_stand_for_their_patch),
        cmocka_unit_test(budgets_buy_samples),
        cmocka_unit_test(later_frames_change_no_plan),
        cmocka_unit_test(errors_are_foreseen),
        cmocka_unit_test(frames_average_to_the_reference),
        cmocka_unit_test(later_frames_weigh_more),
        cmocka_unit_test(frames_repeat),
        cmocka_unit_test(pictures_have_no_past),
        cmocka_unit_test(samples_stay_from_frame_to_frame),
    };
    return run_physics_tests(tests, screen_setup, screen_teardown);
}
