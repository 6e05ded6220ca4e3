// SPDX-License-Identifier: MIT
// Pass 1: irradiance transport of every surface sample (W05 eq 8) and the means of the
// hierarchy.
#include "bake/checkpoint.h"
#include "bake/loops.h"
#include "bake/row_store.h"
#include "bake/run.h"
#include "bake/work.h"
#include "trace/triangle.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

// Visibility of a packet's texels: 1 all visible, -1 all blocked, 0 unknown.
static inline int visibility(const struct packet_bins *b, const struct horizon_view *view)
{
    const bool visible = !((b->mask[0] & ~view->visible[b->word[0]]) |
                           (b->mask[1] & ~view->visible[b->word[1]]));
    const bool blocked = !((b->mask[0] & ~view->blocked[b->word[0]]) |
                           (b->mask[1] & ~view->blocked[b->word[1]]));
    return (int)visible - (int)blocked;
}

// Rays of one receiver that wait to be cast together. Each ray stands for some of the four
// texels of a packet of directions. These are written as open before it is cast, and as 0 where
// it hits the surface.
struct waiting {
    const struct prt_scene *scene;
    const struct directions *d;
    struct prt_packet packet;
    uint32_t n;         // lanes that are taken
    uint32_t of[16];    // packet of directions
    uint8_t texels[16]; // bit j: the ray stands for the packet's texel j
    uint16_t *open;     // [n_packet]
    float *out;
    uint64_t rays;
};

static void set_origin(struct prt_packet *p, const struct prt_scene *scene,
                       const struct receiver *at)
{
    const float unit = at->model_units ? 1 : prt_scene_model_units(scene);
    const float eps = prt_scene_model_epsilon(scene);
    for (int i = 0; i < 16; i++) {
        p->ox[i] = unit * at->origin[0] + eps * at->face_normal[0];
        p->oy[i] = unit * at->origin[1] + eps * at->face_normal[1];
        p->oz[i] = unit * at->origin[2] + eps * at->face_normal[2];
        p->dx[i] = 1, p->dy[i] = p->dz[i] = 0; // of lanes that are not taken
        p->tnear[i] = 0;
        p->tfar[i] = INFINITY;
    }
}

static void write_texels(const uint32_t texel[4], const float sum[4], float *out)
{
    for (int j = 0; j < 4; j++) out[texel[j]] = sum[j];
}

static void cast_waiting(struct waiting *w)
{
    const uint32_t lanes = (1u << w->n) - 1;
    uint32_t blocked = w->n ? prt_scene_model_occluded16(w->scene, &w->packet, lanes) : 0;
    w->rays += w->n;
    w->n = 0;
    for (; blocked; blocked &= blocked - 1) {
        const uint32_t i = (uint32_t)__builtin_ctz(blocked), k = w->of[i];
        for (int j = 0; j < 4; j++)
            if (w->texels[i] >> j & 1) {
                w->open[k] &= (uint16_t) ~(15u << 4 * j);
                w->out[w->d->texel[(size_t)k * 4 + (size_t)j]] = 0;
            }
    }
}

// Queues the ray of lane i, direction `at` + i, for texels of packet k.
static void wait_for(struct waiting *w, size_t at, uint32_t i, uint32_t k, uint32_t texels)
{
    const uint32_t to = w->n++;
    w->packet.dx[to] = w->d->x[at + i], w->packet.dy[to] = w->d->y[at + i];
    w->packet.dz[to] = w->d->z[at + i];
    w->of[to] = k, w->texels[to] = (uint8_t)texels;
    if (w->n == 16) cast_waiting(w);
}

// The first lane of `mask` in the group of `wide` lanes (a power of 2) from `first` on, counted
// from its lane `start` and around. The group has a lane of mask.
static uint32_t next_lane(uint32_t mask, uint32_t first, uint32_t start, uint32_t wide)
{
    while (!(mask >> (first + (start & (wide - 1))) & 1)) start++;
    return first + (start & (wide - 1));
}

// One ray for each texel of packet k, or `one` for all four. mask: lanes above the surface.
// turn chooses the rays. Texels without a lane go with the first that has some.
static void ask_texels(struct waiting *w, size_t at, uint32_t k, uint32_t mask, unsigned turn,
                       bool one)
{
    if (one) {
        wait_for(w, at, next_lane(mask, 0, turn + 5 * k, 16), k, 15);
        return;
    }
    uint32_t idle = 0, texels = 0;
    for (uint32_t j = 0; j < 4; j++) idle |= mask >> 4 * j & 15 ? 0 : 1u << j;
    for (uint32_t j = 0; j < 4; j++) {
        if (idle >> j & 1) continue;
        texels = texels ? 1u << j : 1u << j | idle;
        wait_for(w, at, next_lane(mask, 4 * j, turn + k + j, 4), k, texels);
    }
}

