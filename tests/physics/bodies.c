// SPDX-License-Identifier: MIT
// Small bodies of the physics tests.
#include "bodies.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

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

static void add_triangle(struct model *m, uint32_t a, uint32_t b, uint32_t c)
{
    memcpy(m->mesh.triangle[m->mesh.n_triangle++], ((uint32_t[3]){a, b, c}), 12);
}

static void add_vertex(struct model *m, double x, double y, double z, const float normal[3])
{
    float *p = m->mesh.position[m->mesh.n_vertex];
    p[0] = (float)x, p[1] = (float)y, p[2] = (float)z;
    memcpy(m->mesh.normal[m->mesh.n_vertex++], normal, 12);
}

// A ball of the given radius, or of radius_mm where that is NULL.
static void add_rows(struct model *m, uint32_t n_u, uint32_t n_v, uint32_t n_row,
                     body_radius radius, double radius_mm)
{
    const uint32_t first = m->mesh.n_vertex;
    for (uint32_t j = 0; j <= n_v; j++)
        for (uint32_t i = 0; i < n_u; i++) {
            double th = M_PI * j / n_v, ph = 2 * M_PI * i / n_u;
            double r = radius ? radius(th, ph) : radius_mm;
            double d[3] = {sin(th) * cos(ph), cos(th), sin(th) * sin(ph)};
            add_vertex(m, r * d[0], r * d[1], r * d[2],
                       (float[3]){(float)d[0], (float)d[1], (float)d[2]});
        }
    for (uint32_t j = 0; j < n_row; j++)
        for (uint32_t i = 0; i < n_u; i++) {
            uint32_t a = first + j * n_u + i, b = first + j * n_u + (i + 1) % n_u;
            if (j > 0) add_triangle(m, a, b, a + n_u);
            if (j < n_v - 1) add_triangle(m, b, b + n_u, a + n_u);
        }
}

void add_ball(struct model *m, uint32_t n_u, uint32_t n_v, uint32_t n_row, body_radius radius)
{
    add_rows(m, n_u, n_v, n_row, radius, 0);
}

void add_round_ball(struct model *m, uint32_t n_u, uint32_t n_v, double radius_mm)
{
    add_rows(m, n_u, n_v, n_v, NULL, radius_mm);
}

void add_slab(struct model *m, float size_mm, float thickness_mm, uint32_t n)
{
    const uint32_t side = n + 1, lower = side * side, first = m->mesh.n_vertex;
    for (uint32_t i = 0; i < 2 * lower; i++) {
        const bool top = i < lower;
        add_vertex(m, size_mm * ((float)(i % side) / (float)n - 0.5f), top ? 0 : -thickness_mm,
                   size_mm * ((float)(i % lower / side) / (float)n - 0.5f),
                   (float[3]){0, top ? 1 : -1, 0});
    }
    for (uint32_t y = 0; y < n; y++)
        for (uint32_t x = 0; x < n; x++) {
            uint32_t a = first + y * side + x, b = a + 1, c = a + side, d = c + 1;
            add_triangle(m, a, c, b);
            add_triangle(m, b, c, d);
            add_triangle(m, lower + a, lower + b, lower + c);
            add_triangle(m, lower + b, lower + d, lower + c);
        }
}

void add_floor(struct model *m, float half_mm, float y_mm, uint32_t n)
{
    const uint32_t side = n + 1, first = m->mesh.n_vertex;
    for (uint32_t i = 0; i < side * side; i++)
        add_vertex(m, half_mm * (2.0f * (float)(i % side) / (float)n - 1), y_mm,
                   half_mm * (2.0f * (float)(i / side) / (float)n - 1), (float[3]){0, 1, 0});
    for (uint32_t y = 0; y < n; y++)
        for (uint32_t x = 0; x < n; x++) {
            uint32_t a = first + y * side + x;
            add_triangle(m, a, a + side, a + 1);
            add_triangle(m, a + 1, a + side, a + side + 1);
        }
}

double dented_ball(double theta, double phi)
{
    return 8 + 1.2 * sin(3 * phi) * sin(theta) * sin(theta) + 0.8 * cos(4 * theta);
}

double fluted_ball(double theta, double phi)
{
    return 10 + 2 * sin(6 * phi) * sin(theta) * sin(theta);
}

struct prt_mesh *body_mesh(const struct prt_context *ctx, struct model *m, bool normals)
{
    struct prt_mesh *mesh;
    assert_int_equal(prt_mesh_create(ctx, m->mesh.n_vertex, (const float(*)[3])m->mesh.position,
                                     normals ? (const float(*)[3])m->mesh.normal : NULL,
                                     m->mesh.n_triangle, (const uint32_t(*)[3])m->mesh.triangle,
                                     &mesh),
                     PRT_OK);
    assert_int_equal(prt_mesh_scale(ctx, mesh, 0, 1), PRT_OK);
    model_finish(m);
    return mesh;
}

void split_parts(struct prt_mesh *mesh, uint32_t n, const struct part part[])
{
    static struct prt_surface surface[MOST_PARTS];
    static struct prt_block block[MOST_PARTS];
    assert_true(n <= MOST_PARTS);
    const struct prt_surface first = mesh->surface[0];
    for (uint32_t i = 0; i < n; i++) {
        const uint32_t vertex = i + 1 < n ? part[i + 1].vertex_begin : mesh->n_vertex;
        const uint32_t triangle = i + 1 < n ? part[i + 1].triangle_begin : mesh->n_triangle;
        const float *rgb = part[i].rgb;
        surface[i] = first;
        if (rgb)
            surface[i] = (struct prt_surface){.name = "floor",
                                              .base_color = {rgb[0], rgb[1], rgb[2], 1}};
        block[i] = (struct prt_block){i,
                                      i,
                                      part[i].vertex_begin,
                                      vertex - part[i].vertex_begin,
                                      part[i].triangle_begin,
                                      triangle - part[i].triangle_begin};
    }
    mesh->surface = surface, mesh->n_surface = n;
    mesh->block = block, mesh->n_block = n, mesh->n_object = n;
    mesh->object = NULL; // names of one object only
}

void split_opaque(struct prt_mesh *mesh, uint32_t vertex_begin, uint32_t triangle_begin,
                  const float rgb[3])
{
    split_parts(mesh, 2, (struct part[]){{0, 0, NULL}, {vertex_begin, triangle_begin, rgb}});
}

struct prt_mesh *ball_over_square(const struct prt_context *ctx, uint32_t around,
                                  uint32_t along)
{
    struct model m;
    model_init(&m, around * (along + 1) + 4, 2 * around * along + 2);
    add_round_ball(&m, around, along, 10);
    const uint32_t n_vertex = m.mesh.n_vertex, n_triangle = m.mesh.n_triangle;
    add_floor(&m, 15, -11, 1);
    struct prt_mesh *mesh = body_mesh(ctx, &m, false);
    split_opaque(mesh, n_vertex, n_triangle, (const float[]){0.8f, 0.6f, 0.4f});
    return mesh;
}
