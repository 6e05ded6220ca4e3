// SPDX-License-Identifier: MIT
// Receivers: the points that engines sum light for, one for each smooth patch of s x s pixels,
// in tiles, and the weights by which every point of the G-buffer interpolates them (METHODS
// §6). Kept while the view stays.
#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { BLOCK = 8 }; // cells a side; receivers of a block share tiles; chosen, not measured

void prt_view_finish(struct view_cache *v)
{
    for (int k = 0; k < 3; k++) prt_free(v->p[k]);
    free(v->begin);
    free(v->object);
    free(v->leader);
    prt_free(v->from);
    prt_free(v->weight);
    memset(v, 0, sizeof *v);
}

uint64_t prt_view_key(const struct frame *f)
{
    uint64_t key = f->width * 0x9e3779b97f4a7c15ULL + f->height;
    for (int k = 0; k < 3; k++)
        key = prt_hash64(f->g.position[k], (size_t)f->g.n_point * sizeof(float), key);
    return prt_hash64(f->g.pixel, (size_t)f->g.n_point * sizeof(uint32_t), key);
}

// The eye, and the side of a pixel at a depth of 1.
struct footprint {
    float eye[3], forward[3], tan_pixel;
};

static struct footprint footprint_of(const struct prt_visibility *vis)
{
    uint32_t height;
    struct footprint p;
    float right[3], up[3], l = 0;
    prt_visibility_frame(vis, p.eye, p.forward, right, up);
    prt_visibility_camera(vis, NULL, NULL, &height, NULL);
    for (int k = 0; k < 3; k++) l += up[k] * up[k];
    p.tan_pixel = 2 * sqrtf(l) / (float)height;
    return p;
}

static float pixel_mm(const struct footprint *p, const struct prt_gbuffer *g, uint32_t i)
{
    float z = 0;
    for (int k = 0; k < 3; k++) z += (g->position[k][i] - p->eye[k]) * p->forward[k];
    return fabsf(z) * p->tan_pixel;
}

float prt_view_pixel_mm(const struct prt_visibility *vis)
{
    struct footprint p = footprint_of(vis);
    struct prt_gbuffer g;
    double sum = 0;
    uint32_t n = 0;
    prt_visibility_gbuffer(vis, &g);
    for (uint32_t i = 0; i < g.n_point; i += 37, n++) sum += (double)pixel_mm(&p, &g, i);
    return n ? (float)(sum / n) : 0;
}

uint32_t prt_receiver_size(double pixel_mm, double scale_mm)
{
    uint32_t size = 1;
    while (size < 4 && 2 * size * pixel_mm <= RECEIVER_SHARE * scale_mm) size *= 2;
    return size;
}

struct group {
    float p[3], n[3], weight;
    uint32_t object, leader, column;
};
struct builder {
    struct frame *f;
    const struct prt_gbuffer *g;
    struct footprint foot;
    uint32_t size, across, down, blocks_across, n_cell;
    uint32_t *start; // [n_cell+1] into order
    uint32_t *order; // points by cell
    uint32_t *first; // [n_cell+1] into group
    struct group *group;
    uint32_t n_group;
    uint32_t *own; // [n_point] group
};

static uint32_t cell_at(const struct builder *b, uint32_t cx, uint32_t cy)
{
    uint32_t block = cy / BLOCK * b->blocks_across + cx / BLOCK;
    return block * BLOCK * BLOCK + cy % BLOCK * BLOCK + cx % BLOCK;
}

static uint32_t cell_of(const struct builder *b, uint32_t pixel)
{
    return cell_at(b, pixel % b->f->width / b->size, pixel / b->f->width / b->size);
}

static uint32_t object_of(const struct builder *b, uint32_t point)
{
    return b->f->screen->mesh->block[b->g->block[point]].object;
}

// Whether a point may interpolate a group: same object, same smooth patch.
static bool alike(const struct builder *b, const struct group *group, uint32_t object,
                  uint32_t i, float reach)
{
    if (group->object != object) return false;
    float d2 = 0, c = 0;
    for (int k = 0; k < 3; k++) {
        float d = b->g->position[k][i] - b->g->position[k][group->leader];
        d2 += d * d;
        c += b->g->normal[k][i] * group->n[k];
    }
    return d2 < reach * reach && c > 0.6f;
}

static void sort_points(struct builder *b)
{
    const struct prt_gbuffer *g = b->g;
    for (uint32_t i = 0; i < g->n_point; i++)
        if (!g->opaque[i]) b->start[cell_of(b, g->pixel[i]) + 1]++;
    for (uint32_t c = 0; c < b->n_cell; c++) b->start[c + 1] += b->start[c];
    for (uint32_t i = 0; i < g->n_point; i++)
        if (!g->opaque[i]) b->order[b->start[cell_of(b, g->pixel[i])]++] = i;
    memmove(b->start + 1, b->start, b->n_cell * sizeof *b->start);
    b->start[0] = 0;
}

