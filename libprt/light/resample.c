/* SPDX-License-Identifier: MIT */
/* Owns power-conserving resampling between lat-long images and cubemaps.
 *
 * The sphere is cut into thin wedges of azimuth at every column edge of the lat-long image and
 * of the cube's side faces, so that a wedge lies in one column of either. Along a wedge's
 * central meridian both images are piecewise constant in z = sin(latitude), and dz dphi is
 * solid angle: power moves between cells by exact 1-D overlap in z. Only the cells of +Y and -Y
 * are not bounded by meridians; there the wedges are made thin enough (rays_per_texel through
 * the corner texels). Each cell's sum is divided by the solid angle it was given, so a constant
 * stays constant, and one factor a channel, within about 1e-4 of 1, makes the total power
 * exact. */
#include "base/isa.h"
#include "light_private.h"

#include <math.h>
#include <string.h>

typedef double v4d __attribute__((vector_size(32)));
typedef float v4f __attribute__((vector_size(16)));

#define PI 3.14159265358979323846
#define INLINE static inline __attribute__((always_inline)) /* into each ISA's variant */
enum { BLOCK = 8, N_QUADRANT = 4 };

/* Azimuth phi of side faces' centres (direction (sin phi, ., -cos phi)); in each, s =
 * -tan(beta) with beta = phi - centre. */
static const struct {
    unsigned face;
    double phi;
} quadrants[N_QUADRANT] = {{5, 0}, {0, PI / 2}, {4, PI}, {1, -PI / 2}};

/* Wedges through a corner texel of a cap: the error falls with the square. Fine cubes, whose
 * cost grows with n squared, hold few source pixels a texel and take fewer. */
static const double RAYS_MIN = 8.0, RAYS_MAX = 20.0;

static double rays_per_texel(uint32_t n)
{
    const double rays = RAYS_MAX * 32.0 / n;
    return rays < RAYS_MIN ? RAYS_MIN : rays > RAYS_MAX ? RAYS_MAX : rays;
}

static unsigned cap_rays(double n_wedge, uint32_t n, double rays_per_texel)
{
    /* a corner texel at radius 0.7 n texels subtends 1/(0.7 n) rad of azimuth */
    const double rays = rays_per_texel * 2.0 * PI * 0.7 * n;
    const double s = ceil(rays / n_wedge);
    return s < 1 ? 1 : (unsigned)s;
}

/* atan for 0 <= |x| <= 1 within 1.2e-5 rad: only a first guess of a row. */
INLINE double rough_atan(double x)
{
    const double q = x * x;
    return x *
           (0.9998660 + q * (-0.3302995 + q * (0.1801410 + q * (-0.0851330 + q * 0.0208351))));
}

/* Walks the cells of a cube's cap along one azimuth outwards from the pole. */
struct cap_walk {
    int x, y, dx, dy;
    double rho, next_x, next_y, step_x, step_y, end;
};

INLINE void cap_walk_start(struct cap_walk *w, uint32_t n, double s, double t)
{
    const double half = 0.5 * n, centre_low = (double)(n / 2);
    const bool odd = n & 1;
    const double as = fabs(s) > 1e-12 ? fabs(s) : 1e-12, at = fabs(t) > 1e-12 ? fabs(t) : 1e-12;
    w->dx = s >= 0 ? 1 : -1;
    w->dy = t >= 0 ? 1 : -1;
    w->x = (int)centre_low - (!odd && s < 0);
    w->y = (int)centre_low - (!odd && t < 0);
    w->step_x = 1.0 / (as * half);
    w->step_y = 1.0 / (at * half);
    w->next_x = (odd ? 0.5 : 1.0) * w->step_x;
    w->next_y = (odd ? 0.5 : 1.0) * w->step_y;
    w->rho = 0;
    w->end = 1.0 / (as > at ? as : at);
}

/* Leaves the current cell: returns its outer radius and moves on; the last one is w->end. */
INLINE double cap_walk_next(struct cap_walk *w, bool *last)
{
    double out;
    if (w->next_x < w->next_y) {
        out = w->next_x;
        w->next_x += w->step_x;
        w->x += w->dx;
    } else {
        out = w->next_y;
        w->next_y += w->step_y;
        w->y += w->dy;
    }
    *last = out >= w->end * (1 - 1e-9);
    return *last ? w->end : out;
}

