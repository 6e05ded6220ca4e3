// SPDX-License-Identifier: MIT
// The visibility buffer: the triangle that each sub-sample of the covered pixels sees (MT97),
// and the shading points that sub-samples are grouped into.
#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// One shading point before the arrays of the G-buffer exist.
struct point {
    uint32_t pixel, triangle, block, corner[3];
    float bary[2], position[3], normal[3], weight, facing, variance;
    uint8_t opaque;
};

struct row_points {
    struct point *point;
    uint32_t n, capacity;
};

struct builder {
    const struct prt_context *ctx;
    const struct prt_mesh *mesh;
    struct prt_visibility *vis;
    struct gl_draw draw;
    uint32_t *triangle_block;
    struct row_points *row;
    uint32_t band_begin;
    const uint32_t *id;
    double pixel_scale; // side of a pixel at depth 1
};

// Ray through (x,y) in pixels, not normalised: its component along forward is 1.
static void pixel_ray(const struct camera_frame *f, double x, double y, uint32_t width,
                      uint32_t height, double d[3])
{
    double a = 2 * x / width - 1, b = 1 - 2 * y / height;
    for (int i = 0; i < 3; i++) d[i] = f->forward[i] + a * f->right[i] + b * f->up[i];
}

// Barycentrics of the ray's intersection with the plane of a triangle (Moeller-Trumbore in
// double, MT97), clamped to the triangle, since GL snaps vertices to 1/256 pixel. False for a
// triangle seen edge on.
static bool ray_barycentrics(const double eye[3], const double d[3], const float a[3],
                             const float b[3], const float c[3], double uv[2])
{
    double e1[3], e2[3], s[3], h[3], q[3];
    for (int i = 0; i < 3; i++) {
        e1[i] = (double)b[i] - a[i];
        e2[i] = (double)c[i] - a[i];
        s[i] = eye[i] - a[i];
    }
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        h[i] = d[j] * e2[k] - d[k] * e2[j];
        q[i] = s[j] * e1[k] - s[k] * e1[j];
    }
    double det = e1[0] * h[0] + e1[1] * h[1] + e1[2] * h[2];
    double u = (s[0] * h[0] + s[1] * h[1] + s[2] * h[2]) / det;
    double v = (d[0] * q[0] + d[1] * q[1] + d[2] * q[2]) / det;
    if (!isfinite(u) || !isfinite(v)) {
        uv[0] = uv[1] = 1.0 / 3;
        return false;
    }
    u = fmax(u, 0);
    v = fmax(v, 0);
    double sum = u + v;
    if (sum > 1) {
        u /= sum;
        v /= sum;
    }
    uv[0] = u;
    uv[1] = v;
    return true;
}

static uint16_t unorm16(double x)
{
    return (uint16_t)(x * 65535 + 0.5);
}

// Position and smooth normal at a sub-sample.
static void fill_point(const struct builder *b, uint32_t triangle, const double uv[2],
                       struct point *p)
{
    const struct prt_mesh *m = b->mesh;
    const uint32_t *t = m->triangle[triangle];
    double w[3] = {1 - uv[0] - uv[1], uv[0], uv[1]}, n[3], e1[3], e2[3], to_eye[3];
    p->triangle = triangle;
    p->block = b->triangle_block[triangle];
    p->opaque = !m->surface[m->block[p->block].surface].translucent;
    for (int k = 0; k < 3; k++) p->corner[k] = t[k];
    for (int i = 0; i < 3; i++) {
        double x = 0;
        n[i] = 0;
        for (int k = 0; k < 3; k++) {
            x += w[k] * m->position[t[k]][i];
            n[i] += w[k] * m->normal[t[k]][i];
        }
        p->position[i] = (float)x;
        to_eye[i] = b->vis->frame.eye[i] - x;
        e1[i] = (double)m->position[t[1]][i] - m->position[t[0]][i];
        e2[i] = (double)m->position[t[2]][i] - m->position[t[0]][i];
    }
    double face[3] = {e1[1] * e2[2] - e1[2] * e2[1], e1[2] * e2[0] - e1[0] * e2[2],
                      e1[0] * e2[1] - e1[1] * e2[0]};
    double facing = face[0] * to_eye[0] + face[1] * to_eye[1] + face[2] * to_eye[2];
    double l = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    bool cancelled = !(l > 1e-6);
    if (cancelled) {
        memcpy(n, to_eye, sizeof n);
        l = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    }
    if (!(l > 0)) l = 1;
    if (facing < 0 && !cancelled)
        l = -l; // the back of an open surface: the normal is flipped towards the eye
    for (int i = 0; i < 3; i++) p->normal[i] = (float)(n[i] / l);
    double f2 = face[0] * face[0] + face[1] * face[1] + face[2] * face[2];
    double w2 = to_eye[0] * to_eye[0] + to_eye[1] * to_eye[1] + to_eye[2] * to_eye[2];
    p->facing = f2 * w2 > 0 ? (float)(fabs(facing) / sqrt(f2 * w2)) : 1;
    p->variance = 0;
    p->bary[0] = (float)uv[0];
    p->bary[1] = (float)uv[1];
}

