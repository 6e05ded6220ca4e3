// SPDX-License-Identifier: MIT
// screen/: laws that hold for every image-space engine. Above 600 lines: a list of laws, each
// read alone.
#include "screen_stage.h"

#include "prt/reference.h"

// Law: constant E on a large plane gives B = rho_d E by every engine (METHODS §8). The
// camera looks at the middle of a sheet that is large against the medium's reach.
static void plane_gives_total_reflectance(void **state)
{
    static const struct {
        enum prt_screen_engine engine;
        uint32_t n;
        double mean, worst; // tolerated relative errors
    } row[] = {{PRT_SCREEN_SPLAT, 0, 0.008, 0.02},
               {PRT_SCREEN_TEXTURE, 16384, 0.001, 0.04},
               {PRT_SCREEN_HYBRID, 4000, 0.0025, 0.025},
               {PRT_SCREEN_REFERENCE, 0, 5e-4, 0.04},
               {PRT_SCREEN_TANGENT, 64, 0.0015, 0.014}};
    struct prt_material m = marble;
    // absorbing enough that 30 mm hold all of it, as in skin
    for (int c = 0; c < 3; c++) m.sigma_a[c] = 0.03f + 0.02f * (float)c;
    struct model model;
    model_init(&model, 20000, 40000);
    struct prt_block *block = begin_block(&model, true);
    add_sheet(&model, (float[3]){0, 0, 0}, (float[3]){30, 0, 0}, (float[3]){0, 30, 0}, 20);
    end_block(&model, block);
    // M03 reads irradiance from the picture, which must contain enough of the plane
    struct prt_camera near = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 12}, wide = near;
    wide.fovy_deg = 54;
    struct stage s;
    stage_init(&s, &model, near, 48, 48);
    for (size_t k = 0; k < sizeof row / sizeof *row; k++) {
        if (row[k].engine == PRT_SCREEN_TANGENT) {
            stage_finish(&s);
            stage_init(&s, &model, wide, 220, 220);
        }
        struct prt_screen_options options = {.engine = row[k].engine, .n_sample = row[k].n};
        struct prt_screen_report report;
        pixels b = render(&s, &m, NULL, &from_front, options, &report);
        for (int c = 0; c < 3; c++) {
            struct prt_diffusion d;
            prt_diffusion_init(&d, m.sigma_s_prime[c], m.sigma_a[c], m.eta);
            double e = prt_fresnel_transmittance(m.eta, 1) * (c + 1);
            double want = d.rho_d * e / M_PI, mean = 0, worst = 0;
            uint32_t n = 0;
            for (uint32_t i = 0; i < s.g.n_point; i++) {
                if (hypotf(s.g.position[0][i], s.g.position[1][i]) > 8) continue;
                n++;
                mean += b[i][c] / want;
                worst = fmax(worst, fabs(b[i][c] / want - 1));
            }
            mean /= n;
            const char *name = prt_screen_engine_name(row[k].engine);
            expect_near(expect_name("%s: mean B / (rho_d E)", name), mean, 1, row[k].mean);
            expect_below(expect_name("%s: worst pixel", name), worst, row[k].worst);
        }
        free(b);
    }
    stage_finish(&s);
    model_finish(&model);
}

// Irradiance of every vertex by its object; object 0 at x < 0.
static void light_objects(const struct model *m, const float left[3], const float right[3],
                          float (*e)[3])
{
    for (uint32_t b = 0; b < m->mesh.n_block; b++)
        for (uint32_t v = 0; v < m->block[b].n_vertex; v++)
            memcpy(e[m->block[b].vertex_begin + v], b ? right : left, sizeof *e);
}

static void expect_object(const struct stage *s, const struct model *m, uint32_t object,
                          pixels a, pixels b)
{
    for (uint32_t i = 0; i < s->g.n_point; i++)
        for (int c = 0; c < 3 && m->block[s->g.block[i]].object == object; c++) {
            float want = b ? b[i][c] : 0;
            assert_float_equal(a[i][c], want, 0);
        }
}

