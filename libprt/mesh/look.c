// SPDX-License-Identifier: MIT
// The look of a surface at a point: its maps and vertex colours, filtered over a footprint.
#include "internal.h"

#include <math.h>
#include <string.h>

bool prt_mesh_has_look(const struct prt_mesh *mesh)
{
    return mesh->maps || mesh->color || mesh->gain;
}

void prt_mesh_footprint(const struct prt_mesh *mesh, uint32_t triangle, const float step[3],
                        float d[2])
{
    const uint32_t *v = mesh->triangle[triangle];
    double e1[3], e2[3], g11 = 0, g12 = 0, g22 = 0, s1 = 0, s2 = 0;
    for (int k = 0; k < 3; k++) {
        e1[k] = (double)mesh->position[v[1]][k] - mesh->position[v[0]][k];
        e2[k] = (double)mesh->position[v[2]][k] - mesh->position[v[0]][k];
        g11 += e1[k] * e1[k];
        g12 += e1[k] * e2[k];
        g22 += e2[k] * e2[k];
        s1 += e1[k] * (double)step[k];
        s2 += e2[k] * (double)step[k];
    }
    double det = g11 * g22 - g12 * g12;
    bool good = det > 1e-12 * g11 * g22 && isfinite(det);
    d[0] = good ? (float)((s1 * g22 - s2 * g12) / det) : 0;
    d[1] = good ? (float)((s2 * g11 - s1 * g12) / det) : 0;
}

struct place {
    const struct prt_mesh *mesh;
    uint32_t triangle;
    float a, b, da[2], db[2]; // change of a and of b over the footprint's two axes
};

// Filtered value of one map; false where the surface has none.
static bool look_up(const struct place *p, const struct prt_texture_ref *ref, float rgba[4])
{
    float corner[3][2], uv[2], dx[2], dy[2];
    if (ref->image == UINT32_MAX) return false;
    prt_mesh_corner_uv(p->mesh, p->triangle, ref->uv_set, corner);
    for (int k = 0; k < 2; k++) {
        float s = corner[1][k] - corner[0][k], t = corner[2][k] - corner[0][k];
        uv[k] = corner[0][k] + p->a * s + p->b * t;
        dx[k] = p->da[0] * s + p->db[0] * t;
        dy[k] = p->da[1] * s + p->db[1] * t;
    }
    prt_texture_sample(&p->mesh->image[ref->image], p->mesh->texel, ref, uv, dx, dy, rgba);
    return true;
}

static float dot(const float a[3], const float b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static bool normalise(float n[3])
{
    float l = dot(n, n);
    if (!(l > 1e-20f) || !isfinite(l)) return false;
    l = 1 / sqrtf(l);
    for (int k = 0; k < 3; k++) n[k] *= l;
    return true;
}

// Directions in which u and v of a map grow, orthogonal to n (B78). The frame is of the
// triangle; after KHR_texture_transform, whose rotation turns the tangents, too.
static bool tangents(const struct place *p, const struct prt_texture_ref *ref, const float n[3],
                     float t[3], float b[3])
{
    const uint32_t *v = p->mesh->triangle[p->triangle];
    float corner[3][2], s[2][2], e[2][3], cross[3];
    prt_mesh_corner_uv(p->mesh, p->triangle, ref->uv_set, corner);
    for (int j = 0; j < 2; j++) {
        float x = corner[j + 1][0] - corner[0][0], y = corner[j + 1][1] - corner[0][1];
        s[j][0] = ref->transform[0] * x + ref->transform[1] * y;
        s[j][1] = ref->transform[3] * x + ref->transform[4] * y;
        for (int k = 0; k < 3; k++)
            e[j][k] = p->mesh->position[v[j + 1]][k] - p->mesh->position[v[0]][k];
    }
    float det = s[0][0] * s[1][1] - s[0][1] * s[1][0];
    if (!(fabsf(det) > 1e-20f) || !isfinite(det)) return false;
    for (int k = 0; k < 3; k++) t[k] = (s[1][1] * e[0][k] - s[0][1] * e[1][k]) / det;
    float along = dot(t, n);
    for (int k = 0; k < 3; k++) t[k] -= along * n[k];
    if (!normalise(t)) return false;
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        cross[k] = n[i] * t[j] - n[j] * t[i];
        b[k] = (s[0][0] * e[1][k] - s[1][0] * e[0][k]) / det;
    }
    // glTF's green points up the image, against v
    float up = dot(cross, b) < 0 ? 1 : -1;
    for (int k = 0; k < 3; k++) b[k] = up * cross[k];
    return true;
}

