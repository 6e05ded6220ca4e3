// SPDX-License-Identifier: MIT
// screen/: media other than one dipole: images over uv, and profiles of materials.
#include "screen_stage.h"

// A sheet with uv over [0,1]² in a wide view.
static const struct prt_camera sheet_camera = {
    .eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 54};

static void sheet_with_uv(struct model *model, struct stage *s)
{
    model_init(model, 20000, 40000);
    struct prt_block *block = begin_block(model, true);
    add_sheet(model, (float[3]){0, 0, 0}, (float[3]){30, 0, 0}, (float[3]){0, 30, 0}, 20);
    end_block(model, block);
    model->mesh.uv = calloc(model->mesh.n_vertex, sizeof *model->mesh.uv);
    for (uint32_t v = 0; v < model->mesh.n_vertex; v++)
        for (int k = 0; k < 2; k++)
            model->mesh.uv[v][k] = (model->mesh.position[v][k] + 30) / 60;
    stage_init(s, model, sheet_camera, 160, 160);
}

static double middle(const struct stage *s, pixels b, int c)
{
    double sum = 0;
    uint32_t n = 0;
    for (uint32_t i = 0; i < s->g.n_point; i++) {
        if (hypotf(s->g.position[0][i], s->g.position[1][i]) > 8) continue;
        sum += (double)b[i][c];
        n++;
    }
    return sum / n;
}

// A sheet with uv in a medium that absorbs, and its picture without maps.
struct sheet {
    struct model model;
    struct stage s;
    struct prt_material m;
    struct prt_screen_options options;
    pixels base;
};

static void sheet_begin(struct sheet *t)
{
    *t = (struct sheet){.m = marble, .options = {.engine = PRT_SCREEN_TANGENT, .n_sample = 64}};
    for (int c = 0; c < 3; c++) t->m.sigma_a[c] = 0.05f;
    sheet_with_uv(&t->model, &t->s);
    t->base = render(&t->s, &t->m, NULL, &from_front, t->options, NULL);
}

static void sheet_end(struct sheet *t)
{
    free(t->base);
    free(t->model.mesh.uv);
    stage_finish(&t->s);
    model_finish(&t->model);
}

// Law: maps multiply sigma_s' and sigma_a where light leaves (METHODS §6, maps, M03): twice the
// coefficients is a denser medium.
static void maps_change_the_medium(void **state)
{
    struct sheet t;
    struct prt_screen_report report;
    static const float two[1][3] = {{2, 2, 2}};
    struct prt_screen_map twice = {1, 1, two};
    sheet_begin(&t);
    struct prt_material denser = t.m;
    for (int c = 0; c < 3; c++) {
        denser.sigma_s_prime[c] *= 2;
        denser.sigma_a[c] *= 2;
    }
    pixels want = render(&t.s, &denser, NULL, &from_front, t.options, NULL);
    t.options.sigma_s_map = t.options.sigma_a_map = &twice;
    pixels b = render(&t.s, &t.m, NULL, &from_front, t.options, &report);
    for (int c = 0; c < 3; c++)
        expect_near("map of 2 over the denser medium",
                    middle(&t.s, b, c) / middle(&t.s, want, c), 1, 0.01);
    assert_int_equal(report.n_medium, 1);
    free(b);
    free(want);
    sheet_end(&t);
}

// 1 on the left half of uv, 60 on the right.
static struct prt_screen_map half_map(void)
{
    static float halves[64][3];
    for (int i = 0; i < 64; i++)
        for (int c = 0; c < 3; c++) halves[i][c] = i < 32 ? 1 : 60;
    return (struct prt_screen_map){64, 1, (const float(*)[3])halves};
}

// Heights that rise by 12 mm to a side of 60.
static struct prt_screen_map ramp_map(void)
{
    static float ramp[256][3];
    for (int i = 0; i < 256; i++) ramp[i][0] = 12 * ((float)i + 0.5f) / 256;
    return (struct prt_screen_map){256, 1, (const float(*)[3])ramp};
}

// Law: a map acts where it is (METHODS §6, maps, M03): absorption sixty times as strong on one
// half makes that half darker, and the other no darker.
static void half_a_map_darkens_its_half(void **state)
{
    struct sheet t;
    struct prt_screen_report report;
    struct prt_screen_map half = half_map();
    sheet_begin(&t);
    t.options.sigma_a_map = &half;
    pixels b = render(&t.s, &t.m, NULL, &from_front, t.options, &report);
    assert_true(report.n_medium >= 2);
    for (uint32_t i = 0; i < t.s.g.n_point; i++) {
        float x = t.s.g.position[0][i], y = t.s.g.position[1][i];
        if (fabsf(y) > 8 || fabsf(x) > 20 || fabsf(x) < 4) continue;
        float share = b[i][1] / t.base[i][1];
        if (x < 0) expect_near("plain half over the plain medium", share, 1, 1e-5);
        else expect_below("absorbing half over the plain medium", share, 0.25);
    }
    free(b);
    sheet_end(&t);
}