// Law: light does not cross between objects that touch. When the lit right one turns from red
// to blue, of equal power so that the same samples are drawn, the lit left one keeps every bit;
// when the left one is dark it is black.
static void touching_objects_exchange_nothing(void **state)
{
    static const float white[3] = {1, 1, 1}, red[3] = {9, 0, 0}, blue[3] = {0, 0, 9},
                       dark[3] = {0, 0, 0};
    struct model model;
    model_init(&model, 20000, 40000);
    add_box(&model, (float[3]){-5, 0, 0}, (float[3]){5, 5, 5}, 8);
    add_box(&model, (float[3]){5, 0, 0}, (float[3]){5, 5, 5}, 8);
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 30};
    struct stage s;
    stage_init(&s, &model, camera, 64, 64);
    float(*e)[3] = calloc(model.mesh.n_vertex, sizeof *e);
    for (int engine = 0; engine <= PRT_SCREEN_REFERENCE; engine++) {
        struct prt_screen_options options = {.engine = (enum prt_screen_engine)engine,
                                             .n_sample =
                                                 engine == PRT_SCREEN_REFERENCE ? 5000 : 0,
                                             .vertex_irradiance = (const float(*)[3])e};
        light_objects(&model, white, red, e);
        pixels beside_red = render(&s, &marble, NULL, &from_front, options, NULL);
        light_objects(&model, white, blue, e);
        pixels beside_blue = render(&s, &marble, NULL, &from_front, options, NULL);
        light_objects(&model, dark, blue, e);
        pixels unlit = render(&s, &marble, NULL, &from_front, options, NULL);
        double left = 0;
        for (uint32_t i = 0; i < s.g.n_point; i++)
            if (model.block[s.g.block[i]].object == 0) left += (double)beside_red[i][0];
        assert_true(left / s.g.n_point > 0.01);
        expect_object(&s, &model, 0, beside_blue, beside_red);
        expect_object(&s, &model, 0, unlit, NULL);
        free(beside_red);
        free(beside_blue);
        free(unlit);
    }
    free(e);
    stage_finish(&s);
    model_finish(&model);
}

// Law: light does not cross from object to object (METHODS §1): each looks as among its own
// kind.
static void media_keep_apart(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){-8, 0, 0}, 7, 20);
    add_sphere(&model, (float[3]){8, 0, 0}, 7, 20);
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 30};
    struct stage s;
    stage_init(&s, &model, camera, 64, 64);
    struct prt_material medium[2] = {marble, marble};
    for (int c = 0; c < 3; c++) medium[1].sigma_a[c] = 0.3f;
    struct prt_screen_options options = {.engine = PRT_SCREEN_TEXTURE};
    pixels alone[2];
    for (int k = 0; k < 2; k++)
        alone[k] = render(&s, &medium[k], NULL, &from_front, options, NULL);
    struct prt_screen_input input = {.visibility = s.vis,
                                     .media = {2, medium, (const uint8_t[]){0, 1}},
                                     .n_extra = 1,
                                     .extra = &from_front};
    pixels both = calloc(s.g.n_point, sizeof *both);
    assert_int_equal(prt_screen_radiance(&quiet, s.screen, &input, &options, both, NULL),
                     PRT_OK);
    double apart = 0;
    for (uint32_t i = 0; i < s.g.n_point; i++) {
        uint32_t object = model.block[s.g.block[i]].object;
        for (int c = 0; c < 3; c++) {
            expect_close("radiance among other media", alone[object][i][c], both[i][c], 1e-5);
            apart = fmax(apart, fabs((double)alone[0][i][c] - alone[1][i][c]));
        }
    }
    expect_above("largest difference between the two media", apart, 0.1);
    free(alone[0]);
    free(alone[1]);
    free(both);
    stage_finish(&s);
    model_finish(&model);
}

// Law: light crosses a thin wall: every engine gives the sum over all texels (METHODS §6).
static void thin_wall_shines(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_box(&model, (float[3]){0, 0, 0}, (float[3]){15, 15, 1}, 20);
    struct prt_screen_light light = {{0, 0, -1}, {5, 5, 5}, false};
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 20};
    struct stage s;
    stage_init(&s, &model, camera, 40, 40);
    struct prt_screen_options reference = {.engine = PRT_SCREEN_REFERENCE, .n_sample = 60000};
    pixels want = render(&s, &marble, NULL, &light, reference, NULL);
    double total = 0;
    for (uint32_t i = 0; i < s.g.n_point; i++) total += want[i][1];
    expect_above("mean radiance", total / s.g.n_point, 0.01);
    for (int e = 0; e < PRT_SCREEN_REFERENCE; e++) {
        struct prt_screen_options options = {.engine = (enum prt_screen_engine)e};
        pixels b = render(&s, &marble, NULL, &light, options, NULL);
        double rmse = relative(b, want, s.g.n_point);
        expect_below(expect_name("%s: relative RMSE", prt_screen_engine_name(options.engine)),
                     rmse, 0.013);
        free(b);
    }
    free(want);
    stage_finish(&s);
    model_finish(&model);
}

