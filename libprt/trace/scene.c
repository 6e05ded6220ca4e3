// SPDX-License-Identifier: MIT
// The BVH of a mesh, and rays through it in packets of 16.
#include "prt/trace.h"
#include "trace/embree.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if defined(__SSE__)
#include <pmmintrin.h>
#include <xmmintrin.h>
#endif

struct prt_scene {
    RTCDevice device;
    RTCScene scene;
    const struct prt_mesh *mesh;
    struct prt_mesh model; // the mesh in its own units, which the BVH is of
    float mm, inv_mm;      // a unit of it
    float epsilon, model_epsilon;
};

static void embree_error(void *user, enum RTCError code, const char *text)
{
    prt_log(user, PRT_LOG_ERROR, "embree: %s (%d)", text ? text : "unknown error", (int)code);
}

static float mean_edge(const struct prt_mesh *mesh)
{
    double sum = 0;
    size_t step = mesh->n_triangle / 4096 + 1, n = 0;
    for (size_t t = 0; t < mesh->n_triangle; t += step, n++) {
        const float *a = mesh->position[mesh->triangle[t][0]];
        const float *b = mesh->position[mesh->triangle[t][1]];
        double d = 0;
        for (int k = 0; k < 3; k++) d += (double)(a[k] - b[k]) * (a[k] - b[k]);
        sum += sqrt(d);
    }
    return n ? (float)(sum / (double)n) : 0;
}

// Of one object: 1e-4 of the mean edge or 1e-6 of its diagonal; 0: it has no translucent area.
static double object_epsilon(const struct prt_mesh *mesh, uint32_t object, double *farthest)
{
    double lo[3] = {INFINITY, INFINITY, INFINITY}, hi[3] = {-INFINITY, -INFINITY, -INFINITY};
    double edges = 0, square = 0;
    size_t n = 0;
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        const struct prt_block *block = &mesh->block[b];
        if (block->object != object || !mesh->surface[block->surface].translucent) continue;
        for (uint32_t t = block->triangle_begin; t < block->triangle_begin + block->n_triangle;
             t++, n++) {
            const float *p = mesh->position[mesh->triangle[t][0]];
            const float *q = mesh->position[mesh->triangle[t][1]];
            double d = 0;
            for (int k = 0; k < 3; k++) {
                lo[k] = fmin(lo[k], (double)p[k]), hi[k] = fmax(hi[k], (double)p[k]);
                *farthest = fmax(*farthest, fabs((double)p[k]));
                d += ((double)p[k] - q[k]) * ((double)p[k] - q[k]);
            }
            edges += sqrt(d);
        }
    }
    for (int k = 0; k < 3 && n; k++) square += (hi[k] - lo[k]) * (hi[k] - lo[k]);
    return n ? fmax(1e-4 * edges / (double)n, 1e-6 * sqrt(square)) : 0;
}

// The least of the translucent objects, above the rounding of positions: a power of two, so
// that a mesh that is changed a little, or stands beside another, has the same.
static float model_epsilon(const struct prt_mesh *mesh, float otherwise)
{
    double least = INFINITY, farthest = 0;
    for (uint32_t o = 0; o < mesh->n_object; o++) {
        const double own = object_epsilon(mesh, o, &farthest);
        if (own > 0) least = fmin(least, own);
    }
    if (!(least < INFINITY)) return otherwise;
    return (float)exp2(ceil(log2(fmax(least, 2.5e-7 * farthest))));
}

static int commit(const struct prt_context *ctx, struct prt_scene *s)
{
    rtcCommitScene(s->scene);
    if (rtcGetDeviceError(s->device) != RTC_ERROR_NONE)
        return prt_fail(ctx, PRT_NOMEM, "the ray tracing structure could not be built");
    return PRT_OK;
}

// Embree gets copies: it reads up to 16 bytes behind the last vertex.
static int attach(const struct prt_context *ctx, struct prt_scene *s)
{
    const struct prt_mesh *mesh = &s->model;
    RTCGeometry geometry = rtcNewGeometry(s->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    float *vertex = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0,
                                            RTC_FORMAT_FLOAT3, 12, mesh->n_vertex);
    uint32_t *index = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0,
                                              RTC_FORMAT_UINT3, 12, mesh->n_triangle);
    if (!vertex || !index) {
        rtcReleaseGeometry(geometry);
        return prt_fail(ctx, PRT_NOMEM,
                        "no memory for the ray tracing structure of %u triangles",
                        mesh->n_triangle);
    }
    memcpy(vertex, mesh->position, (size_t)mesh->n_vertex * 12);
    memcpy(index, mesh->triangle, (size_t)mesh->n_triangle * 12);
    rtcCommitGeometry(geometry);
    rtcAttachGeometryByID(s->scene, geometry, 0);
    rtcReleaseGeometry(geometry);
    // Without RTC_SCENE_FLAG_ROBUST one ray in two million misses a seam between triangles;
    // with it rays take a fifth longer.
    return commit(ctx, s);
}