// Law: a tint t by absorption gives t of the light in every channel (METHODS §6, maps).
static void a_tint_is_its_share_of_the_light(void **state)
{
    struct sheet t;
    float tint[1][3] = {{0.4f, 0.4f, 0.4f}};
    sheet_begin(&t);
    assert_int_equal(prt_screen_albedo_factors(&quiet, &t.m, 1, (const float(*)[3])tint, tint),
                     PRT_OK);
    struct prt_screen_map tinted = {1, 1, (const float(*)[3])tint};
    t.options.sigma_a_map = &tinted;
    pixels b = render(&t.s, &t.m, NULL, &from_front, t.options, NULL);
    for (int c = 0; c < 3; c++) {
        expect_above("absorption factor of a tint", tint[0][c], 1);
        expect_close("share of the light under a tint of 0.4",
                     middle(&t.s, b, c) / middle(&t.s, t.base, c), 0.4, 0.003);
    }
    free(b);
    sheet_end(&t);
}

// Law: maps tip the normal by their own angle (METHODS §6, maps): a level normal map changes
// nothing, heights that rise by 0.2 tip it by atan(0.2).
static void maps_tip_the_normal(void **state)
{
    struct sheet t;
    static const float flat[1][3] = {{0.5f, 0.5f, 1}};
    struct prt_screen_map level = {1, 1, flat}, heights = ramp_map();
    struct prt_screen_light slant = {{0.6f, 0, 0.8f}, {2, 2, 2}, false};
    sheet_begin(&t);
    struct prt_screen_options mapped = t.options;
    mapped.normal_map = &level;
    pixels b = render(&t.s, &t.m, NULL, &from_front, mapped, NULL);
    expect_below("change by a level normal map", relative(b, t.base, t.s.g.n_point), 1e-6);
    free(b);
    pixels level_lit = render(&t.s, &t.m, NULL, &slant, t.options, NULL);
    mapped = t.options;
    mapped.bump_map = &heights;
    b = render(&t.s, &t.m, NULL, &slant, mapped, NULL);
    double l = sqrt(1 + 0.04), tipped = (0.8 - 0.2 * 0.6) / l;
    double share = prt_fresnel_transmittance(t.m.eta, tipped) * tipped /
                   (prt_fresnel_transmittance(t.m.eta, 0.8) * 0.8);
    expect_close("share of the light on a slope of 0.2",
                 middle(&t.s, b, 1) / middle(&t.s, level_lit, 1), share, 0.02);
    free(b);
    free(level_lit);
    sheet_end(&t);
}

// Law: a map is read at the uv of a triangle's corners, which at the seams of an OBJ are not
// those of its vertices.
static void maps_at_seams(void **state)
{
    struct sheet t;
    struct prt_screen_map half = half_map(), heights = ramp_map();
    const struct prt_screen_light slant = {{0.6f, 0, 0.8f}, {2, 2, 2}, false};
    sheet_begin(&t);
    struct prt_mesh *mesh = &t.model.mesh;
    t.options.sigma_a_map = &half;
    t.options.bump_map = &heights;
    pixels want = render(&t.s, &t.m, NULL, &slant, t.options, NULL);
    mesh->corner_uv = calloc(mesh->n_triangle, sizeof *mesh->corner_uv);
    for (uint32_t i = 0; i < 3 * mesh->n_triangle; i++)
        memcpy(mesh->corner_uv[i / 3][i % 3], mesh->uv[mesh->triangle[i / 3][i % 3]],
               sizeof *mesh->uv);
    for (uint32_t v = 0; v < mesh->n_vertex; v++) mesh->uv[v][0] = (float)(v % 7) / 7;
    pixels b = render(&t.s, &t.m, NULL, &slant, t.options, NULL);
    expect_below("maps by corners against maps by vertices", relative(b, want, t.s.g.n_point),
                 1e-6);
    free(b);
    free(want);
    free(mesh->corner_uv);
    mesh->corner_uv = NULL;
    sheet_end(&t);
}

