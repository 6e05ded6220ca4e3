// SPDX-License-Identifier: MIT
// The shadow of a model on a plane under it (METHODS §6): the share of irradiance that is left
// at the nodes of a grid, interpolated at the pixels that see the plane.
#include "prt/screen.h"
#include "prt/trace.h"

#include <math.h>
#include <string.h>

// Nodes a side and light directions; chosen so that a direction carries at most 1/256 of the
// irradiance, which is a step of an 8-bit picture.
enum { SIDE = 193, N_DIRECTION = 512 };
#define REACH 3.0f    // radius of the shadow in half diagonals of the model
#define FADE_FROM 0.6 // from this share of the radius on the shadow fades

struct direction {
    float d[3], weight[3]; // unit, upward; contribution to the irradiance, RGB
};
struct floor {
    const struct prt_context *ctx;
    const struct prt_visibility *visibility;
    struct prt_scene *scene;
    float y, x, z, radius, epsilon; // of the plane, the grid's middle [mm]
    struct direction direction[N_DIRECTION];
    float total[3];
    uint8_t *wanted;  // [SIDE][SIDE]
    float (*left)[3]; // [SIDE][SIDE] share of the irradiance
    float eye[3], forward[3], right[3], up[3];
    uint32_t width, height;
    float *out; // [height][width][3]
};

// Nodes are denser under the model: a coordinate in [-1,1] of the radius to [-1,1] of the grid.
static float warp(float x)
{
    return copysignf(sqrtf(fabsf(x)), x);
}

// ---- directions: half drawn from the light's share, half from the cosine (balance heuristic)

static float luminance(const float *rgb)
{
    return 0.2126f * rgb[0] + 0.7152f * rgb[1] + 0.0722f * rgb[2];
}

// Cumulative light of the texels above the plane; returns the sum.
static double accumulate(const struct prt_cube *light, double *sum)
{
    const uint32_t n = light->n;
    double total = 0;
    for (uint32_t i = 0; i < 6 * n * n; i++) {
        float d[3];
        prt_cube_direction(i / (n * n), 2 * (i % n + 0.5) / n - 1,
                           2 * (i / n % n + 0.5) / n - 1, d);
        double l = d[1] > 0 ? (double)d[1] * prt_cube_solid_angle(n, i % n, i / n % n) : 0;
        total += l * fmax((double)luminance(light->texel + 3 * (size_t)i), 0);
        sum[i] = total;
    }
    return total;
}

static uint32_t find_texel(const double *sum, uint32_t n, double wanted)
{
    uint32_t lo = 0, hi = n - 1;
    while (lo < hi) {
        uint32_t mid = (lo + hi) / 2;
        if (sum[mid] > wanted) hi = mid;
        else lo = mid + 1;
    }
    return lo;
}

// Weight of a direction in either set: L cos / (N p).
static void weigh(const struct prt_cube *light, double total, struct direction *s)
{
    unsigned face;
    float u, v;
    const uint32_t n = light->n;
    prt_cube_lookup(s->d, &face, &u, &v);
    uint32_t x = (uint32_t)fminf((u + 1) / 2 * (float)n, (float)n - 1);
    uint32_t y = (uint32_t)fminf((v + 1) / 2 * (float)n, (float)n - 1);
    const float *texel = light->texel + 3 * ((size_t)(face * n + y) * n + x);
    float centre[3], cosine = fmaxf(s->d[1], 0);
    prt_cube_direction(face, 2 * (x + 0.5) / n - 1, 2 * (y + 0.5) / n - 1, centre);
    double p = (double)cosine / M_PI;
    if (total > 0) p += fmax((double)centre[1], 0) * fmax((double)luminance(texel), 0) / total;
    for (int c = 0; c < 3; c++)
        s->weight[c] =
            p > 0 ? (float)((double)(fmaxf(texel[c], 0) * cosine) / (N_DIRECTION / 2 * p)) : 0;
}