// A receiver, for the packets of one pattern.
struct lit {
    const struct receiver *at;
    const struct fresnel_table *fresnel;
    const struct bake_loops *loops;
    size_t base;             // first direction of the pattern
    struct prt_packet every; // for all rays of a packet
};

// The cosine to the normal below which one ray stands for a packet's four texels. Bunny in
// marble under studio: errors of 0.74, 0.75 and 0.83 % with 0.16, 0.3 and 0.5 (prt compare).
static const float few_rays = 0.3f;

// Casts every ray of packet k, of which the lanes of `mask` are above the surface.
static void cast_all(struct waiting *w, struct lit *l, uint32_t mask, uint32_t k)
{
    const struct directions *d = w->d;
    const size_t first = l->base + (size_t)k * 16, bytes = 16 * sizeof(float);
    float sum[4];
    memcpy(l->every.dx, d->x + first, bytes);
    memcpy(l->every.dy, d->y + first, bytes);
    memcpy(l->every.dz, d->z + first, bytes);
    const uint32_t clear = mask & ~prt_scene_model_occluded16(w->scene, &l->every, mask);
    w->open[k] = clear == mask ? 0xffff : (uint16_t)clear; // other lanes carry no light
    w->rays += (unsigned)__builtin_popcount(mask);
    l->loops->light_texels(d, first, l->at->normal, l->at->face_normal, l->fresnel, clear, sum);
    write_texels(d->texel + (size_t)k * 4, sum, w->out);
}

uint64_t prt_irradiance_lanes(const struct prt_scene *scene, const struct directions *d,
                              unsigned pattern, const struct fresnel_table *fresnel,
                              const struct receiver *at, const struct horizon_view *view,
                              enum texel_rays rays, const uint64_t *fresh, uint16_t *open,
                              float *out)
{
    struct waiting w = {.scene = scene, .d = d, .open = open, .out = out};
    struct lit l = {at, fresnel, prt_bake_loops(d->cpu),
                    (size_t)(pattern % d->n_pattern) * d->n_packet * 16};
    const float *n = at->normal, *face = at->face_normal;
    // A packet reaches two texels of 2/n at most from its middle, either way.
    const float below = -3.0f / (float)d->n;
    set_origin(&w.packet, scene, at);
    set_origin(&l.every, scene, at);
    memset(out, 0, d->n_coef * sizeof *out);
    for (uint32_t k = 0; k < d->n_packet; k++) {
        const size_t first = l.base + (size_t)k * 16;
        const float cosine =
            n[0] * d->centre[0][k] + n[1] * d->centre[1][k] + n[2] * d->centre[2][k];
        const bool known = fresh && !(fresh[k / 64] >> k % 64 & 1);
        const int certain = cosine < below || (known && !open[k]) ? -1
                            : view && !known ? visibility(&d->bins[k], view)
                                             : 0;
        float sum[4];
        const uint32_t mask = certain < 0
                                  ? 0
                                  : l.loops->light_texels(d, first, n, face, fresnel,
                                                          known ? open[k] : 0xffff, sum);
        if (!known) open[k] = mask ? 0xffff : 0;
        if (!mask) continue;
        write_texels(d->texel + (size_t)k * 4, sum, out);
        if (certain || known) continue;
        if (rays == EVERY_RAY) cast_all(&w, &l, mask, k);
        else
            ask_texels(&w, first, k, mask, pattern >> 8,
                       rays == RAY_A_TEXEL && cosine < few_rays);
    }
    cast_waiting(&w);
    for (uint32_t k = 0; k < d->n_packet && rays == AGREEING_RAYS; k++) {
        if (!open[k] || open[k] == 0xffff) continue;
        float sum[4];
        const uint32_t mask =
            l.loops->light_texels(d, l.base + (size_t)k * 16, n, face, fresnel, 0xffff, sum);
        cast_all(&w, &l, mask, k);
    }
    return w.rays;
}

uint64_t prt_irradiance_row(const struct prt_scene *scene, const struct directions *d,
                            unsigned pattern, const struct fresnel_table *fresnel,
                            const struct receiver *at, const struct horizon_view *view,
                            enum texel_rays rays, float *out)
{
    uint16_t open[MAX_PACKETS];
    return prt_irradiance_lanes(scene, d, pattern, fresnel, at, view, rays, NULL, open, out);
}