// Law: object and camera moved together give the same picture (METHODS §8, a turned light on a
// turned body).
static void translation_changes_nothing(void **state)
{
    pixels b[2][4];
    uint32_t n[2];
    for (int moved = 0; moved < 2; moved++) {
        float at[3] = {moved ? 137.3f : 0, moved ? -55.1f : 0, moved ? 20.7f : 0};
        struct model model;
        model_init(&model, 20000, 40000);
        add_sphere(&model, at, 10, 32);
        struct prt_camera camera = {.up = {0, 1, 0}, .fovy_deg = 30};
        for (int k = 0; k < 3; k++) camera.eye[k] = camera.target[k] = at[k];
        camera.eye[2] += 50;
        struct stage s;
        struct prt_screen_light light = {{0.6f, 0.48f, 0.64f}, {3, 3, 3}, false};
        stage_init(&s, &model, camera, 64, 64);
        for (int e = 0; e < 4; e++) {
            struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                                 .n_sample =
                                                     e == PRT_SCREEN_TEXTURE ? 4000 : 0};
            b[moved][e] = render(&s, &marble, NULL, &light, options, NULL);
        }
        n[moved] = s.g.n_point;
        stage_finish(&s);
        model_finish(&model);
    }
    assert_int_equal(n[0], n[1]);
    for (int e = 0; e < 4; e++) {
        double rmse = relative(b[1][e], b[0][e], n[0]);
        expect_below(
            expect_name("%s: change", prt_screen_engine_name((enum prt_screen_engine)e)), rmse,
            0.022); // other samples
        free(b[0][e]);
        free(b[1][e]);
    }
}

// Law: a list of lights has the cube's power (METHODS §2); E on a convex body under a constant
// unit light is 2 pi int F_t mu dmu, traced or by harmonics (METHODS §1, S09).
static void irradiance_closed_forms(void **state)
{
    struct prt_cube cube = constant_cube(16, (float[3]){1, 1, 1});
    static struct prt_screen_light light[600];
    static const uint32_t size[] = {1, 3, 7, 64, 600};
    for (int k = 0; k < 5; k++) {
        uint32_t n = prt_screen_lights_from_cube(&cube, size[k], light);
        double sum = 0;
        for (uint32_t i = 0; i < n; i++) sum += light[i].rgb[1];
        assert_in_range(n, 1, size[k]);
        expect_near("power of the list over the cube's", sum / (4 * M_PI), 1, 1e-5);
    }
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 10, 32);
    struct prt_scene *scene;
    assert_int_equal(prt_scene_create(&quiet, &model.mesh, &scene), PRT_OK);
    struct samples s;
    assert_int_equal(prt_samples_atlas(&quiet, &model.mesh, 2000, &s), PRT_OK);
    double area = 0;
    for (uint32_t i = 0; i < s.n; i++) area += s.area[i];
    expect_near("area of the atlas over the sphere's", area / (400 * M_PI), 1, 0.004);
    static const float eta[2] = {1.3f, 1.5f};
    static const double want[2] = {2.949541, 2.853264};
    uint32_t n = prt_screen_lights_from_cube(&cube, 600, light);
    for (int k = 0; k < 2; k++) {
        for (int harmonic = 0; harmonic < 2; harmonic++) {
            uint64_t rays = 0;
            if (harmonic) prt_irradiance_harmonics(&cube, &eta[k], false, &s);
            else
                assert_int_equal(
                    prt_irradiance_traced(&quiet, scene, n, light, &eta[k], &s, &rays), PRT_OK);
            double mean = 0;
            for (uint32_t i = 0; i < s.n; i++) mean += s.e[0][i] / s.n;
            expect_close(harmonic ? "mean E by harmonics" : "mean E by rays", mean, want[k],
                         harmonic ? 1e-5 : 2e-4);
        }
    }
    // the layers of all three axes together are the whole surface
    uint64_t rays = 0;
    struct samples peel;
    uint32_t *block = prt_mesh_triangle_blocks(&model.mesh);
    assert_int_equal(
        prt_samples_peel(&quiet, scene, &(struct grid){block, 0.5f, {0, 0}, 0}, &peel, &rays),
        PRT_OK);
    area = 0;
    for (uint32_t i = 0; i < peel.n; i++) area += peel.area[i];
    expect_near("area of the layers over the sphere's", area / (400 * M_PI), 1, 0.002);
    prt_samples_finish(&peel);
    prt_free(block);
    prt_samples_finish(&s);
    prt_scene_destroy(scene);
    model_finish(&model);
    free(cube.texel);
}

// E at a normal that has the cosine c with a light of power 1, by four bands of harmonics: the
// sum of (2 l + 1) / (4 pi) f_l P_l(c) with f_l = 2 pi int F_t mu P_l dmu.
static double four_bands(double eta, double c)
{
    enum { STEPS = 2000 };
    const double of_c[4] = {1, c, (3 * c * c - 1) / 2, (5 * c * c * c - 3 * c) / 2};
    double f[4] = {0}, sum = 0;
    for (int i = 0; i < STEPS; i++) {
        const double mu = (i + 0.5) / STEPS, t = prt_fresnel_transmittance(eta, mu) * mu;
        const double p[4] = {1, mu, (3 * mu * mu - 1) / 2, (5 * mu * mu * mu - 3 * mu) / 2};
        for (int l = 0; l < 4; l++) f[l] += 2 * M_PI * t * p[l] / STEPS;
    }
    for (int l = 0; l < 4; l++) sum += (2 * l + 1) / (4 * M_PI) * f[l] * of_c[l];
    return fmax(sum, 0);
}