static void turn_normal(const struct place *p, const struct prt_texture_ref *ref,
                        struct prt_look *out)
{
    float m[4], t[3], b[3], own[3], n[3];
    memcpy(n, out->normal, sizeof n);
    if (!look_up(p, ref, m) || !tangents(p, ref, n, t, b)) return;
    float l = sqrtf(dot(m, m));
    out->variance = l < 1 ? 1 - l : 0;
    for (int k = 0; k < 3; k++)
        own[k] = ref->scale * (m[0] * t[k] + m[1] * b[k]) + fmaxf(m[2], 1e-3f) * n[k];
    if (normalise(own)) memcpy(out->normal, own, sizeof own);
}

// Base colour texture, vertex colours and, where there is either, the factor of translucent
// surfaces; that of opaque ones is part of their transport.
static void find_base(const struct place *p, const struct prt_surface *surface,
                      const struct prt_texture_ref *ref, float base[4])
{
    const struct prt_mesh *mesh = p->mesh;
    const uint32_t *v = mesh->triangle[p->triangle];
    const float w[3] = {1 - p->a - p->b, p->a, p->b};
    bool textured = ref && look_up(p, ref, base);
    for (int c = 0; c < 4 && mesh->color; c++) {
        float x = 0;
        for (int k = 0; k < 3; k++) x += w[k] * mesh->color[v[k]][c];
        base[c] *= x > 0 ? x < 1 ? x : 1 : 0;
    }
    if (surface->translucent && (textured || mesh->color))
        for (int c = 0; c < 4; c++) base[c] *= surface->base_color[c];
}

void prt_mesh_look(const struct prt_mesh *mesh, uint32_t triangle, uint32_t block, float a,
                   float b, const float da[2], const float db[2], const float normal[3],
                   struct prt_look *out)
{
    const uint32_t s = mesh->block[block].surface;
    const struct prt_surface_maps *maps = mesh->maps ? &mesh->maps[s] : NULL;
    const struct place p = {mesh, triangle, a, b, {da[0], da[1]}, {db[0], db[1]}};
    float rgba[4];
    *out = (struct prt_look){.base = {1, 1, 1, 1}, .roughness = -1, .occlusion = 1};
    memcpy(out->normal, normal, sizeof out->normal);
    find_base(&p, &mesh->surface[s], maps ? &maps->map[PRT_MAP_BASE] : NULL, out->base);
    for (int c = 0; c < 3 && mesh->gain; c++) out->base[c] *= mesh->gain[block][c];
    if (!maps) return;
    turn_normal(&p, &maps->map[PRT_MAP_NORMAL], out);
    out->metallic = maps->metallic;
    if (look_up(&p, &maps->map[PRT_MAP_ROUGHNESS], rgba)) {
        out->roughness = fmaxf(rgba[1] * mesh->surface[s].roughness, 1e-3f);
        out->metallic *= rgba[2];
    }
    if (look_up(&p, &maps->map[PRT_MAP_OCCLUSION], rgba)) {
        float x = 1 + maps->map[PRT_MAP_OCCLUSION].scale * (rgba[0] - 1);
        out->occlusion = x > 1e-3f ? x < 1 ? x : 1 : 1e-3f;
    }
    memcpy(out->emission, maps->emissive, sizeof out->emission);
    if (look_up(&p, &maps->map[PRT_MAP_EMISSIVE], rgba))
        for (int c = 0; c < 3; c++) out->emission[c] *= rgba[c];
}

float prt_mesh_tint(const struct prt_mesh *mesh, const float base[3])
{
    if (!(mesh->texture_split > 0)) return 1;
    float y = 0.2126f * base[0] + 0.7152f * base[1] + 0.0722f * base[2];
    return powf(fmaxf(y, 0.02f), mesh->texture_split);
}