int prt_half_rows_create(const struct prt_context *ctx, size_t n_row, size_t n_texel,
                         uint32_t n_layer, size_t room, struct half_rows *out)
{
    size_t bytes;
    const size_t n_coef = n_texel + (n_layer - 1) * (n_texel / 4);
    memset(out, 0, sizeof *out);
    if (prt_mul_overflow(n_row, n_coef * 2, &bytes)) return PRT_NOMEM;
    int fd = -1;
    if (bytes > room) {
        fd = prt_temporary_file(bytes);
        if (fd < 0)
            return prt_fail(ctx, PRT_IO,
                            "no room for %zu MB of irradiance transport: use fewer --samples "
                            "or a smaller --cube, or point TMPDIR to a larger disk",
                            bytes >> 20);
        prt_log(ctx, PRT_LOG_NOTE, "irradiance transport (%zu MB) is kept on disk",
                bytes >> 20);
    }
    void *map = mmap(NULL, bytes, PROT_READ | PROT_WRITE,
                     fd < 0 ? MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE : MAP_SHARED, fd, 0);
    const bool on_disk = fd >= 0;
    if (on_disk) close(fd);
    if (map == MAP_FAILED)
        return prt_fail(ctx, PRT_NOMEM, "no memory for %zu MB of irradiance transport",
                        bytes >> 20);
    madvise(map, bytes, MADV_HUGEPAGE);
    *out = (struct half_rows){.n_row = n_row,
                              .n_coef = n_coef,
                              .bytes = bytes,
                              .n_texel = n_texel,
                              .n_layer = n_layer,
                              .half = map,
                              .on_disk = on_disk};
    return PRT_OK;
}

void prt_half_rows_rest(const struct half_rows *rows)
{
    if (rows->on_disk) madvise(rows->half, rows->bytes, MADV_DONTNEED); // the file has them
}

void prt_half_rows_finish(struct half_rows *rows)
{
    if (rows->half) munmap(rows->half, rows->bytes);
    memset(rows, 0, sizeof *rows);
}

struct pass_one {
    struct irradiance_source from;
    struct fresnel_table *fresnel; // [media->n], or of the nodes of eta
    struct half_rows *rows;
};

// Where sample s lies in the model's own units, and the corners of its horizon.
static void place_row(const struct pass_one *p, uint32_t s, struct row_place *out)
{
    const struct prt_surface_points *of = p->from.surface;
    const struct prt_mesh *model = prt_scene_model(p->from.scene);
    const uint32_t t = of->triangle[s], *v = model->triangle[t];
    const float *inside = of->inside[s];
    const double u = (double)inside[0], w = (double)inside[1];
    double cross[3], length = 0;
    memset(out, 0, sizeof *out);
    triangle_cross(model, t, cross);
    for (int k = 0; k < 3; k++) length += cross[k] * cross[k];
    for (int k = 0; k < 3; k++) {
        out->position[k] = (float)((1 - u - w) * (double)model->position[v[0]][k] +
                                   u * (double)model->position[v[1]][k] +
                                   w * (double)model->position[v[2]][k]);
        out->face_normal[k] = length > 0 ? (float)(cross[k] / sqrt(length)) : 0;
        out->normal[k] = of->normal[s][k];
    }
    out->epsilon = prt_scene_model_epsilon(p->from.scene);
    out->pattern = (uint32_t)(prt_hash64(out->position, sizeof out->position, 7) >> 32);
    if (p->from.horizon)
        out->words = prt_horizon_around(p->from.horizon, t, inside[0], inside[1], out->corner);
}

// Layer 1 of a row from all its texels: their means over 2 x 2.
static void halve(const struct directions *d, const float *from, float *out)
{
    for (uint32_t i = 0; i < d->n_coef / 4; i++) {
        const uint32_t half = d->n / 2, x = i % half, y = i / half;
        const float *at = from + (size_t)2 * y * d->n + 2 * x;
        out[i] = 0.25f * (at[0] + at[1] + at[d->n] + at[d->n + 1]);
    }
}