// Law: E by harmonics of one texel is its radiance times its solid angle times the bands' lobe,
// by the addition theorem: in a face's corner, on its edge and in its middle (METHODS §6, S09).
static void harmonics_of_one_texel(void **state)
{
    enum { SIDE = 8, NORMALS = 20 };
    static const uint32_t place[3][3] = {{0, 0, 0}, {3, 4, 0}, {4, 3, 4}}; // face, x, y
    const float eta = 1.4f;
    struct samples s;
    struct prt_rng rng;
    prt_rng_init(&rng, 4, 0);
    assert_true(prt_samples_init(&s, NORMALS));
    s.n = NORMALS;
    for (uint32_t i = 0; i < s.n; i++) {
        float n[3], l = 0;
        for (int k = 0; k < 3; k++) n[k] = prt_rng_f32(&rng) - 0.5f, l += n[k] * n[k];
        for (int k = 0; k < 3; k++) s.normal[k][i] = n[k] / sqrtf(l);
        s.object[i] = 0;
    }
    for (int p = 0; p < 3; p++) {
        struct prt_cube cube = constant_cube(SIDE, (float[3]){0, 0, 0});
        const uint32_t face = place[p][0], x = place[p][1], y = place[p][2];
        const double omega = prt_cube_solid_angle(SIDE, x, y);
        float d[3];
        for (uint32_t c = 0; c < 3; c++)
            cube.texel[3 * ((face * SIDE + y) * SIDE + x) + c] = 10 * (float)(c + 1);
        prt_cube_direction(face, (2 * x + 1.0) / SIDE - 1, (2 * y + 1.0) / SIDE - 1, d);
        prt_irradiance_harmonics(&cube, &eta, false, &s);
        for (uint32_t i = 0; i < s.n; i++) {
            double cosine = 0;
            for (int k = 0; k < 3; k++) cosine += (double)(d[k] * s.normal[k][i]);
            for (int c = 0; c < 3; c++)
                expect_near("E by harmonics, over radiance and solid angle",
                            (double)s.e[c][i] / (10 * (c + 1) * omega),
                            four_bands((double)eta, cosine), 1e-4);
        }
        free(cube.texel);
    }
    prt_samples_finish(&s);
}

// Law: light adds up. An environment by harmonics leaves further lights as they are: both
// together are their sum (S09; prt_screen_options.sh_irradiance).
static void harmonics_beside_a_light(void **state)
{
    struct model model;
    model_init(&model, 2000, 4000);
    add_sphere(&model, (float[3]){0, 0, 0}, 10, 12);
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct prt_cube cube = constant_cube(8, (float[3]){0.3f, 0.2f, 0.1f});
    struct stage s;
    stage_init(&s, &model, camera, 20, 20);
    const struct prt_screen_options options = {
        .engine = PRT_SCREEN_REFERENCE, .n_sample = 2000, .sh_irradiance = true};
    pixels sky = render(&s, &marble, &cube, NULL, options, NULL);
    pixels sun = render(&s, &marble, NULL, &from_front, options, NULL);
    pixels both = render(&s, &marble, &cube, &from_front, options, NULL);
    for (uint32_t i = 0; i < s.g.n_point; i++)
        for (int c = 0; c < 3; c++) sky[i][c] += sun[i][c];
    expect_below("both together against their sum", relative(both, sky, s.g.n_point), 1e-6);
    free(sky);
    free(sun);
    free(both);
    free(cube.texel);
    stage_finish(&s);
    model_finish(&model);
}

