// SPDX-License-Identifier: MIT
// screen/: the laws every image-space engine must keep, and their building blocks.
#include "../../libprt/screen/internal.h"
#include "prt/profile.h"
#include "prt/reference.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static struct prt_context quiet;
static struct prt_material marble = {.name = "marble", .sigma_s_prime = {2.19f, 2.62f, 3.0f},
                                     .sigma_a = {0.0021f, 0.0041f, 0.0071f}, .eta = 1.5f,
                                     .roughness = 0.3f};

static void swallow(void *user, enum prt_log_level level, const char *line)
{
}

struct model {
    struct prt_mesh mesh;
    struct prt_block block[4];
    struct prt_surface surface[4];
};

static void model_init(struct model *m, uint32_t max_vertex, uint32_t max_triangle)
{
    memset(m, 0, sizeof *m);
    m->mesh.position = calloc(max_vertex, 12);
    m->mesh.normal = calloc(max_vertex, 12);
    m->mesh.triangle = calloc(max_triangle, 12);
    m->mesh.weld = calloc(max_vertex, 4);
    m->mesh.block = m->block;
    m->mesh.surface = m->surface;
    m->mesh.mm_per_unit = 1;
}

static void model_finish(struct model *m)
{
    free(m->mesh.position);
    free(m->mesh.normal);
    free(m->mesh.triangle);
    free(m->mesh.weld);
}

static struct prt_block *begin_block(struct model *m, bool translucent)
{
    uint32_t i = m->mesh.n_block++;
    m->block[i] = (struct prt_block){m->mesh.n_object++, m->mesh.n_surface, m->mesh.n_vertex, 0,
                                     m->mesh.n_triangle, 0};
    struct prt_surface *s = &m->surface[m->mesh.n_surface++];
    s->translucent = translucent;
    for (int k = 0; k < 4; k++) s->base_color[k] = 0.5f;
    return &m->block[i];
}

static void end_block(struct model *m, struct prt_block *b)
{
    b->n_vertex = m->mesh.n_vertex - b->vertex_begin;
    b->n_triangle = m->mesh.n_triangle - b->triangle_begin;
}

// n x n squares spanned by u and v about a centre; the normal is u x v.
static void add_sheet(struct model *m, const float c[3], const float u[3], const float v[3],
                      uint32_t n)
{
    uint32_t first = m->mesh.n_vertex;
    float normal[3], l = 0;
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        normal[k] = u[i] * v[j] - u[j] * v[i];
        l += normal[k] * normal[k];
    }
    for (uint32_t y = 0; y <= n; y++) {
        for (uint32_t x = 0; x <= n; x++) {
            float a = 2 * (float)x / (float)n - 1, b = 2 * (float)y / (float)n - 1;
            for (int k = 0; k < 3; k++) {
                m->mesh.position[m->mesh.n_vertex][k] = c[k] + a * u[k] + b * v[k];
                m->mesh.normal[m->mesh.n_vertex][k] = normal[k] / sqrtf(l);
            }
            m->mesh.n_vertex++;
        }
    }
    for (uint32_t y = 0; y < n; y++) {
        for (uint32_t x = 0; x < n; x++) {
            uint32_t a = first + y * (n + 1) + x, b = a + n + 1;
            uint32_t t[2][3] = {{a, a + 1, b}, {a + 1, b + 1, b}};
            memcpy(m->mesh.triangle[m->mesh.n_triangle], t, sizeof t);
            m->mesh.n_triangle += 2;
        }
    }
}

// A closed box of half sizes h.
static void add_box(struct model *m, const float c[3], const float h[3], uint32_t n)
{
    struct prt_block *b = begin_block(m, true);
    for (int axis = 0; axis < 3; axis++) {
        for (int sign = -1; sign <= 1; sign += 2) {
            float centre[3] = {c[0], c[1], c[2]}, u[3] = {0}, v[3] = {0};
            int i = (axis + 1) % 3, j = (axis + 2) % 3;
            centre[axis] += (float)sign * h[axis];
            u[i] = h[i];
            v[j] = h[j] * (float)sign;
            add_sheet(m, centre, u, v, n);
        }
    }
    end_block(m, b);
}

static void add_sphere(struct model *m, const float c[3], float radius, uint32_t n)
{
    struct prt_block *b = begin_block(m, true);
    for (uint32_t i = 0; i <= n; i++) {
        for (uint32_t j = 0; j <= 2 * n; j++) {
            double theta = M_PI * i / n, phi = M_PI * j / n;
            float d[3] = {(float)(sin(theta) * sin(phi)), (float)cos(theta),
                          (float)(sin(theta) * cos(phi))};
            for (int k = 0; k < 3; k++) {
                m->mesh.position[m->mesh.n_vertex][k] = c[k] + radius * d[k];
                m->mesh.normal[m->mesh.n_vertex][k] = d[k];
            }
            m->mesh.n_vertex++;
        }
    }
    for (uint32_t i = 0; i < n; i++) {
        for (uint32_t j = 0; j < 2 * n; j++) {
            uint32_t a = b->vertex_begin + i * (2 * n + 1) + j, e = a + 2 * n + 1;
            uint32_t quad[2][3] = {{a, e, a + 1}, {a + 1, e, e + 1}};
            for (int k = 0; k < 2; k++) {
                if ((k == 0 && i == 0) || (k == 1 && i == n - 1)) continue;
                memcpy(m->mesh.triangle[m->mesh.n_triangle++], quad[k], 12);
            }
        }
    }
    end_block(m, b);
}

// A model with its scene, view and engines.
struct stage {
    struct prt_scene *scene;
    struct prt_screen *screen;
    struct prt_visibility *vis;
    struct prt_gbuffer g;
};

static void stage_init(struct stage *s, const struct model *m, struct prt_camera camera,
                       uint32_t w, uint32_t h)
{
    memset(s, 0, sizeof *s);
    assert_int_equal(prt_scene_create(&quiet, &m->mesh, &s->scene), PRT_OK);
    assert_int_equal(prt_screen_create(&quiet, &m->mesh, s->scene, &s->screen), PRT_OK);
    assert_int_equal(prt_visibility_create(&quiet, &m->mesh, &camera, w, h, 4, PRT_RASTER_AUTO,
                                           &s->vis), PRT_OK);
    prt_visibility_gbuffer(s->vis, &s->g);
}

static void stage_finish(struct stage *s)
{
    prt_screen_destroy(s->screen);
    prt_scene_destroy(s->scene);
    prt_visibility_destroy(s->vis);
}

typedef float (*pixels)[3];

static pixels render(struct stage *s, const struct prt_material *material,
                     const struct prt_cube *cube, const struct prt_screen_light *light,
                     struct prt_screen_options options, struct prt_screen_report *report)
{
    pixels out = malloc(((size_t)s->g.n_point + 1) * sizeof *out);
    assert_int_equal(prt_screen_radiance(&quiet, s->screen, s->vis, material, cube, light ? 1 : 0,
                                         light, &options, out, report), PRT_OK);
    for (uint32_t i = 0; i < s->g.n_point; i++)
        for (int k = 0; k < 3; k++) assert_true(isfinite(out[i][k]) && out[i][k] >= 0);
    return out;
}