// Whether two sub-samples may be one point: same block, similar normals, no step in depth.
static bool same_patch(const struct point *a, const struct point *b, double footprint)
{
    if (a->block != b->block) return false;
    double dn = 0, dp = 0;
    for (int i = 0; i < 3; i++) {
        double e = (double)a->position[i] - b->position[i];
        dn += (double)a->normal[i] * b->normal[i];
        dp += e * e;
    }
    return dn > 0.8 && dp < 36 * footprint * footprint;
}

static bool push_point(struct row_points *row, const struct point *p)
{
    if (row->n == row->capacity) {
        uint32_t capacity = row->capacity ? row->capacity * 2 : 64;
        struct point *grown = realloc(row->point, capacity * sizeof *grown);
        if (!grown) return false;
        row->point = grown;
        row->capacity = capacity;
    }
    row->point[row->n++] = *p;
    return true;
}

// Groups a pixel's sub-samples into points: a group's point is its sub-sample nearest to the
// group's mean position.
static bool group_pixel(struct builder *b, struct row_points *row, const struct point *sample,
                        unsigned n_sample)
{
    unsigned group[RASTER_MAX_SUB], n_group = 0;
    for (unsigned s = 0; s < n_sample; s++) {
        double depth = 0;
        for (int i = 0; i < 3; i++)
            depth += b->vis->frame.forward[i] * (sample[s].position[i] - b->vis->frame.eye[i]);
        unsigned k = 0;
        while (k < s && !same_patch(&sample[k], &sample[s], depth * b->pixel_scale)) k++;
        group[s] = k < s ? group[k] : n_group++;
    }
    for (unsigned g = 0; g < n_group; g++) {
        float mean[3] = {0, 0, 0}, best = INFINITY;
        unsigned count = 0, pick = 0;
        for (unsigned s = 0; s < n_sample; s++) {
            if (group[s] != g) continue;
            count++;
            for (int i = 0; i < 3; i++) mean[i] += sample[s].position[i];
        }
        for (unsigned s = 0; s < n_sample; s++) {
            if (group[s] != g) continue;
            float d = 0;
            for (int i = 0; i < 3; i++) {
                float e = sample[s].position[i] - mean[i] / (float)count;
                d += e * e;
            }
            if (d < best) {
                best = d;
                pick = s;
            }
        }
        struct point p = sample[pick];
        float n[3] = {0, 0, 0};
        for (unsigned s = 0; s < n_sample; s++)
            for (int i = 0; group[s] == g && i < 3; i++) n[i] += sample[s].normal[i];
        float length = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) / (float)count;
        p.variance = length < 1 ? 1 - length : 0;
        p.weight = (float)count / (float)b->vis->n_sub;
        if (!push_point(row, &p)) return false;
    }
    return true;
}

static bool covered_pixel(const uint32_t *id, unsigned n_sub)
{
    uint32_t all = UINT32_MAX;
    for (unsigned s = 0; s < n_sub; s++) all &= id[s];
    return all != UINT32_MAX;
}

static int count_rows(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct builder *b = arg;
    struct prt_visibility *vis = b->vis;
    for (size_t y = begin; y < end; y++) {
        const uint32_t *id = b->id + y * vis->width * vis->n_sub;
        uint32_t n = 0;
        for (uint32_t x = 0; x < vis->width; x++)
            n += covered_pixel(id + x * vis->n_sub, vis->n_sub);
        vis->row_covered[b->band_begin + y + 1] = n;
    }
    return PRT_OK;
}

