// SPDX-License-Identifier: MIT
// The ratio of walks to the dipole under even irradiance, and pictures that are scaled by it
// (METHODS §6, walk ratio).
#include "../../libprt/screen/walk_ratio.h"
#include "screen_stage.h"

#include "prt/reference.h"
#include "prt/walk_ratio.h"

static char last_warning[400];
static unsigned n_warning;

static void keep_warning(void *user, enum prt_log_level level, const char *line)
{
    if (level != PRT_LOG_WARNING) return;
    snprintf(last_warning, sizeof last_warning, "%s", line);
    n_warning++;
}

static struct prt_material medium(float sigma_s_prime, float sigma_a)
{
    struct prt_material m = {.name = "medium", .eta = 1.3f, .roughness = 0.3f};
    for (int c = 0; c < 3; c++) {
        m.sigma_s_prime[c] = sigma_s_prime;
        m.sigma_a[c] = sigma_a;
    }
    return m;
}

static const struct prt_material *preset(const char *name)
{
    const struct prt_material *m;
    for (unsigned i = 0; (m = prt_material_preset(i)); i++)
        if (!strcmp(m->name, name)) return m;
    fail_msg("no preset %s", name);
    return NULL;
}

static struct prt_mesh *box(float x, float y, float z, uint32_t n)
{
    struct model m;
    model_init(&m, 6 * (n + 1) * (n + 1), 12 * n * n);
    add_box(&m, (float[]){0, 0, 0}, (float[]){x / 2, y / 2, z / 2}, n);
    return body_mesh(&quiet, &m, true);
}

static struct prt_mesh *ball(body_radius radius, double radius_mm)
{
    struct model m;
    model_init(&m, 96 * 49, 96 * 48 * 2);
    if (radius) add_ball(&m, 96, 48, 48, radius);
    else add_round_ball(&m, 96, 48, radius_mm);
    return body_mesh(&quiet, &m, true);
}

// A leaf: 1 mm in the middle, bent, with sharp edges.
static struct prt_mesh *leaf(void)
{
    struct model m;
    model_init(&m, 48 * 25, 48 * 24 * 2);
    add_round_ball(&m, 48, 24, 1);
    struct prt_mesh *mesh = body_mesh(&quiet, &m, false);
    for (uint32_t v = 0; v < mesh->n_vertex; v++) {
        float *p = mesh->position[v];
        p[0] *= 12, p[1] *= 0.5f, p[2] *= 8;
        p[1] += p[0] * p[0] / 30;
        for (int k = 0; k < 3; k++) mesh->normal[v][k] = 0;
    }
    prt_free(mesh->model); // of other positions
    mesh->model = NULL;
    assert_int_equal(prt_mesh_normals(&quiet, mesh), PRT_OK);
    return mesh;
}

// A body with its view and engines, and its ratio.
struct scene {
    struct prt_mesh *mesh;
    struct prt_scene *scene;
    struct prt_screen *screen;
    struct prt_visibility *vis;
    struct prt_gbuffer g;
    struct prt_walk_ratio *ratio;
    struct prt_walk_ratio_report report;
};

static struct scene scene_of(struct prt_mesh *mesh, const struct prt_material *material)
{
    struct scene s = {.mesh = mesh};
    struct prt_media media = prt_media_one(material);
    struct prt_camera camera = {.automatic = true};
    assert_int_equal(prt_scene_create(&quiet, mesh, &s.scene), PRT_OK);
    assert_int_equal(prt_screen_create(&quiet, mesh, s.scene, &s.screen), PRT_OK);
    assert_int_equal(prt_visibility_create(&quiet, mesh, &camera,
                                           &(struct prt_raster){64, 48, 1, PRT_RASTER_AUTO},
                                           &s.vis),
                     PRT_OK);
    prt_visibility_gbuffer(s.vis, &s.g);
    assert_int_equal(prt_walk_ratio_create(&quiet, s.scene, &media, 64, 1, &s.ratio, &s.report),
                     PRT_OK);
    return s;
}

static void scene_finish(struct scene *s)
{
    prt_walk_ratio_destroy(s->ratio);
    prt_visibility_destroy(s->vis);
    prt_screen_destroy(s->screen);
    prt_scene_destroy(s->scene);
    prt_mesh_destroy(s->mesh);
}