// Relative RMSE over points and channels.
static double relative(pixels a, pixels b, uint32_t n)
{
    double num = 0, den = 0;
    for (uint32_t i = 0; i < n; i++) {
        for (int k = 0; k < 3; k++) {
            num += ((double)a[i][k] - b[i][k]) * ((double)a[i][k] - b[i][k]);
            den += (double)b[i][k] * b[i][k];
        }
    }
    return sqrt(num / den);
}

static const struct prt_screen_light from_front = {{0, 0, 1}, {1, 2, 3}, false};

// Law: constant E on a large plane gives B = rho_d E (METHODS §8), whatever the engine. The
// camera looks at the middle of a sheet that is large against the medium's reach.
static void plane_gives_total_reflectance(void **state)
{
    static const struct {
        enum prt_screen_engine engine;
        uint32_t n;
        double mean, worst; // tolerated relative errors
    } row[] = {{PRT_SCREEN_SPLAT, 0, 0.01, 0.02},
               {PRT_SCREEN_TEXTURE, 16384, 0.01, 0.15},
               {PRT_SCREEN_HYBRID, 4000, 0.01, 0.04},
               {PRT_SCREEN_REFERENCE, 0, 0.01, 0.03},
               {PRT_SCREEN_TANGENT, 64, 0.01, 0.05}};
    struct prt_material m = marble;
    // absorbing enough that 30 mm hold all of it, as in skin
    for (int c = 0; c < 3; c++) m.sigma_a[c] = 0.03f + 0.02f * (float)c;
    struct model model;
    model_init(&model, 20000, 40000);
    struct prt_block *block = begin_block(&model, true);
    add_sheet(&model, (float[3]){0, 0, 0}, (float[3]){30, 0, 0}, (float[3]){0, 30, 0}, 20);
    end_block(&model, block);
    // M03 finds its light in the picture, which must show enough of the plane
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
            struct prt_dipole d;
            prt_dipole_init(&d, m.sigma_s_prime[c], m.sigma_a[c], m.eta);
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
            print_message("%-9s channel %d: mean %+.2f %%, worst %.2f %%\n",
                          prt_screen_engine_name(row[k].engine), c, 100 * (mean - 1),
                          100 * worst);
            assert_true(fabs(mean - 1) < row[k].mean);
            assert_true(worst < row[k].worst);
        }
        free(b);
    }
    stage_finish(&s);
    model_finish(&model);
}

// Chi-square of counts against expectations; true below the 99.9 % point (Wilson-Hilferty).
static bool chi_square_ok(const double *want, const uint32_t *got, int n, double *value)
{
    double x = 0, z = 3.09;
    int k = -1;
    for (int i = 0; i < n; i++) {
        if (want[i] < 5) continue;
        x += (got[i] - want[i]) * (got[i] - want[i]) / want[i];
        k++;
    }
    double a = 2.0 / (9.0 * k);
    *value = x;
    return k > 0 && x < k * pow(1 - a + z * sqrt(a), 3);
}

// M03's radii have density 2 pi r R_d / rho_d, the mean over channels.
static void tangent_radii_follow_rd(void **state)
{
    struct prt_dipole d[3];
    for (int c = 0; c < 3; c++)
        prt_dipole_init(&d[c], marble.sigma_s_prime[c], 0.01 + 0.03 * c, marble.eta);
    enum { BINS = 40, DRAWS = 40000 };
    double want[BINS], edge[BINS + 1], value;
    uint32_t got[BINS] = {0};
    for (int i = 0; i <= BINS; i++) edge[i] = i ? 0.03 * pow(2000, (double)i / BINS) : 0;
    for (int i = 0; i < BINS; i++) {
        want[i] = 0;
        for (int c = 0; c < 3; c++) {
            double in = prt_dipole_tail(&d[c], edge[i]);
            double out = i + 1 < BINS ? prt_dipole_tail(&d[c], edge[i + 1]) : 0;
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
    assert_true(chi_square_ok(want, got, BINS, &value));
    // and the tails are those of the density itself: integrate it
    for (int c = 0; c < 3; c++) {
        double sum = 0;
        for (int i = 0; i < 20000; i++) {
            double r = (i + 0.5) * 1e-3;
            sum += 2 * M_PI * r * prt_dipole_rd(&d[c], r) * 1e-3;
        }
        assert_true(fabs(sum + prt_dipole_tail(&d[c], 20) - d[c].rho_d) < 1e-4 * d[c].rho_d);
    }
}

// C08's texels come in proportion to their value, dark ones never.
static void mip_samples_follow_value(void **state)
{
    enum { N = 256, DRAWS = 100000 };
    float mip[N / 3 * 4 + 4];
    double want[N], total = 0, value;
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
    assert_true(chi_square_ok(want, got, N, &value));
    for (float u = 0.9999f; u < 1; u += 1e-6f)
        assert_true(mip[prt_screen_mip_sample(mip, N, u)] > 0);
}

static void split_weights(void **state)
{
    const double k = 1.5;
    for (double r_p = 0.2; r_p < 6; r_p += 0.4) {
        assert_true(fabs(prt_screen_local_weight(0, r_p) - (1 - 0.5 * exp(-k * r_p))) < 1e-12);
        assert_true(fabs(prt_screen_local_weight(r_p, r_p) - 0.5) < 1e-12);
        double before = 2;
        for (double r = 0; r < 12; r += 0.01) {
            double w = prt_screen_local_weight(r, r_p);
            assert_true(w > 0 && w < 1 && w < before); // W_g = 1 - W_l: both in (0,1)
            assert_true(before > 1 || before - w < 0.01); // continuous at R_p
            before = w;
        }
    }
    struct prt_dipole d[3];
    for (int c = 0; c < 3; c++) prt_dipole_init(&d[c], 1 + c, 0.01, 1.3);
    double r_p = prt_screen_split_radius(d, 0.05), most = 0, beyond = 0;
    for (int c = 0; c < 3; c++) {
        most = fmax(most, 2 * M_PI * r_p * prt_dipole_rd(&d[c], r_p));
        beyond = fmax(beyond, 2 * M_PI * 1.01 * r_p * prt_dipole_rd(&d[c], 1.01 * r_p));
    }
    assert_true(most >= 0.0499 && beyond < 0.05);
}

// Light does not cross between objects that touch: the unlit one stays exactly black.
static void touching_objects_exchange_nothing(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_box(&model, (float[3]){-5, 0, 0}, (float[3]){5, 5, 5}, 8);
    add_box(&model, (float[3]){5, 0, 0}, (float[3]){5, 5, 5}, 8);
    // light along +x comes from the left: only the left box's left side is lit; the camera is in
    // front, so the pixels of the right box see only its own, dark, surface
    struct prt_screen_light light = {{-1, 0, 0}, {5, 5, 5}, false};
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 30};
    struct stage s;
    stage_init(&s, &model, camera, 64, 64);
    for (int e = 0; e <= PRT_SCREEN_REFERENCE; e++) {
        struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                             .n_sample = e == PRT_SCREEN_REFERENCE ? 20000 : 0};
        pixels b = render(&s, &marble, NULL, &light, options, NULL);
        double left = 0;
        for (uint32_t i = 0; i < s.g.n_point; i++) {
            if (model.block[s.g.block[i]].object == 0) left += b[i][0];
            else assert_true(b[i][0] == 0 && b[i][1] == 0 && b[i][2] == 0);
        }
        assert_true(left > 0);
        free(b);
    }
    stage_finish(&s);
    model_finish(&model);
}