static int choose_directions(struct floor *f, const struct prt_cube *light)
{
    const uint32_t n = light->n, all = 6 * n * n;
    double *sum = prt_alloc(all, sizeof *sum);
    if (!sum) return prt_fail(f->ctx, PRT_NOMEM, "floor: no memory");
    double total = accumulate(light, sum);
    for (int i = 0; i < N_DIRECTION; i++) {
        struct direction *s = &f->direction[i];
        double a = (i / 2 + 0.5) / (N_DIRECTION / 2.0); // b, c: the R2 sequence in the texel
        double b = fmod(i / 2 * 0.7548776662466927, 1), c = fmod(i / 2 * 0.5698402909980532, 1);
        if (i % 2 && total > 0) {
            uint32_t t = find_texel(sum, all, a * total);
            prt_cube_direction(t / (n * n), 2 * (t % n + b) / n - 1,
                               2 * (t / n % n + c) / n - 1, s->d);
        } else { // a spiral of equal steps of sin^2, by the golden angle
            double sin2 = (i + 0.5) / N_DIRECTION, turn = i * 0.6180339887498949;
            s->d[0] = (float)(sqrt(sin2) * cos(2 * M_PI * turn));
            s->d[1] = (float)sqrt(1 - sin2);
            s->d[2] = (float)(sqrt(sin2) * sin(2 * M_PI * turn));
        }
        weigh(light, total, s);
        for (int k = 0; k < 3; k++) f->total[k] += s->weight[k];
    }
    prt_free(sum);
    return PRT_OK;
}

// ---- nodes

static void trace_node(const struct floor *f, float x, float z, float left[3])
{
    float lost[3] = {0, 0, 0};
    for (int i = 0; i < N_DIRECTION; i += PRT_PACKET) {
        struct prt_packet packet;
        uint32_t mask = 0;
        for (int k = 0; k < PRT_PACKET; k++) {
            const struct direction *s = &f->direction[i + k];
            packet.ox[k] = x;
            packet.oy[k] = f->y;
            packet.oz[k] = z;
            packet.dx[k] = s->d[0];
            packet.dy[k] = s->d[1];
            packet.dz[k] = s->d[2];
            packet.tnear[k] = 0;
            packet.tfar[k] = INFINITY;
            mask |= (uint32_t)(s->d[1] > 0) << k;
        }
        uint32_t hit = prt_scene_occluded16(f->scene, &packet, mask);
        for (int k = 0; k < PRT_PACKET; k++)
            for (int c = 0; hit >> k & 1 && c < 3; c++)
                lost[c] += f->direction[i + k].weight[c];
    }
    float r = hypotf(x - f->x, z - f->z) / f->radius;
    float t = (r - (float)FADE_FROM) / (1 - (float)FADE_FROM), fade = 1;
    if (t > 0) fade = t < 1 ? 1 - t * t * (3 - 2 * t) : 0;
    for (int c = 0; c < 3; c++)
        left[c] = f->total[c] > 0 ? fmaxf(1 - fade * lost[c] / f->total[c], 0) : 1;
}

static float node(int i)
{
    float u = (float)i / (SIDE - 1) * 2 - 1;
    return u * fabsf(u); // the inverse of warp()
}

static int trace_row(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct floor *f = arg;
    prt_trace_thread_init();
    for (size_t at = begin; at < end; at++) {
        if (!f->wanted[at]) continue;
        trace_node(f, f->x + f->radius * node((int)(at % SIDE)),
                   f->z + f->radius * node((int)(at / SIDE)), f->left[at]);
    }
    return PRT_OK;
}

// ---- pixels

// The grid's coordinates of the plane at a pixel; false where its ray misses the grid.
static bool at_pixel(const struct floor *f, uint32_t px, uint32_t py, float grid[2])
{
    float s = 2 * ((float)px + 0.5f) / (float)f->width - 1;
    float t = 1 - 2 * ((float)py + 0.5f) / (float)f->height, d[3];
    for (int i = 0; i < 3; i++) d[i] = f->forward[i] + s * f->right[i] + t * f->up[i];
    if (!(d[1] < 0) || !(f->eye[1] > f->y)) return false;
    float k = (f->y - f->eye[1]) / d[1];
    float x = (f->eye[0] + k * d[0] - f->x) / f->radius;
    float z = (f->eye[2] + k * d[2] - f->z) / f->radius;
    if (!(fabsf(x) < 1) || !(fabsf(z) < 1)) return false;
    grid[0] = fminf((warp(x) + 1) / 2 * (SIDE - 1), SIDE - 1.001f);
    grid[1] = fminf((warp(z) + 1) / 2 * (SIDE - 1), SIDE - 1.001f);
    return true;
}

