// SPDX-License-Identifier: MIT
// raster/: coverage, barycentrics, hidden surfaces, anti-aliasing, Fresnel, specular, tone map.
// Above 600 lines: short cases that share small meshes and their camera.
#include "prt/raster.h"
#include "raster/internal.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "../data.h"

// One medium of all objects, by what shading reads of it.
#define SURFACE(e, r)                                                   \
    {                                                                   \
        1, &(const struct prt_material){.eta = e, .roughness = r}, NULL \
    }

static struct prt_context quiet;
static char last_line[512];

static void remember(void *user, enum prt_log_level level, const char *line)
{
    snprintf(last_line, sizeof last_line, "%s", line);
}

// A mesh of two blocks at most, each its own object and surface, from loose triangles.
struct scene {
    struct prt_mesh mesh;
    struct prt_block block[2];
    struct prt_surface surface[2];
};

static void scene_init(struct scene *s, uint32_t max_vertex, uint32_t max_triangle)
{
    memset(s, 0, sizeof *s);
    s->mesh.position = calloc(max_vertex, 12);
    s->mesh.normal = calloc(max_vertex, 12);
    s->mesh.triangle = calloc(max_triangle, 12);
    s->mesh.weld = calloc(max_vertex, 4);
    s->mesh.block = s->block;
    s->mesh.surface = s->surface;
    s->mesh.mm_per_unit = 2;
}

static void scene_finish(struct scene *s)
{
    free(s->mesh.position);
    free(s->mesh.normal);
    free(s->mesh.triangle);
    free(s->mesh.weld);
}

static struct prt_block *begin_block(struct scene *s, bool translucent)
{
    struct prt_block *b = &s->block[s->mesh.n_block];
    *b = (struct prt_block){
        s->mesh.n_object++, s->mesh.n_block, s->mesh.n_vertex, 0, s->mesh.n_triangle, 0};
    s->surface[s->mesh.n_surface++].translucent = translucent;
    s->mesh.n_block++;
    return b;
}

static void add_sphere(struct scene *s, const float centre[3], float radius, uint32_t n,
                       bool translucent)
{
    struct prt_block *b = begin_block(s, translucent);
    for (uint32_t i = 0; i <= n; i++) {
        for (uint32_t j = 0; j <= 2 * n; j++) {
            double theta = M_PI * i / n, phi = M_PI * j / n;
            float d[3] = {(float)(sin(theta) * sin(phi)), (float)cos(theta),
                          (float)(sin(theta) * cos(phi))};
            for (int k = 0; k < 3; k++) {
                s->mesh.position[s->mesh.n_vertex][k] = centre[k] + radius * d[k];
                s->mesh.normal[s->mesh.n_vertex][k] = d[k];
            }
            s->mesh.n_vertex++;
        }
    }
    for (uint32_t i = 0; i < n; i++) {
        for (uint32_t j = 0; j < 2 * n; j++) {
            uint32_t a = b->vertex_begin + i * (2 * n + 1) + j, c = a + 2 * n + 1;
            uint32_t quad[2][3] = {{a, c, a + 1}, {a + 1, c, c + 1}};
            for (int k = 0; k < 2; k++) {
                if ((k == 0 && i == 0) || (k == 1 && i == n - 1)) continue;
                memcpy(s->mesh.triangle[s->mesh.n_triangle++], quad[k], 12);
            }
        }
    }
    b->n_vertex = s->mesh.n_vertex - b->vertex_begin;
    b->n_triangle = s->mesh.n_triangle - b->triangle_begin;
}

// A square of half size h about the z axis at height z, facing +z.
static void add_square(struct scene *s, float h, float x, float z, bool translucent)
{
    struct prt_block *b = begin_block(s, translucent);
    uint32_t v = s->mesh.n_vertex;
    for (int k = 0; k < 4; k++) {
        float p[3] = {x + (k & 1 ? h : -h), k & 2 ? h : -h, z}, n[3] = {0, 0, 1};
        memcpy(s->mesh.position[v + (uint32_t)k], p, 12);
        memcpy(s->mesh.normal[v + (uint32_t)k], n, 12);
    }
    uint32_t t[2][3] = {{v, v + 1, v + 2}, {v + 1, v + 3, v + 2}};
    memcpy(s->mesh.triangle[s->mesh.n_triangle], t, sizeof t);
    s->mesh.n_triangle += 2;
    s->mesh.n_vertex += 4;
    b->n_vertex = 4;
    b->n_triangle = 2;
}

// Eye on +z at this distance [mm], looking at the origin; cameras are in model units.
static struct prt_camera front(float distance_mm, float fovy)
{
    return (struct prt_camera){
        .eye = {0, 0, distance_mm / 2}, .up = {0, 1, 0}, .fovy_deg = fovy};
}

static struct prt_visibility *see(const struct scene *s, const struct prt_camera *camera,
                                  uint32_t w, uint32_t h, unsigned n_sub)
{
    struct prt_visibility *vis = NULL;
    assert_int_equal(prt_visibility_create(&quiet, &s->mesh, camera,
                                           &(struct prt_raster){w, h, n_sub, PRT_RASTER_AUTO},
                                           &vis),
                     PRT_OK);
    return vis;
}

// Law: a centred sphere of angular radius asin(R/D) covers a disc of radius R/sqrt(D²-R²).
static void sphere_area(void **state)
{
    struct scene s;
    scene_init(&s, 40000, 80000);
    add_sphere(&s, (float[3]){0, 0, 0}, 10, 96, true);
    struct prt_camera c = front(50, 40);
    for (unsigned n_sub = 2; n_sub <= 8; n_sub *= 2) {
        struct prt_visibility *vis = see(&s, &c, 320, 240, n_sub);
        struct prt_gbuffer g;
        prt_visibility_gbuffer(vis, &g);
        double area = 0, r = 10 / sqrt(2500.0 - 100) / tan(20 * M_PI / 180) * 120;
        for (uint32_t i = 0; i < g.n_point; i++) area += g.weight[i];
        double want = M_PI * r * r, covered = prt_visibility_covered(vis);
        assert_true(fabs(area / want - 1) < 0.002);
        assert_true(covered > want && covered < 1.05 * want);
        assert_true((double)prt_visibility_bytes(vis) > covered * (4 + 8 * n_sub));
        prt_visibility_destroy(vis);
    }
    scene_finish(&s);
}

static void interpolate(const struct prt_mesh *m, uint32_t t, const float uv[2], double p[3])
{
    for (int k = 0; k < 3; k++)
        p[k] = (double)(1 - uv[0] - uv[1]) * m->position[m->triangle[t][0]][k] +
               (double)uv[0] * m->position[m->triangle[t][1]][k] +
               (double)uv[1] * m->position[m->triangle[t][2]][k];
}

