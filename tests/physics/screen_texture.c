// SPDX-License-Identifier: MIT
// screen/: C08's samples, split, atlas and pattern.
#include "screen_stage.h"

#include <sys/resource.h>
#include <unistd.h>

// Law: texels are drawn in proportion to their value, dark ones never (C08 eq 9).
static void mip_samples_follow_value(void **state)
{
    enum { N = 256, DRAWS = 100000 };
    float mip[N / 3 * 4 + 4];
    double want[N], total = 0;
    uint32_t got[N] = {0};
    struct prt_rng rng;
    prt_rng_init(&rng, 9, 0);
    for (int i = 0; i < N; i++) {
        mip[i] = prt_rng_u32(&rng) % 3 ? prt_rng_f32(&rng) * prt_rng_f32(&rng) : 0;
        total += mip[i];
    }
    float *at = mip;
    for (int size = N; size > 1; size /= 4) {
        for (int i = 0; i < size / 4; i++)
            at[size + i] = at[4 * i] + at[4 * i + 1] + at[4 * i + 2] + at[4 * i + 3];
        at += size;
    }
    for (int i = 0; i < N; i++) want[i] = DRAWS * mip[i] / total;
    for (int i = 0; i < DRAWS; i++) got[prt_screen_mip_sample(mip, N, prt_rng_f32(&rng))]++;
    for (int i = 0; i < N; i++) assert_true(mip[i] > 0 || got[i] == 0);
    expect_chi_square("chi-square of the texels", want, got, N);
    for (float u = 0.9999f; u < 1; u += 1e-6f)
        assert_true(mip[prt_screen_mip_sample(mip, N, u)] > 0);
}

// Law: W_l falls from 1 - e^(-K R_p)/2 over 1/2 at R_p to 0, continuously (METHODS §7, C08).
static void split_weights(void **state)
{
    const double k = 1.5;
    for (double r_p = 0.2; r_p < 6; r_p += 0.4) {
        expect_near("W_l(0)", prt_screen_local_weight(0, r_p), 1 - 0.5 * exp(-k * r_p), 1e-12);
        expect_near("W_l(R_p)", prt_screen_local_weight(r_p, r_p), 0.5, 1e-12);
        double before = 2;
        for (double r = 0; r < 12; r += 0.01) {
            double w = prt_screen_local_weight(r, r_p);
            assert_true(w > 0 && w < 1 && w < before);    // W_g = 1 - W_l: both in (0,1)
            assert_true(before > 1 || before - w < 0.01); // continuous at R_p
            before = w;
        }
    }
    struct prt_diffusion d[3];
    for (int c = 0; c < 3; c++) prt_diffusion_init(&d[c], 1 + c, 0.01, 1.3);
    double r_p = prt_screen_split_radius(d, 0.05), most = 0, beyond = 0;
    for (int c = 0; c < 3; c++) {
        most = fmax(most, 2 * M_PI * r_p * prt_diffusion_rd(&d[c], r_p));
        beyond = fmax(beyond, 2 * M_PI * 1.01 * r_p * prt_diffusion_rd(&d[c], 1.01 * r_p));
    }
    expect_above("2 pi r R_d at the split radius", most, 0.0499);
    expect_below("2 pi r R_d beyond it", beyond, 0.05);
}