int prt_scene_refine(const struct prt_context *ctx, struct prt_scene *s)
{
    rtcSetDeviceErrorFunction(s->device, embree_error, (void *)(uintptr_t)ctx);
    rtcSetSceneBuildQuality(s->scene, RTC_BUILD_QUALITY_HIGH);
    int status = commit(ctx, s);
    rtcSetDeviceErrorFunction(s->device, embree_error, NULL);
    return status;
}

int prt_scene_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                     struct prt_scene **out)
{
    if (!mesh->n_triangle) return prt_fail(ctx, PRT_ARG, "the mesh has no triangles");
    prt_trace_thread_init();
    struct prt_scene *s = calloc(1, sizeof *s);
    if (!s) return PRT_NOMEM;
    s->mesh = mesh;
    s->model = *mesh;
    s->mm = s->inv_mm = 1;
    if (mesh->model) {
        s->model.position = mesh->model;
        s->mm = mesh->mm_per_unit, s->inv_mm = 1 / mesh->mm_per_unit;
    }
    char config[64];
    snprintf(config, sizeof config, "threads=%u", prt_pool_size(ctx ? ctx->pool : NULL));
    s->device = rtcNewDevice(config);
    if (!s->device) {
        free(s);
        return prt_fail(ctx, PRT_INTERNAL, "embree could not be started");
    }
    rtcSetDeviceErrorFunction(s->device, embree_error, (void *)(uintptr_t)ctx);
    s->scene = rtcNewScene(s->device);
    int status = attach(ctx, s);
    rtcSetDeviceErrorFunction(s->device, embree_error, NULL);
    if (status) {
        prt_scene_destroy(s);
        return status;
    }
    float lo[3] = {INFINITY, INFINITY, INFINITY}, hi[3] = {-INFINITY, -INFINITY, -INFINITY};
    double diagonal2 = 0;
    for (uint32_t v = 0; v < mesh->n_vertex; v++)
        for (int k = 0; k < 3; k++) {
            lo[k] = fminf(lo[k], mesh->position[v][k]);
            hi[k] = fmaxf(hi[k], mesh->position[v][k]);
        }
    for (int k = 0; k < 3; k++) diagonal2 += (double)(hi[k] - lo[k]) * (hi[k] - lo[k]);
    s->epsilon = fmaxf(1e-4f * mean_edge(mesh), (float)(1e-6 * sqrt(diagonal2)));
    s->model_epsilon = model_epsilon(&s->model, s->epsilon * s->inv_mm);
    *out = s;
    return PRT_OK;
}

void prt_scene_destroy(struct prt_scene *scene)
{
    if (!scene) return;
    if (scene->scene) rtcReleaseScene(scene->scene);
    if (scene->device) rtcReleaseDevice(scene->device);
    free(scene);
}

const struct prt_mesh *prt_scene_mesh(const struct prt_scene *scene)
{
    return scene->mesh;
}

float prt_scene_epsilon(const struct prt_scene *scene)
{
    return scene->epsilon;
}

const struct prt_mesh *prt_scene_model(const struct prt_scene *scene)
{
    return &scene->model;
}

float prt_scene_model_epsilon(const struct prt_scene *scene)
{
    return scene->model_epsilon;
}

float prt_scene_model_units(const struct prt_scene *scene)
{
    return scene->inv_mm;
}

void prt_trace_thread_init(void)
{
#if defined(__SSE__)
    _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON);
    _MM_SET_DENORMALS_ZERO_MODE(_MM_DENORMALS_ZERO_ON);
#endif
}

static void valid_lanes(uint32_t mask, int valid[16])
{
    for (int i = 0; i < 16; i++) valid[i] = -(int)(mask >> i & 1);
}

static void scale_lanes(float out[16], const float in[16], float by)
{
    for (int i = 0; i < 16; i++) out[i] = by * in[i];
}