static int fill_rows(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct builder *b = arg;
    struct prt_visibility *vis = b->vis;
    const struct prt_mesh *m = b->mesh;
    unsigned n_sub = vis->n_sub;
    for (size_t r = begin; r < end; r++) {
        uint32_t y = b->band_begin + (uint32_t)r, at = vis->row_covered[y];
        for (uint32_t x = 0; x < vis->width; x++) {
            const uint32_t *id = b->id + (r * vis->width + x) * n_sub;
            if (!covered_pixel(id, n_sub)) continue;
            struct point sample[RASTER_MAX_SUB];
            unsigned n = 0;
            vis->pixel[at] = y * vis->width + x;
            for (unsigned s = 0; s < n_sub; s++) {
                size_t k = (size_t)at * n_sub + s;
                vis->sample_triangle[k] = id[s];
                vis->sample_uv[k][0] = vis->sample_uv[k][1] = 0;
                if (id[s] >= m->n_triangle) continue;
                const uint32_t *t = m->triangle[id[s]];
                double d[3], uv[2];
                pixel_ray(&vis->frame, x + (double)b->draw.sub_position[s][0],
                          y + (double)b->draw.sub_position[s][1], vis->width, vis->height, d);
                ray_barycentrics(vis->frame.eye, d, m->position[t[0]], m->position[t[1]],
                                 m->position[t[2]], uv);
                vis->sample_uv[k][0] = unorm16(uv[0]);
                vis->sample_uv[k][1] = unorm16(uv[1]);
                sample[n].pixel = vis->pixel[at];
                fill_point(b, id[s], uv, &sample[n++]);
            }
            if (!group_pixel(b, &b->row[y], sample, n)) return PRT_NOMEM;
            at++;
        }
    }
    return PRT_OK;
}

static bool grow(void **p, size_t old_bytes, size_t bytes)
{
    void *q = prt_alloc(bytes ? bytes : 1, 1);
    if (!q) return false;
    if (*p && old_bytes) memcpy(q, *p, old_bytes);
    prt_free(*p);
    *p = q;
    return true;
}

static int take_band(void *user, uint32_t row_begin, uint32_t row_end, const uint32_t *id)
{
    struct builder *b = user;
    struct prt_visibility *vis = b->vis;
    b->band_begin = row_begin;
    b->id = id;
    int status = prt_parallel_for(b->ctx, NULL, row_end - row_begin, 8, count_rows, b);
    if (status) return status;
    for (uint32_t y = row_begin; y < row_end; y++)
        vis->row_covered[y + 1] += vis->row_covered[y];
    size_t before = vis->n_covered, after = vis->row_covered[row_end], sub = vis->n_sub;
    if (!grow((void **)&vis->pixel, before * 4, after * 4) ||
        !grow((void **)&vis->sample_triangle, before * sub * 4, after * sub * 4) ||
        !grow((void **)&vis->sample_uv, before * sub * 4, after * sub * 4))
        return prt_fail(b->ctx, PRT_NOMEM, "raster: no memory for %zu pixels", after);
    vis->n_covered = (uint32_t)after;
    return prt_parallel_for(b->ctx, NULL, row_end - row_begin, 4, fill_rows, b);
}

static bool alloc_points(struct prt_gbuffer *g)
{
    size_t n = g->n_point ? g->n_point : 1;
    // kernels read whole vectors: 16 more elements are allocated
    void **array[] = {
        (void **)&g->pixel,       (void **)&g->triangle,    (void **)&g->block,
        (void **)&g->corner[0],   (void **)&g->corner[1],   (void **)&g->corner[2],
        (void **)&g->bary[0],     (void **)&g->bary[1],     (void **)&g->position[0],
        (void **)&g->position[1], (void **)&g->position[2], (void **)&g->normal[0],
        (void **)&g->normal[1],   (void **)&g->normal[2],   (void **)&g->weight,
        (void **)&g->facing,      (void **)&g->variance};
    bool good = true;
    for (size_t i = 0; i < sizeof array / sizeof *array; i++)
        good &= (*array[i] = prt_calloc(n + 16, 4)) != NULL;
    return good && (g->opaque = prt_calloc(n + 16, 1)) != NULL;
}

static int pack_rows(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct builder *b = arg;
    struct prt_gbuffer *g = &b->vis->g;
    for (size_t y = begin; y < end; y++) {
        uint32_t at = b->vis->row_point[y];
        for (uint32_t k = 0; k < b->row[y].n; k++, at++) {
            const struct point *p = &b->row[y].point[k];
            g->pixel[at] = p->pixel;
            g->triangle[at] = p->triangle;
            g->block[at] = p->block;
            g->weight[at] = p->weight;
            g->opaque[at] = p->opaque;
            g->facing[at] = p->facing;
            g->variance[at] = p->variance;
            for (int i = 0; i < 3; i++) {
                g->corner[i][at] = p->corner[i];
                g->position[i][at] = p->position[i];
                g->normal[i][at] = p->normal[i];
                if (i < 2) g->bary[i][at] = p->bary[i];
            }
        }
    }
    return PRT_OK;
}