// Law: the local and the global part add up to R_d, and a disc keeps its total (METHODS §6,
// C08).
static void split_parts_add_up(void **state)
{
    struct prt_diffusion dipole[1][3];
    for (int c = 0; c < 3; c++) prt_diffusion_init(&dipole[0][c], 1 + c, 0.02, 1.3);
    struct prt_screen_options options = {0};
    struct frame f = {.ctx = &quiet, .dipole = dipole, .options = &options};
    struct radial_table whole, near, far;
    prt_split_table(&f, 0, -1, 0, true, 0, 40, &whole);
    // C08's split, and texture sampling's by the pixel's own irradiance
    for (int own = 0; own < 2; own++) {
        prt_split_table(&f, 0, own ? -1 : 1.5, own ? 0.8 : 0, true, 0, 40, &near);
        prt_split_table(&f, 0, own ? -1 : 1.5, own ? 0.8 : 0, false, 0, 40, &far);
        for (float r = 0; r < 30; r += 0.05f) {
            float a[3], b[3], d[3];
            prt_radial_table_eval(&whole, r * r, a);
            prt_radial_table_eval(&near, r * r, b);
            prt_radial_table_eval(&far, r * r, d);
            for (int c = 0; c < 3; c++)
                expect_near("sum of both parts", b[c] + d[c], a[c], 0.01f * a[c] + 1e-6f);
        }
    }
    double share[3], sum[3] = {0};
    prt_near_share(&f, 0, 0.8, share);
    for (int i = 0; i < 40000; i++) {
        double r = (i + 0.5) * 1e-4, w = 2 * M_PI * r * exp(-r * r / 0.64) * 1e-4;
        for (int c = 0; c < 3; c++) sum[c] += w * prt_diffusion_rd(&dipole[0][c], r);
    }
    for (int c = 0; c < 3; c++) expect_close("near share", share[c], sum[c], 1e-5);
    struct radial_table disc;
    prt_split_table(&f, 0, -1, 0, true, 0.8, 40, &disc);
    double total[2][3] = {{0}};
    for (int i = 0; i < 40000; i++) {
        double r = (i + 0.5) * 1e-3;
        float a[2][3];
        prt_radial_table_eval(&whole, (float)(r * r), a[0]);
        prt_radial_table_eval(&disc, (float)(r * r), a[1]);
        for (int k = 0; k < 2; k++)
            for (int c = 0; c < 3; c++) total[k][c] += 2 * M_PI * r * (double)a[k][c] * 1e-3;
    }
    for (int c = 0; c < 3; c++) {
        expect_close("total of the table", total[0][c], dipole[0][c].rho_d, 2e-4);
        expect_close("total of the disc's table", total[1][c], dipole[0][c].rho_d, 0.02);
    }
}

// Law: texture sampling converges to the sum over all texels where points lie four mean free
// paths apart (C08, METHODS §6, control variate). Without the control variate the error is 10
// %.
static void short_mean_free_paths_stay_sharp(void **state)
{
    struct prt_material cream = {.name = "cream",
                                 .sigma_s_prime = {7.38f, 5.47f, 3.15f},
                                 .sigma_a = {0.0002f, 0.0028f, 0.0163f},
                                 .eta = 1.3f,
                                 .roughness = 0.3f};
    struct prt_screen_light light = {{0.5f, 0.4f, 0.8f}, {5, 5, 5}, false};
    struct model model;
    model_init(&model, 12000, 24000);
    add_sphere(&model, (float[3]){0, 0, 0}, 12, 32);
    add_sphere(&model, (float[3]){7, 5, 13}, 3, 16); // a shadow
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct stage s;
    stage_init(&s, &model, camera, 96, 96);
    struct prt_screen_options options = {.engine = PRT_SCREEN_REFERENCE, .n_sample = 400000};
    pixels want = render(&s, &cream, NULL, &light, options, NULL);
    static const double most[3] = {0.04, 0.022, 0.015};
    double last = 1;
    for (int k = 0; k < 3; k++) {
        options = (struct prt_screen_options){.engine = PRT_SCREEN_TEXTURE,
                                              .n_sample = k ? k > 1 ? 16000 : 1600 : 400};
        pixels b = render(&s, &cream, NULL, &light, options, NULL);
        double error = relative(b, want, s.g.n_point);
        expect_below(expect_name("%u points: relative RMSE", options.n_sample), error, most[k]);
        expect_below(expect_name("%u points: over the error with fewer", options.n_sample),
                     error / last, 1);
        last = error;
        free(b);
    }
    free(want);
    stage_finish(&s);
    model_finish(&model);
}