// Objects of different media in one picture look as they do among their own kind.
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
    for (int k = 0; k < 2; k++) alone[k] = render(&s, &medium[k], NULL, &from_front, options, NULL);
    options.object_material = medium;
    pixels both = render(&s, &marble, NULL, &from_front, options, NULL);
    double apart = 0;
    for (uint32_t i = 0; i < s.g.n_point; i++) {
        uint32_t object = model.block[s.g.block[i]].object;
        for (int c = 0; c < 3; c++) {
            assert_true(fabsf(both[i][c] - alone[object][i][c]) <= 1e-5f * both[i][c]);
            apart = fmax(apart, fabs((double)alone[0][i][c] - alone[1][i][c]));
        }
    }
    assert_true(apart > 0.1);
    free(alone[0]);
    free(alone[1]);
    free(both);
    stage_finish(&s);
    model_finish(&model);
}

// A light behind a thin wall shines through it, as much as the exact sum says.
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
    assert_true(total / s.g.n_point > 0.01);
    for (int e = 0; e < PRT_SCREEN_REFERENCE; e++) {
        struct prt_screen_options options = {.engine = (enum prt_screen_engine)e};
        pixels b = render(&s, &marble, NULL, &light, options, NULL);
        double rmse = relative(b, want, s.g.n_point);
        print_message("back-lit slab, %s: %.2f %%\n", prt_screen_engine_name(options.engine),
                      100 * rmse);
        assert_true(rmse < 0.06);
        free(b);
    }
    free(want);
    stage_finish(&s);
    model_finish(&model);
}

// Object and camera moved together: the same picture (grids may fall elsewhere).
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
                                                 .n_sample = e == PRT_SCREEN_TEXTURE ? 4000 : 0};
            b[moved][e] = render(&s, &marble, NULL, &light, options, NULL);
        }
        n[moved] = s.g.n_point;
        stage_finish(&s);
        model_finish(&model);
    }
    assert_int_equal(n[0], n[1]);
    for (int e = 0; e < 4; e++) {
        double rmse = relative(b[1][e], b[0][e], n[0]);
        print_message("moved, %s: %.3f %%\n", prt_screen_engine_name((enum prt_screen_engine)e),
                      100 * rmse);
        assert_true(rmse < (e == PRT_SCREEN_TEXTURE ? 0.08 : 0.04)); // other samples
        free(b[0][e]);
        free(b[1][e]);
    }
}

static struct prt_cube constant_cube(uint32_t n, const float rgb[3])
{
    struct prt_cube cube = {n, malloc((size_t)6 * n * n * 12)};
    for (size_t i = 0; i < (size_t)6 * n * n; i++) memcpy(cube.texel + 3 * i, rgb, 12);
    return cube;
}

// The list of lights carries the cube's power; E on a convex body under a constant unit light is
// 2 pi int F_t mu dmu (METHODS §1), traced or by harmonics.
static void irradiance_closed_forms(void **state)
{
    struct prt_cube cube = constant_cube(16, (float[3]){1, 1, 1});
    static struct prt_screen_light light[600];
    static const uint32_t size[] = {1, 3, 7, 64, 600};
    for (int k = 0; k < 5; k++) {
        uint32_t n = prt_screen_lights_from_cube(&cube, size[k], light);
        double sum = 0;
        for (uint32_t i = 0; i < n; i++) sum += light[i].rgb[1];
        assert_true(n >= 1 && n <= size[k] && fabs(sum / (4 * M_PI) - 1) < 1e-5);
    }
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 10, 32);
    struct prt_scene *scene;
    assert_int_equal(prt_scene_create(&quiet, &model.mesh, &scene), PRT_OK);
    struct samples s;
    assert_int_equal(samples_atlas(&quiet, &model.mesh, 2000, &s), PRT_OK);
    double area = 0;
    for (uint32_t i = 0; i < s.n; i++) area += s.area[i];
    assert_true(fabs(area / (400 * M_PI) - 1) < 0.01);
    static const float eta[2] = {1.3f, 1.5f};
    static const double want[2] = {2.949541, 2.853264};
    uint32_t n = prt_screen_lights_from_cube(&cube, 600, light);
    for (int k = 0; k < 2; k++) {
        for (int harmonic = 0; harmonic < 2; harmonic++) {
            uint64_t rays = 0;
            if (harmonic) irradiance_harmonics(&cube, &eta[k], &s);
            else assert_int_equal(irradiance_traced(&quiet, scene, n, light, &eta[k], &s, &rays),
                                  PRT_OK);
            double mean = 0;
            for (uint32_t i = 0; i < s.n; i++) mean += s.e[0][i] / s.n;
            assert_true(fabs(mean / want[k] - 1) < (harmonic ? 2e-3 : 0.01));
        }
    }
    // the layers of all three axes together are the whole surface
    uint64_t rays = 0;
    struct samples peel;
    uint32_t *block = prt_mesh_triangle_blocks(&model.mesh);
    assert_int_equal(samples_peel(&quiet, scene, &(struct grid){block, 0.5f, {0, 0}, 0}, &peel, &rays), PRT_OK);
    area = 0;
    for (uint32_t i = 0; i < peel.n; i++) area += peel.area[i];
    assert_true(fabs(area / (400 * M_PI) - 1) < 0.02);
    samples_finish(&peel);
    prt_free(block);
    samples_finish(&s);
    prt_scene_destroy(scene);
    model_finish(&model);
    free(cube.texel);
}

// Errors against the exact sum fall as samples grow, also under an environment.
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
            print_message("%s, %s: %u %.2f %%, %u %.2f %%\n", lit ? "environment" : "distant light",
                          prt_screen_engine_name((enum prt_screen_engine)e), n[e][0],
                          100 * rmse[0], n[e][1], 100 * rmse[1]);
            assert_true(rmse[1] < rmse[0] && rmse[1] < 0.07);
        }
        free(want);
    }
    free(cube.texel);
    stage_finish(&s);
    model_finish(&model);
}