// Depth range of the vertices in front of the eye; where some are behind it the near plane is a
// small share of the far one. False when all are behind.
static bool depth_range(struct builder *b)
{
    const struct camera_frame *f = &b->vis->frame;
    double lo = INFINITY, hi = -INFINITY;
    for (uint32_t v = 0; v < b->mesh->n_vertex; v++) {
        double z = 0;
        for (int i = 0; i < 3; i++) z += f->forward[i] * (b->mesh->position[v][i] - f->eye[i]);
        lo = fmin(lo, z);
        hi = fmax(hi, z);
    }
    if (!(hi > 0)) return false;
    b->draw.z_far = hi * 1.001;
    b->draw.z_near = fmax(lo * 0.999, hi * 1e-5);
    return true;
}

static int build(struct builder *b, enum prt_raster_backend backend)
{
    struct prt_visibility *vis = b->vis;
    b->triangle_block = prt_mesh_triangle_blocks(b->mesh);
    b->row = calloc(vis->height, sizeof *b->row);
    vis->row_covered = prt_calloc((size_t)vis->height + 1, 4);
    vis->row_point = prt_calloc((size_t)vis->height + 1, 4);
    if (!b->triangle_block || !b->row || !vis->row_covered || !vis->row_point)
        return prt_fail(b->ctx, PRT_NOMEM, "raster: no memory for %u rows", vis->height);
    b->draw = (struct gl_draw){.mesh = b->mesh,
                               .frame = &vis->frame,
                               .width = vis->width,
                               .height = vis->height,
                               .n_sub = vis->n_sub,
                               .band = take_band,
                               .user = b};
    b->pixel_scale = 2 * vis->frame.tan_y / vis->height;
    if (b->mesh->n_triangle && depth_range(b)) {
        int status = prt_gl_draw_triangles(b->ctx, backend, &b->draw);
        if (status) return status;
    }
    for (uint32_t y = 0; y < vis->height; y++)
        vis->row_point[y + 1] = vis->row_point[y] + b->row[y].n;
    vis->g.n_point = vis->row_point[vis->height];
    if (!alloc_points(&vis->g))
        return prt_fail(b->ctx, PRT_NOMEM, "raster: no memory for %u points", vis->g.n_point);
    int status = prt_parallel_for(b->ctx, NULL, vis->height, 16, pack_rows, b);
    if (!status) status = prt_raster_look(b->ctx, b->mesh, vis);
    return status ? status : prt_raster_unblocked(b->ctx, b->mesh, vis);
}

static bool keep_objects(struct prt_visibility *vis, const struct prt_mesh *mesh)
{
    vis->block_object = prt_alloc(mesh->n_block, sizeof *vis->block_object);
    vis->n_block = vis->block_object ? mesh->n_block : 0;
    for (uint32_t i = 0; i < vis->n_block; i++) vis->block_object[i] = mesh->block[i].object;
    return vis->block_object != NULL;
}

int prt_visibility_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                          const struct prt_camera *camera, const struct prt_raster *raster,
                          struct prt_visibility **out)
{
    uint32_t width = raster->width, height = raster->height;
    unsigned n_sub = raster->n_sub;
    if (!width || !height || width > RASTER_MAX_SIZE || height > RASTER_MAX_SIZE)
        return prt_fail(ctx, PRT_ARG, "image size %ux%u is outside 1x1 to %dx%d", width, height,
                        RASTER_MAX_SIZE, RASTER_MAX_SIZE);
    if (n_sub != 1 && n_sub != 2 && n_sub != 4 && n_sub != 8)
        return prt_fail(ctx, PRT_ARG, "%u sub-samples a pixel are not 1, 2, 4 or 8", n_sub);
    if (mesh->n_triangle > INT32_MAX / 3)
        return prt_fail(ctx, PRT_LIMIT, "raster: %u triangles are more than GL draws at once",
                        mesh->n_triangle);
    struct prt_camera c = *camera;
    if (c.automatic) prt_camera_frame(mesh, (float)width / (float)height, &c);
    struct prt_visibility *vis = prt_calloc(1, sizeof *vis);
    if (!vis) return prt_fail(ctx, PRT_NOMEM, "raster: no memory");
    vis->camera = c;
    vis->width = width;
    vis->height = height;
    vis->n_sub = n_sub;
    vis->n_mesh_vertex = mesh->n_vertex;
    vis->n_mesh_triangle = mesh->n_triangle;
    int status = prt_camera_frame_init(ctx, &c, mesh->mm_per_unit > 0 ? mesh->mm_per_unit : 1,
                                       width, height, &vis->frame);
    if (!status && !keep_objects(vis, mesh))
        status = prt_fail(ctx, PRT_NOMEM, "raster: no memory");
    if (!status) {
        struct builder b = {.ctx = ctx, .mesh = mesh, .vis = vis};
        status = build(&b, raster->backend);
        for (uint32_t y = 0; b.row && y < height; y++) free(b.row[y].point);
        free(b.row);
        prt_free(b.triangle_block);
    }
    if (status) {
        prt_visibility_destroy(vis);
        return status;
    }
    *out = vis;
    return PRT_OK;
}