// Law: texture sampling keeps the difference of the lit and the dark face of a fin as the sum
// over all texels has it (METHODS §6, near field). Steep faces have more area about a point
// than a plane, which would take more of a point's own irradiance away than its share.
static void fins_shine_on_their_lit_side(void **state)
{
    struct model model;
    struct stage s;
    struct prt_material wax = {.sigma_s_prime = {0.3f, 0.4f, 0.6f},
                               .sigma_a = {0.02f, 0.02f, 0.02f},
                               .eta = 1.3f,
                               .roughness = 0.3f};
    const struct prt_camera camera = {.eye = {0, 0, 200}, .up = {0, 1, 0}, .fovy_deg = 9};
    model_init(&model, 2000, 4000);
    struct prt_block *block = begin_block(&model, true);
    for (int k = -7; k < 7; k++)
        add_sheet(&model, (float[3]){2 * (float)k + 1, 0, 0},
                  (float[3]){1, 0, k % 2 ? 3.75f : -3.75f}, (float[3]){0, 10, 0}, 4);
    end_block(&model, block);
    stage_init(&s, &model, camera, 96, 96);
    float(*e)[3] = calloc(model.mesh.n_vertex, sizeof *e);
    for (uint32_t v = 0; v < model.mesh.n_vertex; v++)
        for (int c = 0; c < 3; c++) e[v][c] = model.mesh.normal[v][0] > 0;
    double ratio[2][3];
    for (int reference = 0; reference < 2; reference++) {
        const struct prt_screen_options options = {.engine = reference ? PRT_SCREEN_REFERENCE
                                                                       : PRT_SCREEN_TEXTURE,
                                                   .n_sample = reference ? 40000 : 800,
                                                   .vertex_irradiance = (const float(*)[3])e};
        pixels b = render(&s, &wax, NULL, &from_front, options, NULL);
        double sum[2][3] = {{0}};
        unsigned n[2] = {0, 0};
        for (uint32_t i = 0; i < s.g.n_point; i++) {
            const bool lit = s.g.normal[0][i] > 0;
            if (fabsf(s.g.position[0][i]) > 8 || fabsf(s.g.position[1][i]) > 5) continue;
            for (int c = 0; c < 3; c++) sum[lit][c] += (double)b[i][c];
            n[lit]++;
        }
        for (int c = 0; c < 3; c++) ratio[reference][c] = sum[1][c] / n[1] * n[0] / sum[0][c];
        free(b);
    }
    for (int c = 0; c < 3; c++)
        expect_near("lit over dark face", ratio[0][c], ratio[1][c], 0.035);
    free(e);
    stage_finish(&s);
    model_finish(&model);
}

// uv that unfold a sphere, one to one for fold 0; other values of fold make them degenerate.
static void add_uv(struct model *m, uint32_t n, int fold)
{
    m->mesh.uv = calloc(m->mesh.n_vertex, sizeof *m->mesh.uv);
    uint32_t row = 2 * n + 1, one = (n + 1) * row;
    for (uint32_t v = 0; v < m->mesh.n_vertex; v++) {
        float *uv = m->mesh.uv[v];
        uv[0] = (float)(v % one % row) / (float)(2 * n);
        uv[1] = (float)(v % one / row) / (float)n;
        if (fold == 1) uv[0] = uv[1] = 0.25f;        // all in one place
        if (fold == 2) uv[0] = fabsf(2 * uv[0] - 1); // mirrored halves lie on each other
        if (fold == 3) uv[1] = NAN;
        if (fold == 4) uv[0] = 3 * uv[0] + 1; // outside the square
        if (fold == 5) uv[1] = 0.5f;          // a line
    }
}