/* ---- lat-long to cube ---- */

struct to_cube {
    const struct prt_image *src;
    uint32_t n;
    double turn; /* [rad] */
    unsigned side_rays, cap_rays;
    const double *edge; /* [H+1] z of row edges, 1 … -1 */
    v4d *cap[2];        /* [n*n] power and solid angle of +Y, -Y but for their diagonals */
    v4d *diagonal[N_QUADRANT]; /* [2 caps][2 diagonals][n] a quadrant's share of those */
    v4d power[N_QUADRANT];
    struct prt_cube *out;
    void *scratch[N_QUADRANT];
};

struct column {
    const double *edge;
    const v4d *prefix; /* [H+1] power per radian above each row edge; lane 3: solid angle */
    const v4f *value;  /* [H] radiance, lane 3: 1 */
    int height;
};

INLINE void power_above(const struct column *col, double z, int row, v4d *out)
{
    row = row < 0 ? 0 : row > col->height - 1 ? col->height - 1 : row;
    while (row > 0 && z > col->edge[row]) row--;
    while (row < col->height - 1 && z < col->edge[row + 1]) row++;
    const double d = col->edge[row] - z;
    *out = col->prefix[row] + __builtin_convertvector(col->value[row], v4d) * d;
}

/* [n] += power of the texels of one side column along the meridian beta. */
INLINE void add_side(const struct column *col, uint32_t n, double beta, double width, v4d *acc)
{
    const double c = cos(beta), row_scale = col->height / PI, step = 2.0 / n;
    v4d above = {0, 0, 0, 0};
    for (uint32_t k = 0; k <= n; k++) {
        const double q = (k * step - 1.0) * c;
        const double z = -q / sqrt(1.0 + q * q);
        const int row = (int)((0.5 * PI + rough_atan(q)) * row_scale);
        v4d here;
        power_above(col, z, row, &here);
        if (k) acc[k - 1] += (here - above) * width;
        above = here;
    }
}

/* Adds the wedge at azimuth phi to the cells of both caps; they mirror each other in t. */
INLINE void add_caps(const struct to_cube *job, const struct column *col, unsigned quadrant,
                     double phi, double width)
{
    const int n = (int)job->n;
    const double row_scale = col->height / PI;
    struct cap_walk w;
    cap_walk_start(&w, job->n, sin(phi), -cos(phi));
    v4d top = {0, 0, 0, 0}, bottom = col->prefix[col->height];
    bool last = false;
    while (!last) {
        const int x = w.x, y = w.y, mirror = n - 1 - y;
        const double rho = cap_walk_next(&w, &last);
        const double z = 1.0 / sqrt(1.0 + rho * rho);
        const double polar = rho <= 1 ? rough_atan(rho) : 0.5 * PI - rough_atan(1.0 / rho);
        const int row = (int)(polar * row_scale);
        v4d t, b;
        power_above(col, z, row, &t);
        power_above(col, -z, col->height - 1 - row, &b);
        if (x == y || x == mirror) {
            v4d *d = job->diagonal[quadrant] + (x == y ? 0 : n);
            d[x] += (t - top) * width;
            d[2 * n + x] += (bottom - b) * width;
        } else {
            job->cap[0][(size_t)y * n + x] += (t - top) * width;
            job->cap[1][(size_t)mirror * n + x] += (bottom - b) * width;
        }
        top = t;
        bottom = b;
    }
}

/* BLOCK columns from `first` on (wrapping), transposed to [BLOCK][H]. */
INLINE void fetch_block(const struct prt_image *src, uint32_t first, v4f *value)
{
    const size_t height = src->height;
    for (size_t r = 0; r < height; r++) {
        const float *row = src->rgb + r * src->width * 3;
        for (uint32_t i = 0; i < BLOCK; i++) {
            const float *p = row + (size_t)((first + i) % src->width) * 3;
            value[i * height + r] = (v4f){p[0], p[1], p[2], 1.0f};
        }
    }
}

