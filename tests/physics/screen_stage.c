// SPDX-License-Identifier: MIT
// Shared by the tests of screen/.
#include "screen_stage.h"

struct prt_context quiet;
struct prt_material marble = {.name = "marble",
                              .sigma_s_prime = {2.19f, 2.62f, 3.0f},
                              .sigma_a = {0.0021f, 0.0041f, 0.0071f},
                              .eta = 1.5f,
                              .roughness = 0.3f};

static void swallow(void *user, enum prt_log_level level, const char *line)
{
}

void model_init(struct model *m, uint32_t max_vertex, uint32_t max_triangle)
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

void model_finish(struct model *m)
{
    free(m->mesh.position);
    free(m->mesh.normal);
    free(m->mesh.triangle);
    free(m->mesh.weld);
}

struct prt_block *begin_block(struct model *m, bool translucent)
{
    uint32_t i = m->mesh.n_block++;
    m->block[i] = (struct prt_block){
        m->mesh.n_object++, m->mesh.n_surface, m->mesh.n_vertex, 0, m->mesh.n_triangle, 0};
    struct prt_surface *s = &m->surface[m->mesh.n_surface++];
    s->translucent = translucent;
    for (int k = 0; k < 4; k++) s->base_color[k] = 0.5f;
    return &m->block[i];
}

void end_block(struct model *m, struct prt_block *b)
{
    b->n_vertex = m->mesh.n_vertex - b->vertex_begin;
    b->n_triangle = m->mesh.n_triangle - b->triangle_begin;
}

// n x n squares spanned by u and v about a centre; the normal is u x v.
void add_sheet(struct model *m, const float c[3], const float u[3], const float v[3],
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
void add_box(struct model *m, const float c[3], const float h[3], uint32_t n)
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

void add_sphere(struct model *m, const float c[3], float radius, uint32_t n)
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

void stage_init(struct stage *s, const struct model *m, struct prt_camera camera, uint32_t w,
                uint32_t h)
{
    memset(s, 0, sizeof *s);
    assert_int_equal(prt_scene_create(&quiet, &m->mesh, &s->scene), PRT_OK);
    assert_int_equal(prt_screen_create(&quiet, &m->mesh, s->scene, &s->screen), PRT_OK);
    assert_int_equal(
        prt_visibility_create(&quiet, &m->mesh, &camera, w, h, 4, PRT_RASTER_AUTO, &s->vis),
        PRT_OK);
    prt_visibility_gbuffer(s->vis, &s->g);
}

void stage_finish(struct stage *s)
{
    prt_screen_destroy(s->screen);
    prt_scene_destroy(s->scene);
    prt_visibility_destroy(s->vis);
}

int try_render(struct stage *s, const struct prt_material *material,
               const struct prt_cube *cube, const struct prt_screen_light *light,
               const struct prt_screen_options *options, pixels out,
               struct prt_screen_report *report)
{
    struct prt_screen_input input = {.visibility = s->vis,
                                     .material = material,
                                     .cube = cube,
                                     .n_extra = light != NULL,
                                     .extra = light};
    return prt_screen_radiance(&quiet, s->screen, &input, options, out, report);
}

pixels render(struct stage *s, const struct prt_material *material, const struct prt_cube *cube,
              const struct prt_screen_light *light, struct prt_screen_options options,
              struct prt_screen_report *report)
{
    pixels out = malloc(((size_t)s->g.n_point + 1) * sizeof *out);
    assert_int_equal(try_render(s, material, cube, light, &options, out, report), PRT_OK);
    for (uint32_t i = 0; i < s->g.n_point; i++)
        for (int k = 0; k < 3; k++) assert_true(isfinite(out[i][k]) && out[i][k] >= 0);
    return out;
}

// Relative RMSE over points and channels.
double relative(pixels a, pixels b, uint32_t n)
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

const struct prt_screen_light from_front = {{0, 0, 1}, {1, 2, 3}, false};

// Chi-square of counts against expectations; true below the 99.9 % point (Wilson-Hilferty).
bool chi_square_ok(const double *want, const uint32_t *got, int n, double *value)
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

struct prt_cube constant_cube(uint32_t n, const float rgb[3])
{
    struct prt_cube cube = {n, malloc((size_t)6 * n * n * 12)};
    for (size_t i = 0; i < (size_t)6 * n * n; i++) memcpy(cube.texel + 3 * i, rgb, 12);
    return cube;
}

int screen_setup(void **state)
{
    prt_context_init(&quiet);
    quiet.log = swallow;
    return prt_pool_create(0, &quiet.pool);
}

int screen_teardown(void **state)
{
    prt_pool_destroy(quiet.pool);
    return 0;
}