// Every kernel gives the C kernel's sums, guarded at odd counts, and says how fast it is.
static void pair_kernels_agree(void **state)
{
    struct prt_dipole d[3];
    for (int c = 0; c < 3; c++) prt_dipole_init(&d[c], 1 + c, 0.01, 1.3);
    struct radial_table t;
    radial_table_fit(&t, prt_screen_dipole_profile, d, d[2].z_r, 60);
    struct prt_rng rng;
    prt_rng_init(&rng, 2, 0);
    // the table: R_d where it matters
    for (int i = 0; i < 1000; i++) {
        double r = 0.01 * pow(2000, i / 1000.0), exact[3];
        float got[3];
        prt_screen_dipole_profile(d, r, exact);
        radial_table_eval(&t, (float)(r * r), got);
        for (int c = 0; c < 3; c++)
            assert_true(fabs(got[c] - exact[c]) < 0.02 * exact[c] + 1e-6 * d[c].rho_d);
    }
    struct emitters e = {0};
    assert_true(emitters_reserve(&e, 3000));
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
        pair_fn run = pair_kernel(mask & prt_cpu_detect());
        memset(block.sum, 0, sizeof block.sum);
        run(&t, &e, 3, 2771, 48, p, sum);
        if (!k) memcpy(first, block.sum, sizeof first);
        for (int c = 0; c < 3; c++) {
            for (int i = 0; i < 48; i++)
                assert_true(fabsf(block.sum[c][i] - first[c][i]) < 2e-4f * first[c][i]);
            for (int i = 48; i < 64; i++) assert_true(block.sum[c][i] == 0);
        }
        double t0 = prt_time_s();
        for (int r = 0; r < 20; r++) run(&t, &e, 0, 2777, 64, p, sum);
        print_message("pairs, %s: %.2f G/s\n", word[k], 20 * 2777 * 64 / (prt_time_s() - t0) / 1e9);
    }
    emitters_finish(&e);
}

// Nothing to see, degenerate triangles, a camera inside, an opaque model: a picture, no NaN.
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
    struct prt_camera inside = {.eye = {0, 0, 0}, .target = {0, 0, -1}, .up = {0, 1, 0},
                                .fovy_deg = 60};
    struct prt_camera away = {.eye = {0, 0, 50}, .target = {0, 0, 90}, .up = {0, 1, 0},
                              .fovy_deg = 30};
    struct prt_screen_light point = {{3, 30, 30}, {900, 900, 900}, true};
    for (int k = 0; k < 2; k++) {
        struct stage s;
        stage_init(&s, &model, k ? away : inside, 24, 24);
        for (int e = 0; e <= PRT_SCREEN_REFERENCE; e++) {
            struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                                 .n_sample = e == PRT_SCREEN_REFERENCE ? 9000 : 0,
                                                 .budget_ms = e == 2 ? 5 : 0};
            struct prt_screen_report report;
            pixels b = render(&s, &marble, NULL, &point, options, &report);
            if (!k) assert_true(b[0][0] > 0);
            free(b);
        }
        struct prt_shade shade = {.eta = 1.5f, .fresnel = true};
        struct prt_screen_options options = {.measure_error = true};
        struct prt_screen_report report;
        struct prt_image image;
        assert_int_equal(prt_screen_image(&quiet, s.screen, s.vis, &marble, NULL, 1, &point,
                                          &options, &shade, &image, &report), PRT_OK);
        for (int i = 0; i < 24 * 24 * 3; i++) assert_true(isfinite(image.rgb[i]));
        assert_true(k || (report.error > 0 && report.error < 0.1));
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
    assert_true(fabs(most - 0.5 / M_PI * 3) < 0.01);
    free(b);
    struct prt_screen_light bad = {{NAN, 0, 0}, {1, 1, 1}, false};
    struct prt_screen_options options = {0};
    b = malloc(s.g.n_point * sizeof *b);
    assert_int_equal(prt_screen_radiance(&quiet, s.screen, s.vis, &marble, NULL, 1, &bad, &options,
                                         b, NULL), PRT_ARG);
    static const struct prt_screen_options nonsense[] = {
        {.n_sample = 5000}, {.n_sample = 1}, {.engine = PRT_SCREEN_TANGENT, .n_sample = 1u << 20},
        {.engine = PRT_SCREEN_TEXTURE, .n_sample = 1u << 30}, {.budget_ms = -1}, {.epsilon = 1},
        {.bound = NAN}, {.engine = (enum prt_screen_engine)9}};
    for (size_t i = 0; i < sizeof nonsense / sizeof *nonsense; i++)
        assert_int_equal(prt_screen_radiance(&quiet, s.screen, s.vis, &marble, NULL, 1, &from_front,
                                             &nonsense[i], b, NULL), PRT_ARG);
    struct prt_material broken = marble;
    broken.sigma_a[1] = NAN;
    assert_int_equal(prt_screen_radiance(&quiet, s.screen, s.vis, &broken, NULL, 1, &from_front,
                                         &options, b, NULL), PRT_ARG);
    free(b);
    stage_finish(&s);
    model_finish(&model);
}

// A thick slab's multipole is the dipole; a thinner slab reflects less; the profile integrates to
// its closed-form total; engines use it in the dipole's place.
static void multipole_limits(void **state)
{
    enum { N = 3000 };
    static float r[N], rd[N][3];
    double rho[3], before[3] = {0, 0, 0};
    for (int k = 0; k < N; k++) r[k] = k ? (float)(0.002 * pow(100000, k / (double)N)) : 0;
    static const double thickness[] = {0.5, 2, 8, 500};
    for (int t = 0; t < 4; t++) {
        assert_int_equal(prt_screen_multipole(&quiet, &marble, thickness[t], N, r, rd, rho), PRT_OK);
        for (int c = 0; c < 3; c++) {
            struct prt_dipole d;
            prt_dipole_init(&d, marble.sigma_s_prime[c], marble.sigma_a[c], marble.eta);
            double sum = 0;
            for (int k = 1; k < N; k++)
                sum += M_PI * ((double)r[k] - r[k - 1]) * (r[k] * rd[k][c] + r[k - 1] * rd[k - 1][c]);
            assert_true(fabs(sum / rho[c] - 1) < 0.01);
            assert_true(rho[c] > before[c] && rho[c] <= d.rho_d * 1.0001);
            before[c] = rho[c];
            if (t < 3) continue;
            for (int k = 0; k < N; k++)
                assert_true(fabs(rd[k][c] - prt_dipole_rd(&d, r[k])) < 1e-3 * rd[k][c] + 1e-7);
        }
    }
    assert_int_equal(prt_screen_multipole(&quiet, &marble, 0, N, r, rd, rho), PRT_ARG);
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 10, 24);
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct stage s;
    stage_init(&s, &model, camera, 40, 40);
    struct prt_screen_profile profile = {N, r, (const float(*)[3])rd};
    static const enum prt_screen_engine engine[2] = {PRT_SCREEN_SPLAT, PRT_SCREEN_TEXTURE};
    for (int e = 0; e < 2; e++) {
        struct prt_screen_options options = {.engine = engine[e]};
        pixels a = render(&s, &marble, NULL, &from_front, options, NULL);
        options.profile = &profile;
        pixels b = render(&s, &marble, NULL, &from_front, options, NULL);
        assert_true(relative(b, a, s.g.n_point) < 0.01);
        free(a);
        free(b);
    }
    struct prt_screen_options wrong = {.engine = PRT_SCREEN_TANGENT, .profile = &profile};
    pixels b = malloc(s.g.n_point * sizeof *b);
    assert_int_equal(prt_screen_radiance(&quiet, s.screen, s.vis, &marble, NULL, 1, &from_front,
                                         &wrong, b, NULL), PRT_ARG);
    free(b);
    stage_finish(&s);
    model_finish(&model);
}

