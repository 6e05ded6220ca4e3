// SPDX-License-Identifier: MIT
// UPDATE_VERTICES: moves a model's vertices and keeps its triangles.
#include "net/dispatch.h"
#include "relight.pb-c.h"
#include "net/request.h"
#include "ops/vertices.h"
#include "render/shared/geometry.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

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
    pose->resource = LEDGER_PAYLOAD;
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
    const struct vertex_change change = {.first = in->first,
                                         .n = in->n,
                                         .own_units = in->own_units,
                                         .has_normals = in->has_normals,
                                         .values = (const float *)request->payload};
    char error[256] = "";
    if (in->if_generation && in->if_generation != m->generation) {
        request->generation = m->generation;
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
                     "the geometry of %.100s is generation %llu, not %llu (if_generation): "
                     "others moved its vertices meanwhile",
                     m->name, (unsigned long long)m->generation,
                     (unsigned long long)in->if_generation);
        return;
    }
    if (vertices_bad(&change, mesh, m->name, error)) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE, "%s", error);
        return;
    }
    int code = 0;
    struct pose *pose = in->n ? own_pose(m, mesh, request, &code, error) : NULL;
    if (in->n && !pose) {
        request_fail(request, code, "%s", error);
        return;
    }
    const bool moved = in->n > 0;
    if (moved) {
        struct prt_mesh now = *mesh;
        vertices_move(&change, mesh, pose);
        now.position = pose->position;
        prt_mesh_bounds(&now, m->facts.box);
        forget_old_shapes(m);
        m->generation++;
    }
    Relight__UpdateVerticesAnswer out = RELIGHT__UPDATE_VERTICES_ANSWER__INIT;
    out.generation = m->generation;
    request_answer(request, &out.base, NULL); // and frees the request
    if (moved) model_changed(m);
}

void op_update_vertices(struct request *request)
{
    const Relight__UpdateVerticesRequest *in =
        (const Relight__UpdateVerticesRequest *)request->message;
    if (vertices_sized(request, in->n, in->has_normals))
        with_mesh(request, in->model, mesh_ready);
}
