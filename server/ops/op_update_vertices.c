// SPDX-License-Identifier: MIT
// UPDATE_VERTICES: moves a model's vertices and keeps its triangles.
#include "net/dispatch.h"
#include "relight.pb-c.h"
#include "net/request.h"
#include "render/shared/geometry.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const float farthest_mm = 1e6f;

// A pose that only the model holds: its own, or a copy of it or of the file's positions. NULL
// with code and error. The principal that caused the copy is charged while the model holds it.
static struct pose *own_pose(struct model *m, const struct prt_mesh *mesh,
                             const struct request *request, int *code, char error[256])
{
    size_t n = mesh->n_vertex;
    if (m->pose && m->pose->refs == 1) return m->pose;
    struct pose *pose = calloc(1, sizeof *pose);
    *code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
    snprintf(error, 256, "not enough memory");
    if (!pose) return NULL;
    pose->refs = 1;
    if (ledger_take(request->principal, LEDGER_PAYLOAD, n * 24, error)) {
        *code = refusal_code(request->principal, LEDGER_PAYLOAD, n * 24);
        free(pose);
        return NULL;
    }
    pose->principal = request->principal;
    principal_hold(pose->principal);
    pose->charged = n * 24;
    pose->n = mesh->n_vertex;
    pose->position = prt_alloc(n, sizeof *pose->position);
    pose->normal = prt_calloc(n, sizeof *pose->normal);
    if (!pose->position || !pose->normal) {
        pose_release(pose);
        return NULL;
    }
    memcpy(pose->position, m->pose ? m->pose->position : mesh->position, n * 12);
    if (m->pose) memcpy(pose->normal, m->pose->normal, n * 12);
    pose_release(m->pose);
    return m->pose = pose;
}

static bool all_within(const float *x, size_t n, float limit)
{
    for (size_t i = 0; i < n; i++)
        if (!(fabsf(x[i]) <= limit)) return false; // catches NaN
    return true;
}

// Normalises; 0 where that is impossible: the normal is then computed from the triangles.
static void put_normal(const float in[3], float out[3])
{
    float length = sqrtf(in[0] * in[0] + in[1] * in[1] + in[2] * in[2]);
    bool good = length > 1e-12f && isfinite(length);
    for (int c = 0; c < 3; c++) out[c] = good ? in[c] / length : 0;
}

// Forgets cached results of earlier shapes, except the previous one, which may still be in use:
// the next call forgets it.
static void forget_old_shapes(struct model *m)
{
    char prefix[96];
    for (uint64_t g = m->generation; g > 0 && g + 2 > m->generation; g--) {
        // The bake's results belong to the file's shape: moved vertices do not change them.
        if (g == m->baked_generation) continue;
        snprintf(prefix, sizeof prefix, "%s/%llu/", m->key, (unsigned long long)g);
        cache_forget(m->server->cache, prefix, true);
    }
}

static void mesh_ready(struct request *request, struct model *m, struct cache_entry *file)
{
    const Relight__UpdateVerticesRequest *in =
        (const Relight__UpdateVerticesRequest *)request->message;
    const struct prt_mesh *mesh = &prt_file_transport(file->value)->mesh;
    const float *from = (const float *)request->payload;
    const float *normal = in->has_normals ? from + 3 * (size_t)in->n : NULL;
    float scale = in->own_units && mesh->mm_per_unit > 0 ? mesh->mm_per_unit : 1;
    if ((uint64_t)in->first + in->n > mesh->n_vertex) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE,
                     "first+n is %llu, allowed range 0 to %u: the vertices of %.100s",
                     (unsigned long long)in->first + in->n, mesh->n_vertex, m->name);
        return;
    }
    if (!all_within(from, 3 * (size_t)in->n, farthest_mm / scale)) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE,
                     "a position is no number or too large, allowed range -1e6 to 1e6 mm");
        return;
    }
    if (normal && !all_within(normal, 3 * (size_t)in->n, 1e9f)) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE,
                     "a normal is no number or too large, allowed range -1e9 to 1e9");
        return;
    }
    int code = 0;
    char error[256] = "";
    struct pose *pose = in->n ? own_pose(m, mesh, request, &code, error) : NULL;
    if (in->n && !pose) {
        request_fail(request, code, "%s", error);
        return;
    }
    for (size_t i = 0; i < in->n; i++) {
        float *p = pose->position[in->first + i], *q = pose->normal[in->first + i];
        for (int c = 0; c < 3; c++) p[c] = from[3 * i + (size_t)c] * scale;
        memset(q, 0, sizeof *pose->normal);
        if (normal) put_normal(normal + 3 * i, q);
    }
    if (in->n) {
        forget_old_shapes(m);
        m->generation++;
    }
    bool moved = in->n > 0;
    Relight__UpdateVerticesAnswer out = RELIGHT__UPDATE_VERTICES_ANSWER__INIT;
    out.generation = m->generation;
    request_answer(request, &out.base, NULL); // and frees the request
    if (moved) model_changed(m);
}

void op_update_vertices(struct request *request)
{
    const Relight__UpdateVerticesRequest *in =
        (const Relight__UpdateVerticesRequest *)request->message;
    uint64_t want = (uint64_t)in->n * (in->has_normals ? 24 : 12);
    if (request->payload_size != want) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                     "the payload has %zu bytes where %u vertices%s take %llu",
                     request->payload_size, in->n, in->has_normals ? " with normals" : "",
                     (unsigned long long)want);
        return;
    }
    with_mesh(request, in->model, mesh_ready);
}