// The reference engine, with its own samples and rays, says the same under a cube of light with
// a lamp in it.
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
    struct prt_reference_options reference = {.term = PRT_REFERENCE_MULTIPLE, .n_sample = 12000,
                                              .n_ray = 512, .vertex = vertex, .n_vertex = 3 * N};
    assert_int_equal(prt_reference_colors(&quiet, &model.mesh, &medium, &cube, &reference, want),
                     PRT_OK);
    for (int e = 0; e < 4; e++) {
        struct prt_screen_options options = {.engine = (enum prt_screen_engine)e, .n_light = 128};
        pixels b = render(&s, &medium, &cube, NULL, options, NULL);
        double num = 0, den = 0;
        for (uint32_t i = 0; i < N; i++) {
            uint32_t at = (uint32_t)((uint64_t)i * s.g.n_point / N);
            float w[3] = {1 - s.g.bary[0][at] - s.g.bary[1][at], s.g.bary[0][at], s.g.bary[1][at]};
            for (int c = 0; c < 3; c++) {
                double q = 0;
                for (uint32_t k = 0; k < 3; k++) q += (double)w[k] * want[3 * i + k][c];
                num += (b[at][c] - q) * (b[at][c] - q);
                den += q * q;
            }
        }
        print_message("against the reference engine, %s: %.2f %%\n",
                      prt_screen_engine_name(options.engine), 100 * sqrt(num / den));
        assert_true(sqrt(num / den) < 0.05);
        free(b);
    }
    free(cube.texel);
    stage_finish(&s);
    model_finish(&model);
}

// While nothing changes each picture is nearer the exact one.
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
    static const double last[4] = {0.01, 0.02, 0.02, 0.015};
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
        print_message("refined, %s: %.2f %%, then %.2f %%\n",
                      prt_screen_engine_name((enum prt_screen_engine)e), 100 * rmse[0],
                      100 * rmse[1]);
        assert_true(rmse[1] < rmse[0] && rmse[1] < last[e]);
    }
    free(want);
    stage_finish(&s);
    model_finish(&model);
}

// Local and global part together are R_d, as tables too, and a disc keeps the total.
static void split_parts_add_up(void **state)
{
    struct prt_dipole dipole[1][3];
    for (int c = 0; c < 3; c++) prt_dipole_init(&dipole[0][c], 1 + c, 0.02, 1.3);
    struct prt_screen_options options = {0};
    struct frame f = {.ctx = &quiet, .dipole = dipole, .options = &options};
    struct radial_table whole, near, far;
    split_table(&f, 0, -1, 0, true, 0, 40, &whole);
    // C08's split, and texture sampling's by the pixel's own irradiance
    for (int own = 0; own < 2; own++) {
        split_table(&f, 0, own ? -1 : 1.5, own ? 0.8 : 0, true, 0, 40, &near);
        split_table(&f, 0, own ? -1 : 1.5, own ? 0.8 : 0, false, 0, 40, &far);
        for (float r = 0; r < 30; r += 0.05f) {
            float a[3], b[3], d[3];
            radial_table_eval(&whole, r * r, a);
            radial_table_eval(&near, r * r, b);
            radial_table_eval(&far, r * r, d);
            for (int c = 0; c < 3; c++)
                assert_true(fabsf(b[c] + d[c] - a[c]) < 0.01f * a[c] + 1e-6f);
        }
    }
    double share[3], sum[3] = {0};
    own_share(&f, 0, 0.8, share);
    for (int i = 0; i < 40000; i++) {
        double r = (i + 0.5) * 1e-4, w = 2 * M_PI * r * exp(-r * r / 0.64) * 1e-4;
        for (int c = 0; c < 3; c++) sum[c] += w * prt_dipole_rd(&dipole[0][c], r);
    }
    for (int c = 0; c < 3; c++) assert_true(fabs(share[c] / sum[c] - 1) < 0.002);
    struct radial_table disc;
    split_table(&f, 0, -1, 0, true, 0.8, 40, &disc);
    double total[2][3] = {{0}};
    for (int i = 0; i < 40000; i++) {
        double r = (i + 0.5) * 1e-3;
        float a[2][3];
        radial_table_eval(&whole, (float)(r * r), a[0]);
        radial_table_eval(&disc, (float)(r * r), a[1]);
        for (int k = 0; k < 2; k++)
            for (int c = 0; c < 3; c++) total[k][c] += 2 * M_PI * r * (double)a[k][c] * 1e-3;
    }
    for (int c = 0; c < 3; c++) {
        assert_true(fabs(total[0][c] / dipole[0][c].rho_d - 1) < 0.01);
        assert_true(fabs(total[1][c] / dipole[0][c].rho_d - 1) < 0.02);
    }
}

// C08 under light of short ways: points lie four mean free paths apart, and what is nearer comes
// from the pixel's own irradiance. Blurred over the points' cells it would be off by 10 %.
static void short_ways_stay_sharp(void **state)
{
    struct prt_material cream = {.name = "cream", .sigma_s_prime = {7.38f, 5.47f, 3.15f},
                                 .sigma_a = {0.0002f, 0.0028f, 0.0163f}, .eta = 1.3f,
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
    static const double most[3] = {0.05, 0.035, 0.02};
    double last = 1;
    for (int k = 0; k < 3; k++) {
        options = (struct prt_screen_options){.engine = PRT_SCREEN_TEXTURE,
                                              .n_sample = k ? k > 1 ? 16000 : 1600 : 400};
        pixels b = render(&s, &cream, NULL, &light, options, NULL);
        double error = relative(b, want, s.g.n_point);
        print_message("cream, texture %u: %.2f %%\n", options.n_sample, 100 * error);
        assert_true(error < most[k] && error < last);
        last = error;
        free(b);
    }
    free(want);
    stage_finish(&s);
    model_finish(&model);
}

// A sphere whose uv unfold it; `fold` says how they are spoilt.
static void add_uv(struct model *m, uint32_t n, int fold)
{
    m->mesh.uv = calloc(m->mesh.n_vertex, sizeof *m->mesh.uv);
    uint32_t row = 2 * n + 1, one = (n + 1) * row;
    for (uint32_t v = 0; v < m->mesh.n_vertex; v++) {
        float *uv = m->mesh.uv[v];
        uv[0] = (float)(v % one % row) / (float)(2 * n);
        uv[1] = (float)(v % one / row) / (float)n;
        if (fold == 1) uv[0] = uv[1] = 0.25f;                 // all in one place
        if (fold == 2) uv[0] = fabsf(2 * uv[0] - 1);          // mirrored halves lie on each other
        if (fold == 3) uv[1] = NAN;
        if (fold == 4) uv[0] = 3 * uv[0] + 1;                 // outside the square
        if (fold == 5) uv[1] = 0.5f;                          // a line
    }
}

// C08's atlas lies in the model's uv where they are one to one, and the picture is the same;
// where they are not it lies along the triangles.
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
        if (fold == 0) add_sphere(&model, (float[3]){0, 22, 0}, 5, N); // each has the whole square
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
                if (fold == 0) print_message("in the model's uv: %.2f %%\n", 100 * rmse);
                assert_true(fold == 0 ? rmse < 0.03 && rmse > 0 : rmse < 1e-6);
            }
            if (b != plain) free(b);
        }
        // and its texels are the whole surface
        bool injective;
        struct samples texels;
        assert_int_equal(samples_uv_atlas(&quiet, &model.mesh, 20000, &texels, &injective), PRT_OK);
        assert_true(injective == (fold == 0));
        if (injective) {
            double area = 0;
            for (uint32_t i = 0; i < texels.n; i++) {
                area += (double)texels.area[i];
                assert_true(i == 0 || texels.object[i] >= texels.object[i - 1]);
            }
            assert_true(fabs(area / (500 * M_PI) - 1) < 0.01);
            samples_finish(&texels);
        }
        stage_finish(&s);
        free(model.mesh.uv);
        model_finish(&model);
    }
    free(plain);
}