// Lengths of the packet times `unit` are in the model's units.
static uint32_t occluded(const struct prt_scene *scene, const struct prt_packet *packet,
                         float unit, uint32_t mask)
{
    struct RTCRay16 ray;
    int valid[16] __attribute__((aligned(64)));
    valid_lanes(mask, valid);
    scale_lanes(ray.org_x, packet->ox, unit);
    scale_lanes(ray.org_y, packet->oy, unit);
    scale_lanes(ray.org_z, packet->oz, unit);
    memcpy(ray.dir_x, packet->dx, 64);
    memcpy(ray.dir_y, packet->dy, 64);
    memcpy(ray.dir_z, packet->dz, 64);
    scale_lanes(ray.tnear, packet->tnear, unit);
    scale_lanes(ray.tfar, packet->tfar, unit);
    for (int i = 0; i < 16; i++) {
        ray.time[i] = 0;
        ray.mask[i] = ~0u;
        ray.id[i] = 0;
        ray.flags[i] = 0;
    }
    embree_occluded16(valid, scene->scene, &ray);
    uint32_t hit = 0;
    for (int i = 0; i < 16; i++) hit |= (uint32_t)(ray.tfar[i] < 0) << i;
    return hit & mask;
}

uint32_t prt_scene_occluded16(const struct prt_scene *scene, const struct prt_packet *packet,
                              uint32_t mask)
{
    return occluded(scene, packet, scene->inv_mm, mask);
}

uint32_t prt_scene_model_occluded16(const struct prt_scene *scene,
                                    const struct prt_packet *packet, uint32_t mask)
{
    return occluded(scene, packet, 1, mask);
}

void prt_scene_intersect16(const struct prt_scene *scene, struct prt_packet *packet,
                           uint32_t mask, bool coherent)
{
    struct RTCRayHit16 rh;
    int valid[16] __attribute__((aligned(64)));
    valid_lanes(mask, valid);
    scale_lanes(rh.ray.org_x, packet->ox, scene->inv_mm);
    scale_lanes(rh.ray.org_y, packet->oy, scene->inv_mm);
    scale_lanes(rh.ray.org_z, packet->oz, scene->inv_mm);
    memcpy(rh.ray.dir_x, packet->dx, 64);
    memcpy(rh.ray.dir_y, packet->dy, 64);
    memcpy(rh.ray.dir_z, packet->dz, 64);
    scale_lanes(rh.ray.tnear, packet->tnear, scene->inv_mm);
    scale_lanes(rh.ray.tfar, packet->tfar, scene->inv_mm);
    for (int i = 0; i < 16; i++) {
        rh.ray.time[i] = 0;
        rh.ray.mask[i] = ~0u;
        rh.ray.id[i] = 0;
        rh.ray.flags[i] = 0;
        rh.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
        rh.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
    }
    embree_intersect16(valid, scene->scene, &rh, coherent);
    for (int i = 0; i < 16; i++) {
        bool hit = (mask >> i & 1) && rh.hit.geomID[i] != RTC_INVALID_GEOMETRY_ID;
        packet->t[i] = hit ? scene->mm * rh.ray.tfar[i] : packet->tfar[i];
        packet->u[i] = hit ? rh.hit.u[i] : 0;
        packet->v[i] = hit ? rh.hit.v[i] : 0;
        packet->gx[i] = rh.hit.Ng_x[i], packet->gy[i] = rh.hit.Ng_y[i];
        packet->gz[i] = rh.hit.Ng_z[i];
        packet->triangle[i] = hit ? rh.hit.primID[i] : UINT32_MAX;
    }
}

static void one_ray(struct prt_packet *p, const float o[3], const float d[3], float tnear,
                    float tfar)
{
    memset(p, 0, sizeof *p);
    p->ox[0] = o[0], p->oy[0] = o[1], p->oz[0] = o[2];
    p->dx[0] = d[0], p->dy[0] = d[1], p->dz[0] = d[2];
    p->tnear[0] = tnear, p->tfar[0] = tfar;
}

// A ray that aims exactly at a vertex or an edge, as along the normals of a regular mesh, may
// miss. A miss counts only when four slightly different rays miss.
bool prt_scene_intersect(const struct prt_scene *scene, const float o[3], const float d[3],
                         float tnear, float tfar, float *t, uint32_t *triangle, float *u,
                         float *v)
{
    static const float aside[4][3] = {{0, 0, 0}, {3, 1, -2}, {-2, 3, 1}, {1, -2, 3}};
    struct prt_packet p;
    float length = sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    for (int i = 0; i < 4; i++) {
        float w[3];
        for (int k = 0; k < 3; k++) w[k] = d[k] + 1e-5f * length * aside[i][k];
        one_ray(&p, o, w, tnear, tfar);
        prt_scene_intersect16(scene, &p, 1, false);
        if (p.triangle[0] != UINT32_MAX) break;
    }
    *t = p.t[0], *triangle = p.triangle[0], *u = p.u[0], *v = p.v[0];
    return p.triangle[0] != UINT32_MAX;
}
