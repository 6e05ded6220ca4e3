// SPDX-License-Identifier: MIT
// C08's atlas in the model's own texture coordinates, where they are one to one: no two places
// of an object have the same.
#include "internal.h"

#include "trace/triangle.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_SIDE = 4096 }; // texels, 64 MiB of owners an object; chosen, not measured

// One object's triangles on a grid of side x side texels.
struct chart {
    const struct prt_mesh *mesh;
    uint32_t side, object;
    uint32_t *owner;         // [side][side] triangle or UINT32_MAX
    uint64_t covered, twice; // texels with a triangle; further triangles on such texels
    double area_hit;         // mm^2 of triangles with a texel
};

static double uv_area(const struct prt_mesh *mesh, uint32_t t)
{
    const float *a = mesh->uv[mesh->triangle[t][0]], *b = mesh->uv[mesh->triangle[t][1]];
    const float *c = mesh->uv[mesh->triangle[t][2]];
    return 0.5 * (((double)b[0] - (double)a[0]) * ((double)c[1] - (double)a[1]) -
                  ((double)b[1] - (double)a[1]) * ((double)c[0] - (double)a[0]));
}

// Whether (x, y) lies in a triangle of positive area; w: twice the areas opposite its corners.
// A point on an edge that two triangles share lies in one of them (top-left rule).
static bool covers(const double p[3][2], double x, double y, double w[3])
{
    for (int k = 0; k < 3; k++) {
        const double *a = p[(k + 1) % 3], *b = p[(k + 2) % 3];
        double dx = b[0] - a[0], dy = b[1] - a[1];
        w[k] = dx * (y - a[1]) - dy * (x - a[0]);
        bool inclusive = dy < 0 || (dy == 0 && dx > 0);
        if (w[k] < 0 || (w[k] == 0 && !inclusive)) return false;
    }
    return true;
}

// Calls fn for each texel centre in the triangle, with barycentrics of vertices 1 and 2.
typedef void (*texel_fn)(void *arg, uint32_t x, uint32_t y, double bu, double bv);
static void each_texel(const struct prt_mesh *mesh, uint32_t t, uint32_t side, texel_fn fn,
                       void *arg)
{
    double p[3][2], lo[2] = {INFINITY, INFINITY}, hi[2] = {-INFINITY, -INFINITY};
    double area = 2 * uv_area(mesh, t) * side * side;
    bool turned = area < 0;
    for (int k = 0; k < 3; k++) {
        const float *uv = mesh->uv[mesh->triangle[t][turned && k ? 3 - k : k]];
        for (int j = 0; j < 2; j++) {
            p[k][j] = (double)uv[j] * side;
            lo[j] = fmin(lo[j], p[k][j]);
            hi[j] = fmax(hi[j], p[k][j]);
        }
    }
    if (!(fabs(area) > 0)) return;
    int x0 = (int)fmax(ceil(lo[0] - 0.5), 0), x1 = (int)fmin(floor(hi[0] - 0.5), side - 1.0);
    int y0 = (int)fmax(ceil(lo[1] - 0.5), 0), y1 = (int)fmin(floor(hi[1] - 0.5), side - 1.0);
    for (int y = y0; y <= y1; y++) {
        for (int x = x0; x <= x1; x++) {
            double w[3];
            if (!covers((const double(*)[2])p, x + 0.5, y + 0.5, w)) continue;
            double b1 = w[1] / fabs(area), b2 = w[2] / fabs(area);
            fn(arg, (uint32_t)x, (uint32_t)y, turned ? b2 : b1, turned ? b1 : b2);
        }
    }
}

struct mark {
    struct chart *chart;
    uint32_t triangle;
    bool hit;
};

static void mark_texel(void *arg, uint32_t x, uint32_t y, double bu, double bv)
{
    struct mark *m = arg;
    uint32_t *owner = &m->chart->owner[(size_t)y * m->chart->side + x];
    m->hit = true;
    if (*owner != UINT32_MAX) {
        m->chart->twice++;
        return;
    }
    *owner = m->triangle;
    m->chart->covered++;
}

// Adds the areas of an object's triangles in uv and in mm^2. False where uv lie outside [0,1]²
// (by more than rounding) or their area is 0 or more than that of the square.
static bool measure_object(const struct prt_mesh *mesh, uint32_t object, double *uv,
                           double *area)
{
    bool good = true;
    for (uint32_t b = 0; b < mesh->n_block && good; b++) {
        const struct prt_block *k = &mesh->block[b];
        if (k->object != object || !prt_block_translucent(mesh, b)) continue;
        for (uint32_t t = k->triangle_begin; t < k->triangle_begin + k->n_triangle && good;
             t++) {
            double own = triangle_area(mesh, t), flat = fabs(uv_area(mesh, t));
            if (!(own > 0)) continue;
            for (int j = 0; j < 3; j++)
                for (int i = 0; i < 2; i++) {
                    float x = mesh->uv[mesh->triangle[t][j]][i];
                    good &= x >= -1e-4f && x <= 1 + 1e-4f;
                }
            *uv += flat;
            *area += own;
        }
    }
    return good && *uv > 1e-4 && *uv <= 1.001;
}