// A sheet with uv over [0,1]², seen by a wide camera.
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
    struct prt_camera wide = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 54};
    stage_init(s, model, wide, 160, 160);
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

// Maps: factors of 2 everywhere are a medium of twice the coefficients; a flat normal map changes
// nothing; a slope of heights tips the normal as far as it says; two halves of different media
// look each as its own.
static void maps_change_the_medium(void **state)
{
    struct prt_material m = marble;
    for (int c = 0; c < 3; c++) m.sigma_a[c] = 0.05f;
    struct model model;
    struct stage s;
    sheet_with_uv(&model, &s);
    struct prt_screen_options options = {.engine = PRT_SCREEN_TANGENT, .n_sample = 64};
    struct prt_screen_report report;
    pixels base = render(&s, &m, NULL, &from_front, options, NULL);
    static const float two[1][3] = {{2, 2, 2}}, flat[1][3] = {{0.5f, 0.5f, 1}};
    struct prt_screen_map twice = {1, 1, two}, level = {1, 1, flat};
    struct prt_material denser = m;
    for (int c = 0; c < 3; c++) {
        denser.sigma_s_prime[c] *= 2;
        denser.sigma_a[c] *= 2;
    }
    pixels want = render(&s, &denser, NULL, &from_front, options, NULL);
    struct prt_screen_options mapped = options;
    mapped.sigma_s_map = mapped.sigma_a_map = &twice;
    pixels b = render(&s, &m, NULL, &from_front, mapped, &report);
    for (int c = 0; c < 3; c++)
        assert_true(fabs(middle(&s, b, c) / middle(&s, want, c) - 1) < 0.01);
    assert_int_equal(report.n_medium, 1);
    free(b);
    // absorption sixty times as strong on one half: it is darker there, and no darker elsewhere
    static float halves[64][3];
    for (int i = 0; i < 64; i++)
        for (int c = 0; c < 3; c++) halves[i][c] = i < 32 ? 1 : 60;
    struct prt_screen_map half = {64, 1, (const float(*)[3])halves};
    mapped = options;
    mapped.sigma_a_map = &half;
    b = render(&s, &m, NULL, &from_front, mapped, &report);
    assert_true(report.n_medium >= 2);
    for (uint32_t i = 0; i < s.g.n_point; i++) {
        float x = s.g.position[0][i], y = s.g.position[1][i];
        if (fabsf(y) > 8 || fabsf(x) > 20 || fabsf(x) < 4) continue;
        float share = b[i][1] / base[i][1];
        assert_true(x < 0 ? fabsf(share - 1) < 0.1f : share < 0.5f);
    }
    free(b);
    mapped = options;
    mapped.normal_map = &level;
    b = render(&s, &m, NULL, &from_front, mapped, NULL);
    assert_true(relative(b, base, s.g.n_point) < 1e-3);
    free(b);
    // a tint of 0.4 by absorption gives 0.4 of the light in every channel
    float tint[1][3] = {{0.4f, 0.4f, 0.4f}};
    assert_int_equal(prt_screen_albedo_factors(&quiet, &m, 1, (const float(*)[3])tint, tint),
                     PRT_OK);
    struct prt_screen_map tinted = {1, 1, (const float(*)[3])tint};
    mapped = options;
    mapped.sigma_a_map = &tinted;
    b = render(&s, &m, NULL, &from_front, mapped, NULL);
    for (int c = 0; c < 3; c++) {
        print_message("tinted 0.4: %.4f of the light\n", middle(&s, b, c) / middle(&s, base, c));
        assert_true(tint[0][c] > 1);
        assert_true(fabs(middle(&s, b, c) / middle(&s, base, c) / 0.4 - 1) < 0.02);
    }
    free(b);
    // heights that rise by 12 mm to a side of 60: a normal tipped by atan(0.2); the light's angle
    static float ramp[256][3];
    for (int i = 0; i < 256; i++) ramp[i][0] = 12 * ((float)i + 0.5f) / 256;
    struct prt_screen_map heights = {256, 1, (const float(*)[3])ramp};
    struct prt_screen_light slant = {{0.6f, 0, 0.8f}, {2, 2, 2}, false};
    pixels level_lit = render(&s, &m, NULL, &slant, options, NULL);
    mapped = options;
    mapped.bump_map = &heights;
    b = render(&s, &m, NULL, &slant, mapped, NULL);
    double l = sqrt(1 + 0.04), tipped = (0.8 - 0.2 * 0.6) / l;
    double share = prt_fresnel_transmittance(m.eta, tipped) * tipped /
                   (prt_fresnel_transmittance(m.eta, 0.8) * 0.8);
    print_message("a slope of 0.2: %.4f of the light, closed form %.4f\n",
                  middle(&s, b, 1) / middle(&s, level_lit, 1), share);
    assert_true(fabs(middle(&s, b, 1) / middle(&s, level_lit, 1) / share - 1) < 0.02);
    free(b);
    // refusals
    static const float bad[1][3] = {{NAN, 0, 0}}, negative[1][3] = {{-1, 0, 0}};
    struct prt_screen_map wrong[] = {{1, 1, bad}, {1, 1, negative}, {0, 1, two}, {1, 1, NULL}};
    b = malloc(s.g.n_point * sizeof *b);
    for (int i = 0; i < 4; i++) {
        mapped = options;
        mapped.sigma_s_map = &wrong[i];
        assert_int_equal(prt_screen_radiance(&quiet, s.screen, s.vis, &m, NULL, 1, &from_front,
                                             &mapped, b, NULL), PRT_ARG);
    }
    mapped = (struct prt_screen_options){.engine = PRT_SCREEN_SPLAT, .sigma_s_map = &twice};
    assert_int_equal(prt_screen_radiance(&quiet, s.screen, s.vis, &m, NULL, 1, &from_front, &mapped,
                                         b, NULL), PRT_ARG);
    // uv folded to a line: no frame for bumps, a picture all the same
    for (uint32_t v = 0; v < model.mesh.n_vertex; v++) model.mesh.uv[v][1] = 0.5f;
    mapped = options;
    mapped.bump_map = &heights;
    mapped.normal_map = &level;
    mapped.sigma_a_map = &half;
    free(render(&s, &m, NULL, &slant, mapped, NULL));
    float(*kept)[2] = model.mesh.uv;
    model.mesh.uv = NULL;
    assert_int_equal(prt_screen_radiance(&quiet, s.screen, s.vis, &m, NULL, 1, &from_front, &mapped,
                                         b, NULL), PRT_ARG);
    free(kept);
    free(b);
    free(base);
    free(want);
    free(level_lit);
    stage_finish(&s);
    model_finish(&model);
}