INLINE void sum_column(const double *edge, const v4f *value, int height, v4d *prefix)
{
    v4d sum = {0, 0, 0, 0};
    for (int r = 0; r < height; r++) {
        prefix[r] = sum;
        sum += __builtin_convertvector(value[r], v4d) * (edge[r] - edge[r + 1]);
    }
    prefix[height] = sum;
}

static void store_side(const struct to_cube *job, unsigned face, uint32_t x, v4d *acc)
{
    const uint32_t n = job->n;
    float *dst = job->out->texel + ((size_t)face * n * n + x) * 3;
    for (uint32_t y = 0; y < n; y++) {
        for (int c = 0; c < 3; c++) dst[(size_t)y * n * 3 + c] = (float)(acc[y][c] / acc[y][3]);
        acc[y] = (v4d){0, 0, 0, 0};
    }
}

INLINE void quadrant_body(const struct to_cube *job, unsigned quadrant)
{
    const struct prt_image *src = job->src;
    const uint32_t n = job->n, width = src->width;
    const int height = (int)src->height;
    v4d *prefix = job->scratch[quadrant], *acc = prefix + height + 1;
    v4f *block = (v4f *)(acc + n);
    const double centre = quadrants[quadrant].phi, per_column = 2.0 * PI / width;
    /* source column k (unwrapped) covers beta in [k, k+1) * per_column - offset */
    const double offset = centre + job->turn + PI;
    int64_t k = (int64_t)floor((offset - PI / 4) / per_column);
    int64_t block_first = k - BLOCK;
    bool fresh = true;
    struct column col = {job->edge, prefix, NULL, height};
    v4d total = {0, 0, 0, 0};
    double cur = -PI / 4;
    memset(acc, 0, n * sizeof *acc);
    for (uint32_t j = 0; j < n; j++) {
        const double end = j + 1 == n ? PI / 4 : atan(2.0 * (j + 1) / n - 1.0);
        while (cur < end) {
            double stop = (double)(k + 1) * per_column - offset;
            if (stop <= cur + 1e-13) {
                k++;
                fresh = true;
                continue;
            }
            if (fresh) {
                if (k >= block_first + BLOCK) {
                    block_first = k;
                    fetch_block(src, (uint32_t)(((k % width) + width) % width), block);
                }
                col.value = block + (size_t)(k - block_first) * height;
                sum_column(job->edge, col.value, height, prefix);
                fresh = false;
            }
            stop = stop < end ? stop : end;
            const double wedge = stop - cur;
            total += prefix[height] * wedge;
            /* towards a face's corners texel edges run askew: two meridians a wedge */
            const unsigned sides = job->side_rays * (cur < -0.3 || cur > 0.3 ? 2 : 1);
            for (unsigned i = 0; i < sides; i++)
                add_side(&col, n, cur + wedge * (i + 0.5) / sides, wedge / sides, acc);
            for (unsigned i = 0; i < job->cap_rays; i++)
                add_caps(job, &col, quadrant, centre + cur + wedge * (i + 0.5) / job->cap_rays,
                         wedge / job->cap_rays);
            cur = stop;
        }
        store_side(job, quadrants[quadrant].face, n - 1 - j, acc);
    }
    ((struct to_cube *)(uintptr_t)job)->power[quadrant] = total;
}

static int quadrant_c(void *arg, size_t begin, size_t end, unsigned worker)
{
    for (size_t q = begin; q < end; q++) quadrant_body(arg, (unsigned)q);
    return 0;
}

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX2)
static int quadrant_avx2(void *arg, size_t begin, size_t end, unsigned worker)
{
    for (size_t q = begin; q < end; q++) quadrant_body(arg, (unsigned)q);
    return 0;
}
PRT_ISA_END
#endif