// The point of a sample's triangle and barycentrics projects to the sample's position.
static void barycentrics_project_back(void **state)
{
    struct scene s;
    scene_init(&s, 4000, 8000);
    add_sphere(&s, (float[3]){2, -1, 3}, 10, 24, true);
    struct prt_camera c = front(45, 50);
    // Where sub-samples are that are drawn one by one, in 1/16 pixel (raster/gl.c).
    static const double last[9][2] = {[1] = {8, 8}, [2] = {4, 4}, [8] = {15, 1}};
    for (unsigned n_sub = 1; n_sub <= 8; n_sub *= 2) {
        struct prt_visibility *vis = see(&s, &c, 200, 150, n_sub);
        unsigned seen = 0, off = 0;
        for (uint32_t y = 0; y < 150; y++) {
            for (uint32_t x = 0; x < 200; x++) {
                float uv[2];
                uint32_t t = prt_visibility_sample(vis, x, y, n_sub - 1, uv);
                if (t == UINT32_MAX) continue;
                double p[3], k = tan(25 * M_PI / 180);
                interpolate(&s.mesh, t, uv, p);
                double px = (p[0] / (45 - p[2]) / k * 150 / 200 + 1) * 100;
                double py = (1 - p[1] / (45 - p[2]) / k) * 75;
                if (n_sub != 4) {
                    // at a silhouette the clamp to a triangle seen edge-on may move one far: GL
                    // snaps vertices
                    off += fabs(px - x - last[n_sub][0] / 16) > 0.01 ||
                           fabs(py - y - last[n_sub][1] / 16) > 0.01;
                } else {
                    assert_true(px > x - 0.01 && px < x + 1.01 && py > y - 0.01 &&
                                py < y + 1.01);
                }
                seen++;
            }
        }
        assert_true(seen > 4500 && off <= 2);
        prt_visibility_destroy(vis);
    }
    scene_finish(&s);
}

static uint32_t cast(const struct prt_mesh *m, const double o[3], const double d[3])
{
    uint32_t best = UINT32_MAX;
    double nearest = 1e300;
    for (uint32_t i = 0; i < m->n_triangle; i++) {
        double e[2][3], q[3], h[3], r[3];
        for (int k = 0; k < 3; k++) {
            e[0][k] =
                (double)m->position[m->triangle[i][1]][k] - m->position[m->triangle[i][0]][k];
            e[1][k] =
                (double)m->position[m->triangle[i][2]][k] - m->position[m->triangle[i][0]][k];
            r[k] = o[k] - m->position[m->triangle[i][0]][k];
        }
        for (int k = 0; k < 3; k++) {
            int a = (k + 1) % 3, b = (k + 2) % 3;
            h[k] = d[a] * e[1][b] - d[b] * e[1][a];
            q[k] = r[a] * e[0][b] - r[b] * e[0][a];
        }
        double det = e[0][0] * h[0] + e[0][1] * h[1] + e[0][2] * h[2];
        double u = (r[0] * h[0] + r[1] * h[1] + r[2] * h[2]) / det;
        double v = (d[0] * q[0] + d[1] * q[1] + d[2] * q[2]) / det;
        double t = (e[1][0] * q[0] + e[1][1] * q[1] + e[1][2] * q[2]) / det;
        if (u >= 0 && v >= 0 && u + v <= 1 && t > 0 && t < nearest) {
            nearest = t;
            best = i;
        }
    }
    return best;
}

// The triangle that GL keeps is the first one along the ray.
static void same_as_ray_cast(void **state)
{
    struct scene s;
    scene_init(&s, 8000, 16000);
    add_sphere(&s, (float[3]){0, 0, 0}, 10, 24, true);
    add_sphere(&s, (float[3]){6, 3, 6}, 5, 16, false);
    struct prt_camera c = front(45, 40);
    struct prt_visibility *vis = see(&s, &c, 256, 256, 1);
    struct prt_rng rng;
    prt_rng_init(&rng, 7, 0);
    unsigned differ = 0, n = 1500, hits = 0;
    for (unsigned i = 0; i < n; i++) {
        uint32_t x = prt_rng_u32(&rng) % 256, y = prt_rng_u32(&rng) % 256;
        double k = tan(20 * M_PI / 180), o[3] = {0, 0, 45};
        double d[3] = {((x + 0.5) / 128 - 1) * k, (1 - (y + 0.5) / 128) * k, -1};
        float uv[2];
        uint32_t want = cast(&s.mesh, o, d), got = prt_visibility_sample(vis, x, y, 0, uv);
        hits += want != UINT32_MAX;
        differ += want != got;
    }
    // vertices snap to 1/256 pixel: a ray through an edge may fall either way
    assert_true(hits > 300);
    assert_true(differ <= n / 100);
    prt_visibility_destroy(vis);
    scene_finish(&s);
}

static void backends_agree(void **state)
{
    struct scene s;
    scene_init(&s, 4000, 8000);
    add_sphere(&s, (float[3]){0, 0, 0}, 10, 24, true);
    struct prt_camera c = front(45, 40);
    struct prt_visibility *a = NULL, *b = NULL;
    int have_a = prt_visibility_create(
        &quiet, &s.mesh, &c, &(struct prt_raster){160, 120, 4, PRT_RASTER_OSMESA}, &a);
    int have_b = prt_visibility_create(&quiet, &s.mesh, &c,
                                       &(struct prt_raster){160, 120, 4, PRT_RASTER_EGL}, &b);
    if (have_a || have_b) {
        char reason[600];
        snprintf(reason, sizeof reason, "needs both OSMesa and EGL (%.500s)", last_line);
        prt_visibility_destroy(a);
        prt_visibility_destroy(b);
        scene_finish(&s);
        skip_because(reason);
    }
    unsigned seen = 0;
    for (uint32_t y = 0; y < 120; y++) {
        for (uint32_t x = 0; x < 160; x++) {
            for (unsigned k = 0; k < 4; k++) {
                float ua[2], ub[2];
                uint32_t ta = prt_visibility_sample(a, x, y, k, ua);
                assert_int_equal(ta, prt_visibility_sample(b, x, y, k, ub));
                assert_memory_equal(ua, ub, sizeof ua);
                seen += ta != UINT32_MAX;
            }
        }
    }
    assert_true(seen > 1000);
    prt_visibility_destroy(a);
    prt_visibility_destroy(b);
    scene_finish(&s);
}

static struct prt_image shade_const(const struct scene *s, const struct prt_visibility *vis,
                                    struct prt_shade *shade, const float rgb[3])
{
    float *plane = calloc((size_t)s->mesh.n_vertex * (shade->n_plane ? shade->n_plane : 1), 12);
    for (uint32_t v = 0; v < s->mesh.n_vertex; v++) memcpy(plane + 3 * v, rgb, 12);
    if (!shade->planes) shade->planes = plane;
    if (!shade->n_plane) shade->n_plane = 1;
    struct prt_image image;
    assert_int_equal(prt_shade_image(&quiet, vis, &s->mesh, shade, &image), PRT_OK);
    if (shade->planes == plane) shade->planes = NULL;
    free(plane);
    return image;
}

// An edge pixel holds its covered quarters times the radiance, and the mean is the covered
// area: also where the radiance is 4, since sub-samples are averaged before anything clamps
// them.
static void edges_are_antialiased(void **state)
{
    struct scene s;
    scene_init(&s, 8, 4);
    add_square(&s, 10, 0, 0, true);
    // roll the camera so that no edge is parallel to the pixels
    struct prt_camera c = front(50, 40);
    c.up[0] = 0.3f;
    struct prt_visibility *vis = see(&s, &c, 128, 128, 4);
    struct prt_shade shade = {.media = SURFACE(1.3f, 0)};
    for (float radiance = 1; radiance <= 4; radiance += 3) {
        struct prt_image image =
            shade_const(&s, vis, &shade, (float[3]){radiance, radiance, radiance});
        double sum = 0, side = 10 / (50 * tan(20 * M_PI / 180)) * 128;
        unsigned partial = 0;
        for (uint32_t i = 0; i < 128 * 128; i++) {
            float quarters = image.rgb[3 * i] * 4 / radiance;
            assert_float_equal(quarters, roundf(quarters), 1e-5f);
            assert_in_range((int)roundf(quarters), 0, 4);
            partial += quarters > 0.5f && quarters < 3.5f;
            sum += (double)image.rgb[3 * i] / (double)radiance;
        }
        assert_in_range(partial, 81, 128 * 8);
        assert_float_equal(sum / (side * side), 1, 0.005);
        prt_image_finish(&image);
    }
    prt_visibility_destroy(vis);
    scene_finish(&s);
}