void prt_visibility_destroy(struct prt_visibility *vis)
{
    if (!vis) return;
    struct prt_gbuffer *g = &vis->g;
    prt_free(vis->block_object);
    prt_free(vis->row_covered);
    prt_free(vis->row_point);
    prt_free(vis->pixel);
    prt_free(vis->sample_triangle);
    prt_free(vis->sample_uv);
    prt_free(g->pixel);
    prt_free(g->triangle);
    prt_free(g->block);
    prt_free(g->weight);
    prt_free(g->opaque);
    prt_free(g->facing);
    prt_free(g->variance);
    prt_free(g->unblocked);
    prt_raster_look_finish(g);
    for (int i = 0; i < 3; i++) {
        prt_free(g->corner[i]);
        prt_free(g->position[i]);
        prt_free(g->normal[i]);
        if (i < 2) prt_free(g->bary[i]);
    }
    prt_free(vis);
}

uint32_t prt_visibility_covered(const struct prt_visibility *vis)
{
    return vis->n_covered;
}

uint64_t prt_visibility_bytes(const struct prt_visibility *vis)
{
    return sizeof *vis + 8 * ((uint64_t)vis->height + 1) +
           (uint64_t)vis->n_covered * (4 + 8 * (uint64_t)vis->n_sub) +
           (uint64_t)vis->g.n_point *
               (69 + (vis->g.base[0] ? 12 : 0) + (vis->g.turned[0] ? 16 : 0) +
                (vis->g.roughness ? 4 : 0) + (vis->g.occlusion ? 4 : 0) +
                (vis->g.emission[0] ? 12 : 0) + (vis->g.unblocked ? 4 : 0));
}

void prt_visibility_camera(const struct prt_visibility *vis, struct prt_camera *out,
                           uint32_t *width, uint32_t *height, unsigned *n_sub)
{
    if (out) *out = vis->camera;
    if (width) *width = vis->width;
    if (height) *height = vis->height;
    if (n_sub) *n_sub = vis->n_sub;
}

uint32_t prt_visibility_sample(const struct prt_visibility *vis, uint32_t x, uint32_t y,
                               unsigned s, float uv[2])
{
    uv[0] = uv[1] = 0;
    if (x >= vis->width || y >= vis->height || s >= vis->n_sub) return UINT32_MAX;
    uint32_t lo = vis->row_covered[y], hi = vis->row_covered[y + 1], want = y * vis->width + x;
    while (lo < hi) {
        uint32_t mid = lo + (hi - lo) / 2;
        if (vis->pixel[mid] < want) lo = mid + 1;
        else hi = mid;
    }
    if (lo >= vis->row_covered[y + 1] || vis->pixel[lo] != want) return UINT32_MAX;
    size_t k = (size_t)lo * vis->n_sub + s;
    uv[0] = (float)vis->sample_uv[k][0] / 65535.0f;
    uv[1] = (float)vis->sample_uv[k][1] / 65535.0f;
    return vis->sample_triangle[k];
}

void prt_visibility_gbuffer(const struct prt_visibility *vis, struct prt_gbuffer *out)
{
    *out = vis->g;
}

void prt_visibility_frame(const struct prt_visibility *vis, float eye[3], float forward[3],
                          float right[3], float up[3])
{
    for (int i = 0; i < 3; i++) {
        eye[i] = (float)vis->frame.eye[i];
        forward[i] = (float)vis->frame.forward[i];
        right[i] = (float)vis->frame.right[i];
        up[i] = (float)vis->frame.up[i];
    }
}