/* Scales a cube so that its power is `power` exactly, channel by channel. */
static int set_power(struct prt_cube *cube, const double power[3])
{
    const size_t n_face = (size_t)cube->n * cube->n;
    float *omega = prt_alloc(n_face, sizeof *omega);
    if (!omega) return PRT_NOMEM;
    prt_cube_solid_angles(cube->n, omega);
    double sum[3] = {0, 0, 0};
    for (unsigned face = 0; face < 6; face++) {
        const float *p = cube->texel + face * n_face * 3;
        for (size_t i = 0; i < n_face; i++)
            for (int c = 0; c < 3; c++) sum[c] += (double)p[i * 3 + c] * omega[i];
    }
    prt_free(omega);
    float scale[3];
    for (int c = 0; c < 3; c++) scale[c] = sum[c] > 0 ? (float)(power[c] / sum[c]) : 1.0f;
    for (size_t i = 0; i < 6 * n_face; i++)
        for (int c = 0; c < 3; c++) cube->texel[i * 3 + c] *= scale[c];
    return PRT_OK;
}

/* Power to radiance. A cap texel's wedges add up to its solid angle within some 1e-3. Dividing
 * by what they add up to keeps a plain background plain; what rises above the background (the
 * least of the texel and its neighbours) is divided by the exact solid angle, so a sun keeps
 * its power. */
static void average_cap(const v4d *cell, uint32_t n, float *dst)
{
    for (uint32_t y = 0; y < n; y++)
        for (uint32_t x = 0; x < n; x++) {
            const size_t i = (size_t)y * n + x;
            const size_t near[4] = {x ? i - 1 : i, x + 1 < n ? i + 1 : i, y ? i - n : i,
                                    y + 1 < n ? i + n : i};
            const double exact = prt_cube_solid_angle(n, x, y), given = cell[i][3];
            for (int c = 0; c < 3; c++) {
                double base = given > 0 ? cell[i][c] / given : 0;
                for (int k = 0; k < 4; k++) {
                    const v4d *other = &cell[near[k]];
                    if ((*other)[3] > 0 && (*other)[c] < base * (*other)[3])
                        base = (*other)[c] / (*other)[3];
                }
                const double above = (cell[i][c] - base * given) / exact;
                dst[i * 3 + c] = (float)(base + (above > 0 ? above : 0));
            }
        }
}

static void finish_caps(struct to_cube *job)
{
    const uint32_t n = job->n;
    const size_t n_face = (size_t)n * n;
    for (unsigned quadrant = 0; quadrant < N_QUADRANT; quadrant++)
        for (uint32_t x = 0; x < n; x++) {
            const v4d *d = job->diagonal[quadrant];
            job->cap[0][(size_t)x * n + x] += d[x];
            job->cap[0][(size_t)(n - 1 - x) * n + x] += d[n + x];
            /* the lower cap is mirrored in t: its first diagonal is the other one */
            job->cap[1][(size_t)(n - 1 - x) * n + x] += d[2 * n + x];
            job->cap[1][(size_t)x * n + x] += d[3 * n + x];
        }
    for (unsigned cap = 0; cap < 2; cap++)
        average_cap(job->cap[cap], n, job->out->texel + (2 + cap) * n_face * 3);
}

static double *row_edges(uint32_t height)
{
    double *edge = prt_alloc((size_t)height + 1, sizeof *edge);
    for (uint32_t r = 0; edge && r <= height; r++)
        edge[r] = r == 0 ? 1.0 : r == height ? -1.0 : cos(PI * r / height);
    return edge;
}