// Two blocks that meet within a pixel each have a point in it, weighted by their share of its
// sub-samples. Points of blocks are kept apart, since their media may differ.
static void blocks_share_a_pixel(void **state)
{
    enum { SIDE = 64 };
    struct scene s;
    struct prt_gbuffer g;
    scene_init(&s, 8, 4);
    const float pixel = 2 * 50 * tanf(20 * (float)M_PI / 180) / SIDE, line = pixel / 2;
    add_square(&s, 10, line - 10, 0, true);
    add_square(&s, 10, line + 10, 0, true);
    struct prt_camera c = front(50, 40);
    struct prt_visibility *vis = see(&s, &c, SIDE, SIDE, 4);
    prt_visibility_gbuffer(vis, &g);
    unsigned n[2] = {0, 0};
    for (uint32_t i = 0; i < g.n_point; i++) {
        const uint32_t x = g.pixel[i] % SIDE, y = g.pixel[i] / SIDE;
        if (y < 20 || y >= 44 || x < 24 || x >= 40) continue;
        assert_float_equal(g.weight[i], x == SIDE / 2 ? 0.5 : 1, 0);
        if (x != SIDE / 2) assert_int_equal(g.block[i], x > SIDE / 2);
        if (x == SIDE / 2) n[g.block[i]]++;
    }
    assert_int_equal(n[0], 24);
    assert_int_equal(n[1], 24);
    prt_visibility_destroy(vis);
    scene_finish(&s);
}

// The share that a coarse ball reflects of an even sky, against a smooth one's: interpolated
// normals that face away from the eye would reflect all of it at the silhouette, in lines of
// bright or dark pixels.
static void silhouettes_reflect_no_more(void **state)
{
    enum { SIDE = 200 };
    float area[2] = {0, 0}, worst[2] = {0, 0}, covered[2] = {0, 0};
    for (int fine = 0; fine < 2; fine++) {
        struct scene s;
        uint32_t n = fine ? 128 : 10;
        scene_init(&s, (n + 1) * (2 * n + 1), 4 * n * n);
        add_sphere(&s, (float[3]){0, 0, 0}, 10, n, true);
        struct prt_camera c = front(40, 24);
        c.eye[1] = 7; // not along an axis of the facets
        struct prt_visibility *vis = see(&s, &c, SIDE, SIDE, 4);
        struct prt_cube sky;
        struct prt_specular *specular;
        assert_int_equal(prt_cube_init(&sky, 32), PRT_OK);
        for (uint32_t i = 0; i < 6 * 32 * 32 * 3; i++) sky.texel[i] = 1;
        assert_int_equal(prt_specular_create(&quiet, &sky, &specular), PRT_OK);
        struct prt_shade shade = {
            .media = SURFACE(1.3f, 0.2f), .fresnel = true, .specular = specular};
        struct prt_image image = shade_const(&s, vis, &shade, (float[3]){0, 0, 0});
        struct prt_gbuffer g;
        prt_visibility_gbuffer(vis, &g);
        for (uint32_t i = 0; i < g.n_point; i++) {
            if (g.weight[i] < 1) continue;
            float x = image.rgb[3 * g.pixel[i]];
            covered[fine]++;
            area[fine] += x > 0.5f;
            worst[fine] = fmaxf(worst[fine], x);
        }
        prt_image_finish(&image);
        prt_specular_destroy(specular);
        prt_cube_finish(&sky);
        prt_visibility_destroy(vis);
        scene_finish(&s);
    }
    print_message(
        "reflects over half: %.3f %% of a coarse ball, %.3f %% of a smooth one; worst "
        "%.2f and %.2f\n",
        100 * (double)(area[0] / covered[0]), 100 * (double)(area[1] / covered[1]),
        (double)worst[0], (double)worst[1]);
    assert_true(area[0] / covered[0] < area[1] / covered[1] + 0.002f);
    assert_true(worst[0] < 0.8f);
}

// Normals that differ within a pixel widen the reflection: a ball of a few pixels mirrors a sky
// with one bright texel as its mean over many directions, the same at each shift.
static void small_mirrors_are_steady(void **state)
{
    struct prt_cube sky;
    struct prt_specular *specular;
    assert_int_equal(prt_cube_init(&sky, 32), PRT_OK);
    sky.texel[3 * ((4 * 32 + 13) * 32 + 17)] = 500; // towards +z
    assert_int_equal(prt_specular_create(&quiet, &sky, &specular), PRT_OK);
    double least = 1e30, most = 0;
    for (int k = 0; k < 12; k++) {
        struct scene s;
        scene_init(&s, 49 * 97, 4 * 48 * 48);
        add_sphere(&s, (float[3]){0.07f * (float)k, 0.05f * (float)k, 0}, 10, 48, true);
        struct prt_camera c = front(400, 30);
        struct prt_visibility *vis = see(&s, &c, 32, 32, 8);
        struct prt_shade shade = {
            .media = SURFACE(1.5f, 0.1f), .fresnel = true, .specular = specular};
        struct prt_image image = shade_const(&s, vis, &shade, (float[3]){0, 0, 0});
        double sum = 0;
        for (uint32_t i = 0; i < 32 * 32; i++) sum += (double)image.rgb[3 * i];
        least = fmin(least, sum);
        most = fmax(most, sum);
        prt_image_finish(&image);
        prt_visibility_destroy(vis);
        scene_finish(&s);
    }
    print_message("light of a small ball's highlight: %.3f to %.3f\n", least, most);
    assert_true(most < 2 * least);
    prt_specular_destroy(specular);
    prt_cube_finish(&sky);
}

// Colours at vertices change no normal: the variance of normals over a pixel stays.
static void colours_keep_the_variance(void **state)
{
    struct scene s;
    struct prt_gbuffer g[2];
    struct prt_visibility *vis[2];
    struct prt_camera c = front(200, 30);
    double most = 0;
    scene_init(&s, 49 * 97, 4 * 48 * 48);
    add_sphere(&s, (float[3]){0, 0, 0}, 10, 48, true);
    for (int k = 0; k < 2; k++) {
        if (k) {
            s.mesh.color = calloc(s.mesh.n_vertex, sizeof *s.mesh.color);
            for (uint32_t i = 0; i < 4 * s.mesh.n_vertex; i++)
                s.mesh.color[i / 4][i % 4] = 0.5f;
        }
        vis[k] = see(&s, &c, 32, 32, 8);
        prt_visibility_gbuffer(vis[k], &g[k]);
    }
    assert_int_equal(g[0].n_point, g[1].n_point);
    for (uint32_t i = 0; i < g[0].n_point; i++) {
        most = fmax(most, (double)g[0].variance[i]);
        assert_float_equal(g[1].variance[i], g[0].variance[i], 1e-6);
    }
    assert_true(most > 1e-3);
    free(s.mesh.color);
    for (int k = 0; k < 2; k++) prt_visibility_destroy(vis[k]);
    scene_finish(&s);
}