static int want_rows(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct floor *f = arg;
    for (size_t y = begin; y < end; y++)
        for (uint32_t x = 0; x < f->width; x++) {
            float grid[2];
            if (!at_pixel(f, x, (uint32_t)y, grid)) continue;
            uint8_t *w = f->wanted + (size_t)grid[1] * SIDE + (size_t)grid[0];
            for (int k = 0; k < 4; k++)
                __atomic_store_n(w + (k & 1) + (k >> 1) * SIDE, 1, __ATOMIC_RELAXED);
        }
    return PRT_OK;
}

static int fill_rows(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct floor *f = arg;
    for (size_t y = begin; y < end; y++)
        for (uint32_t x = 0; x < f->width; x++) {
            float grid[2], *out = f->out + 3 * (y * f->width + x);
            out[0] = out[1] = out[2] = 1;
            if (!at_pixel(f, x, (uint32_t)y, grid)) continue;
            int i = (int)grid[0], j = (int)grid[1];
            float a = grid[0] - (float)i, b = grid[1] - (float)j;
            const float(*n)[3] = (const float(*)[3])f->left + (size_t)j * SIDE + i;
            for (int c = 0; c < 3; c++)
                out[c] = (n[0][c] * (1 - a) + n[1][c] * a) * (1 - b) +
                         (n[SIDE][c] * (1 - a) + n[SIDE + 1][c] * a) * b;
        }
    return PRT_OK;
}

// The least y of all objects: a translucent one may stand on an opaque one.
static float lowest(const struct prt_mesh *mesh)
{
    float y = INFINITY;
    for (uint32_t i = 0; i < mesh->n_block; i++) {
        const struct prt_block *b = &mesh->block[i];
        for (uint32_t v = b->vertex_begin; v < b->vertex_begin + b->n_vertex; v++)
            y = fminf(y, mesh->position[v][1]);
    }
    return y;
}

static void place(struct floor *f, const struct prt_mesh *mesh)
{
    float box[2][3];
    prt_mesh_bounds(mesh, box);
    float diagonal = 0;
    for (int i = 0; i < 3; i++) diagonal += (box[1][i] - box[0][i]) * (box[1][i] - box[0][i]);
    f->radius = REACH * sqrtf(diagonal) / 2 + 1e-6f;
    f->epsilon = prt_scene_epsilon(f->scene);
    f->y = lowest(mesh) - f->epsilon;
    f->x = (box[0][0] + box[1][0]) / 2;
    f->z = (box[0][2] + box[1][2]) / 2;
    prt_visibility_camera(f->visibility, NULL, &f->width, &f->height, NULL);
    prt_visibility_frame(f->visibility, f->eye, f->forward, f->right, f->up);
}

static int compute(struct floor *f, const struct prt_cube *light)
{
    int status = choose_directions(f, light);
    if (!status) status = prt_parallel_for(f->ctx, NULL, f->height, 8, want_rows, f);
    if (!status)
        status = prt_parallel_for(f->ctx, "floor", (size_t)SIDE * SIDE, 16, trace_row, f);
    return status ? status : prt_parallel_for(f->ctx, NULL, f->height, 8, fill_rows, f);
}

int prt_floor_shadow(const struct prt_context *ctx, const struct prt_mesh *mesh,
                     const struct prt_visibility *visibility, const struct prt_cube *light,
                     float **out)
{
    struct floor f = {.ctx = ctx, .visibility = visibility};
    int status = prt_scene_create(ctx, mesh, &f.scene);
    if (status) return status;
    place(&f, mesh);
    f.wanted = prt_calloc((size_t)SIDE * SIDE, 1);
    f.left = prt_calloc((size_t)SIDE * SIDE, sizeof *f.left);
    f.out = prt_alloc((size_t)f.width * f.height, 3 * sizeof *f.out);
    if (f.wanted && f.left && f.out) status = compute(&f, light);
    else
        status =
            prt_fail(ctx, PRT_NOMEM, "floor: no memory for %ux%u pixels", f.width, f.height);
    prt_scene_destroy(f.scene);
    prt_free(f.wanted);
    prt_free(f.left);
    if (status) prt_free(f.out);
    else *out = f.out;
    return status;
}