// Contract of prt_screen_radiance: maps that are none, and maps without uv, are refused.
static void wrong_maps_are_refused(void **state)
{
    struct sheet t;
    static const float two[1][3] = {{2, 2, 2}}, flat[1][3] = {{0.5f, 0.5f, 1}};
    static const float bad[1][3] = {{NAN, 0, 0}}, negative[1][3] = {{-1, 0, 0}};
    struct prt_screen_map wrong[] = {{1, 1, bad}, {1, 1, negative}, {0, 1, two}, {1, 1, NULL}};
    struct prt_screen_map level = {1, 1, flat}, heights = ramp_map(), half = half_map();
    struct prt_screen_light slant = {{0.6f, 0, 0.8f}, {2, 2, 2}, false};
    sheet_begin(&t);
    pixels b = malloc(t.s.g.n_point * sizeof *b);
    struct prt_screen_options mapped = t.options;
    for (int i = 0; i < 4; i++) {
        mapped.sigma_s_map = &wrong[i];
        assert_int_equal(try_render(&t.s, &t.m, NULL, &from_front, &mapped, b, NULL), PRT_ARG);
    }
    // uv folded to a line: no frame for bumps, a picture all the same
    struct prt_mesh *mesh = &t.model.mesh;
    for (uint32_t v = 0; v < mesh->n_vertex; v++) mesh->uv[v][1] = 0.5f;
    mapped = t.options;
    mapped.bump_map = &heights;
    mapped.normal_map = &level;
    mapped.sigma_a_map = &half;
    free(render(&t.s, &t.m, NULL, &slant, mapped, NULL));
    float(*kept)[2] = mesh->uv;
    mesh->uv = NULL;
    assert_int_equal(try_render(&t.s, &t.m, NULL, &from_front, &mapped, b, NULL), PRT_ARG);
    mesh->uv = kept;
    free(b);
    sheet_end(&t);
}

// Law: maps do the same in every engine (METHODS §6, maps): a tint of 0.4 leaves 0.4 of the
// light, a slope tips the normal by its own angle. A surface may have maps of its own, or none.
static void every_engine_takes_maps(void **state)
{
    static const uint32_t count[5] = {160, 64, 2500, 900, 60000};
    struct prt_material m = marble;
    for (int c = 0; c < 3; c++) m.sigma_a[c] = 0.05f;
    struct model model;
    struct stage s;
    sheet_with_uv(&model, &s);
    stage_finish(&s);
    stage_init(&s, &model, sheet_camera, 32, 32);
    static float tint[1][3] = {{0.4f, 0.4f, 0.4f}}, flat[1][3] = {{0.5f, 0.5f, 1}};
    static float ramp[256][3], halves[64][3];
    for (int i = 0; i < 256; i++) ramp[i][0] = 12 * ((float)i + 0.5f) / 256;
    for (int i = 0; i < 64; i++)
        for (int c = 0; c < 3; c++) halves[i][c] = i < 32 ? 1 : 0.3f;
    const struct prt_material *medium = &m;
    assert_int_equal(
        prt_screen_albedo_factors(&quiet, medium, 1, (const float(*)[3])tint, tint), 0);
    assert_int_equal(
        prt_screen_albedo_factors(&quiet, medium, 64, (const float(*)[3])halves, halves), 0);
    const struct prt_screen_map tinted = {1, 1, (const float(*)[3])tint}, none = {0, 0, NULL};
    const struct prt_screen_map level = {1, 1, (const float(*)[3])flat};
    const struct prt_screen_map heights = {256, 1, (const float(*)[3])ramp};
    const struct prt_screen_map half = {64, 1, (const float(*)[3])halves};
    const struct prt_screen_light slant = {{0.6f, 0, 0.8f}, {2, 2, 2}, false};
    double l = sqrt(1 + 0.04), tipped = (0.8 - 0.2 * 0.6) / l;
    double slope = prt_fresnel_transmittance(m.eta, tipped) * tipped /
                   (prt_fresnel_transmittance(m.eta, 0.8) * 0.8);
    for (int e = PRT_SCREEN_REFERENCE; e >= 0; e--) {
        if (e + 1 ==
            PRT_SCREEN_REFERENCE) { // the others with a picture that shows what lies about
            stage_finish(&s);
            stage_init(&s, &model, sheet_camera, 160, 160);
        }
        struct prt_screen_options plain = {.engine = (enum prt_screen_engine)e,
                                           .n_sample = count[e]},
                                  o = plain;
        pixels base = render(&s, &m, NULL, &slant, plain, NULL);
        o.sigma_a_map = &tinted;
        pixels b = render(&s, &m, NULL, &slant, o, NULL);
        double tint_share = middle(&s, b, 1) / middle(&s, base, 1);
        o.maps_by_surface = true;
        pixels own = render(&s, &m, NULL, &slant, o, NULL);
        assert_memory_equal(own, b, s.g.n_point * sizeof *b);
        free(own);
        o.sigma_a_map = &none;
        own = render(&s, &m, NULL, &slant, o, NULL);
        expect_below("change by an empty map", relative(own, base, s.g.n_point), 1e-4);
        free(own);
        free(b);
        o = plain;
        o.normal_map = &level;
        b = render(&s, &m, NULL, &slant, o, NULL);
        double level_share = middle(&s, b, 1) / middle(&s, base, 1);
        free(b);
        o = plain;
        o.bump_map = &heights;
        b = render(&s, &m, NULL, &slant, o, NULL);
        double slope_share = middle(&s, b, 1) / middle(&s, base, 1);
        free(b);
        o = plain;
        o.sigma_a_map = &half;
        o.measure_error = e != PRT_SCREEN_REFERENCE;
        struct prt_screen_report report;
        b = render(&s, &m, NULL, &slant, o, &report);
        const char *name = prt_screen_engine_name(plain.engine);
        expect_close(expect_name("%s: share under a tint", name), tint_share, 0.4, 0.003);
        expect_near(expect_name("%s: share under a level map", name), level_share, 1, 1e-6);
        expect_close(expect_name("%s: share on a slope", name), slope_share, slope, 1.2e-4);
        if (o.measure_error)
            expect_below(expect_name("%s: reported error on two halves", name), report.error,
                         0.05);
        free(b);
        free(base);
    }
    free(model.mesh.uv);
    stage_finish(&s);
    model_finish(&model);
}