// The emitted radiance is the model's: neither exit nor base colour multiplies it.
static void emission_is_added(void **state)
{
    static const float emissive[3] = {1, 2, 3}, body[3] = {0.5f, 0.25f, 0};
    struct scene s;
    struct prt_surface_maps maps;
    struct prt_camera c = front(200, 30);
    struct prt_image image[2];
    scene_init(&s, 4, 2);
    add_square(&s, 100, 0, 0, true);
    prt_surface_maps_default(&maps);
    s.mesh.maps = &maps;
    s.mesh.color = calloc(4, sizeof *s.mesh.color);
    for (int i = 0; i < 16; i++) s.mesh.color[i / 4][i % 4] = 0.5f;
    for (int k = 0; k < 2; k++) {
        if (k) memcpy(maps.emissive, emissive, sizeof emissive);
        struct prt_visibility *vis = see(&s, &c, 16, 16, 1);
        struct prt_shade shade = {.media = SURFACE(1.5f, 0.3f), .fresnel = true};
        image[k] = shade_const(&s, vis, &shade, body);
        prt_visibility_destroy(vis);
    }
    for (int i = 0; i < 3 * 16 * 16; i++)
        assert_float_equal(image[1].rgb[i] - image[0].rgb[i], emissive[i % 3], 1e-5);
    for (int k = 0; k < 2; k++) prt_image_finish(&image[k]);
    free(s.mesh.color);
    scene_finish(&s);
}

// The hidden part of the sky is interpolated between the corners of a triangle. Of a reflection
// 3 (1 - hidden) - 0.7 is left, held in [0, 1] (METHODS §6, specular occlusion). At one vertex
// a part of each direction is hidden.
static void hidden_sky_between_corners(void **state)
{
    struct scene s;
    struct prt_gbuffer g;
    struct prt_camera c = front(50, 40);
    double least = 1, most = 0;
    scene_init(&s, 4, 2);
    add_square(&s, 10, 0, 0, true);
    s.mesh.blocked = calloc(4, sizeof *s.mesh.blocked);
    s.mesh.blocked[1][0] = 64; // of Y_0, 64 * 4 / 127 = 2.016
    struct prt_visibility *vis = see(&s, &c, 64, 64, 1);
    prt_visibility_gbuffer(vis, &g);
    for (uint32_t i = 0; i < g.n_point; i++) {
        const uint32_t *v = s.mesh.triangle[g.triangle[i]];
        const float a = g.bary[0][i], b = g.bary[1][i], w[3] = {1 - a - b, a, b};
        double hidden = 0;
        for (int k = 0; k < 3; k++)
            hidden += v[k] == 1 ? 0.28209479 * 2.015748 * (double)w[k] : 0;
        const double want = fmin(fmax(3 * (1 - hidden) - 0.7, 0), 1);
        assert_float_equal(g.unblocked[i], want, 1e-4);
        least = fmin(least, want), most = fmax(most, want);
    }
    assert_true(least < 0.8 && most == 1);
    prt_visibility_destroy(vis);
    free(s.mesh.blocked);
    scene_finish(&s);
}

// At normal incidence F_t/T = (1 - ((eta-1)/(eta+1))²)/T (METHODS §1, exit); opaque surfaces
// keep plane 0 as it is.
static void fresnel_at_normal_incidence(void **state)
{
    for (int translucent = 0; translucent < 2; translucent++) {
        struct scene s;
        scene_init(&s, 8, 4);
        add_square(&s, 10, 0, 0, translucent);
        struct prt_camera c = front(50, 20);
        struct prt_visibility *vis = see(&s, &c, 65, 65, 1);
        struct prt_shade shade = {.media = SURFACE(1.5f, 0), .fresnel = true};
        struct prt_image image = shade_const(&s, vis, &shade, (float[3]){1, 2, 3});
        const float *p = image.rgb + 3 * (32 * 65 + 32);
        for (int k = 0; k < 3; k++)
            assert_true(fabs(p[k] - (k + 1) * (translucent ? 0.96 / 0.908222 : 1.0)) < 1e-5);
        // and off axis as medium's exact formula has it
        double t = tan(10 * M_PI / 180) * 64 / 65, cosine = 1 / sqrt(1 + t * t);
        double want = translucent ? prt_fresnel_transmittance(1.5, cosine) : 1;
        assert_true(fabs(image.rgb[3 * 32 * 65] - want / (translucent ? 0.908222 : 1)) < 1e-5);
        prt_image_finish(&image);
        // the papers' exit has no divisor
        shade.exit = PRT_EXIT_PAPERS;
        image = shade_const(&s, vis, &shade, (float[3]){1, 2, 3});
        assert_true(fabs(image.rgb[3 * 32 * 65] - want) < 1e-5);
        prt_image_finish(&image);
        prt_visibility_destroy(vis);
        scene_finish(&s);
    }
}

// Where the normals of a triangle cancel, the point looks at the eye, and its cosine is that of
// the triangle, however small the triangle is. It was 2.5 here, and reflections were NaN.
static void normals_that_cancel(void **state)
{
    struct scene s;
    struct prt_cube sky;
    struct prt_specular *specular;
    struct prt_camera c = front(40, 0.1f);
    scene_init(&s, 4, 2);
    add_square(&s, 0.05f, 0, 0, true);
    memset(s.mesh.normal, 0, 4 * sizeof *s.mesh.normal);
    assert_int_equal(prt_cube_init(&sky, 16), PRT_OK);
    for (size_t i = 0; i < (size_t)6 * 16 * 16 * 3; i++) sky.texel[i] = 1;
    assert_int_equal(prt_specular_create(&quiet, &sky, &specular), PRT_OK);
    struct prt_visibility *vis = see(&s, &c, 16, 16, 1);
    struct prt_gbuffer g;
    prt_visibility_gbuffer(vis, &g);
    assert_true(g.n_point >= 200);
    for (uint32_t i = 0; i < g.n_point; i++) {
        assert_float_equal(g.facing[i], 1, 1e-3);
        assert_float_equal(g.normal[2][i], 1, 1e-3);
    }
    struct prt_shade shade = {
        .media = SURFACE(1.5f, 0.1f), .fresnel = true, .specular = specular};
    struct prt_image image = shade_const(&s, vis, &shade, (float[3]){1, 1, 1});
    for (size_t i = 0; i < (size_t)16 * 16 * 3; i++) assert_true(isfinite(image.rgb[i]));
    prt_image_finish(&image);
    prt_specular_destroy(specular);
    prt_cube_finish(&sky);
    prt_visibility_destroy(vis);
    scene_finish(&s);
}

static int no_band(void *user, uint32_t row_begin, uint32_t row_end, const uint32_t *id)
{
    return PRT_OK;
}

// A size that the driver refuses is an error of its own, not one of the next picture.
static void refused_size_is_forgotten(void **state)
{
    struct scene s;
    struct prt_camera c = front(50, 20);
    struct camera_frame frame;
    scene_init(&s, 4, 2);
    add_square(&s, 10, 0, 0, true);
    struct prt_visibility *vis = see(&s, &c, 16, 16, 1);
    frame = vis->frame;
    struct gl_draw wide = {.mesh = &s.mesh,
                           .frame = &frame,
                           .width = 1 << 20,
                           .height = 4,
                           .n_sub = 1,
                           .z_near = 1,
                           .z_far = 100,
                           .band = no_band};
    assert_int_equal(prt_gl_draw_triangles(&quiet, PRT_RASTER_AUTO, &wide), PRT_UNSUPPORTED);
    prt_visibility_destroy(vis);
    prt_visibility_destroy(see(&s, &c, 16, 16, 1));
    scene_finish(&s);
}