// Law: a lamp gives I cos / d^2, and nothing where a surface lies between it and the point. A
// surface beyond the lamp casts no shadow (METHODS §1, irradiance).
static void lamps_under_a_roof(void **state)
{
    static const struct {
        float where[3];
        bool point;
        double want;
    } row[] = {{{0, 5, 0}, true, 1 / 25.},     // below the roof
               {{3, 4, 0}, true, 0.8 / 25},    // the same, aslant
               {{0, 20, 0}, true, 0},          // above it
               {{0, -5, 0}, true, 0},          // below the floor
               {{40, 30, 0}, true, .6 / 2500}, // past its edge
               {{0, 1, 0}, false, 0},          {{4, 3, 0}, false, 0.6}};
    struct model model;
    struct prt_scene *scene;
    struct samples s;
    uint64_t rays = 0;
    model_init(&model, 100, 100);
    struct prt_block *block = begin_block(&model, true);
    add_sheet(&model, (float[3]){0, 10, 0}, (float[3]){6, 0, 0}, (float[3]){0, 0, 6}, 2);
    end_block(&model, block);
    assert_int_equal(prt_scene_create(&quiet, &model.mesh, &scene), PRT_OK);
    assert_true(prt_samples_init(&s, 1));
    s.n = 1;
    s.object[0] = 0;
    for (int k = 0; k < 3; k++) s.p[k][0] = 0, s.normal[k][0] = s.face[k][0] = k == 1;
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        struct prt_screen_light light = {.rgb = {1, 2, 0}, .point = row[i].point};
        const float *w = row[i].where;
        const float length = row[i].point ? 1 : hypotf(w[0], w[1]);
        for (int k = 0; k < 3; k++) light.where[k] = w[k] / length;
        assert_int_equal(prt_irradiance_traced(&quiet, scene, 1, &light, NULL, &s, &rays),
                         PRT_OK);
        for (int c = 0; c < 3; c++)
            expect_near(row[i].point ? "E of a lamp" : "E from afar", s.e[c][0],
                        row[i].want * (double)light.rgb[c], 1e-6);
    }
    prt_samples_finish(&s);
    prt_scene_destroy(scene);
    model_finish(&model);
}

// Law: fewer lights than six faces are one, of the cube's power and from the mean direction of
// its power (METHODS §6).
static void few_lights_are_their_mean(void **state)
{
    enum { SIDE = 8 };
    static const struct {
        uint32_t face, x, y;
        float rgb[3];
    } lamp[] = {{0, 5, 2, {3, 1, 2}}, {2, 1, 6, {0.5f, 0.2f, 0.1f}}, {5, 3, 3, {0, 1, 1}}};
    struct prt_cube cube = constant_cube(SIDE, (float[3]){0, 0, 0});
    double want[3] = {0}, mean[3] = {0}, length = 0;
    for (size_t i = 0; i < sizeof lamp / sizeof *lamp; i++) {
        const uint32_t x = lamp[i].x, y = lamp[i].y;
        const double omega = prt_cube_solid_angle(SIDE, x, y);
        float d[3];
        prt_cube_direction(lamp[i].face, (2 * x + 1.0) / SIDE - 1, (2 * y + 1.0) / SIDE - 1, d);
        for (int c = 0; c < 3; c++) {
            cube.texel[3 * ((lamp[i].face * SIDE + y) * SIDE + x) + (uint32_t)c] =
                lamp[i].rgb[c];
            want[c] += omega * (double)lamp[i].rgb[c];
            for (int k = 0; k < 3; k++)
                mean[k] += omega * (double)lamp[i].rgb[c] * (double)d[k];
        }
    }
    for (int k = 0; k < 3; k++) length += mean[k] * mean[k];
    for (uint32_t n = 1; n < 6; n++) {
        struct prt_screen_light light[6];
        assert_int_equal(prt_screen_lights_from_cube(&cube, n, light), 1);
        for (int k = 0; k < 3; k++) {
            expect_near("power of the one light", (double)light[0].rgb[k], want[k], 1e-6);
            expect_near("direction of the one light", (double)light[0].where[k],
                        mean[k] / sqrt(length), 1e-6);
        }
    }
    free(cube.texel);
}

// Law: errors against the sum over all texels fall as samples grow (METHODS §6, expected
// error).
static void errors_fall(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_box(&model, (float[3]){0, 0, 0}, (float[3]){10, 6, 8}, 12);
    struct prt_camera camera = {.eye = {30, 20, 50}, .up = {0, 1, 0}, .fovy_deg = 25};
    struct stage s;
    stage_init(&s, &model, camera, 64, 64);
    struct prt_cube cube = constant_cube(16, (float[3]){0.2f, 0.2f, 0.2f});
    for (int i = 0; i < 12; i++) cube.texel[3 * (2 * 256 + 100 + i) + 1] = 40; // a lamp in +Y
    static const uint32_t n[4][2] = {{40, 160}, {8, 256}, {200, 8000}, {100, 2000}};
    for (int lit = 0; lit < 2; lit++) {
        struct prt_screen_light light = {{0.3f, 0.8f, 0.5f}, {3, 3, 3}, false};
        struct prt_screen_options exact = {.engine = PRT_SCREEN_REFERENCE, .n_sample = 100000};
        pixels want = render(&s, &marble, lit ? &cube : NULL, lit ? NULL : &light, exact, NULL);
        for (int e = 0; e < 4; e++) {
            double rmse[2];
            for (int k = 0; k < 2; k++) {
                struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                                     .n_sample = n[e][k]};
                struct prt_screen_report report;
                pixels b = render(&s, &marble, lit ? &cube : NULL, lit ? NULL : &light, options,
                                  &report);
                rmse[k] = relative(b, want, s.g.n_point);
                assert_true(report.n_light >= 1 && report.n_sample > 0 && report.n_ray > 0);
                free(b);
            }
            const char *name = prt_screen_engine_name((enum prt_screen_engine)e);
            const char *sky = lit ? "environment" : "distant light";
            expect_below(expect_name("%s, %s: error with more samples", sky, name), rmse[1],
                         0.07);
            expect_below(expect_name("%s, %s: over that with few", sky, name),
                         rmse[1] / rmse[0], 1);
        }
        free(want);
    }
    free(cube.texel);
    stage_finish(&s);
    model_finish(&model);
}