// The row of sample s with its open directions, of which those of `fresh` packets are found:
// the layers have the same rays. Returns the rays cast. row: [n_coef] and room for [n_texel].
static uint64_t sample_row(const struct pass_one *p, uint32_t s, const struct row_place *place,
                           const uint64_t *fresh, uint16_t *open, float *row)
{
    static const uint64_t none[(MAX_PACKETS + 63) / 64];
    const struct prt_surface_points *of = p->from.surface;
    const struct receiver at = {place->position, place->normal, place->face_normal, true};
    const uint32_t medium = prt_media_index(p->from.media, of->object[s]);
    const struct directions *d = p->from.directions;
    float *room = row + p->rows->n_coef;
    struct horizon_view view;
    bool any = !fresh;
    for (uint32_t k = 0; !any && k < (d->n_packet + 63) / 64; k++) any = fresh[k] != 0;
    const bool viewed = any && place->words;
    if (viewed)
        prt_horizon_view(p->from.horizon, of->triangle[s], of->inside[s][0], of->inside[s][1],
                         &view);
    const uint64_t cast = prt_irradiance_lanes(
        p->from.scene, d, place->pattern, &p->fresnel[p->from.nodes ? 0 : medium], &at,
        viewed ? &view : NULL, RAY_A_TEXEL, fresh, open, row);
    if (p->rows->n_layer > 1) {
        (void)prt_irradiance_lanes(p->from.scene, d, place->pattern, &p->fresnel[1], &at, NULL,
                                   RAY_A_TEXEL, none, open, room);
        halve(d, room, row + p->rows->n_texel);
    }
    for (size_t k = 0; of->tint && k < p->rows->n_coef; k++) row[k] *= of->tint[s];
    return cast;
}

// What a worker writes a piece of rows with.
struct piece_room {
    struct row_place *place; // [n]
    uint64_t *fresh;         // [n][words]
    uint16_t *open;          // [n][n_packet]
    float *row;
};

static int piece_rows(struct pass_one *p, uint32_t begin, uint32_t n, struct piece_room *room)
{
    const struct hierarchy *h = p->from.hierarchy;
    const size_t n_packet = p->from.directions->n_packet, words = (n_packet + 63) / 64;
    uint64_t started = prt_work_begin(), cast = 0;
    bool kept = true;
    for (uint32_t i = 0; i < n; i++) place_row(p, h->order[begin + i], &room->place[i]);
    if (p->from.store) {
        const uint64_t known = prt_row_store_read(p->from.store, begin, n, room->place,
                                                  room->open, room->fresh, &kept);
        prt_work_reuse(p->from.work, known, n * n_packet);
    }
    for (uint32_t i = 0; i < n; i++) {
        cast += sample_row(p, h->order[begin + i], &room->place[i],
                           p->from.store ? room->fresh + i * words : NULL,
                           room->open + i * n_packet, room->row);
        prt_f32_to_f16_array(room->row, p->rows->n_coef,
                             p->rows->half + (begin + i) * p->rows->n_coef);
    }
    if (!kept) prt_row_store_write(p->from.store, begin, n, room->place, room->open);
    prt_work_end(p->from.work, WORK_IRRADIANCE, started, cast, 0);
    return PRT_OK;
}

static int pass_one_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct pass_one *p = arg;
    const size_t n = end - begin, n_packet = p->from.directions->n_packet;
    if (prt_checkpoint_read_rows(p->from.checkpoint, p->rows, begin, n)) return PRT_OK;
    prt_trace_thread_init();
    struct piece_room room = {
        .place = prt_alloc(n, sizeof *room.place),
        .fresh = prt_alloc(n * ((n_packet + 63) / 64), sizeof *room.fresh),
        .open = prt_alloc(n * n_packet, sizeof *room.open),
        .row = prt_alloc(p->rows->n_coef + p->rows->n_texel, sizeof *room.row)};
    int status = room.place && room.fresh && room.open && room.row ? PRT_OK : PRT_NOMEM;
    if (!status) status = piece_rows(p, (uint32_t)begin, (uint32_t)n, &room);
    if (!status) prt_checkpoint_write_rows(p->from.checkpoint, p->rows, begin, n);
    prt_free(room.place);
    prt_free(room.fresh);
    prt_free(room.open);
    prt_free(room.row);
    if (begin / 64 % 64 == 0) prt_half_rows_rest(p->rows);
    return status;
}