static int latlong_to_cube(const struct prt_context *ctx, const struct prt_image *src,
                           uint32_t n, double turn, struct prt_cube *out)
{
    struct to_cube job = {.src = src, .n = n, .turn = turn, .out = out};
    const double n_wedge = (double)src->width + 4.0 * n;
    const size_t n_face = (size_t)n * n;
    job.side_rays = (unsigned)ceil(768.0 / n_wedge);
    job.cap_rays = cap_rays(n_wedge, n, rays_per_texel(n));
    double *edge = row_edges(src->height);
    v4d *cap = prt_calloc(2 * n_face + (size_t)16 * n, sizeof(v4d));
    const size_t scratch_size =
        ((size_t)src->height + 1 + n) * sizeof(v4d) + (size_t)BLOCK * src->height * sizeof(v4f);
    const size_t scratch_stride = (scratch_size + 63) / 64 * 64;
    char *scratch = prt_alloc(N_QUADRANT, scratch_stride);
    int err = PRT_NOMEM;
    if (edge && cap && scratch) {
        job.edge = edge;
        for (unsigned i = 0; i < 2; i++) job.cap[i] = cap + i * n_face;
        for (unsigned q = 0; q < N_QUADRANT; q++) {
            job.diagonal[q] = cap + 2 * n_face + (size_t)q * 4 * n;
            job.scratch[q] = scratch + q * scratch_stride;
        }
        prt_loop_fn fn = quadrant_c;
#if PRT_ISA_X86
        if (ctx && (ctx->cpu & PRT_CPU_AVX2)) fn = quadrant_avx2;
#endif
        err = prt_parallel_for(ctx, NULL, N_QUADRANT, 1, fn, &job);
    }
    if (!err) {
        finish_caps(&job);
        double power[3] = {0, 0, 0};
        for (unsigned q = 0; q < N_QUADRANT; q++)
            for (int c = 0; c < 3; c++) power[c] += job.power[q][c];
        err = set_power(out, power);
    }
    prt_free(edge);
    prt_free(cap);
    prt_free(scratch);
    return err;
}

/* ---- cube to cube, unrotated: both grids cut a face into rectangles ---- */

struct cut {
    double at;         /* face coordinate in [-1,1] */
    uint32_t src, dst; /* cells of the interval that begins here */
};

/* Merges the edges of n_src and n_dst cells; returns the number of intervals. */
static uint32_t merge_grids(uint32_t n_src, uint32_t n_dst, struct cut *cuts)
{
    uint32_t i = 0, j = 0, count = 0;
    while (i < n_src && j < n_dst) {
        const uint64_t a = (uint64_t)i * n_dst, b = (uint64_t)j * n_src;
        const double at = 2.0 * (double)(a > b ? a : b) / ((double)n_src * n_dst) - 1.0;
        cuts[count++] = (struct cut){at, i, j};
        const uint64_t a1 = a + n_dst, b1 = b + n_src;
        i += a1 <= b1;
        j += b1 <= a1;
    }
    cuts[count].at = 1.0;
    return count;
}

static int cube_to_cube(const struct prt_context *ctx, const struct prt_cube *src, uint32_t n,
                        struct prt_cube *out)
{
    const size_t n_face = (size_t)n * n, n_src = src->n;
    if (src->n == n) {
        memcpy(out->texel, src->texel, 6 * n_face * 3 * sizeof(float));
        return PRT_OK;
    }
    struct cut *cuts = prt_alloc(n_src + n + 1, sizeof *cuts);
    double *corner = prt_alloc((n_src + n + 1) * 2, sizeof *corner);
    double *acc = prt_calloc(n_face * 6 * 4, sizeof *acc);
    int err = PRT_NOMEM;
    if (!cuts || !corner || !acc) goto done;
    const uint32_t count = merge_grids(src->n, n, cuts);
    double *above = corner, *below = corner + count + 1;
    for (uint32_t r = 0; r <= count; r++) {
        const double t = cuts[r].at;
        for (uint32_t i = 0; i <= count; i++)
            below[i] = atan2(cuts[i].at * t, sqrt(1.0 + t * t + cuts[i].at * cuts[i].at));
        for (uint32_t i = 0; r > 0 && i < count; i++) {
            const double omega = below[i + 1] - below[i] - above[i + 1] + above[i];
            const struct cut *row = &cuts[r - 1];
            for (unsigned face = 0; face < 6; face++) {
                const float *s =
                    src->texel + ((face * n_src + row->src) * n_src + cuts[i].src) * 3;
                double *a = acc + (((size_t)face * n + row->dst) * n + cuts[i].dst) * 4;
                a[0] += omega * s[0];
                a[1] += omega * s[1];
                a[2] += omega * s[2];
                a[3] += omega;
            }
        }
        double *swap = above;
        above = below;
        below = swap;
    }
    for (size_t i = 0; i < 6 * n_face; i++)
        for (int c = 0; c < 3; c++)
            out->texel[i * 3 + c] = (float)(acc[i * 4 + c] / acc[i * 4 + 3]);
    err = PRT_OK;
done:
    prt_free(cuts);
    prt_free(corner);
    prt_free(acc);
    return err;
}