// Contract of prt_screen_image: nothing to see, degenerate triangles, a camera inside or an
// opaque model give a picture without NaN; options out of range are refused.
static void odd_input_gives_pictures(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 10, 12);
    // zero-area triangles at the end of the block
    for (int i = 0; i < 8; i++) {
        uint32_t t[3] = {5, 5, 9};
        memcpy(model.mesh.triangle[model.mesh.n_triangle++], t, 12);
    }
    end_block(&model, &model.block[0]);
    struct prt_camera inside = {
        .eye = {0, 0, 0}, .target = {0, 0, -1}, .up = {0, 1, 0}, .fovy_deg = 60};
    struct prt_camera away = {
        .eye = {0, 0, 50}, .target = {0, 0, 90}, .up = {0, 1, 0}, .fovy_deg = 30};
    struct prt_screen_light point = {{3, 30, 30}, {900, 900, 900}, true};
    for (int k = 0; k < 2; k++) {
        struct stage s;
        stage_init(&s, &model, k ? away : inside, 24, 24);
        for (int e = 0; e <= PRT_SCREEN_REFERENCE; e++) {
            struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                                 .n_sample =
                                                     e == PRT_SCREEN_REFERENCE ? 9000 : 0,
                                                 .budget_ms = e == 2 ? 5 : 0};
            struct prt_screen_report report;
            pixels b = render(&s, &marble, NULL, &point, options, &report);
            if (!k) expect_above("radiance seen from inside", b[0][0], 0);
            free(b);
        }
        struct prt_shade shade = {.media = {1, &marble, NULL}, .fresnel = true};
        struct prt_screen_options options = {.measure_error = true};
        struct prt_screen_report report;
        struct prt_image image;
        struct prt_screen_input input = {
            .visibility = s.vis, .media = {1, &marble, NULL}, .n_extra = 1, .extra = &point};
        assert_int_equal(
            prt_screen_image(&quiet, s.screen, &input, &options, &shade, &image, &report),
            PRT_OK);
        for (int i = 0; i < 24 * 24 * 3; i++) assert_true(isfinite(image.rgb[i]));
        if (!k) expect_near("reported error", report.error, 0.05, 0.05);
        prt_image_finish(&image);
        stage_finish(&s);
    }
    model.surface[0].translucent = 0;
    struct stage s;
    struct prt_camera front = {.eye = {0, 0, 50}, .up = {0, 1, 0}, .fovy_deg = 30};
    stage_init(&s, &model, front, 33, 33);
    pixels b = render(&s, &marble, NULL, &from_front, (struct prt_screen_options){0}, NULL);
    float most = 0; // albedo/pi E at the middle
    for (uint32_t i = 0; i < s.g.n_point; i++) most = fmaxf(most, b[i][2]);
    expect_near("albedo/pi E of an opaque model", most, 0.5 / M_PI * 3, 3e-4);
    free(b);
    struct prt_screen_light bad = {{NAN, 0, 0}, {1, 1, 1}, false};
    struct prt_screen_options options = {0};
    b = malloc(s.g.n_point * sizeof *b);
    assert_int_equal(try_render(&s, &marble, NULL, &bad, &options, b, NULL), PRT_ARG);
    static const struct prt_screen_options nonsense[] = {
        {.n_sample = 5000},
        {.n_sample = 1},
        {.engine = PRT_SCREEN_TANGENT, .n_sample = 1u << 20},
        {.engine = PRT_SCREEN_TEXTURE, .n_sample = 1u << 30},
        {.budget_ms = -1},
        {.epsilon = 1},
        {.bound = NAN},
        {.engine = (enum prt_screen_engine)9}};
    for (size_t i = 0; i < sizeof nonsense / sizeof *nonsense; i++)
        assert_int_equal(try_render(&s, &marble, NULL, &from_front, &nonsense[i], b, NULL),
                         PRT_ARG);
    struct prt_material broken = marble;
    broken.sigma_a[1] = NAN;
    assert_int_equal(try_render(&s, &broken, NULL, &from_front, &options, b, NULL), PRT_ARG);
    free(b);
    stage_finish(&s);
    model_finish(&model);
}