static pixels draw(const struct scene *s, const struct prt_material *material,
                   const struct prt_cube *cube, struct prt_screen_options o)
{
    pixels out = malloc((s->g.n_point + 1u) * sizeof *out);
    const struct prt_screen_input input = {
        .visibility = s->vis, .media = prt_media_one(material), .cube = cube};
    assert_int_equal(prt_screen_radiance(&quiet, s->screen, &input, &o, out, NULL), PRT_OK);
    return out;
}

// The mean over the picture's points, and the channels, of colours at the vertices.
static double mean_of_vertices(const struct scene *s, const float (*color)[3])
{
    double mean = 0;
    for (uint32_t i = 0; i < s->g.n_point; i++) {
        const double u = (double)s->g.bary[0][i], v = (double)s->g.bary[1][i];
        for (int c = 0; c < 3; c++)
            mean += (1 - u - v) * (double)color[s->g.corner[0][i]][c] +
                    u * (double)color[s->g.corner[1][i]][c] +
                    v * (double)color[s->g.corner[2][i]][c];
    }
    return mean / s->g.n_point / 3;
}

static double mean_of(const struct scene *s, pixels rgb)
{
    double mean = 0;
    for (uint32_t i = 0; i < s->g.n_point; i++)
        for (int c = 0; c < 3; c++) mean += (double)rgb[i][c];
    return mean / s->g.n_point / 3;
}

// The irradiance at the vertices, exactly: engines' own lights err by some 3 %.
static pixels irradiance_of(const struct scene *s, const struct prt_media *media,
                            const struct prt_cube *cube)
{
    const struct prt_reference_options o = {.term = PRT_REFERENCE_IRRADIANCE, .n_ray = 1024};
    pixels e = malloc((s->mesh->n_vertex + 1u) * sizeof *e);
    assert_int_equal(prt_reference_colors(&quiet, s->mesh, media, cube, &o, e), PRT_OK);
    return e;
}

// Weights of a search, and the same times a number of each point's own.
struct gathered {
    double weight, moment;
    unsigned n;
};

static void take_point(void *arg, const struct ratio_point *point, float weight)
{
    struct gathered *g = arg;
    g->weight += (double)weight;
    g->moment += (double)(weight * point->dipole[0]);
    g->n++;
}

// Contract of prt_ratio_gather: each point of the object in reach, once, with the weight
// (1 - (d / reach)^2)^2 ((1 + cosine of the normals) / 2)^8, which a search of all points
// gives.
static void points_in_reach_by_their_weight(void **state)
{
    enum { POINTS = 600, SEARCHES = 200 };
    static struct ratio_point point[POINTS];
    struct ratio_grid grid;
    struct prt_rng rng;
    unsigned found = 0;
    prt_rng_init(&rng, 17, 0);
    for (int i = 0; i < POINTS + SEARCHES; i++) {
        struct ratio_point q = {.object = prt_rng_u32(&rng) % 2};
        float length = 0;
        q.dipole[0] = prt_rng_f32(&rng);
        for (int k = 0; k < 3; k++) {
            q.p[k] = (float)(9 >> k) * prt_rng_f32(&rng);
            q.n[k] = prt_rng_f32(&rng) - 0.5f;
            length += q.n[k] * q.n[k];
        }
        for (int k = 0; k < 3; k++) q.n[k] /= sqrtf(length);
        if (i < POINTS) point[i] = q;
        if (i == POINTS - 1)
            assert_int_equal(prt_ratio_grid_create(point, POINTS, 0.7f, &grid), PRT_OK);
        if (i < POINTS) continue;
        struct gathered got = {0}, want = {0};
        const float reach = 0.2f + 4 * q.dipole[0];
        prt_ratio_gather(&grid, q.p, q.n, q.object, reach, take_point, &got);
        for (int j = 0; j < POINTS; j++) {
            double d2 = 0, cosine = 0;
            for (int k = 0; k < 3; k++) {
                d2 += pow((double)(point[j].p[k] - q.p[k]), 2);
                cosine += (double)(point[j].n[k] * q.n[k]);
            }
            const double near = 1 - d2 / ((double)reach * (double)reach);
            if (near <= 0 || point[j].object != q.object) continue;
            const double weight = near * near * pow((1 + cosine) / 2, 8);
            want.weight += weight;
            want.moment += weight * (double)point[j].dipole[0];
        }
        expect_near("sum of weights", got.weight, want.weight, 1e-4);
        expect_near("sum of weighted points", got.moment, want.moment, 1e-4);
        found += got.n;
    }
    expect_above("points that were found", found, 1000);
    prt_ratio_grid_finish(&grid);
}