static int unwanted(void *user, const char *stage, double fraction, double eta_s)
{
    ++*(unsigned *)user;
    assert_true(fraction > 0 && fraction < 1);
    return 1;
}

// Nobody wants a large picture any more: it ends between its bands, and the driver draws on.
static void large_picture_is_cancelled(void **state)
{
    struct scene s;
    struct prt_camera c = front(50, 20);
    unsigned n_asked = 0;
    struct prt_context ctx = quiet;
    ctx.progress = unwanted;
    ctx.progress_user = &n_asked;
    scene_init(&s, 4, 2);
    add_square(&s, 10, 0, 0, true);
    struct prt_visibility *vis = NULL;
    struct prt_raster large = {4096, 3072, 1, PRT_RASTER_AUTO}; // three bands
    assert_int_equal(prt_visibility_create(&ctx, &s.mesh, &c, &large, &vis), PRT_CANCELLED);
    assert_null(vis);
    assert_int_equal(n_asked, 1);
    struct prt_raster small = {16, 16, 1, PRT_RASTER_AUTO};
    assert_int_equal(prt_visibility_create(&ctx, &s.mesh, &c, &small, &vis), PRT_OK);
    assert_int_equal(n_asked, 1);
    prt_visibility_destroy(vis);
    scene_finish(&s);
}

// Plane k is weighted by Y_k of the refracted view direction.
static void phase_planes_times_harmonics(void **state)
{
    struct scene s;
    scene_init(&s, 8, 4);
    add_square(&s, 10, 0, 0, true);
    struct prt_camera c = front(50, 20);
    c.eye[0] = 12;
    c.eye[1] = -9;
    struct prt_visibility *vis = see(&s, &c, 33, 33, 1);
    float *planes = calloc((size_t)16 * 4, 12);
    for (unsigned k = 1; k < 16; k++) {
        for (int v = 0; v < 4; v++) {
            planes[3 * v] = planes[3 * v + 1] = planes[3 * v + 2] = 5; // stays positive
            for (unsigned j = 1; j < 16; j++)
                for (int ch = 0; ch < 3; ch++)
                    planes[(j * 4 + (unsigned)v) * 3 + (unsigned)ch] = j == k;
        }
        struct prt_shade shade = {.media = SURFACE(1.4f, 0), .n_plane = 16, .planes = planes};
        struct prt_image image = shade_const(&s, vis, &shade, (float[3]){0, 0, 0});
        double e[3] = {24, -18, 50}, l = sqrt(24.0 * 24 + 18 * 18 + 2500), cosine = 50 / l;
        double ct = sqrt(1 - (1 - cosine * cosine) / (1.4 * 1.4));
        float w[3], y[16];
        for (int i = 0; i < 3; i++) w[i] = (float)(e[i] / l / 1.4);
        w[2] += (float)(ct - cosine / 1.4);
        prt_sh_eval(4, w, y);
        assert_true(fabs(image.rgb[3 * (16 * 33 + 16)] - 5 - y[k]) < 2e-3);
        prt_image_finish(&image);
    }
    free(planes);
    prt_visibility_destroy(vis);
    scene_finish(&s);
}

static struct prt_cube uniform_cube(uint32_t n, const float rgb[3])
{
    struct prt_cube cube = {n, calloc((size_t)6 * n * n, 12)};
    for (size_t i = 0; i < (size_t)6 * n * n; i++) memcpy(cube.texel + 3 * i, rgb, 12);
    return cube;
}

static void specular_of_constant_is_constant(void **state)
{
    const float rgb[3] = {0.5f, 1, 2};
    static const uint32_t size[] = {16, 32, 64};
    for (int k = 0; k < 3; k++) {
        struct prt_cube cube = uniform_cube(size[k], rgb);
        struct prt_specular *s = NULL;
        assert_int_equal(prt_specular_create(&quiet, &cube, &s), PRT_OK);
        struct prt_rng rng;
        prt_rng_init(&rng, 3, 0);
        for (int i = 0; i < 500; i++) {
            float d[3], got[3];
            for (int j = 0; j < 3; j++) d[j] = prt_rng_f32(&rng) - 0.5f;
            prt_specular_eval(s, d, prt_rng_f32(&rng), got);
            for (int j = 0; j < 3; j++) assert_true(fabsf(got[j] / rgb[j] - 1) < 1e-4f);
        }
        prt_specular_destroy(s);
        free(cube.texel);
    }
}

// A rougher lobe spreads a small lamp: its peak falls, and its light stays about the same.
static void specular_spreads_with_roughness(void **state)
{
    struct prt_cube cube = uniform_cube(32, (float[3]){0, 0, 0});
    for (uint32_t y = 14; y < 18; y++)
        for (uint32_t x = 14; x < 18; x++)
            for (int c = 0; c < 3; c++) cube.texel[(y * 32 + x) * 3 + (uint32_t)c] = 100; // +X
    struct prt_specular *s = NULL;
    assert_int_equal(prt_specular_create(&quiet, &cube, &s), PRT_OK);
    float before = 1e9f;
    for (int i = 0; i <= 10; i++) {
        float got[3];
        prt_specular_eval(s, (float[3]){1, 0, 0}, (float)i / 10, got);
        assert_true(got[0] <= before * 1.0001f && got[0] > 0);
        before = got[0];
    }
    assert_true(before < 10);
    prt_specular_destroy(s);
    free(cube.texel);
}

// The background seen along the view axis is the light from there; faces meet without steps.
static void background_is_looked_up(void **state)
{
    struct scene s;
    scene_init(&s, 8, 4);
    add_square(&s, 0.01f, 0, 100, true); // behind the eye
    struct prt_cube cube = uniform_cube(128, (float[3]){0, 0, 0});
    for (unsigned face = 0; face < 6; face++) {
        for (uint32_t y = 0; y < 128; y++) {
            for (uint32_t x = 0; x < 128; x++) {
                float d[3];
                prt_cube_direction(face, (2 * x + 1) / 128.0 - 1, (2 * y + 1) / 128.0 - 1, d);
                for (uint32_t c = 0; c < 3; c++)
                    cube.texel[((face * 128 + y) * 128 + x) * 3 + c] = d[c] + 2;
            }
        }
    }
    struct prt_camera c = front(50, 120);
    struct prt_visibility *vis = see(&s, &c, 300, 200, 4);
    assert_int_equal(prt_visibility_covered(vis), 0);
    struct prt_shade shade = {.media = SURFACE(1.3f, 0), .background = &cube};
    struct prt_image image = shade_const(&s, vis, &shade, (float[3]){1, 1, 1});
    for (uint32_t y = 0; y < 200; y++) {
        for (uint32_t x = 0; x < 300; x++) {
            double k = tan(60 * M_PI / 180),
                   d[3] = {((x + 0.5) / 150 - 1) * k * 1.5, (1 - (y + 0.5) / 100) * k, -1};
            double l = sqrt(d[0] * d[0] + d[1] * d[1] + 1);
            for (uint32_t j = 0; j < 3; j++)
                assert_true(fabs(image.rgb[(y * 300 + x) * 3 + j] - 2 - d[j] / l) < 0.012);
        }
    }
    prt_image_finish(&image);
    prt_visibility_destroy(vis);
    free(cube.texel);
    scene_finish(&s);
}