// Law: every engine gives the reference's B/pi under a cube of light with a lamp (METHODS §8).
static void reference_engine_agrees(void **state)
{
    enum { N = 120 };
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 10, 40);
    struct prt_camera camera = {.eye = {0, 8, 60}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct prt_cube cube = constant_cube(16, (float[3]){0.3f, 0.3f, 0.4f});
    for (int i = 0; i < 4; i++) cube.texel[3 * (2 * 256 + 100 + i) + 1] = 60;
    struct prt_material medium = marble;
    for (int c = 0; c < 3; c++) medium.sigma_s_prime[c] *= 0.5f;
    struct stage s;
    stage_init(&s, &model, camera, 100, 100);
    static uint32_t vertex[3 * N];
    static float want[3 * N][3];
    for (uint32_t i = 0; i < N; i++)
        for (int k = 0; k < 3; k++)
            vertex[3 * i + (uint32_t)k] = s.g.corner[k][(uint64_t)i * s.g.n_point / N];
    struct prt_reference_options reference = {.term = PRT_REFERENCE_MULTIPLE,
                                              .n_sample = 12000,
                                              .n_ray = 512,
                                              .vertex = vertex,
                                              .n_vertex = 3 * N};
    assert_int_equal(prt_reference_colors(&quiet, &model.mesh,
                                          &(struct prt_media){1, &medium, NULL}, &cube,
                                          &reference, want),
                     PRT_OK);
    for (int e = 0; e < 4; e++) {
        struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                             .n_light = 128};
        pixels b = render(&s, &medium, &cube, NULL, options, NULL);
        double num = 0, den = 0;
        for (uint32_t i = 0; i < N; i++) {
            uint32_t at = (uint32_t)((uint64_t)i * s.g.n_point / N);
            float w[3] = {1 - s.g.bary[0][at] - s.g.bary[1][at], s.g.bary[0][at],
                          s.g.bary[1][at]};
            for (int c = 0; c < 3; c++) {
                double q = 0;
                for (uint32_t k = 0; k < 3; k++) q += (double)w[k] * want[3 * i + k][c];
                num += (b[at][c] - q) * (b[at][c] - q);
                den += q * q;
            }
        }
        expect_below(expect_name("%s: relative RMSE", prt_screen_engine_name(options.engine)),
                     sqrt(num / den), 0.05);
        free(b);
    }
    free(cube.texel);
    stage_finish(&s);
    model_finish(&model);
}

// Law: refined pictures converge to the sum over all texels (METHODS §6, running mean).
static void refinement_converges(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 5, 32);
    struct prt_camera camera = {.eye = {0, 3, 30}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct prt_screen_light light = {{0.3f, 0.8f, 0.5f}, {3, 3, 3}, false};
    struct stage s;
    stage_init(&s, &model, camera, 80, 80);
    struct prt_screen_options exact = {.engine = PRT_SCREEN_REFERENCE, .n_sample = 80000};
    pixels want = render(&s, &marble, NULL, &light, exact, NULL);
    static const double last[4] = {0.006, 0.02, 0.005, 0.009};
    for (int e = 0; e < 4; e++) {
        double rmse[2];
        for (uint32_t k = 0; k < 2; k++) {
            struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                                 .n_sample = e == PRT_SCREEN_TANGENT ? 16 : 0,
                                                 .refine = 4 * k};
            pixels b = render(&s, &marble, NULL, &light, options, NULL);
            rmse[k] = relative(b, want, s.g.n_point);
            free(b);
        }
        const char *name = prt_screen_engine_name((enum prt_screen_engine)e);
        expect_below(expect_name("%s: error when refined", name), rmse[1], last[e]);
        expect_below(expect_name("%s: over the first error", name), rmse[1] / rmse[0], 1);
    }
    free(want);
    stage_finish(&s);
    model_finish(&model);
}

// Law: E given at the vertices gives the picture that traced E gives (METHODS §6), without
// rays.
static void known_irradiance_needs_no_rays(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 10, 40);
    struct prt_camera camera = {.eye = {0, 8, 60}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct stage s;
    stage_init(&s, &model, camera, 72, 72);
    // a sphere casts no shadow on what faces the light: E = F_t cos L
    float(*e)[3] = calloc(model.mesh.n_vertex, sizeof *e);
    for (uint32_t v = 0; v < model.mesh.n_vertex; v++) {
        double c = (double)model.mesh.normal[v][2];
        for (int k = 0; k < 3 && c > 0; k++)
            e[v][k] = (float)((k + 1) * c * prt_fresnel_transmittance(1.5, fmin(c, 1)));
    }
    for (int engine = 0; engine <= PRT_SCREEN_REFERENCE; engine++) {
        struct prt_screen_options options = {.engine = (enum prt_screen_engine)engine};
        if (engine == PRT_SCREEN_TEXTURE) options.n_sample = 4000;
        if (engine == PRT_SCREEN_REFERENCE) options.n_sample = 40000;
        struct prt_screen_report report;
        pixels traced = render(&s, &marble, NULL, &from_front, options, NULL);
        options.vertex_irradiance = (const float(*)[3])e;
        pixels known = render(&s, &marble, NULL, &from_front, options, &report);
        expect_below("relative RMSE, known against traced E",
                     relative(known, traced, s.g.n_point), 0.02);
        assert_true(engine == PRT_SCREEN_SPLAT || report.n_ray == 0); // its layers are traced
        free(traced);
        free(known);
    }
    free(e);
    stage_finish(&s);
    model_finish(&model);
}