// C08's pattern of rings finds what the dense sum finds, in every instruction set, and keeps
// to objects.
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
        struct prt_screen_options options = {.engine = PRT_SCREEN_HYBRID, .n_sample = 900,
                                             .rings = 20, .spokes = 20};
        pixels b = render(&s, &marble, NULL, &light, options, NULL);
        quiet.cpu = all;
        double rmse = relative(b, want, s.g.n_point);
        if (!k) print_message("20 rings of 20: %.2f %%\n", 100 * rmse);
        assert_true(rmse < 0.05);
        if (!first) first = b;
        else assert_true(relative(b, first, s.g.n_point) < 1e-3);
        if (b != first) free(b);
    }
    // a light from the left leaves all of the right box dark but its front
    struct prt_screen_light side = {{-1, 0, 0}, {5, 5, 5}, false};
    struct prt_screen_options options = {.engine = PRT_SCREEN_HYBRID, .rings = 20, .spokes = 20};
    pixels b = render(&s, &marble, NULL, &side, options, NULL);
    for (uint32_t i = 0; i < s.g.n_point; i++)
        assert_true(model.block[s.g.block[i]].object == 0 ||
                    (b[i][0] == 0 && b[i][1] == 0 && b[i][2] == 0));
    free(b);
    b = malloc(s.g.n_point * sizeof *b);
    options.spokes = 0;
    assert_int_equal(prt_screen_radiance(&quiet, s.screen, s.vis, &marble, NULL, 1, &side, &options,
                                         b, NULL), PRT_ARG);
    free(b);
    free(first);
    free(want);
    stage_finish(&s);
    model_finish(&model);
}

// The mean of frames goes to the exact sum; a frame's number and seed make its picture.
static void frames_average_to_the_reference(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 5, 32);
    struct prt_camera camera = {.eye = {0, 3, 30}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct prt_screen_light light = {{0.3f, 0.8f, 0.5f}, {3, 3, 3}, false};
    struct prt_shade shade = {.eta = 1.5f, .fresnel = true};
    static const uint32_t count[4] = {48, 16, 400, 100};
    struct stage s;
    stage_init(&s, &model, camera, 64, 64);
    for (int e = 0; e < 4; e++) {
        struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                             .n_sample = count[e], .measure_error = true};
        struct prt_screen_progress *p;
        assert_int_equal(prt_screen_progress_create(&quiet, s.screen, s.vis, &p), PRT_OK);
        double before = 0, after = 0;
        for (uint32_t k = 0; k < 24; k++) {
            struct prt_screen_report report;
            struct prt_image image;
            assert_int_equal(prt_screen_progress_image(&quiet, p, &marble, NULL, 1, &light,
                                                       &options, &shade, &image, &report), PRT_OK);
            assert_int_equal(report.frame, k);
            for (int i = 0; i < 64 * 64 * 3; i++) assert_true(isfinite(image.rgb[i]));
            prt_image_finish(&image);
            if (!k) before = report.error;
            after = report.error;
        }
        assert_int_equal(prt_screen_progress_frames(p), 24);
        print_message("24 frames, %s: %.2f %%, then %.2f %%\n",
                      prt_screen_engine_name(options.engine), 100 * before, 100 * after);
        // tangent's irradiance is no finer than these pixels, however many the samples
        assert_true(after < 0.8 * before && after < 0.022);
        prt_screen_progress_restart(p);
        assert_int_equal(prt_screen_progress_frames(p), 0);
        prt_screen_progress_destroy(p);
        options.measure_error = false;
        options.frame = 5;
        options.seed = 3;
        pixels a = render(&s, &marble, NULL, &light, options, NULL);
        pixels b = render(&s, &marble, NULL, &light, options, NULL);
        assert_true(memcmp(a, b, s.g.n_point * sizeof *a) == 0);
        options.frame = 6;
        pixels c = render(&s, &marble, NULL, &light, options, NULL);
        assert_true(memcmp(a, c, s.g.n_point * sizeof *a) != 0);
        free(a);
        free(b);
        free(c);
    }
    stage_finish(&s);
    model_finish(&model);
}

// E known at the vertices takes the place of rays: the same picture under the same light, by every
// engine, and none traced.
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
        assert_true(relative(known, traced, s.g.n_point) < 0.02);
        assert_true(engine == PRT_SCREEN_SPLAT || report.n_ray == 0); // its layers are traced
        free(traced);
        free(known);
    }
    free(e);
    stage_finish(&s);
    model_finish(&model);
}

// More time, more samples, less error foreseen; nonsense is refused.
static void budgets_buy_samples(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_sphere(&model, (float[3]){0, 0, 0}, 10, 24);
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 24};
    struct stage s;
    stage_init(&s, &model, camera, 100, 100);
    for (int e = 0; e < 4; e++) {
        struct prt_screen_plan plan, before = {0};
        for (double ms = 2; ms < 500; ms *= 2) {
            struct prt_screen_options options = {0};
            assert_int_equal(prt_screen_plan(&quiet, s.screen, s.vis, &marble,
                                             (enum prt_screen_engine)e, false, 0, ms, &options,
                                             &plan), PRT_OK);
            assert_true(options.n_sample == plan.n_sample && (int)options.engine == e);
            assert_true(plan.expected_error > 0 && plan.expected_error <= 1);
            assert_true(plan.n_sample >= before.n_sample);
            assert_true(!before.n_sample || plan.expected_error <= before.expected_error);
            before = plan;
        }
        assert_true(before.n_sample > 200);
        // the options' own budget means the same
        struct prt_screen_options options = {.engine = (enum prt_screen_engine)e, .budget_ms = 20};
        struct prt_screen_report report;
        free(render(&s, &marble, NULL, &from_front, options, &report));
        assert_true(report.n_asked >= 16 && report.expected_error > 0);
    }
    struct prt_screen_options options = {0};
    struct prt_screen_plan plan;
    assert_int_equal(prt_screen_choose(&quiet, s.screen, s.vis, &marble, false, 0, 50, &options,
                                       &plan), PRT_OK);
    assert_true(options.n_sample == plan.n_sample && options.engine == plan.engine);
    assert_int_equal(prt_screen_plan(&quiet, s.screen, s.vis, &marble, PRT_SCREEN_REFERENCE, false,
                                     0, 50, &options, &plan), PRT_ARG);
    static const double bad[] = {0, -1, NAN, INFINITY};
    for (int i = 0; i < 4; i++)
        assert_int_equal(prt_screen_choose(&quiet, s.screen, s.vis, &marble, false, 0, bad[i],
                                           &options, &plan), PRT_ARG);
    stage_finish(&s);
    model_finish(&model);
}