// A turned look-up gives the picture of the turned environment, and pixels of 8 bits are what
// prt_tone_map() makes of the image. A quarter of a turn maps texels to texels.
static void turned_specular_and_8_bits(void **state)
{
    enum { W = 120, H = 90 };
    struct scene s;
    scene_init(&s, 8000, 16000);
    add_sphere(&s, (float[3]){0, 0, 0}, 10, 24, true);
    struct prt_camera c = front(45, 40);
    struct prt_visibility *vis = see(&s, &c, W, H, 4);
    struct prt_rng rng;
    prt_rng_init(&rng, 12, 0);
    float *planes = malloc((size_t)4 * s.mesh.n_vertex * 12);
    for (size_t i = 0; i < (size_t)12 * s.mesh.n_vertex; i++) planes[i] = prt_rng_f32(&rng);
    struct prt_env env = {.kind = PRT_ENV_CUBE, .cube = uniform_cube(32, (float[3]){0, 0, 0})};
    for (size_t i = 0; i < 6 * 32 * 32 * 3; i++) env.cube.texel[i] = prt_rng_f32(&rng);
    struct prt_cube turned;
    struct prt_image image[2];
    uint8_t rgb8[H * W * 3], expected[H * W * 3];
    assert_int_equal(prt_env_to_cube(&quiet, &env, 32, 90, &turned), PRT_OK);
    struct prt_shade shade = {
        .n_plane = 4, .planes = planes, .media = SURFACE(1.5f, 0.1f), .fresnel = true};
    for (int k = 0; k < 2; k++) {
        struct prt_specular *specular = NULL;
        const struct prt_cube *cube = k ? &env.cube : &turned;
        assert_int_equal(prt_specular_create(&quiet, cube, &specular), PRT_OK);
        shade.specular = specular;
        shade.background = cube;
        shade.specular_rotate_deg = shade.background_rotate_deg = k ? 90 : 0;
        assert_int_equal(prt_shade_image(&quiet, vis, &s.mesh, &shade, &image[k]), PRT_OK);
        if (k) {
            struct prt_image none;
            shade.rgb8 = rgb8;
            shade.tone = PRT_TONE_REINHARD;
            shade.exposure_ev = 0.7f;
            assert_int_equal(prt_shade_image(&quiet, vis, &s.mesh, &shade, &none), PRT_OK);
            assert_null(none.rgb);
            assert_int_equal(prt_tone_map(&quiet, &image[1], PRT_TONE_REINHARD, 0.7f, expected),
                             PRT_OK);
            assert_memory_equal(rgb8, expected, sizeof rgb8);
            shade.transparent = true;
            assert_int_equal(prt_shade_image(&quiet, vis, &s.mesh, &shade, &none), PRT_ARG);
        }
        prt_specular_destroy(specular);
    }
    double worst = 0;
    for (size_t i = 0; i < (size_t)W * H * 3; i++)
        worst = fmax(worst, fabs((double)image[0].rgb[i] - (double)image[1].rgb[i]));
    print_message("turned look-up: at most %.2e off\n", worst);
    assert_true(worst < 2e-4);
    for (int k = 0; k < 2; k++) prt_image_finish(&image[k]);
    prt_visibility_destroy(vis);
    prt_cube_finish(&turned);
    free(planes);
    free(env.cube.texel);
    scene_finish(&s);
}

// Planes are packed by vertex where a mesh has fewer vertices than the picture has points, and
// read one by one else: here with vertices that no triangle has. Both give one picture.
static void planes_of_few_and_many_vertices(void **state)
{
    enum { W = 61, H = 47, MANY = 40000 };
    static const unsigned n_plane[] = {4, 9, 16};
    struct prt_camera c = front(45, 30);
    struct scene s[2];
    struct prt_visibility *vis[2];
    float *few = malloc((size_t)16 * MANY * 12), *many = calloc((size_t)16 * MANY, 12);
    struct prt_rng rng;
    prt_rng_init(&rng, 17, 0);
    for (size_t i = 0; i < (size_t)16 * MANY * 3; i++) few[i] = prt_rng_f32(&rng);
    for (int k = 0; k < 2; k++) {
        scene_init(&s[k], MANY, 4000);
        add_sphere(&s[k], (float[3]){0, 0, 0}, 10, 8, true);
        add_sphere(&s[k], (float[3]){6, 3, 6}, 5, 6, false);
        if (k) s[k].mesh.n_vertex = MANY;
        s[k].block[1].n_vertex = s[k].mesh.n_vertex - s[k].block[1].vertex_begin;
        vis[k] = see(&s[k], &c, W, H, 4);
    }
    const uint32_t n = s[0].mesh.n_vertex;
    for (unsigned p = 0; p < 16; p++)
        memcpy(many + (size_t)p * MANY * 3, few + (size_t)p * n * 3, (size_t)n * 12);
    for (int i = 0; i < 3; i++) {
        struct prt_image image[2];
        struct prt_shade shade = {
            .n_plane = n_plane[i], .media = SURFACE(1.3f, 0.3f), .fresnel = true};
        for (int k = 0; k < 2; k++) {
            shade.planes = k ? many : few;
            assert_int_equal(prt_shade_image(&quiet, vis[k], &s[k].mesh, &shade, &image[k]),
                             PRT_OK);
        }
        double most = 0, differ = 0;
        for (size_t j = 0; j < W * H * 3; j++) {
            most = fmax(most, (double)image[0].rgb[j]);
            differ = fmax(differ, fabs((double)image[0].rgb[j] - (double)image[1].rgb[j]));
        }
        print_message("%u planes: at most %.2e of %.3g off\n", n_plane[i], differ, most);
        assert_true(most > 0.5 && differ < 2e-6 * most);
        for (int k = 0; k < 2; k++) prt_image_finish(&image[k]);
    }
    for (int k = 0; k < 2; k++) {
        prt_visibility_destroy(vis[k]);
        scene_finish(&s[k]);
    }
    free(few);
    free(many);
}