// Law: where nothing is absorbed, all light that enters leaves (METHODS §9, furnace): under
// irradiance 1 a picture that is scaled to all walks is 1, where the dipole's is 1.26 in a
// slab. W itself has no error here; D is interpolated between points, and at the edges of a box
// falls to less than half within one free path.
static void white_bodies_return_what_falls_on_them(void **state)
{
    struct prt_mesh *const body[] = {box(20, 2, 20, 1), box(20, 2, 20, 16), ball(NULL, 5)};
    const struct prt_material white = medium(1, 0);
    for (unsigned b = 0; b < 3; b++) {
        struct scene s = scene_of(body[b], &white);
        struct prt_screen_options o = {.engine = PRT_SCREEN_REFERENCE, .n_sample = 131072};
        pixels one = malloc(s.mesh->n_vertex * sizeof *one);
        double most = 0, least = INFINITY, off = 0, before = 0;
        for (uint32_t v = 0; v < s.mesh->n_vertex; v++) one[v][0] = one[v][1] = one[v][2] = 1;
        o.vertex_irradiance = (const float(*)[3])one;
        pixels plain = draw(&s, &white, NULL, o);
        o.ratio = s.ratio, o.ratio_share = PRT_WALK_ALL;
        pixels scaled = draw(&s, &white, NULL, o);
        for (uint32_t i = 0; i < s.g.n_point; i++) {
            const double x = M_PI * (double)scaled[i][0];
            before = fmax(before, (double)plain[i][0]);
            most = fmax(most, x);
            least = fmin(least, x);
            off += fabs(x - 1) > 0.03;
        }
        if (b < 2) expect_above("slab: brightest pixel by the dipole", M_PI * before, 1.2);
        else expect_below("ball: brightest pixel by the dipole", M_PI * before, 0.8);
        expect_near("mean of the picture", M_PI * mean_of(&s, scaled), 1, 0.005);
        expect_below("share of pixels further than 3 % from 1", off / s.g.n_point, 0.03);
        expect_below("brightest pixel", most, b < 2 ? 1.1 : 1.01);
        expect_above("darkest pixel", least, b < 2 ? 0.85 : 0.99);
        expect_below("standard error", s.report.standard_error, 3e-4);
        free(one);
        free(plain);
        free(scaled);
        scene_finish(&s);
    }
}

// Law: under an even sky the mean exitance of the scaled picture is that of the walks. The
// bound: the engine's expected error is up to 0.018, 3 standard errors of both means, over some
// 600 groups and 500 vertices, are below 0.01.
static void thin_parts_return_what_walks_return(void **state)
{
    static const char *const media[] = {"marble", "skin1"};
    struct prt_cube cube = constant_cube(16, (float[]){1, 1, 1});
    for (unsigned b = 0; b < 4; b++) {
        const struct prt_material *m = preset(media[b % 2]);
        const char *body = b < 2 ? "slab" : "leaf";
        struct scene s = scene_of(b < 2 ? box(20, 2, 20, 8) : leaf(), m);
        const struct prt_media all = prt_media_one(m);
        struct prt_reference_options o = {
            .term = PRT_REFERENCE_MULTIPLE, .n_sample = 20000, .n_ray = 256, .n_walk = 64};
        struct prt_screen_options options = {.engine = PRT_SCREEN_TEXTURE};
        pixels truth = malloc(s.mesh->n_vertex * sizeof *truth);
        pixels e = irradiance_of(&s, &all, &cube);
        options.vertex_irradiance = (const float(*)[3])e;
        assert_int_equal(prt_reference_colors(&quiet, s.mesh, &all, &cube, &o, truth), PRT_OK);
        const double want = mean_of_vertices(&s, (const float(*)[3])truth);
        pixels plain = draw(&s, m, &cube, options);
        options.ratio = s.ratio, options.ratio_share = PRT_WALK_MULTIPLE;
        pixels scaled = draw(&s, m, &cube, options);
        print_message("  %s, %s: dipole %.3f, scaled %.3f of the walks\n", body, m->name,
                      mean_of(&s, plain) / want, mean_of(&s, scaled) / want);
        expect_near(expect_name("%s, %s: mean over that of walks", body, m->name),
                    mean_of(&s, scaled) / want, 1, 0.028);
        if (b > 1) expect_above("leaf: by the dipole", mean_of(&s, plain) / want, 1.5);
        free(truth);
        free(e);
        free(plain);
        free(scaled);
        scene_finish(&s);
    }
    prt_cube_finish(&cube);
}