// Law: an atlas in the model's one-to-one uv gives the picture of an atlas along triangles (C08
// eq 7); uv that are not one to one are not used.
static void uv_are_the_atlas(void **state)
{
    enum { N = 24 };
    struct prt_camera camera = {.eye = {0, 8, 60}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct prt_screen_light light = {{0.3f, 0.5f, 0.8f}, {3, 3, 3}, false};
    pixels plain = NULL;
    for (int fold = -1; fold < 6; fold++) {
        struct model model;
        model_init(&model, 20000, 40000);
        add_sphere(&model, (float[3]){0, 0, 0}, 10, N);
        if (fold == 0)
            add_sphere(&model, (float[3]){0, 22, 0}, 5, N); // each has the whole square
        if (fold >= 0) add_uv(&model, N, fold);
        struct stage s;
        stage_init(&s, &model, camera, 60, 60);
        for (int hybrid = 0; hybrid < 2; hybrid++) {
            struct prt_screen_options options = {
                .engine = hybrid ? PRT_SCREEN_HYBRID : PRT_SCREEN_TEXTURE, .n_sample = 3000};
            struct prt_screen_report report;
            pixels b = render(&s, &marble, NULL, &light, options, &report);
            assert_true(report.uv_atlas == (fold == 0));
            if (!plain) plain = b;
            if (!hybrid && fold >= 0) {
                double rmse = relative(b, plain, s.g.n_point);
                if (fold == 0) {
                    expect_below("relative RMSE, in the model's uv", rmse, 0.015);
                    expect_above("relative RMSE, in another atlas", rmse, 0);
                } else {
                    expect_below("relative RMSE, uv not one to one", rmse, 1e-6);
                }
            }
            if (b != plain) free(b);
        }
        // The texels of equal area that the reference has between them do not stay.
        for (int exact = 1; exact >= 0; exact--) {
            struct prt_screen_options options = {
                .engine = exact ? PRT_SCREEN_REFERENCE : PRT_SCREEN_TEXTURE,
                .n_sample = exact ? 16 * 3000 : 3000}; // as many texels
            struct prt_screen_report report;
            free(render(&s, &marble, NULL, &light, options, &report));
            assert_true(report.uv_atlas == (fold == 0 && !exact));
        }
        // and its texels are the whole surface
        bool injective;
        struct samples texels;
        assert_int_equal(prt_samples_uv_atlas(&quiet, &model.mesh, 20000, &texels, &injective),
                         PRT_OK);
        assert_true(injective == (fold == 0));
        if (injective) {
            double area = 0;
            for (uint32_t i = 0; i < texels.n; i++) {
                area += (double)texels.area[i];
                assert_true(i == 0 || texels.object[i] >= texels.object[i - 1]);
            }
            expect_near("area of the texels over the spheres'", area / (500 * M_PI), 1, 0.01);
            prt_samples_finish(&texels);
        }
        stage_finish(&s);
        free(model.mesh.uv);
        model_finish(&model);
    }
    free(plain);
}

// Law: the measured error is that against the reference's picture, also where the engine's own
// texels lie in uv that crowd on half of the model (prt_screen_options.measure_error).
static void measured_in_uneven_uv(void **state)
{
    enum { N = 24 };
    const struct prt_camera camera = {.eye = {0, 60, 0}, .up = {0, 0, 1}, .fovy_deg = 24};
    const struct prt_screen_light light = {{0, 0.8f, 0.6f}, {3, 3, 3}, false};
    struct prt_screen_options exact = {.engine = PRT_SCREEN_REFERENCE, .n_sample = 70000};
    struct prt_screen_options options = {
        .engine = PRT_SCREEN_TEXTURE, .n_sample = 3000, .measure_error = true};
    struct prt_screen_report report;
    struct model model;
    struct stage s;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 10, N);
    add_uv(&model, N, 0);
    for (uint32_t v = 0; v < model.mesh.n_vertex; v++) {
        float *y = &model.mesh.uv[v][1]; // the upper half takes a 10th
        *y = *y < 0.5f ? 0.2f * *y : 0.1f + 1.8f * (*y - 0.5f);
    }
    stage_init(&s, &model, camera, 60, 60);
    pixels want = render(&s, &marble, NULL, &light, exact, NULL);
    pixels got = render(&s, &marble, NULL, &light, options, &report);
    const double error = relative(got, want, s.g.n_point);
    assert_true(report.uv_atlas);
    expect_close("measured error over that of the whole picture", report.error, error, 0.1);
    free(got);
    free(want);
    stage_finish(&s);
    free(model.mesh.uv);
    model_finish(&model);
}