// The area-weighted mean of a node: of its children's rows, or of a leaf's samples.
static void average_node(struct pass_one *p, uint32_t at, float *row, float *child)
{
    const struct node *node = &p->from.hierarchy->node[at];
    size_t n = p->rows->n_coef, n_sample = p->from.surface->n_sample;
    memset(row, 0, n * sizeof *row);
    if (!node->child[0]) {
        for (uint32_t i = node->begin; i < node->begin + node->count; i++) {
            float w = p->from.surface->area[p->from.hierarchy->order[i]] / node->area;
            prt_f16_to_f32_array(p->rows->half + i * n, n, child);
            for (size_t k = 0; k < n; k++) row[k] += w * child[k];
        }
    } else {
        for (int c = 0; c < 2; c++) {
            float w = p->from.hierarchy->node[node->child[c]].area / node->area;
            prt_f16_to_f32_array(p->rows->half + (n_sample + node->child[c]) * n, n, child);
            for (size_t k = 0; k < n; k++) row[k] += w * child[k];
        }
    }
    prt_f32_to_f16_array(row, n, p->rows->half + (n_sample + at) * n);
}

// Leaves in parallel; the inner nodes follow in falling order, because children have larger
// indices than their parent.
static int leaf_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct pass_one *p = arg;
    uint64_t started = prt_work_begin();
    float *scratch = prt_alloc(2 * p->rows->n_coef, sizeof *scratch);
    if (!scratch) return PRT_NOMEM;
    for (size_t i = begin; i < end; i++)
        if (!p->from.hierarchy->node[i].child[0])
            average_node(p, (uint32_t)i, scratch, scratch + p->rows->n_coef);
    prt_free(scratch);
    prt_work_end(p->from.work, WORK_NODES, started, 0, 0);
    return PRT_OK;
}

// Rays of a vertex's horizon: one for each coarse bin above its plane, and some 1000 of the
// fine ones; chosen, not measured. On the bunny it spares nine in ten of a sample's rays.
static const double horizon_rays = 0.5 * 6 * 16 * 16 + 1000, spared = 0.8;

bool prt_irradiance_horizon_pays(const struct directions *d, const struct prt_scene *scene,
                                 uint32_t n_sample)
{
    double horizon = horizon_rays * prt_scene_mesh(scene)->n_vertex;
    const double samples = 0.5 * d->n_coef * n_sample; // a ray a texel
    return horizon < spared * samples;
}

// The tables of the layers: the mean of F_t at two nodes of eta and half the difference, each
// over its own mean.
static struct fresnel_table *layer_tables(const struct prt_eta_nodes *nodes, float mix[2][2])
{
    struct fresnel_table *table = prt_bake_node_fresnel(nodes);
    const float own[2] = {(float)prt_fresnel_mean_transmittance((double)nodes->node[0]),
                          (float)prt_fresnel_mean_transmittance((double)nodes->node[1])};
    for (int i = 0; table && i < FRESNEL_STEPS + 2; i++) {
        const float low = table[0].value[i] / own[0], high = table[1].value[i] / own[1];
        table[0].value[i] = 0.5f * (high + low);
        table[1].value[i] = 0.5f * (high - low);
    }
    mix[0][0] = own[0], mix[0][1] = -own[0];
    mix[1][0] = mix[1][1] = own[1];
    return table;
}

int prt_irradiance_bake(const struct prt_context *ctx, const struct irradiance_source *from,
                        struct half_rows *out)
{
    struct pass_one p = {.from = *from, .rows = out};
    const struct hierarchy *h = from->hierarchy;
    uint32_t n_sample = from->surface->n_sample;
    int status =
        prt_half_rows_create(ctx, (size_t)n_sample + h->n_node, from->directions->n_coef,
                             from->nodes ? from->nodes->n : 1, from->room, out);
    if (status) return status;
    const size_t n_coef = out->n_coef;
    p.fresnel =
        from->nodes ? layer_tables(from->nodes, out->mix) : prt_bake_fresnel(from->media);
    if (!p.fresnel) {
        prt_half_rows_finish(out);
        return PRT_NOMEM;
    }
    status = prt_parallel_for(ctx, "irradiance", n_sample, 64, pass_one_range, &p);
    if (status == PRT_OK)
        status = prt_parallel_for(ctx, "hierarchy", h->n_node, 256, leaf_range, &p);
    uint64_t started = prt_work_begin();
    float *scratch = status == PRT_OK ? prt_alloc(2 * n_coef, sizeof *scratch) : NULL;
    if (status == PRT_OK && !scratch) status = PRT_NOMEM;
    for (uint32_t i = h->n_node; status == PRT_OK && i-- > 0;)
        if (h->node[i].child[0]) average_node(&p, i, scratch, scratch + n_coef);
    prt_free(scratch);
    prt_work_end(from->work, WORK_NODES, started, 0, 0);
    prt_free(p.fresnel);
    if (status) prt_half_rows_finish(out);
    return status;
}