// Contract: equal inputs give equal ratios for any number of threads.
static void threads_do_not_matter(void **state)
{
    struct prt_mesh *mesh = box(6, 2, 6, 4);
    const struct prt_media media = prt_media_one(preset("ketchup"));
    struct prt_walk_ratio *ratio[2];
    struct prt_scene *scene;
    assert_int_equal(prt_scene_create(&quiet, mesh, &scene), PRT_OK);
    for (unsigned k = 0; k < 2; k++) {
        struct prt_context own = quiet;
        assert_int_equal(prt_pool_create(k ? 3 : 1, &own.pool), PRT_OK);
        assert_int_equal(prt_walk_ratio_create(&own, scene, &media, 50, 7, &ratio[k], NULL),
                         PRT_OK);
        prt_pool_destroy(own.pool);
    }
    for (int share = 0; share < PRT_WALK_SHARES; share++) {
        float at[2][3];
        assert_memory_equal(prt_walk_ratio_vertices(ratio[0], (enum prt_walk_share)share),
                            prt_walk_ratio_vertices(ratio[1], (enum prt_walk_share)share),
                            mesh->n_vertex * sizeof(float[3]));
        for (unsigned k = 0; k < 2; k++)
            prt_walk_ratio_at(ratio[k], (enum prt_walk_share)share, 5, 0.2f, 0.3f, at[k]);
        assert_memory_equal(at[0], at[1], sizeof at[0]);
    }
    for (unsigned k = 0; k < 2; k++) prt_walk_ratio_destroy(ratio[k]);
    prt_scene_destroy(scene);
    prt_mesh_destroy(mesh);
}

// Law: W/D has no steps, along a line over triangles that are larger, and smaller, than the
// distance of the points.
static void ratio_is_continuous(void **state)
{
    const struct prt_material *m = preset("marble");
    for (unsigned n = 1; n <= 64; n *= 64) {
        struct prt_mesh *mesh = box(8, 2, 8, n);
        const struct prt_media media = prt_media_one(m);
        struct prt_walk_ratio *ratio;
        struct prt_scene *scene;
        enum { STEPS = 20000 };
        float last = 0, most = 0, low = INFINITY, high = 0;
        assert_int_equal(prt_scene_create(&quiet, mesh, &scene), PRT_OK);
        assert_int_equal(prt_walk_ratio_create(&quiet, scene, &media, 50, 7, &ratio, NULL),
                         PRT_OK);
        for (unsigned i = 0; i < STEPS; i++) { // along x, above the upper face
            const float o[3] = {7.9f * ((float)i / STEPS - 0.5f), 5, 1.23f};
            const float down[3] = {0, -1, 0};
            float t, u, v, at[3];
            uint32_t triangle;
            assert_true(prt_scene_intersect(scene, o, down, 0, 10, &t, &triangle, &u, &v));
            prt_walk_ratio_at(ratio, PRT_WALK_MULTIPLE, triangle, u, v, at);
            if (i) most = fmaxf(most, fabsf(at[0] - last));
            last = at[0], low = fminf(low, last), high = fmaxf(high, last);
        }
        expect_below(expect_name("largest step over the range, %u squares", n),
                     most / (high - low), 0.01);
        prt_walk_ratio_destroy(ratio);
        prt_scene_destroy(scene);
        prt_mesh_destroy(mesh);
    }
}

