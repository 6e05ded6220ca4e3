// SPDX-License-Identifier: MIT
// Pass 1: irradiance transport of every surface sample (W05 eq 8) and the hierarchy's sums.
#include "bake/stages.h"

#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

// cosines, mask and weights of one packet; returns the lanes worth a ray.
PRT_CLONES static uint32_t prepare(const struct directions *d, size_t at, const float n[3],
                                   const float f[3], const struct fresnel_table *fresnel,
                                   struct prt_packet *packet, float *value)
{
    float keep[16];
    for (int i = 0; i < 16; i++) {
        float x = d->x[at + i], y = d->y[at + i], z = d->z[at + i];
        float cosine = n[0] * x + n[1] * y + n[2] * z;
        float horizon = f[0] * x + f[1] * y + f[2] * z;
        float c = cosine > 0 ? cosine : 0;
        c = c < 1 ? c : 1;
        keep[i] = cosine > 0 && horizon > 0 ? 1.0f : 0.0f;
        packet->dx[i] = x, packet->dy[i] = y, packet->dz[i] = z;
        float ft = fresnel ? fresnel_table_eval(fresnel, c) : 1.0f;
        value[i] = keep[i] * ft * c * d->weight[at + i];
    }
    uint32_t mask = 0;
    for (int i = 0; i < 16; i++) mask |= (uint32_t)(keep[i] > 0) << i;
    return mask;
}

uint64_t irradiance_row(const struct prt_scene *scene, const struct directions *d,
                        unsigned pattern, const struct fresnel_table *fresnel,
                        const float origin[3], const float normal[3],
                        const float face_normal[3], float *out)
{
    struct prt_packet packet;
    float value[16] __attribute__((aligned(64)));
    float eps = prt_scene_epsilon(scene);
    uint64_t rays = 0;
    for (int i = 0; i < 16; i++) {
        packet.ox[i] = origin[0] + eps * face_normal[0];
        packet.oy[i] = origin[1] + eps * face_normal[1];
        packet.oz[i] = origin[2] + eps * face_normal[2];
        packet.tnear[i] = 0;
        packet.tfar[i] = INFINITY;
    }
    size_t base = (size_t)(pattern % d->n_pattern) * d->n_packet * 16;
    for (uint32_t k = 0; k < d->n_packet; k++) {
        const uint32_t *texel = d->texel + (size_t)k * 4;
        uint32_t mask = prepare(d, base + (size_t)k * 16, normal, face_normal, fresnel, &packet,
                                value);
        uint32_t open = mask ? mask & ~prt_scene_occluded16(scene, &packet, mask) : 0;
        rays += (unsigned)__builtin_popcount(mask);
        for (int j = 0; j < 4; j++) {
            float sum = 0;
            for (int i = 4 * j; i < 4 * j + 4; i++) sum += open >> i & 1 ? value[i] : 0;
            out[texel[j]] = sum;
        }
    }
    return rays;
}

int half_rows_create(const struct prt_context *ctx, size_t n_row, size_t n_coef,
                     struct half_rows *out)
{
    size_t bytes;
    memset(out, 0, sizeof *out);
    if (prt_mul_overflow(n_row, n_coef * 2, &bytes)) return PRT_NOMEM;
    long pages = sysconf(_SC_AVPHYS_PAGES), page = sysconf(_SC_PAGESIZE);
    int fd = -1;
    if (pages > 0 && page > 0 && bytes > (size_t)pages / 10 * 6 * (size_t)page) {
        const char *dir = getenv("TMPDIR");
        char path[512];
        snprintf(path, sizeof path, "%s/prt-bake-XXXXXX", dir && *dir ? dir : "/var/tmp");
        fd = mkstemp(path);
        if (fd < 0 || ftruncate(fd, (off_t)bytes)) {
            if (fd >= 0) close(fd);
            return prt_fail(ctx, PRT_IO,
                            "no room for %zu MB of irradiance transport: use fewer --samples "
                            "or a smaller --cube, or point TMPDIR to a larger disk",
                            bytes >> 20);
        }
        unlink(path);
        prt_log(ctx, PRT_LOG_NOTE, "irradiance transport (%zu MB) is kept on disk", bytes >> 20);
    }
    void *map = mmap(NULL, bytes, PROT_READ | PROT_WRITE,
                     fd < 0 ? MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE : MAP_SHARED, fd, 0);
    if (fd >= 0) close(fd);
    if (map == MAP_FAILED)
        return prt_fail(ctx, PRT_NOMEM, "no memory for %zu MB of irradiance transport",
                        bytes >> 20);
    madvise(map, bytes, MADV_HUGEPAGE);
    *out = (struct half_rows){n_row, n_coef, bytes, map};
    return PRT_OK;
}