// Receivers share light among pixels of one patch only: a picture with a few looks like one with
// a receiver at every pixel, and weights of a point add up to one.
static void receivers_stand_for_their_patch(void **state)
{
    struct model model;
    model_init(&model, 20000, 40000);
    add_box(&model, (float[3]){-6, 0, 0}, (float[3]){5, 6, 4}, 8);
    add_sphere(&model, (float[3]){6, 0, 5}, 6, 24);
    struct prt_camera camera = {.eye = {10, 20, 60}, .up = {0, 1, 0}, .fovy_deg = 28};
    struct stage s;
    stage_init(&s, &model, camera, 128, 128);
    struct prt_screen_options options = {.engine = PRT_SCREEN_SPLAT};
    struct frame f = {.ctx = &quiet, .screen = s.screen, .vis = s.vis, .options = &options,
                      .width = 128, .height = 128, .g = s.g, .view_key = 77};
    uint32_t before = UINT32_MAX;
    for (uint32_t size = 1; size <= 4; size *= 2) {
        const struct view_cache *v, *again;
        assert_int_equal(view_get(&f, size, &v), PRT_OK);
        assert_int_equal(view_get(&f, size, &again), PRT_OK);
        assert_true(v == again && v->n_receiver < before && v->n_receiver <= s.g.n_point);
        before = v->n_receiver;
        uint32_t *object = malloc((v->n_column + 1) * sizeof *object);
        for (uint32_t t = 0; t < v->n_tile; t++)
            for (uint32_t i = v->begin[t]; i < v->begin[t + 1]; i++) object[i] = v->object[t];
        double worst = 0;
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
            assert_true(fabsf(sum - 1) < 1e-5f);
            for (int j = 0; j < 3; j++) d += powf(p[j] - s.g.position[j][i], 2);
            worst = fmax(worst, sqrt((double)d));
        }
        // a pixel is 0.25 mm wide here
        assert_true(worst < 0.5 * (1 + 3.0 * size));
        free(object);
    }
    stage_finish(&s);
    model_finish(&model);
}

// What a frame says of its own error is not much less than it is, whatever light and medium: the
// first frame is checked, later ones go by it.
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
            struct prt_screen_options exact = {.engine = PRT_SCREEN_REFERENCE, .n_sample = 60000};
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
                                      prt_screen_engine_name(options.engine), options.n_sample, m,
                                      l, 100 * error, 100 * report.expected_error);
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
    print_message("error over what was foreseen: %.2f at most, %.2f in the mean of %d\n", worst,
                  exp(mean / n), n);
    assert_true(worst < 1.5);
    assert_true(exp(mean / n) > 0.4 && exp(mean / n) < 1);
    prt_cube_finish(&cube);
    model_finish(&model);
}

// A profile of another shape keeps its total: on a large plane B = total E (S09's tables, any R_d).
static void profiles_keep_their_total(void **state)
{
    enum { N = 512 };
    static float r_mm[N], rd[N][3];
    struct prt_profile burley;
    assert_int_equal(prt_profile_init_burley(&quiet, &burley, 0.7, 1.5), PRT_OK);
    double near = 0.01 * prt_profile_radius(&burley, 0.999), far = prt_profile_radius(&burley, 1e-5);
    for (int k = 0; k < N; k++) {
        double r = k ? near * pow(far / near, (k - 1.0) / (N - 2)) : 0;
        r_mm[k] = (float)r;
        for (int c = 0; c < 3; c++) rd[k][c] = (float)prt_profile_rd(&burley, fmax(r, near));
    }
    struct prt_screen_profile table = {N, r_mm, (const float(*)[3])rd};
    struct model model;
    model_init(&model, 20000, 40000);
    struct prt_block *block = begin_block(&model, true);
    add_sheet(&model, (float[3]){0, 0, 0}, (float[3]){30, 0, 0}, (float[3]){0, 30, 0}, 20);
    end_block(&model, block);
    struct prt_camera camera = {.eye = {0, 0, 60}, .up = {0, 1, 0}, .fovy_deg = 12};
    struct stage s;
    stage_init(&s, &model, camera, 48, 48);
    for (int e = 0; e < 4; e++) {
        struct prt_screen_options options = {.engine = (enum prt_screen_engine)e,
                                             .profile = &table};
        pixels b = malloc((s.g.n_point + 1) * sizeof *b);
        int status = prt_screen_radiance(&quiet, s.screen, s.vis, &marble, NULL, 1, &from_front,
                                         &options, b, NULL);
        assert_int_equal(status, e == PRT_SCREEN_TANGENT ? PRT_ARG : PRT_OK);
        double mean = 0;
        for (uint32_t i = 0; i < s.g.n_point && !status; i++) mean += b[i][1] / s.g.n_point;
        double want = burley.total * 2 * prt_fresnel_transmittance(marble.eta, 1) / M_PI;
        if (!status) {
            print_message("Burley, %s: %+.2f %%\n", prt_screen_engine_name(options.engine),
                          100 * (mean / want - 1));
            assert_true(fabs(mean / want - 1) < 0.03);
        }
        free(b);
    }
    prt_profile_finish(&burley);
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

// A frame that is stopped anywhere says so, and the next one is as if it had never been.
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
                                             .n_sample = e == PRT_SCREEN_REFERENCE ? 4000 : 100};
        pixels out = malloc((s.g.n_point + 1) * sizeof *out);
        int stops = 0;
        for (int at = 0; at < 40; at++) {
            struct stopper stopper = {0, at};
            quiet.progress = stop_there;
            quiet.progress_user = &stopper;
            int status = prt_screen_radiance(&quiet, s.screen, s.vis, &marble, &cube, 0, NULL,
                                             &options, out, NULL);
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

static int setup(void **state)
{
    prt_context_init(&quiet);
    quiet.log = swallow;
    return prt_pool_create(0, &quiet.pool);
}

static int teardown(void **state)
{
    prt_pool_destroy(quiet.pool);
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(plane_gives_total_reflectance),
        cmocka_unit_test(tangent_radii_follow_rd),
        cmocka_unit_test(mip_samples_follow_value),
        cmocka_unit_test(split_weights),
        cmocka_unit_test(touching_objects_exchange_nothing),
        cmocka_unit_test(media_keep_apart),
        cmocka_unit_test(thin_wall_shines),
        cmocka_unit_test(translation_changes_nothing),
        cmocka_unit_test(irradiance_closed_forms),
        cmocka_unit_test(errors_fall),
        cmocka_unit_test(pair_kernels_agree),
        cmocka_unit_test(odd_input_gives_pictures),
        cmocka_unit_test(multipole_limits),
        cmocka_unit_test(reference_engine_agrees),
        cmocka_unit_test(refinement_converges),
        cmocka_unit_test(split_parts_add_up),
        cmocka_unit_test(short_ways_stay_sharp),
        cmocka_unit_test(uv_are_the_atlas),
        cmocka_unit_test(maps_change_the_medium),
        cmocka_unit_test(pattern_is_the_near_part),
        cmocka_unit_test(frames_average_to_the_reference),
        cmocka_unit_test(known_irradiance_needs_no_rays),
        cmocka_unit_test(budgets_buy_samples),
        cmocka_unit_test(receivers_stand_for_their_patch),
        cmocka_unit_test(errors_are_foreseen),
        cmocka_unit_test(profiles_keep_their_total),
        cmocka_unit_test(frames_can_be_stopped),
        cmocka_unit_test(engine_words),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