/* Quarter turns permute faces: the face at azimuth phi shows what was at phi + 90 degrees. */
static int quarter_turn(struct prt_cube *cube)
{
    static const unsigned from[6] = {4, 5, 2, 3, 1, 0}; /* +X shows +Z, -X -Z, +Z -X, -Z +X */
    const uint32_t n = cube->n;
    const size_t n_face = (size_t)n * n * 3;
    float *old = prt_alloc(6 * n_face, sizeof *old);
    if (!old) return PRT_NOMEM;
    memcpy(old, cube->texel, 6 * n_face * sizeof *old);
    for (unsigned face = 0; face < 6; face++)
        for (uint32_t y = 0; y < n; y++)
            for (uint32_t x = 0; x < n; x++) {
                uint32_t sx = x, sy = y;
                if (face == 2) sx = n - 1 - y, sy = x;
                if (face == 3) sx = y, sy = n - 1 - x;
                memcpy(cube->texel + face * n_face + ((size_t)y * n + x) * 3,
                       old + from[face] * n_face + ((size_t)sy * n + sx) * 3, 3 * sizeof *old);
            }
    prt_free(old);
    return PRT_OK;
}

/* ---- cube to lat-long ---- */

struct to_latlong {
    const struct prt_cube *cube;
    struct prt_image *out;
    const double *edge;
    unsigned rays;
};

/* Meridian phi through the cube as descending z of cell ends and the cells; returns the count.
 */
static uint32_t meridian(const struct prt_cube *cube, const unsigned quadrant, double beta,
                         double *end, const float **cell)
{
    const uint32_t n = cube->n;
    const size_t n_face = (size_t)n * n;
    const double phi = quadrants[quadrant].phi + beta, c = cos(beta);
    uint32_t count = 0;
    struct cap_walk w;
    bool last = false;
    cap_walk_start(&w, n, sin(phi), -cos(phi));
    while (!last) {
        cell[count] = cube->texel + (2 * n_face + (size_t)w.y * n + w.x) * 3;
        const double rho = cap_walk_next(&w, &last);
        end[count++] = 1.0 / sqrt(1.0 + rho * rho);
    }
    const uint32_t n_cap = count;
    const double s = -tan(beta);
    const double fx = (s + 1.0) * 0.5 * n;
    const uint32_t x = fx < 0 ? 0 : fx >= n ? n - 1 : (uint32_t)fx;
    for (uint32_t y = 0; y < n; y++) {
        const double q = (2.0 * (y + 1) / n - 1.0) * c;
        cell[count] = cube->texel + (quadrants[quadrant].face * n_face + (size_t)y * n + x) * 3;
        end[count++] = -q / sqrt(1.0 + q * q);
    }
    for (uint32_t i = n_cap; i-- > 0;) { /* -Y is +Y with t mirrored, walked inwards */
        const size_t at = (size_t)(cell[i] - cube->texel) / 3 - 2 * n_face;
        cell[count] = cube->texel + (3 * n_face + (n - 1 - at / n) * n + at % n) * 3;
        end[count++] = i > 0 ? -end[i - 1] : -1.0;
    }
    return count;
}