struct stopper {
    int asked, stop_at;
};

static int stop_there(void *user, const char *stage, double fraction, double eta_s)
{
    struct stopper *stopper = user;
    return stopper->asked++ >= stopper->stop_at;
}

// Contract of prt_screen_radiance: a stopped frame returns PRT_CANCELLED and leaves the next
// alone.
static void frames_can_be_stopped(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 5, 24);
    struct prt_camera camera = {.eye = {0, 3, 30}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct prt_cube cube = constant_cube(16, (float[3]){1, 1, 1});
    struct stage s, fresh;
    stage_init(&s, &model, camera, 40, 40);
    for (int e = 0; e < 5; e++) {
        struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                             .n_sample =
                                                 e == PRT_SCREEN_REFERENCE ? 4000 : 100};
        pixels out = malloc((s.g.n_point + 1) * sizeof *out);
        int stops = 0;
        for (int at = 0; at < 40; at++) {
            struct stopper stopper = {0, at};
            quiet.progress = stop_there;
            quiet.progress_user = &stopper;
            int status = try_render(&s, &marble, &cube, NULL, &options, out, NULL);
            quiet.progress = NULL;
            assert_int_equal(status, stopper.asked > at ? PRT_CANCELLED : PRT_OK);
            if (!status) break;
            stops++;
        }
        assert_true(stops >= 2 && stops < 40);
        stage_init(&fresh, &model, camera, 40, 40);
        pixels want = render(&fresh, &marble, &cube, NULL, options, NULL);
        assert_memory_equal(out, want, s.g.n_point * sizeof *out);
        stage_finish(&fresh);
        free(want);
        free(out);
    }
    stage_finish(&s);
    prt_cube_finish(&cube);
    model_finish(&model);
}

// Contract of prt_screen_engine_parse: every engine has its own word.
static void engine_words(void **state)
{
    enum prt_screen_engine e;
    for (int k = 0; k <= PRT_SCREEN_REFERENCE; k++) {
        const char *name = prt_screen_engine_name((enum prt_screen_engine)k);
        assert_int_equal(prt_screen_engine_parse(name, &e), PRT_OK);
        assert_int_equal((int)e, k);
    }
    assert_int_equal(prt_screen_engine_parse("vertex", &e), PRT_ARG);
}

// Law: the texels of each object stand for its own surface, also of one so small that it has
// more of them than its share (C08).
static void texels_stand_for_their_object(void **state)
{
    static const float radius[2] = {10, 0.3f};
    struct model model;
    model_init(&model, 20000, 40000);
    for (int k = 0; k < 2; k++)
        add_sphere(&model, (float[3]){14 * (float)k, 0, 0}, radius[k], 32);
    struct samples s;
    assert_int_equal(prt_samples_atlas(&quiet, &model.mesh, 2000, &s), PRT_OK);
    double area[2] = {0, 0};
    for (uint32_t i = 0; i < s.n; i++) area[s.object[i]] += (double)s.area[i];
    for (int k = 0; k < 2; k++)
        expect_near("area of an object's texels over its sphere's",
                    area[k] / (4 * M_PI * (double)radius[k] * (double)radius[k]), 1, 0.004);
    prt_samples_finish(&s);
    model_finish(&model);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(texels_stand_for_their_object),
        cmocka_unit_test(plane_gives_total_reflectance),
        cmocka_unit_test(touching_objects_exchange_nothing),
        cmocka_unit_test(media_keep_apart),
        cmocka_unit_test(thin_wall_shines),
        cmocka_unit_test(translation_changes_nothing),
        cmocka_unit_test(irradiance_closed_forms),
        cmocka_unit_test(harmonics_of_one_texel),
        cmocka_unit_test(harmonics_beside_a_light),
        cmocka_unit_test(lamps_under_a_roof),
        cmocka_unit_test(few_lights_are_their_mean),
        cmocka_unit_test(errors_fall),
        cmocka_unit_test(odd_input_gives_pictures),
        cmocka_unit_test(reference_engine_agrees),
        cmocka_unit_test(refinement_converges),
        cmocka_unit_test(known_irradiance_needs_no_rays),
        cmocka_unit_test(frames_can_be_stopped),
        cmocka_unit_test(engine_words),
    };
    return run_physics_tests(tests, screen_setup, screen_teardown);
}