// Every instruction set gives the C kernel's picture up to rounding.
static void kernels_agree(void **state)
{
    struct scene s;
    scene_init(&s, 8000, 16000);
    add_sphere(&s, (float[3]){0, 0, 0}, 10, 24, true);
    add_sphere(&s, (float[3]){6, 3, 6}, 5, 16, false);
    struct prt_camera c = front(45, 40);
    struct prt_visibility *vis = see(&s, &c, 203, 111, 4);
    struct prt_rng rng;
    prt_rng_init(&rng, 11, 0);
    float *planes = malloc((size_t)9 * s.mesh.n_vertex * 12);
    for (size_t i = 0; i < (size_t)27 * s.mesh.n_vertex; i++) planes[i] = prt_rng_f32(&rng);
    struct prt_cube cube = uniform_cube(32, (float[3]){0, 0, 0});
    for (size_t i = 0; i < 6 * 32 * 32 * 3; i++) cube.texel[i] = prt_rng_f32(&rng);
    struct prt_specular *spec = NULL;
    assert_int_equal(prt_specular_create(&quiet, &cube, &spec), PRT_OK);
    struct prt_shade shade = {.n_plane = 9,
                              .planes = planes,
                              .media = SURFACE(1.3f, 0.3f),
                              .fresnel = true,
                              .specular = spec,
                              .background = &cube};
    struct prt_image image[3];
    static const char *const word[] = {"c", "avx2", "avx512"};
    for (int k = 0; k < 3; k++) {
        struct prt_context ctx = quiet;
        unsigned mask;
        assert_int_equal(prt_cpu_parse(word[k], &mask), PRT_OK);
        ctx.cpu = mask & prt_cpu_detect();
        double t = 1e9;
        for (int rep = 0; rep < 3; rep++) {
            double t0 = prt_time_s();
            if (rep) prt_image_finish(&image[k]);
            assert_int_equal(prt_shade_image(&ctx, vis, &s.mesh, &shade, &image[k]), PRT_OK);
            t = fmin(t, prt_time_s() - t0);
        }
        print_message("shade 203x111, 9 planes, %s: %.2f ms\n", word[k], t * 1e3);
    }
    for (size_t i = 0; i < 203 * 111 * 3; i++) {
        for (int k = 1; k < 3; k++)
            assert_true(fabsf(image[k].rgb[i] - image[0].rgb[i]) <
                        1e-4f * (1 + fabsf(image[0].rgb[i])));
        assert_true(isfinite(image[0].rgb[i]) && image[0].rgb[i] >= 0);
    }
    for (int k = 0; k < 3; k++) prt_image_finish(&image[k]);
    prt_specular_destroy(spec);
    prt_visibility_destroy(vis);
    free(planes);
    free(cube.texel);
    scene_finish(&s);
}

// Points shaded with the planes' own interpolated radiance give the same picture.
static void points_compose_as_planes(void **state)
{
    struct scene s;
    scene_init(&s, 4000, 8000);
    add_sphere(&s, (float[3]){0, 0, 0}, 10, 24, true);
    struct prt_camera c = front(45, 40);
    struct prt_visibility *vis = see(&s, &c, 120, 90, 4);
    struct prt_gbuffer g;
    prt_visibility_gbuffer(vis, &g);
    float(*radiance)[3] = malloc(g.n_point * sizeof *radiance);
    for (uint32_t i = 0; i < g.n_point; i++)
        for (int k = 0; k < 3; k++) radiance[i][k] = (float)(k + 1);
    struct prt_shade shade = {
        .media = SURFACE(1.3f, 0), .fresnel = true, .background_rgb = {0.2f, 0.1f, 0}};
    struct prt_image a = shade_const(&s, vis, &shade, (float[3]){1, 2, 3}), b;
    assert_int_equal(prt_shade_points(&quiet, vis, (const float(*)[3])radiance, &shade, &b),
                     PRT_OK);
    for (size_t i = 0; i < 120 * 90 * 3; i++) assert_true(fabsf(a.rgb[i] - b.rgb[i]) < 1e-5f);
    prt_image_finish(&a);
    prt_image_finish(&b);
    free(radiance);
    prt_visibility_destroy(vis);
    scene_finish(&s);
}

static void tone_values(void **state)
{
    float value[9] = {0, 0.18f, 1, 4, 1e30f, -1, NAN, 0.0005f, 0.5f};
    uint8_t out[9];
    struct prt_image image = {3, 1, value};
    assert_int_equal(prt_tone_map(&quiet, &image, PRT_TONE_NONE, 0, out), PRT_OK);
    const uint8_t none[] = {0, 118, 255};
    for (int i = 0; i < 3; i++) assert_true(abs(out[i] - none[i]) <= 1);
    struct prt_image three = {3, 1, value};
    uint8_t nine[9];
    assert_int_equal(prt_tone_map(&quiet, &three, PRT_TONE_REINHARD, 0, nine), PRT_OK);
    // R/(1+R) then sRGB: 1 -> 0.5 -> 188; 4 -> 0.8 -> 231; huge -> 255; NaN and -1 -> 0
    const int want[9] = {0, 109, 188, 231, 255, 0, 0, 2, 156};
    for (int i = 0; i < 9; i++) assert_true(abs(nine[i] - want[i]) <= 1);
    assert_int_equal(prt_tone_map(&quiet, &three, PRT_TONE_REINHARD, 2, nine), PRT_OK);
    assert_true(abs(nine[2] - 231) <= 1); // two stops: 1 becomes 4
    assert_int_equal(prt_tone_map(&quiet, &three, PRT_TONE_FILMIC, 0, nine), PRT_OK);
    assert_true(nine[0] == 0 && nine[1] > 100 && nine[1] < 130 && nine[2] > 190 &&
                nine[2] < 220 && nine[3] > nine[2] && nine[4] == 255);
    assert_int_equal(prt_tone_map(&quiet, &three, PRT_TONE_FILMIC, 1000, nine), PRT_ARG);
}

// Every value of a ramp is within one step of the curves of METHODS §6: none, filmic, Reinhard.
static void tone_curves(void **state)
{
    static float ramp[3 * 4096];
    static uint8_t got[3 * 4096];
    static uint16_t fine[3 * 4096];
    struct prt_image image = {4096, 1, ramp};
    for (int tone = 0; tone < 3; tone++) {
        float top = tone == PRT_TONE_NONE ? 1 : 30;
        for (int i = 0; i < 3 * 4096; i++)
            ramp[i] = top * (float)(i * i) / (3 * 4096.0f * 3 * 4096);
        assert_int_equal(prt_tone_map(&quiet, &image, (enum prt_tone)tone, 0, got), PRT_OK);
        assert_int_equal(prt_tone_map_fine(&quiet, &image, (enum prt_tone)tone, 0, fine),
                         PRT_OK);
        assert_true(fine[0] == 0); // black
        for (int i = 0; i < 3 * 4096; i++) {
            double x = ramp[i], y = x;
            if (tone == PRT_TONE_FILMIC) y = x * (x + 0.06) / (x * (x + 0.62) + 0.09);
            if (tone == PRT_TONE_REINHARD) y = x / (1 + x);
            y = y <= 0.0031308 ? 12.92 * y : 1.055 * pow(y, 1 / 2.4) - 0.055;
            if (!(fabs(255 * y - got[i]) < 0.65))
                fail_msg("tone %d: %g is %d, not %g", tone, x, got[i], 255 * y);
            if (!(fabs(255 * y - fine[i] / 257.0) < 0.25) || (fine[i] + 128) / 257 != got[i])
                fail_msg("tone %d: %g is %g, not %g", tone, x, fine[i] / 257.0, 255 * y);
        }
    }
}

static void camera_faults(void **state)
{
    struct prt_camera c;
    assert_int_equal(prt_camera_parse(&quiet, "1,2,3:0,0,0", &c), PRT_OK);
    assert_true(c.eye[1] == 2 && c.up[1] == 1 && c.fovy_deg == 36 && !c.automatic);
    assert_int_equal(prt_camera_parse(&quiet, "1,2,3:0,0,-1:0,0,1:60", &c), PRT_OK);
    assert_true(c.target[2] == -1 && c.up[2] == 1 && c.fovy_deg == 60);
    assert_int_equal(prt_camera_parse(&quiet, "auto", &c), PRT_OK);
    assert_true(c.automatic);
    static const char *const bad[][2] = {{"", "EYE"},
                                         {"1,2", "EYE"},
                                         {"1,2,3", "TARGET"},
                                         {"1,2,3:", "TARGET"},
                                         {"1,2,3:4,5", "TARGET"},
                                         {"1,2,3:4,5,6:0,1", "UP"},
                                         {"1,2,3:4,5,6:0,1,0:x", "FOVY"},
                                         {"1,2,3:4,5,6:0,1,0:170", "(0,170)"},
                                         {"1,2,3:4,5,6:0,1,0:0", "(0,170)"},
                                         {"1,2,3:4,5,6:0,1,0:nan", "(0,170)"},
                                         {"1,2,3:1,2,3", "same point"},
                                         {"nan,2,3:1,2,3", "EYE"},
                                         {"1,2,3:4,5,6:0,1,0:30:9", "FOVY"},
                                         {"1 2 3:4,5,6", "EYE"}};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        last_line[0] = 0;
        assert_int_equal(prt_camera_parse(&quiet, bad[i][0], &c), PRT_ARG);
        assert_non_null(strstr(last_line, bad[i][1]));
    }
    last_line[0] = 0;
    assert_int_equal(prt_camera_parse(&quiet, "0,5,0:0,0,0", &c), PRT_OK);
    assert_non_null(strstr(last_line, "parallel"));
}