static int latlong_columns(void *arg, size_t begin, size_t stop, unsigned worker)
{
    const struct to_latlong *job = arg;
    const uint32_t n = job->cube->n, width = job->out->width, height = job->out->height;
    double *acc = prt_alloc((size_t)height * 3 + 5 * n + 8, sizeof *acc);
    const float **cell = prt_alloc((size_t)5 * n + 8, sizeof *cell);
    if (!acc || !cell) {
        prt_free(acc);
        prt_free(cell);
        return PRT_NOMEM;
    }
    double *end = acc + (size_t)height * 3;
    for (size_t i = begin; i < stop; i++) {
        const double first = 2 * PI * (double)i / width - PI;
        const double past = 2 * PI * (double)(i + 1) / width - PI;
        memset(acc, 0, (size_t)height * 3 * sizeof *acc);
        for (double cur = first; cur < past - 1e-13;) {
            /* the side column that holds cur: its far edge ends the wedge */
            const double turns = floor((cur + 1e-13 + PI / 4) / (PI / 2));
            const unsigned quadrant = (unsigned)(((int)turns % 4 + 4) % 4);
            const double beta = cur - turns * PI / 2;
            double j = floor((tan(beta) + 1.0) * 0.5 * n + 1e-9) + 1;
            double far = j >= n ? PI / 4 : atan(2.0 * j / n - 1.0);
            if (far <= beta + 1e-13) far = j + 1 >= n ? PI / 4 : atan(2.0 * (j + 1) / n - 1.0);
            double next = turns * PI / 2 + far;
            next = next < past ? next : past;
            if (next <= cur) next = past;
            const double wedge = (next - cur) / job->rays;
            for (unsigned r = 0; r < job->rays; r++) {
                const uint32_t count =
                    meridian(job->cube, quadrant, beta + wedge * (r + 0.5), end, cell);
                uint32_t row = 0;
                double z = 1.0;
                for (uint32_t k = 0; k < count; k++)
                    while (z > end[k]) {
                        const bool row_ends = row + 1 < height && job->edge[row + 1] > end[k];
                        const double low = row_ends ? job->edge[row + 1] : end[k];
                        const double omega = (z - low) * wedge;
                        for (int c = 0; c < 3; c++) acc[row * 3 + c] += omega * cell[k][c];
                        z = low;
                        row += row_ends;
                    }
            }
            cur = next;
        }
        for (uint32_t r = 0; r < height; r++) {
            const double omega = (job->edge[r] - job->edge[r + 1]) * (past - first);
            for (int c = 0; c < 3; c++)
                job->out->rgb[((size_t)r * width + i) * 3 + c] =
                    (float)(acc[r * 3 + c] / omega);
        }
    }
    prt_free(acc);
    prt_free(cell);
    return PRT_OK;
}

static void latlong_power(const struct prt_image *im, const double *edge, double power[3])
{
    memset(power, 0, 3 * sizeof *power);
    for (uint32_t r = 0; r < im->height; r++) {
        const float *p = im->rgb + (size_t)r * im->width * 3;
        double sum[3] = {0, 0, 0};
        for (uint32_t x = 0; x < im->width; x++)
            for (int c = 0; c < 3; c++) sum[c] += p[x * 3 + c];
        for (int c = 0; c < 3; c++)
            power[c] += sum[c] * (edge[r] - edge[r + 1]) * 2 * PI / im->width;
    }
}

static void cube_power(const struct prt_cube *cube, double power[3])
{
    memset(power, 0, 3 * sizeof *power);
    const uint32_t n = cube->n;
    for (uint32_t y = 0; y < n; y++)
        for (uint32_t x = 0; x < n; x++) {
            const double omega = prt_cube_solid_angle(n, x, y);
            for (unsigned face = 0; face < 6; face++)
                for (int c = 0; c < 3; c++)
                    power[c] += omega * cube->texel[(((size_t)face * n + y) * n + x) * 3 + c];
        }
}

void prt_env_power(const struct prt_env *env, double power[3])
{
    memset(power, 0, 3 * sizeof *power);
    if (env->kind == PRT_ENV_CUBE) {
        cube_power(&env->cube, power);
        return;
    }
    double *edge = row_edges(env->latlong.height);
    if (edge) latlong_power(&env->latlong, edge, power);
    prt_free(edge);
}

