// SPDX-License-Identifier: MIT
// PUT_POSE: vertices, or a moment of an animation, become a pose that requests name by its
// content.
#include "net/dispatch.h"
#include "net/request_wait.h"
#include "ops/pose_animation.h"
#include "ops/vertices.h"
#include "relight.pb-c.h"
#include "render/shared/poses.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct posing {
    struct request_wait wait; // for the worker
    struct model *model;
    struct cache_entry *file; // has the mesh
    struct pose *base, *pose; // base: NULL, the file's vertices
    struct vertex_change change;
    struct held_bytes *bytes; // of the change; NULL where it is of an animation
    struct decoded_pose *animated;
    char refused[256]; // a fault of the vertices; "": none
};

static void end_posing(struct posing *p)
{
    pose_release(p->base);
    pose_release(p->pose);
    held_bytes_release(p->bytes);
    decoded_pose_destroy(p->animated);
    cache_release(p->file);
    model_release(p->model);
    free(p);
}

// The pose's name: of its vertices in mm and the normals that were given.
static void name_pose(struct pose *pose)
{
    struct relight_sha256 sha;
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, "pose", 4);
    relight_sha256_add(&sha, pose->position, (size_t)pose->n * 12);
    relight_sha256_add(&sha, pose->normal, (size_t)pose->n * 12);
    relight_sha256_hex(&sha, pose->name);
}

static int run_posing(struct work *work, const struct prt_context *ctx)
{
    struct posing *p = (struct posing *)work;
    const struct prt_mesh *mesh = &prt_file_transport(p->file->value)->mesh;
    size_t n = mesh->n_vertex;
    struct pose *pose = p->pose;
    if (vertices_bad(&p->change, mesh, p->model->name, p->refused)) return PRT_OK;
    pose->n = mesh->n_vertex;
    pose->position = prt_alloc(n, sizeof *pose->position);
    pose->normal = prt_calloc(n, sizeof *pose->normal);
    if (!pose->position || !pose->normal) return PRT_NOMEM;
    memcpy(pose->position, p->base ? p->base->position : mesh->position, n * 12);
    if (p->base) memcpy(pose->normal, p->base->normal, n * 12);
    vertices_move(&p->change, mesh, pose);
    name_pose(pose);
    return PRT_OK;
}

static void posed(struct request_wait *wait, struct request *request)
{
    struct posing *p = (struct posing *)wait;
    struct pose *pose = NULL;
    char error[256];
    int code = 0;
    if (request && wait->work.status) {
        request_fail(request, error_of_status(wait->work.status), "%s", wait->work.error);
    } else if (request && p->refused[0]) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE, "%s", p->refused);
    } else if (request && p->model->gone) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                     "%.100s was forgotten meanwhile", p->model->name);
    } else if (request) {
        code = poses_add(request->server->poses, p->model, p->pose, request->principal, &pose,
                         error);
        p->pose = NULL;
        if (code) {
            request_fail(request, code, "%s", error);
        } else {
            Relight__PutPoseAnswer out = RELIGHT__PUT_POSE_ANSWER__INIT;
            out.pose = pose->name;
            out.generation = pose->generation;
            request_answer(request, &out.base, NULL);
        }
    }
    pose_release(pose);
    end_posing(p);
}

// A state for the request; NULL: it was answered.
static struct posing *new_posing(struct request *request, struct model *m,
                                 struct cache_entry *file)
{
    struct posing *p = calloc(1, sizeof *p);
    if (!p || !(p->pose = calloc(1, sizeof *p->pose))) {
        free(p);
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return NULL;
    }
    p->pose->refs = 1;
    p->model = m;
    model_hold(m);
    p->file = file;
    cache_hold(file);
    return p;
}

// The file of an animation was read. request NULL: it has ended.
static void animated(void *user, struct request *request, struct decoded_pose *decoded)
{
    struct posing *p = user;
    p->animated = decoded;
    if (!request || !decoded) { // the request is answered
        end_posing(p);
        return;
    }
    const uint32_t n = prt_file_transport(p->file->value)->mesh.n_vertex;
    if (decoded->n != n) {
        request_fail(
            request, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
            "the animation's file has %u vertices, %.100s has %u: is it another model?",
            decoded->n, p->model->name, n);
        end_posing(p);
        return;
    }
    p->change = (struct vertex_change){
        .n = n, .own_units = true, .has_normals = true, .values = decoded->values};
    request_await_work(request, &p->wait, run_posing, posed);
}

static void mesh_ready(struct request *request, struct model *m, struct cache_entry *file)
{
    const Relight__PutPoseRequest *in = (const Relight__PutPoseRequest *)request->message;
    char error[256] = "not enough memory";
    int code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
    struct posing *p = new_posing(request, m, file);
    if (!p) return;
    if (in->animation[0]) {
        pose_animate(request, animated, p);
        return;
    }
    bool failed = in->base_pose[0] && !(p->base = poses_find(request->server->poses, m,
                                                             in->base_pose, &code, error));
    if (p->base && p->base->n != prt_file_transport(file->value)->mesh.n_vertex) {
        failed = true;
        code = RELIGHT__ERROR_CODE__ERROR_MISMATCH;
        snprintf(error, sizeof error,
                 "base_pose has %u vertices, %.100s has %u: it is of another model", p->base->n,
                 m->name, prt_file_transport(file->value)->mesh.n_vertex);
    }
    if (!failed && in->n) failed = !(p->bytes = request_take_payload(request));
    if (failed) {
        request_fail(request, code, "%s", error);
        end_posing(p);
        return;
    }
    p->change = (struct vertex_change){.first = in->first,
                                       .n = in->n,
                                       .own_units = in->own_units,
                                       .has_normals = in->has_normals,
                                       .values = p->bytes ? p->bytes->bytes : NULL};
    request_await_work(request, &p->wait, run_posing, posed);
}

void op_put_pose(struct request *request)
{
    const Relight__PutPoseRequest *in = (const Relight__PutPoseRequest *)request->message;
    if (in->animation[0] && (in->n || in->base_pose[0] || request->payload_size))
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                     "an animation gives all vertices: leave n, base_pose and payload out");
    else if (in->n_files && !in->animation[0])
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                     "animation is missing: files are those of an animation");
    else if (vertices_sized(request, in->n, in->has_normals))
        with_mesh(request, in->model, mesh_ready);
}