// Up along the view is replaced by -z, and by +x along z: a view from above has -z at its top.
static void parallel_ups_are_replaced(void **state)
{
    static const struct {
        float eye[3], up[3];
        int axis, sign; // of the direction at the picture's top
    } row[] = {{{0, 50, 0}, {0, 1, 0}, 2, -1},
               {{0, -50, 0}, {0, 1, 0}, 2, -1},
               {{50, 0, 0}, {-1, 0, 0}, 2, -1},
               {{0, 0, 50}, {0, 0, 1}, 0, 1}};
    struct scene s;
    scene_init(&s, 4, 2);
    add_square(&s, 10, 0, 0, true);
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        struct prt_camera c = {.fovy_deg = 90};
        float eye[3], forward[3], right[3], up[3];
        memcpy(c.eye, row[i].eye, sizeof c.eye);
        memcpy(c.up, row[i].up, sizeof c.up);
        struct prt_visibility *vis = see(&s, &c, 8, 8, 1);
        prt_visibility_frame(vis, eye, forward, right, up);
        for (int k = 0; k < 3; k++)
            assert_float_equal(up[k], k == row[i].axis ? row[i].sign : 0, 1e-5);
        prt_visibility_destroy(vis);
    }
    scene_finish(&s);
}

static void sizes_are_limited(void **state)
{
    struct scene s;
    scene_init(&s, 8, 4);
    add_square(&s, 10, 0, 0, true);
    struct prt_camera c = front(50, 40);
    struct prt_visibility *vis = NULL;
    static const uint32_t bad[][2] = {{0, 10}, {10, 0}, {4097, 10}, {10, 4097}};
    for (int i = 0; i < 4; i++) {
        assert_int_equal(prt_visibility_create(
                             &quiet, &s.mesh, &c,
                             &(struct prt_raster){bad[i][0], bad[i][1], 1, PRT_RASTER_AUTO},
                             &vis),
                         PRT_ARG);
        assert_non_null(strstr(last_line, "4096"));
    }
    assert_int_equal(prt_visibility_create(&quiet, &s.mesh, &c,
                                           &(struct prt_raster){10, 10, 3, PRT_RASTER_AUTO},
                                           &vis),
                     PRT_ARG);
    // a picture cut into several bands has no seam: the square's rows are all there
    vis = see(&s, &c, 4096, 2048, 1);
    double side = 10 / (50 * tan(20 * M_PI / 180)) * 2048;
    assert_true(fabs(prt_visibility_covered(vis) / (side * side) - 1) < 0.002);
    prt_visibility_destroy(vis);
    scene_finish(&s);
}

// The default camera frames all of the translucent object and nearly fills the image; a camera
// inside it draws a picture too.
static void default_camera_frames(void **state)
{
    struct scene s;
    scene_init(&s, 4000, 8000);
    add_sphere(&s, (float[3]){100, 20, -30}, 10, 24, true);
    struct prt_camera c = {.automatic = true};
    static const uint32_t size[][2] = {{200, 100}, {100, 200}};
    for (int k = 0; k < 2; k++) {
        struct prt_visibility *vis = see(&s, &c, size[k][0], size[k][1], 1);
        uint32_t lo = UINT32_MAX, hi = 0, w = size[k][0], h = size[k][1];
        for (uint32_t y = 0; y < h; y++) {
            for (uint32_t x = 0; x < w; x++) {
                float uv[2];
                if (prt_visibility_sample(vis, x, y, 0, uv) == UINT32_MAX) continue;
                uint32_t edge = k ? x : y;
                lo = edge < lo ? edge : lo;
                hi = edge > hi ? edge : hi;
            }
        }
        assert_true(lo >= 2 && lo <= 9 && hi >= 90 && hi <= 97);
        struct prt_camera made;
        prt_visibility_camera(vis, &made, NULL, NULL, NULL);
        assert_true(made.eye[2] > made.target[2] && made.eye[1] > made.target[1]);
        prt_visibility_destroy(vis);
    }
    struct prt_camera inside = {
        .eye = {50, 10, -15}, .target = {51, 10, -15}, .up = {0, 1, 0}, .fovy_deg = 60};
    struct prt_visibility *vis = see(&s, &inside, 50, 50, 4);
    assert_int_equal(prt_visibility_covered(vis), 2500);
    struct prt_shade shade = {.media = SURFACE(1.3f, 0), .fresnel = true};
    struct prt_image image = shade_const(&s, vis, &shade, (float[3]){1, 1, 1});
    const float most = 1 / 0.938868f; // F_t/T at normal incidence is below
    for (int i = 0; i < 7500; i++) assert_true(image.rgb[i] > 0.9f && image.rgb[i] <= most);
    prt_image_finish(&image);
    prt_visibility_destroy(vis);
    scene_finish(&s);
}

static int setup(void **state)
{
    prt_context_init(&quiet);
    quiet.log = remember;
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sphere_area),
        cmocka_unit_test(barycentrics_project_back),
        cmocka_unit_test(same_as_ray_cast),
        cmocka_unit_test(backends_agree),
        cmocka_unit_test(edges_are_antialiased),
        cmocka_unit_test(fresnel_at_normal_incidence),
        cmocka_unit_test(normals_that_cancel),
        cmocka_unit_test(refused_size_is_forgotten),
        cmocka_unit_test(large_picture_is_cancelled),
        cmocka_unit_test(blocks_share_a_pixel),
        cmocka_unit_test(silhouettes_reflect_no_more),
        cmocka_unit_test(small_mirrors_are_steady),
        cmocka_unit_test(colours_keep_the_variance),
        cmocka_unit_test(emission_is_added),
        cmocka_unit_test(hidden_sky_between_corners),
        cmocka_unit_test(phase_planes_times_harmonics),
        cmocka_unit_test(turned_specular_and_8_bits),
        cmocka_unit_test(specular_of_constant_is_constant),
        cmocka_unit_test(specular_spreads_with_roughness),
        cmocka_unit_test(background_is_looked_up),
        cmocka_unit_test(planes_of_few_and_many_vertices),
        cmocka_unit_test(kernels_agree),
        cmocka_unit_test(points_compose_as_planes),
        cmocka_unit_test(tone_values),
        cmocka_unit_test(tone_curves),
        cmocka_unit_test(camera_faults),
        cmocka_unit_test(parallel_ups_are_replaced),
        cmocka_unit_test(sizes_are_limited),
        cmocka_unit_test(default_camera_frames),
    };
    return run_test_group(tests, setup, NULL);
}