static void make_groups(struct builder *b)
{
    const struct prt_gbuffer *g = b->g;
    for (uint32_t c = 0; c < b->n_cell; c++) {
        b->first[c] = b->n_group;
        for (uint32_t at = b->start[c]; at < b->start[c + 1]; at++) {
            uint32_t i = b->order[at], object = object_of(b, i), k = b->first[c];
            float reach = 2.5f * (float)b->size * pixel_mm(&b->foot, g, i);
            while (k < b->n_group && !alike(b, &b->group[k], object, i, reach)) k++;
            struct group *q = &b->group[k];
            if (k == b->n_group) {
                *q = (struct group){.object = object, .leader = i};
                for (int j = 0; j < 3; j++) q->n[j] = g->normal[j][i];
                b->n_group++;
            }
            for (int j = 0; j < 3; j++) q->p[j] += g->weight[i] * g->position[j][i];
            q->weight += g->weight[i];
            b->own[i] = k;
        }
    }
    b->first[b->n_cell] = b->n_group;
    for (uint32_t k = 0; k < b->n_group; k++)
        for (int j = 0; j < 3; j++) b->group[k].p[j] /= b->group[k].weight;
}

// Assigns columns to groups: those of a block, object by object, in tiles padded to 16.
static bool make_tiles(struct builder *b, struct view_cache *v)
{
    uint32_t per_block = BLOCK * BLOCK, n_block = b->n_cell / per_block, column = 0;
    size_t most = (size_t)b->n_group + 1;
    v->begin = malloc((most + 1) * sizeof *v->begin);
    v->object = malloc(most * sizeof *v->object);
    if (!v->begin || !v->object) return false;
    for (uint32_t k = 0; k < n_block; k++) {
        uint32_t from = b->first[k * per_block], to = b->first[(k + 1) * per_block], done = 0;
        for (uint32_t q = from; q < to; q++) b->group[q].column = UINT32_MAX;
        while (done < to - from) {
            uint32_t object = UINT32_MAX, n = 0;
            v->begin[v->n_tile] = column;
            for (uint32_t q = from; q < to && n < TILE_POINTS; q++) {
                struct group *group = &b->group[q];
                if (group->column != UINT32_MAX) continue;
                if (object == UINT32_MAX) object = group->object;
                if (group->object != object) continue;
                group->column = column + n++;
            }
            v->object[v->n_tile++] = object;
            column += (n + 15) & ~15u;
            done += n;
        }
    }
    v->begin[v->n_tile] = column;
    v->n_column = column;
    for (int k = 0; k < 3; k++)
        if (!(v->p[k] = prt_alloc((size_t)column + 16, sizeof(float)))) return false;
    // padding repeats the first receiver of a tile
    for (uint32_t q = 0; q < b->n_group; q++) {
        for (int k = 0; k < 3; k++) v->p[k][b->group[q].column] = b->group[q].p[k];
    }
    if (!(v->leader = malloc(((size_t)column + 1) * sizeof *v->leader))) return false;
    memset(v->leader, 0xff, ((size_t)column + 1) * sizeof *v->leader);
    for (uint32_t q = 0; q < b->n_group; q++)
        v->leader[b->group[q].column] = b->group[q].leader;
    for (uint32_t t = 0; t < v->n_tile; t++) {
        for (uint32_t i = v->begin[t]; i < v->begin[t + 1]; i++) {
            if (v->leader[i] != UINT32_MAX) continue;
            v->leader[i] = v->leader[v->begin[t]];
            for (int k = 0; k < 3; k++) v->p[k][i] = v->p[k][v->begin[t]];
        }
    }
    return true;
}

// Bilinear weights of the groups on the point's patch in the four nearest cells.
static int link_points(void *arg, size_t begin, size_t end, unsigned worker)
{
    void **both = arg;
    const struct builder *b = both[0];
    struct view_cache *v = both[1];
    const struct prt_gbuffer *g = b->g;
    for (size_t i = begin; i < end; i++) {
        uint32_t *from = v->from[i];
        float *weight = v->weight[i], total = 0;
        memset(from, 0, sizeof v->from[i]);
        memset(weight, 0, sizeof v->weight[i]);
        if (g->opaque[i]) continue;
        uint32_t object = object_of(b, (uint32_t)i), x = g->pixel[i] % b->f->width;
        uint32_t y = g->pixel[i] / b->f->width;
        if (b->size > 1) {
            float reach = 4 * (float)b->size * pixel_mm(&b->foot, g, (uint32_t)i);
            float fx = ((float)x + 0.5f) / (float)b->size - 0.5f;
            float fy = ((float)y + 0.5f) / (float)b->size - 0.5f;
            int x0 = (int)floorf(fx), y0 = (int)floorf(fy);
            for (int k = 0; k < 4; k++) {
                int cx = x0 + (k & 1), cy = y0 + (k >> 1);
                if (cx < 0 || cy < 0 || cx >= (int)b->across || cy >= (int)b->down) continue;
                uint32_t c = cell_at(b, (uint32_t)cx, (uint32_t)cy), q = b->first[c];
                while (q < b->first[c + 1] &&
                       !alike(b, &b->group[q], object, (uint32_t)i, reach))
                    q++;
                if (q == b->first[c + 1]) continue;
                float w = (1 - fabsf(fx - (float)cx)) * (1 - fabsf(fy - (float)cy));
                from[k] = b->group[q].column;
                weight[k] = w;
                total += w;
            }
        }
        // no such group, or cells of one pixel: the point's own group
        if (!(total > 0.05f)) {
            memset(weight, 0, sizeof v->weight[i]);
            from[0] = b->group[b->own[i]].column;
            weight[0] = total = 1;
        }
        for (int k = 0; k < 4; k++) weight[k] /= total;
        for (int k = 0; k < 4; k++)
            if (!(weight[k] > 0)) from[k] = from[0];
    }
    return PRT_OK;
}