static void mark_object(struct chart *chart)
{
    const struct prt_mesh *mesh = chart->mesh;
    memset(chart->owner, 0xff, (size_t)chart->side * chart->side * sizeof *chart->owner);
    chart->covered = chart->twice = 0;
    chart->area_hit = 0;
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        const struct prt_block *k = &mesh->block[b];
        if (k->object != chart->object || !prt_block_translucent(mesh, b)) continue;
        for (uint32_t t = k->triangle_begin; t < k->triangle_begin + k->n_triangle; t++) {
            struct mark mark = {chart, t, false};
            each_texel(mesh, t, chart->side, mark_texel, &mark);
            if (mark.hit) chart->area_hit += triangle_area(mesh, t);
        }
    }
}

static uint32_t spread2(uint32_t x)
{
    x &= 0x7fff;
    x = (x | x << 8) & 0x00ff00ff;
    x = (x | x << 4) & 0x0f0f0f0f;
    x = (x | x << 2) & 0x33333333;
    return (x | x << 1) & 0x55555555;
}

struct texel {
    uint32_t triangle;
    float bu, bv, area;
};
struct fill {
    const struct chart *chart;
    struct texel *texel;
    struct key *key;
    uint32_t n, most, triangle;
    float area;
};

static void fill_texel(void *arg, uint32_t x, uint32_t y, double bu, double bv)
{
    struct fill *f = arg;
    if (f->chart->owner[(size_t)y * f->chart->side + x] != f->triangle || f->n == f->most)
        return;
    f->texel[f->n] = (struct texel){f->triangle, (float)bu, (float)bv, f->area};
    f->key[f->n] = (struct key){
        (uint64_t)f->chart->object << CODE_BITS | spread2(x) | spread2(y) << 1, f->n};
    f->n++;
}

// Texels of one object; each stands for its area times A_S / A_T of its triangle. Areas are
// then scaled so that their sum is the object's, since small triangles hold no texel centre.
static void fill_object(struct fill *f)
{
    const struct prt_mesh *mesh = f->chart->mesh;
    double side = f->chart->side, total = 0, sum = 0;
    uint32_t first = f->n;
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        const struct prt_block *k = &mesh->block[b];
        if (k->object != f->chart->object || !prt_block_translucent(mesh, b)) continue;
        for (uint32_t t = k->triangle_begin; t < k->triangle_begin + k->n_triangle; t++) {
            double flat = fabs(uv_area(mesh, t)), own = triangle_area(mesh, t);
            total += own;
            if (!(flat > 0)) continue;
            f->triangle = t;
            f->area = (float)(own / flat / side / side);
            each_texel(mesh, t, f->chart->side, fill_texel, f);
        }
    }
    for (uint32_t i = first; i < f->n; i++) sum += (double)f->texel[i].area;
    for (uint32_t i = first; i < f->n && sum > 0; i++)
        f->texel[i].area = (float)((double)f->texel[i].area * total / sum);
}

int prt_samples_uv_atlas(const struct prt_context *ctx, const struct prt_mesh *mesh, uint32_t n,
                         struct samples *out, bool *injective)
{
    double total = 0;
    *injective = false;
    if (!mesh->uv || !mesh->n_object) return PRT_OK;
    for (uint32_t o = 0; o < mesh->n_object; o++) {
        double uv = 0, area = 0;
        if (!measure_object(mesh, o, &uv, &area) && area > 0) return PRT_OK;
        total += area;
    }
    if (!(total > 0)) return PRT_OK;
    uint32_t most = n + n / 2 + 4096 * mesh->n_object;
    struct chart chart = {.mesh = mesh};
    struct fill fill = {.chart = &chart, .most = most};
    fill.texel = malloc((size_t)most * sizeof *fill.texel);
    fill.key = malloc(2 * (size_t)most * sizeof *fill.key);
    bool good = fill.texel && fill.key, one_to_one = true;
    for (uint32_t o = 0; o < mesh->n_object && good && one_to_one; o++) {
        double uv = 0, area = 0;
        measure_object(mesh, o, &uv, &area);
        if (!(area > 0)) continue;
        double side = ceil(sqrt(n * (area / total) / uv));
        chart.side = side < 16 ? 16 : side > MOST_SIDE ? MOST_SIDE : (uint32_t)side;
        chart.object = o;
        free(chart.owner);
        chart.owner = malloc((size_t)chart.side * chart.side * sizeof *chart.owner);
        if (!(good = chart.owner != NULL)) break;
        mark_object(&chart);
        // rounding at seams may cover 0.2 % of texels twice; triangles without a texel may hold
        // 10 % of the area
        one_to_one = chart.twice * 500 <= chart.covered && chart.area_hit > 0.9 * area;
        if (one_to_one) fill_object(&fill);
    }
    int status = PRT_OK;
    if (good && one_to_one) {
        if (prt_samples_init(out, fill.n)) {
            const struct key *key = prt_sort_keys(fill.key, fill.key + most, fill.n);
            for (uint32_t i = 0; i < fill.n; i++) {
                const struct texel *t = &fill.texel[key[i].index];
                prt_sample_place(mesh, t->triangle, (double)t->bu, (double)t->bv, out, i);
                out->area[i] = t->area;
                out->object[i] = (uint32_t)(key[i].code >> CODE_BITS);
            }
            out->n = fill.n;
            *injective = fill.n > 0;
            if (!fill.n) prt_samples_finish(out);
        } else {
            good = false;
        }
    }
    if (!good)
        status = prt_fail(ctx, PRT_NOMEM, "screen: no memory for an atlas of %u texels", n);
    free(chart.owner);
    free(fill.texel);
    free(fill.key);
    return status;
}
