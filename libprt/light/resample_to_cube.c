/* SPDX-License-Identifier: MIT */
/* Resamples a lat-long image to a cubemap, turned by any angle; power is conserved
 * (resample.h). */
#include "base/isa.h"
#include "resample.h"

#include <string.h>

typedef double v4d __attribute__((vector_size(32)));
typedef float v4f __attribute__((vector_size(16)));

#define INLINE static inline __attribute__((always_inline)) /* into each ISA's variant */
enum { BLOCK = 8 }; /* source columns transposed together */

/* Wedges through a corner texel of a cap: the error falls with the square. Fine cubes, whose
 * cost grows with n squared, hold few source pixels a texel and take fewer. */
static const double RAYS_MIN = 8.0, RAYS_MAX = 20.0;

static double rays_per_texel(uint32_t n)
{
    const double rays = RAYS_MAX * 32.0 / n;
    return rays < RAYS_MIN ? RAYS_MIN : rays > RAYS_MAX ? RAYS_MAX : rays;
}

/* atan for 0 <= |x| <= 1 within 1.2e-5 rad: only a first guess of a row. */
INLINE double rough_atan(double x)
{
    const double q = x * x;
    return x *
           (0.9998660 + q * (-0.3302995 + q * (0.1801410 + q * (-0.0851330 + q * 0.0208351))));
}

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

int prt_resample_latlong_to_cube(const struct prt_context *ctx, const struct prt_image *src,
                                 uint32_t n, double turn, struct prt_cube *out)
{
    struct to_cube job = {.src = src, .n = n, .turn = turn, .out = out};
    const double n_wedge = (double)src->width + 4.0 * n;
    const size_t n_face = (size_t)n * n;
    job.side_rays = (unsigned)ceil(768.0 / n_wedge);
    job.cap_rays = prt_resample_cap_rays(n_wedge, n, rays_per_texel(n));
    double *edge = prt_resample_row_edges(src->height);
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