void half_rows_finish(struct half_rows *rows)
{
    if (rows->half) munmap(rows->half, rows->bytes);
    memset(rows, 0, sizeof *rows);
}

struct pass_one {
    const struct prt_scene *scene;
    const struct prt_surface_points *surface;
    const struct hierarchy *h;
    const struct directions *d;
    const struct fresnel_table *fresnel;
    struct half_rows *rows;
    atomic_uint_fast64_t rays;
};

static int pass_one_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct pass_one *p = arg;
    prt_trace_thread_init();
    float *row = prt_alloc(p->rows->n_coef, sizeof *row);
    if (!row) return PRT_NOMEM;
    uint64_t rays = 0;
    for (size_t i = begin; i < end; i++) {
        uint32_t s = p->h->order[i];
        unsigned pattern = (unsigned)(prt_hash64(&s, sizeof s, 7) >> 32);
        rays += irradiance_row(p->scene, p->d, pattern, p->fresnel, p->surface->position[s],
                               p->surface->normal[s], p->surface->face_normal[s], row);
        prt_f32_to_f16_array(row, p->rows->n_coef, p->rows->half + i * p->rows->n_coef);
    }
    atomic_fetch_add(&p->rays, rays);
    prt_free(row);
    return PRT_OK;
}

// A subtree's sums, children first; leaves add their samples.
static void sum_node(struct pass_one *p, uint32_t at, float *row, float *child)
{
    const struct node *node = &p->h->node[at];
    size_t n = p->rows->n_coef, n_sample = p->surface->n_sample;
    memset(row, 0, n * sizeof *row);
    if (!node->child[0]) {
        for (uint32_t i = node->begin; i < node->begin + node->count; i++) {
            float w = p->surface->area[p->h->order[i]] / node->area;
            prt_f16_to_f32_array(p->rows->half + i * n, n, child);
            for (size_t k = 0; k < n; k++) row[k] += w * child[k];
        }
    } else {
        for (int c = 0; c < 2; c++) {
            float w = p->h->node[node->child[c]].area / node->area;
            prt_f16_to_f32_array(p->rows->half + (n_sample + node->child[c]) * n, n, child);
            for (size_t k = 0; k < n; k++) row[k] += w * child[k];
        }
    }
    prt_f32_to_f16_array(row, n, p->rows->half + (n_sample + at) * n);
}

// Children have larger indices than their parent: leaves in parallel first, then inner nodes in
// falling order.
static int leaf_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct pass_one *p = arg;
    float *scratch = prt_alloc(2 * p->rows->n_coef, sizeof *scratch);
    if (!scratch) return PRT_NOMEM;
    for (size_t i = begin; i < end; i++)
        if (!p->h->node[i].child[0])
            sum_node(p, (uint32_t)i, scratch, scratch + p->rows->n_coef);
    prt_free(scratch);
    return PRT_OK;
}

int irradiance_bake(const struct prt_context *ctx, const struct prt_scene *scene,
                    const struct prt_surface_points *surface, const struct hierarchy *h,
                    const struct directions *d, double eta, struct half_rows *out,
                    uint64_t *rays)
{
    struct fresnel_table fresnel;
    fresnel_table_init(&fresnel, eta);
    int status = half_rows_create(ctx, (size_t)surface->n_sample + h->n_node, d->n_coef, out);
    if (status) return status;
    struct pass_one p = {.scene = scene, .surface = surface, .h = h, .d = d, .fresnel = &fresnel,
                         .rows = out};
    status = prt_parallel_for(ctx, "irradiance", surface->n_sample, 64, pass_one_range, &p);
    if (status == PRT_OK)
        status = prt_parallel_for(ctx, "hierarchy", h->n_node, 256, leaf_range, &p);
    float *scratch = status == PRT_OK ? prt_alloc(2 * (size_t)d->n_coef, sizeof *scratch) : NULL;
    if (status == PRT_OK && !scratch) status = PRT_NOMEM;
    for (uint32_t i = h->n_node; status == PRT_OK && i-- > 0;)
        if (h->node[i].child[0]) sum_node(&p, i, scratch, scratch + d->n_coef);
    prt_free(scratch);
    *rays = atomic_load(&p.rays);
    if (status) half_rows_finish(out);
    return status;
}