int prt_cube_to_latlong(const struct prt_context *ctx, const struct prt_cube *cube,
                        uint32_t width, uint32_t height, struct prt_image *out)
{
    memset(out, 0, sizeof *out);
    if (!cube->n || !width || !height || width > 16384 || height > 16384)
        return prt_fail(ctx, PRT_ARG, "lat-long size %u x %u: allowed is 1..16384", width,
                        height);
    struct prt_image image = {width, height,
                              prt_alloc((size_t)width * height * 3, sizeof(float))};
    double *edge = row_edges(height);
    int err = PRT_NOMEM;
    if (image.rgb && edge) {
        struct to_latlong job = {cube, &image, edge,
                                 cap_rays(width + 4.0 * cube->n, cube->n, RAYS_MIN)};
        err = prt_parallel_for(ctx, NULL, width, 16, latlong_columns, &job);
    }
    if (!err) {
        double want[3], have[3];
        cube_power(cube, want);
        latlong_power(&image, edge, have);
        for (int c = 0; c < 3; c++) {
            const float scale = have[c] > 0 ? (float)(want[c] / have[c]) : 1.0f;
            for (size_t i = 0; i < (size_t)width * height; i++) image.rgb[i * 3 + c] *= scale;
        }
    }
    prt_free(edge);
    if (err) {
        prt_image_finish(&image);
        return prt_fail(ctx, err, "lat-long of %u x %u: %s", width, height,
                        prt_status_text(err));
    }
    *out = image;
    return PRT_OK;
}

/* ---- environments ---- */

/* The lat-long a cube environment is turned from: 8 n x 4 n, so 2 pixels a texel, made once. */
static int turned_source(const struct prt_context *ctx, const struct prt_env *env,
                         struct prt_image *temporary, const struct prt_image **out)
{
    uint32_t width = env->cube.n * 8;
    width = width < 256 ? 256 : width > 4096 ? 4096 : width;
    struct prt_env_cache *cache = env->cache;
    int err = PRT_OK;
    if (!cache) {
        err = prt_cube_to_latlong(ctx, &env->cube, width, width / 2, temporary);
        *out = temporary;
        return err;
    }
    pthread_mutex_lock(&cache->lock);
    if (!cache->latlong.rgb)
        err = prt_cube_to_latlong(ctx, &env->cube, width, width / 2, &cache->latlong);
    pthread_mutex_unlock(&cache->lock);
    *out = &cache->latlong;
    return err;
}

static int turned_cube(const struct prt_context *ctx, const struct prt_env *env, uint32_t n,
                       double degrees, struct prt_cube *out)
{
    const double quarters = degrees / 90.0;
    int err;
    if (quarters == floor(quarters)) {
        err = cube_to_cube(ctx, &env->cube, n, out);
        for (int i = 0; !err && i < (int)quarters; i++) err = quarter_turn(out);
        return err;
    }
    struct prt_image temporary = {0};
    const struct prt_image *src = NULL;
    err = turned_source(ctx, env, &temporary, &src);
    if (!err) err = latlong_to_cube(ctx, src, n, degrees * PI / 180.0, out);
    prt_image_finish(&temporary);
    return err;
}

int prt_env_to_cube(const struct prt_context *ctx, const struct prt_env *env, uint32_t n,
                    double rotate_deg, struct prt_cube *out)
{
    out->n = 0;
    out->texel = NULL;
    if (n < 1 || n > PRT_CUBE_MAX)
        return prt_fail(ctx, PRT_ARG, "cube size %u: allowed is 1..%d", n, PRT_CUBE_MAX);
    if (!isfinite(rotate_deg))
        return prt_fail(ctx, PRT_ARG, "rotation must be a finite number of degrees");
    double degrees = fmod(rotate_deg, 360.0);
    if (degrees < 0) degrees += 360.0;
    if (degrees >= 360.0) degrees = 0;
    struct prt_cube cube;
    int err = prt_cube_init(&cube, n);
    if (err) return err;
    if (env->kind == PRT_ENV_CUBE) err = turned_cube(ctx, env, n, degrees, &cube);
    else err = latlong_to_cube(ctx, &env->latlong, n, degrees * PI / 180.0, &cube);
    if (err) {
        prt_cube_finish(&cube);
        return prt_fail(ctx, err, "resampling to 6 x %u x %u: %s", n, n, prt_status_text(err));
    }
    *out = cube;
    return PRT_OK;
}

uint32_t prt_env_full_cube(const struct prt_env *env)
{
    /* a face spans a quarter of the lat-long's width */
    const uint32_t want =
        env->kind == PRT_ENV_CUBE ? env->cube.n : (env->latlong.width + 3) / 4;
    uint32_t n = 16;
    while (n < want && n < 1024) n *= 2;
    return n;
}
