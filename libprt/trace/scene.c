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
    float epsilon;
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
    const struct prt_mesh *mesh = s->mesh;
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

uint32_t prt_scene_occluded16(const struct prt_scene *scene, const struct prt_packet *packet,
                              uint32_t mask)
{
    struct RTCRay16 ray;
    int valid[16] __attribute__((aligned(64)));
    valid_lanes(mask, valid);
    memcpy(ray.org_x, packet->ox, 64);
    memcpy(ray.org_y, packet->oy, 64);
    memcpy(ray.org_z, packet->oz, 64);
    memcpy(ray.dir_x, packet->dx, 64);
    memcpy(ray.dir_y, packet->dy, 64);
    memcpy(ray.dir_z, packet->dz, 64);
    memcpy(ray.tnear, packet->tnear, 64);
    memcpy(ray.tfar, packet->tfar, 64);
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

void prt_scene_intersect16(const struct prt_scene *scene, struct prt_packet *packet,
                           uint32_t mask, bool coherent)
{
    struct RTCRayHit16 rh;
    int valid[16] __attribute__((aligned(64)));
    valid_lanes(mask, valid);
    memcpy(rh.ray.org_x, packet->ox, 64);
    memcpy(rh.ray.org_y, packet->oy, 64);
    memcpy(rh.ray.org_z, packet->oz, 64);
    memcpy(rh.ray.dir_x, packet->dx, 64);
    memcpy(rh.ray.dir_y, packet->dy, 64);
    memcpy(rh.ray.dir_z, packet->dz, 64);
    memcpy(rh.ray.tnear, packet->tnear, 64);
    memcpy(rh.ray.tfar, packet->tfar, 64);
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
        packet->t[i] = hit ? rh.ray.tfar[i] : packet->tfar[i];
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