// Bytes of addresses that this process has.
static size_t address_space(void)
{
    long pages = 0;
    FILE *f = fopen("/proc/self/statm", "r");
    assert_non_null(f);
    assert_int_equal(fscanf(f, "%ld", &pages), 1);
    fclose(f);
    return (size_t)pages * (size_t)sysconf(_SC_PAGESIZE);
}

// Contract of prt_frame_atlas: without memory for texels in the model's uv it says so, and the
// next frame takes them.
static void uv_are_tried_again(void **state)
{
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
    skip(); // a sanitizer takes terabytes of addresses
#endif
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 10, 24);
    add_uv(&model, 24, 0);
    float(*irradiance)[3] = calloc(model.mesh.n_vertex, sizeof *irradiance);
    struct prt_screen_options options = {.engine = PRT_SCREEN_TEXTURE,
                                         .vertex_irradiance = (const float(*)[3])irradiance};
    struct prt_screen_report report = {0};
    struct prt_screen screen = {.mesh = &model.mesh};
    struct frame f = {.ctx = &quiet, .screen = &screen, .options = &options, .report = &report};
    // 16 million texels need some gigabytes
    struct rlimit before, limit;
    assert_int_equal(getrlimit(RLIMIT_AS, &before), 0);
    limit = before;
    limit.rlim_cur = (rlim_t)address_space() + (200 << 20);
    assert_int_equal(setrlimit(RLIMIT_AS, &limit), 0);
    int status = prt_frame_atlas(&f, 1 << 24, false);
    assert_int_equal(setrlimit(RLIMIT_AS, &before), 0);
    assert_int_equal(status, PRT_NOMEM);
    assert_int_equal(screen.uv_state, 0);
    assert_int_equal(prt_frame_atlas(&f, 20000, false), PRT_OK);
    assert_true(report.uv_atlas);
    prt_samples_finish(&screen.atlas);
    free(irradiance);
    free(model.mesh.uv);
    model_finish(&model);
}

// Law: the pattern of rings gives the near part of the sum (METHODS §6, hybrid, C08), in every
// instruction set, and takes no light from other objects.
static void pattern_is_the_near_part(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_box(&model, (float[3]){-6, 0, 0}, (float[3]){6, 6, 6}, 8);
    add_box(&model, (float[3]){6, 0, 0}, (float[3]){6, 6, 6}, 8);
    struct prt_screen_light light = {{-0.8f, 0, 0.6f}, {5, 5, 5}, false};
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 26};
    struct stage s;
    stage_init(&s, &model, camera, 72, 72);
    struct prt_screen_options exact = {.engine = PRT_SCREEN_REFERENCE, .n_sample = 80000};
    pixels want = render(&s, &marble, NULL, &light, exact, NULL), first = NULL;
    static const char *const word[] = {"c", "avx2", "avx512"};
    for (int k = 0; k < 3; k++) {
        unsigned mask, all = quiet.cpu;
        assert_int_equal(prt_cpu_parse(word[k], &mask), PRT_OK);
        quiet.cpu = mask & prt_cpu_detect();
        struct prt_screen_options options = {
            .engine = PRT_SCREEN_HYBRID, .n_sample = 900, .rings = 20, .spokes = 20};
        pixels b = render(&s, &marble, NULL, &light, options, NULL);
        quiet.cpu = all;
        double rmse = relative(b, want, s.g.n_point);
        expect_below("relative RMSE, 20 rings of 20", rmse, 0.03);
        if (!first) first = b;
        else
            expect_below("change by the instruction set", relative(b, first, s.g.n_point),
                         1e-3);
        if (b != first) free(b);
    }
    // a light from the left leaves all of the right box dark but its front
    struct prt_screen_light side = {{-1, 0, 0}, {5, 5, 5}, false};
    struct prt_screen_options options = {
        .engine = PRT_SCREEN_HYBRID, .rings = 20, .spokes = 20};
    pixels b = render(&s, &marble, NULL, &side, options, NULL);
    for (uint32_t i = 0; i < s.g.n_point; i++)
        assert_true(model.block[s.g.block[i]].object == 0 ||
                    (b[i][0] == 0 && b[i][1] == 0 && b[i][2] == 0));
    free(b);
    b = malloc(s.g.n_point * sizeof *b);
    options.spokes = 0;
    assert_int_equal(try_render(&s, &marble, NULL, &side, &options, b, NULL), PRT_ARG);
    free(b);
    free(first);
    free(want);
    stage_finish(&s);
    model_finish(&model);
}