// Contract: a body with a large hole keeps the dipole, with a warning; walks have a range.
static void holes_keep_the_dipole(void **state)
{
    const struct prt_media media = prt_media_one(preset("marble"));
    struct prt_walk_ratio_report report;
    struct prt_walk_ratio *ratio;
    struct prt_scene *scene;
    struct model m;
    model_init(&m, 24 * 13, 24 * 12 * 2);
    add_ball(&m, 24, 12, 4, dented_ball);
    struct prt_mesh *mesh = body_mesh(&quiet, &m, true);
    assert_int_equal(prt_scene_create(&quiet, mesh, &scene), PRT_OK);
    n_warning = 0;
    assert_int_equal(prt_walk_ratio_create(&quiet, scene, &media, 50, 0, &ratio, &report),
                     PRT_OK);
    assert_int_equal(n_warning, 1);
    assert_non_null(strstr(last_warning, "of the walks escape through holes"));
    assert_ptr_equal(strstr(last_warning, "object 0: "), last_warning); // it has no name
    assert_int_equal(report.n_kept, 1);
    for (uint32_t v = 0; v < mesh->n_vertex; v++)
        for (int c = 0; c < 3; c++)
            assert_true(prt_walk_ratio_vertices(ratio, PRT_WALK_ALL)[v][c] == 1);
    prt_walk_ratio_destroy(ratio);
    assert_int_equal(prt_walk_ratio_create(&quiet, scene, &media, 15, 0, &ratio, NULL),
                     PRT_ARG);
    prt_scene_destroy(scene);
    prt_mesh_destroy(mesh);
}

// Law: walks that fade away in a dark medium did not escape: a closed body of it is scaled, and
// nothing is said about holes.
static void dark_media_have_no_holes(void **state)
{
    const struct prt_material ink = medium(5, 5);
    struct prt_mesh *mesh = ball(NULL, 20);
    n_warning = 0;
    struct scene s = scene_of(mesh, &ink);
    assert_int_equal(n_warning, 0);
    assert_int_equal(s.report.n_kept, 0);
    expect_below("share of walks that escape", s.report.leaked, 1e-3);
    scene_finish(&s);
}

// Law: the dipole's error in a medium is that of the objects that have it (METHODS §9): of two
// boxes together the points are those of either, and the errors are not the same.
static void errors_are_of_one_medium(void **state)
{
    const struct prt_material both[2] = {*preset("skimmilk"), medium(1, 2)};
    const uint8_t of_object[2] = {0, 1};
    const struct prt_media media = {2, both, of_object};
    struct prt_walk_ratio_report report;
    struct prt_walk_ratio *ratio;
    struct prt_dipole_error error[3];
    struct prt_scene *scene;
    struct model m;
    struct part part[2] = {{0}};
    model_init(&m, 600, 1000);
    for (uint32_t i = 0; i < 2; i++) {
        part[i] = (struct part){m.mesh.n_vertex, m.mesh.n_triangle, NULL};
        add_box(&m, (float[]){i ? 20 : -20, 0, 0}, (float[]){8, i ? 1.5f : 1, 6}, 4);
    }
    struct prt_mesh *mesh = body_mesh(&quiet, &m, true);
    split_parts(mesh, 2, part);
    assert_int_equal(prt_scene_create(&quiet, mesh, &scene), PRT_OK);
    assert_int_equal(prt_walk_ratio_create(&quiet, scene, &media, 64, 1, &ratio, &report),
                     PRT_OK);
    for (uint32_t i = 0; i < 3; i++)
        assert_int_equal(prt_walk_ratio_dipole_error(ratio, &media, i, &error[i]), PRT_OK);
    assert_int_equal(error[0].n_point + error[1].n_point, report.n_point);
    assert_true(error[0].n_point > 0 && error[1].n_point > 0);
    assert_int_equal(error[2].n_point, 0);
    assert_true(error[0].bright_mm[0] < 0 && error[0].dark_mm[0] < 0);
    assert_true(error[1].bright_mm[0] > 0 && error[1].dark_mm[0] > 0);
    expect_above("difference of the two media's errors", fabs(error[0].rms - error[1].rms),
                 0.02);
    for (uint32_t i = 0; i < 2; i++) // of the medium's own points
        expect_above("part of a thin box where the dipole is a tenth off", error[i].above_tenth,
                     0.7);
    prt_walk_ratio_destroy(ratio);
    prt_scene_destroy(scene);
    prt_mesh_destroy(mesh);
}

static int setup(void **state)
{
    const int failed = screen_setup(state);
    quiet.log = keep_warning;
    return failed;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(points_in_reach_by_their_weight),
        cmocka_unit_test(white_bodies_return_what_falls_on_them),
        cmocka_unit_test(thin_parts_return_what_walks_return),
        cmocka_unit_test(threads_do_not_matter),
        cmocka_unit_test(ratio_is_continuous),
        cmocka_unit_test(holes_keep_the_dipole),
        cmocka_unit_test(dark_media_have_no_holes),
        cmocka_unit_test(errors_are_of_one_medium),
    };
    return run_physics_tests(tests, setup, screen_teardown);
}