// Law: every engine spreads light by the material's own R_d (METHODS §1, other profiles): B =
// total E on a large plane, and on a ball the sum over all texels.
static void engines_use_the_profile_of_the_material(void **state)
{
    static const char *const text[2] = {
        "{\"profile\":\"burley\",\"albedo\":[0.7,0.6,0.8],\"mean_free_path\":[3,2.5,2],"
        "\"eta\":1.4}",
        "{\"profile\":\"curve\",\"radius\":[0,1,2,4],\"rd\":[[0.05,0.04,0.02,0],[0.05,0.04,0.02,"
        "0],[0.03,0.02,0.01,0]],\"eta\":1.4}"};
    static const uint32_t count[5] = {160, 256, 2500, 900, 60000};
    for (int k = 0; k < 2; k++) {
        struct prt_material m;
        assert_int_equal(prt_material_parse(&quiet, "test", text[k], strlen(text[k]), &m),
                         PRT_OK);
        struct prt_diffusion d[3];
        prt_material_dipoles(&m, d);
        struct model sheet, ball;
        struct stage flat, round;
        sheet_with_uv(&sheet, &flat);
        stage_finish(&flat);
        stage_init(&flat, &sheet, sheet_camera, 32, 32);
        model_init(&ball, 20000, 40000);
        add_sphere(&ball, (float[3]){0, 0, 0}, 10, 32);
        stage_init(&round, &ball,
                   (struct prt_camera){.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 24}, 48,
                   48);
        pixels want = NULL;
        for (int e = PRT_SCREEN_REFERENCE; e >= 0; e--) {
            struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                                 .n_sample = count[e]};
            if (e + 1 == PRT_SCREEN_REFERENCE) {
                stage_finish(&flat);
                stage_init(&flat, &sheet, sheet_camera, 160, 160);
            }
            pixels b = render(&flat, &m, NULL, &from_front, options, NULL);
            double total = middle(&flat, b, 0) * M_PI / prt_fresnel_transmittance(m.eta, 1);
            free(b);
            b = render(&round, &m, NULL, &from_front, options, NULL);
            if (!want) want = b;
            double off = relative(b, want, round.g.n_point);
            const char *name = prt_screen_engine_name(options.engine);
            expect_close(expect_name("profile %d, %s: total", k, name), total, d[0].rho_d,
                         0.03);
            expect_below(expect_name("profile %d, %s: ball", k, name), off, 0.05);
            if (b != want) free(b);
        }
        free(want);
        free(sheet.mesh.uv);
        stage_finish(&flat);
        stage_finish(&round);
        model_finish(&sheet);
        model_finish(&ball);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(maps_change_the_medium),
        cmocka_unit_test(half_a_map_darkens_its_half),
        cmocka_unit_test(a_tint_is_its_share_of_the_light),
        cmocka_unit_test(maps_tip_the_normal),
        cmocka_unit_test(maps_at_seams),
        cmocka_unit_test(wrong_maps_are_refused),
        cmocka_unit_test(every_engine_takes_maps),
        cmocka_unit_test(engines_use_the_profile_of_the_material),
    };
    return run_physics_tests(tests, screen_setup, screen_teardown);
}