// Law: the near part of each object is by its own medium (METHODS §6, hybrid): two boxes, of
// which the second scatters more and absorbs, are each as the sum over all texels has them.
static void pattern_of_each_medium(void **state)
{
    static const uint8_t own[2] = {0, 1};
    struct prt_material medium[2] = {marble, marble};
    for (int c = 0; c < 3; c++) medium[1].sigma_s_prime[c] *= 5, medium[1].sigma_a[c] = 0.3f;
    const struct prt_screen_light light = {{-0.8f, 0, 0.6f}, {5, 5, 5}, false};
    const struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 26};
    struct model model;
    struct stage s;
    model_init(&model, 20000, 40000);
    add_box(&model, (float[3]){-6, 0, 0}, (float[3]){5, 6, 6}, 8);
    add_box(&model, (float[3]){6, 0, 0}, (float[3]){5, 6, 6}, 8);
    stage_init(&s, &model, camera, 48, 48);
    const struct prt_screen_input input = {
        .visibility = s.vis, .media = {2, medium, own}, .n_extra = 1, .extra = &light};
    pixels color[2];
    for (int hybrid = 0; hybrid < 2; hybrid++) {
        const struct prt_screen_options options = {.engine = hybrid ? PRT_SCREEN_HYBRID
                                                                    : PRT_SCREEN_REFERENCE,
                                                   .n_sample = hybrid ? 900 : 60000,
                                                   .rings = 20,
                                                   .spokes = 20};
        color[hybrid] = malloc((s.g.n_point + 1) * sizeof *color[hybrid]);
        assert_int_equal(
            prt_screen_radiance(&quiet, s.screen, &input, &options, color[hybrid], NULL),
            PRT_OK);
    }
    double error[2] = {0}, all[2] = {0};
    for (uint32_t i = 0; i < s.g.n_point; i++)
        for (int c = 0; c < 3; c++) {
            const uint32_t object = model.block[s.g.block[i]].object;
            const double want = (double)color[0][i][c], got = (double)color[1][i][c];
            error[object] += (got - want) * (got - want);
            all[object] += want * want;
        }
    for (int o = 0; o < 2; o++)
        expect_below("relative RMSE on an object of its own medium", sqrt(error[o] / all[o]),
                     0.1);
    for (int k = 0; k < 2; k++) free(color[k]);
    stage_finish(&s);
    model_finish(&model);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(mip_samples_follow_value),
        cmocka_unit_test(split_weights),
        cmocka_unit_test(split_parts_add_up),
        cmocka_unit_test(short_mean_free_paths_stay_sharp),
        cmocka_unit_test(fins_shine_on_their_lit_side),
        cmocka_unit_test(uv_are_the_atlas),
        cmocka_unit_test(measured_in_uneven_uv),
        cmocka_unit_test(uv_are_tried_again),
        cmocka_unit_test(pattern_is_the_near_part),
        cmocka_unit_test(pattern_of_each_medium),
    };
    return run_physics_tests(tests, screen_setup, screen_teardown);
}
