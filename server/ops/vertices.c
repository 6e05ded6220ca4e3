// SPDX-License-Identifier: MIT
// New positions and normals of a request.
#include "ops/vertices.h"

#include "relight.pb-c.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static const float farthest_mm = 1e6f;

bool vertices_sized(struct request *request, uint32_t n, bool has_normals)
{
    uint64_t want = (uint64_t)n * (has_normals ? 24 : 12);
    if (request->payload_size == want) return true;
    request_fail(request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                 "the payload has %zu bytes where %u vertices%s take %llu",
                 request->payload_size, n, has_normals ? " with normals" : "",
                 (unsigned long long)want);
    return false;
}

static float scale_of(const struct vertex_change *change, const struct prt_mesh *mesh)
{
    return change->own_units && mesh->mm_per_unit > 0 ? mesh->mm_per_unit : 1;
}

// The number of leading vertices whose numbers are within the limit.
static size_t count_within(const float *x, size_t n, float limit)
{
    size_t i = 0;
    while (i < 3 * n && fabsf(x[i]) <= limit) i++; // a NaN is not
    return i / 3;
}

bool vertices_bad(const struct vertex_change *change, const struct prt_mesh *mesh,
                  const char *name, char error[256])
{
    size_t n = change->n, good = n, good_normals = n;
    uint64_t end = (uint64_t)change->first + change->n;
    error[0] = 0;
    if (end <= mesh->n_vertex)
        good = count_within(change->values, n, farthest_mm / scale_of(change, mesh));
    if (end <= mesh->n_vertex && change->has_normals)
        good_normals = count_within(change->values + 3 * n, n, 1e9f);
    if (end > mesh->n_vertex)
        snprintf(error, 256, "first+n is %llu, allowed range 0 to %u: the vertices of %.100s",
                 (unsigned long long)end, mesh->n_vertex, name);
    else if (good < n)
        snprintf(error, 256,
                 "vertex %zu: its position is no number or too large, allowed range -1e6 to "
                 "1e6 mm",
                 change->first + good);
    else if (good_normals < n)
        snprintf(error, 256,
                 "vertex %zu: its normal is no number or too large, allowed range -1e9 to 1e9",
                 change->first + good_normals);
    return error[0];
}

// Normalises; 0 where that is impossible: the normal is then computed from the triangles.
static void put_normal(const float in[3], float out[3])
{
    float length = sqrtf(in[0] * in[0] + in[1] * in[1] + in[2] * in[2]);
    bool good = length > 1e-12f && isfinite(length);
    for (int c = 0; c < 3; c++) out[c] = good ? in[c] / length : 0;
}

void vertices_move(const struct vertex_change *change, const struct prt_mesh *mesh,
                   struct pose *pose)
{
    float scale = scale_of(change, mesh);
    const float *normal = change->has_normals ? change->values + 3 * (size_t)change->n : NULL;
    for (size_t i = 0; i < change->n; i++) {
        float *p = pose->position[change->first + i], *q = pose->normal[change->first + i];
        for (int c = 0; c < 3; c++) p[c] = change->values[3 * i + (size_t)c] * scale;
        memset(q, 0, sizeof *pose->normal);
        if (normal) put_normal(normal + 3 * i, q);
    }
}