static int build(struct frame *f, uint32_t size, struct view_cache *v)
{
    struct builder b = {.f = f, .g = &f->g, .foot = footprint_of(f->vis), .size = size};
    b.across = (f->width + size - 1) / size;
    b.down = (f->height + size - 1) / size;
    b.blocks_across = (b.across + BLOCK - 1) / BLOCK;
    b.n_cell = b.blocks_across * ((b.down + BLOCK - 1) / BLOCK) * BLOCK * BLOCK;
    size_t n = (size_t)f->g.n_point + 1;
    b.start = calloc((size_t)b.n_cell + 2, sizeof *b.start);
    b.first = malloc(((size_t)b.n_cell + 1) * sizeof *b.first);
    b.order = malloc(n * sizeof *b.order);
    b.own = malloc(n * sizeof *b.own);
    b.group = malloc(n * sizeof *b.group);
    v->from = prt_alloc(n, sizeof *v->from);
    v->weight = prt_alloc(n, sizeof *v->weight);
    bool good = b.start && b.first && b.order && b.own && b.group && v->from && v->weight;
    if (good) {
        sort_points(&b);
        make_groups(&b);
        good = make_tiles(&b, v);
    }
    v->n_receiver = b.n_group;
    void *both[2] = {&b, v};
    int status = good ? prt_parallel_for(f->ctx, NULL, f->g.n_point, 1024, link_points, both)
                      : prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for receivers");
    free(b.start);
    free(b.first);
    free(b.order);
    free(b.own);
    free(b.group);
    return status;
}

int prt_view_get(struct frame *f, uint32_t size, const struct view_cache **out)
{
    struct prt_screen *s = f->screen;
    uint64_t key = f->view_key + size;
    for (int k = 0; k < VIEWS; k++) {
        if (s->view[k].key != key || !s->view[k].from) continue;
        *out = &s->view[k];
        s->view[k].used = ++s->clock;
        return PRT_OK;
    }
    struct view_cache *v = &s->view[0];
    for (int k = 1; k < VIEWS; k++)
        if (s->view[k].used < v->used) v = &s->view[k];
    prt_view_finish(v);
    int status = build(f, size, v);
    if (status) {
        prt_view_finish(v);
        return status;
    }
    v->key = key;
    v->used = ++s->clock;
    *out = v;
    return PRT_OK;
}

struct resolve_job {
    const struct frame *f;
    const struct view_cache *view;
};

static int resolve_points(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct resolve_job *job = arg;
    const struct view_cache *v = job->view;
    const float *s0 = job->f->sum[0], *s1 = job->f->sum[1], *s2 = job->f->sum[2];
    const float scale = (float)(1 / M_PI);
    for (size_t i = begin; i < end; i++) {
        if (job->f->g.opaque[i]) continue;
        const uint32_t *from = v->from[i];
        const float *w = v->weight[i];
        float sum[3] = {0, 0, 0};
        for (int k = 0; k < 4; k++) {
            sum[0] += w[k] * s0[from[k]];
            sum[1] += w[k] * s1[from[k]];
            sum[2] += w[k] * s2[from[k]];
        }
        for (int k = 0; k < 3; k++) job->f->radiance[i][k] += sum[k] * scale;
    }
    return PRT_OK;
}

int prt_receivers_begin(struct frame *f, double scale_mm)
{
    // light varies over scale_mm; receivers are RECEIVER_SHARE of that apart at the most
    uint32_t size = prt_receiver_size((double)prt_view_pixel_mm(f->vis), scale_mm);
    uint32_t finer = f->options->refine / 2 + f->options->frame / 4;
    while (finer-- && size > 1) size /= 2;
    int status = prt_view_get(f, size, &f->view);
    if (status) return status;
    f->report->receivers = f->view->n_receiver;
    for (int k = 0; k < 3; k++) {
        f->sum[k] = prt_calloc((size_t)f->view->n_column + 16, sizeof(float));
        if (!f->sum[k]) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for receivers");
    }
    return PRT_OK;
}

int prt_receivers_resolve(struct frame *f)
{
    struct resolve_job job = {f, f->view};
    int status = prt_parallel_for(f->ctx, NULL, f->g.n_point, 2048, resolve_points, &job);
    prt_receivers_finish(f);
    return status;
}

void prt_receivers_finish(struct frame *f)
{
    for (int k = 0; k < 3; k++) {
        prt_free(f->sum[k]);
        f->sum[k] = NULL;
    }
}
