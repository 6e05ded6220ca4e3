/* SPDX-License-Identifier: MIT */
/* Cubes of an environment that turns: a reduced lat-long image of it, kept in its cache, times
 * a sparse matrix that depends on the cube's size alone. A turn shifts the image's columns, and
 * a part of a column is interpolated: between the cubes of the two whole numbers of columns, of
 * which the last ones are kept. Power is conserved.
 * Pixels that hold much of the power, a sun's, are left out of the image and are added one by
 * one at their places (METHODS §2). */
#include "resample.h"

#include <stdlib.h>
#include <string.h>

typedef float v4f __attribute__((vector_size(16)));
/* Pixels of the reduced image for each texel along a face's side, and wedges of azimuth that
 * each of its columns is cut into for the matrix. */
enum { PER_TEXEL = 2, WEDGES = 16, SLOTS = 1 << 13, SIZES = 3 };

/* Rows: for each texel of the cube its pixels, with weights that sum to 1. */
struct matrix {
    uint32_t *begin; /* [6 n n + 1] */
    uint32_t *index; /* of the pixel, in rows of twice the image's width */
    float *weight;
    float *solid_angle; /* [n n] of a face's texels */
};
static struct matrix matrix[SIZES]; /* for n = 16, 32, 64 */
static pthread_mutex_t matrix_lock = PTHREAD_MUTEX_INITIALIZER;

static int size_index(uint32_t n)
{
    return n == 16 ? 0 : n == 32 ? 1 : n == 64 ? 2 : -1;
}

static void matrix_finish(struct matrix *m)
{
    prt_free(m->begin);
    prt_free(m->index);
    prt_free(m->weight);
    prt_free(m->solid_angle);
    *m = (struct matrix){0};
}

/* ---- the matrix */

struct share {
    uint32_t texel; /* + 1; 0: the slot is free */
    uint16_t row, column;
    double area; /* [sr] */
};
struct builder {
    uint32_t n, width, height;
    const double *edge; /* [height+1] z of row edges */
    struct share *slot; /* [SLOTS] of the column that is being cut */
    uint32_t n_slot;
    uint16_t column;
    struct share *all;
    size_t n_all, room;
    bool failed;
};

static void add_share(struct builder *b, uint32_t texel, uint32_t row, double area)
{
    uint32_t at = (texel * 2654435761u + row * 40503u) % SLOTS;
    while (b->slot[at].texel && (b->slot[at].texel != texel + 1 || b->slot[at].row != row))
        at = (at + 1) % SLOTS;
    if (!b->slot[at].texel && ++b->n_slot > SLOTS / 2) {
        b->failed = true;
        return;
    }
    b->slot[at].texel = texel + 1;
    b->slot[at].row = (uint16_t)row;
    b->slot[at].area += area;
}

/* The strip of a wedge between z_top and z_low belongs to one texel: cut at the row edges. */
static void add_strip(struct builder *b, uint32_t texel, double z_top, double z_low,
                      double width)
{
    const double last = b->height - 1;
    double at = acos(z_top > 1 ? 1 : z_top) / PI * b->height;
    uint32_t row = (uint32_t)(at < 0 ? 0 : at > last ? last : at);
    while (row > 0 && z_top > b->edge[row]) row--;
    for (; row < b->height && b->edge[row] > z_low; row++) {
        const double top = z_top < b->edge[row] ? z_top : b->edge[row];
        const double low = z_low > b->edge[row + 1] ? z_low : b->edge[row + 1];
        if (top > low) add_share(b, texel, row, (top - low) * width);
    }
}

static void add_wedge(struct builder *b, unsigned quadrant, uint32_t x, double beta,
                      double width)
{
    const uint32_t n = b->n, face = quadrants[quadrant].face;
    const double phi = quadrants[quadrant].phi + beta, c = cos(beta);
    double above = 0;
    for (uint32_t k = 0; k <= n; k++) {
        const double q = (2.0 * k / n - 1.0) * c, z = -q / sqrt(1.0 + q * q);
        if (k) add_strip(b, (face * n + k - 1) * n + x, above, z, width);
        above = z;
    }
    struct cap_walk w;
    cap_walk_start(&w, n, sin(phi), -cos(phi));
    double top = 1;
    for (bool last = false; !last;) {
        const uint32_t cx = (uint32_t)w.x, cy = (uint32_t)w.y;
        const double rho = cap_walk_next(&w, &last), z = 1.0 / sqrt(1.0 + rho * rho);
        add_strip(b, (2 * n + cy) * n + cx, top, z, width);
        add_strip(b, (3 * n + (n - 1 - cy)) * n + cx, -z, -top, width);
        top = z;
    }
}

static void end_column(struct builder *b)
{
    if (b->n_all + b->n_slot > b->room) {
        const size_t room = 2 * b->room + SLOTS;
        struct share *all = realloc(b->all, room * sizeof *all);
        if (!all) {
            b->failed = true;
            return;
        }
        b->all = all;
        b->room = room;
    }
    for (uint32_t i = 0; i < SLOTS; i++) {
        if (!b->slot[i].texel) continue;
        b->all[b->n_all] = b->slot[i];
        b->all[b->n_all++].column = b->column;
    }
    memset(b->slot, 0, SLOTS * sizeof *b->slot);
    b->n_slot = 0;
}

/* One quadrant of azimuth, cut at the columns' and the texels' edges. */
static void cut_quadrant(struct builder *b, unsigned quadrant)
{
    const double per_column = 2.0 * PI / b->width;
    const double offset = quadrants[quadrant].phi + PI;
    int64_t k = (int64_t)floor((offset - PI / 4) / per_column + 1e-9);
    double cur = -PI / 4;
    for (uint32_t j = 0; j < b->n; j++) {
        const double end = j + 1 == b->n ? PI / 4 : atan(2.0 * (j + 1) / b->n - 1.0);
        while (cur < end - 1e-13 && !b->failed) {
            double stop = (double)(k + 1) * per_column - offset;
            if (stop <= cur + 1e-13) {
                end_column(b);
                k++;
                continue;
            }
            b->column = (uint16_t)(((k % b->width) + b->width) % b->width);
            stop = stop < end ? stop : end;
            for (int i = 0; i < WEDGES; i++)
                add_wedge(b, quadrant, b->n - 1 - j, cur + (stop - cur) * (i + 0.5) / WEDGES,
                          (stop - cur) / WEDGES);
            cur = stop;
        }
    }
    end_column(b);
}

static int pack(const struct builder *b, struct matrix *out)
{
    const uint32_t rows = 6 * b->n * b->n;
    struct matrix m = {.begin = prt_calloc((size_t)rows + 2, sizeof *m.begin),
                       .index = prt_alloc(b->n_all, sizeof *m.index),
                       .weight = prt_alloc(b->n_all, sizeof *m.weight),
                       .solid_angle = prt_alloc((size_t)b->n * b->n, sizeof(float))};
    double *sum = prt_calloc(rows, sizeof *sum);
    if (!m.begin || !m.index || !m.weight || !m.solid_angle || !sum) {
        prt_free(sum);
        matrix_finish(&m);
        return PRT_NOMEM;
    }
    for (size_t i = 0; i < b->n_all; i++) {
        m.begin[b->all[i].texel + 1]++; /* texel is one more than its index */
        sum[b->all[i].texel - 1] += b->all[i].area;
    }
    for (uint32_t t = 0; t < rows; t++) m.begin[t + 2] += m.begin[t + 1];
    for (size_t i = 0; i < b->n_all; i++) {
        const struct share *s = &b->all[i];
        const uint32_t at = m.begin[s->texel]++;
        m.index[at] = 2 * s->row * b->width + s->column;
        m.weight[at] = (float)(s->area / sum[s->texel - 1]);
    }
    prt_free(sum);
    prt_cube_solid_angles(b->n, m.solid_angle);
    *out = m;
    return PRT_OK;
}

static int make_matrix(uint32_t n, struct matrix *out)
{
    struct builder b = {.n = n, .width = 4 * PER_TEXEL * n, .height = 2 * PER_TEXEL * n};
    double *edge = prt_resample_row_edges(b.height);
    b.edge = edge;
    b.slot = calloc(SLOTS, sizeof *b.slot);
    int status = edge && b.slot ? PRT_OK : PRT_NOMEM;
    for (unsigned q = 0; q < N_QUADRANT && !status; q++) cut_quadrant(&b, q);
    if (!status) status = b.failed ? PRT_NOMEM : pack(&b, out);
    free(b.slot);
    free(b.all);
    prt_free(edge);
    return status;
}

static int matrix_get(uint32_t n, const struct matrix **out)
{
    struct matrix *m = &matrix[size_index(n)];
    int status = PRT_OK;
    pthread_mutex_lock(&matrix_lock);
    if (!m->begin) status = make_matrix(n, m);
    pthread_mutex_unlock(&matrix_lock);
    *out = m;
    return status;
}

/* ---- the reduced image */

static double luminance(const float *p)
{
    return 0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2];
}

/* Luminance beyond which a pixel of row y is taken for bright: it then holds more than one
 * PRT_BRIGHT_MAX-th of the power, so that there are at most that many. */
static double *bright_limits(const struct prt_image *src, uint32_t width)
{
    double *limit = prt_alloc(src->height, sizeof *limit), power = 0;
    for (uint32_t y = 0; limit && y < src->height; y++) {
        const float *row = src->rgb + (size_t)y * src->width * 3;
        double sum = 0;
        limit[y] = cos(PI * y / src->height) - cos(PI * (y + 1.0) / src->height);
        for (uint32_t x = 0; x < src->width; x++) sum += luminance(row + 3 * (size_t)x);
        power += sum * limit[y];
    }
    /* pixels that are not smaller than the reduced image's need no place of their own */
    const bool smaller = src->width > width;
    for (uint32_t y = 0; limit && y < src->height; y++)
        limit[y] = smaller ? power / PRT_BRIGHT_MAX / limit[y] : INFINITY;
    return limit;
}

static int find_bright(const struct prt_image *src, const double *limit,
                       struct prt_turned_image *out)
{
    out->bright = prt_alloc(PRT_BRIGHT_MAX, sizeof *out->bright);
    if (!out->bright) return PRT_NOMEM;
    for (uint32_t y = 0; y < src->height; y++) {
        const double area = (cos(PI * y / src->height) - cos(PI * (y + 1.0) / src->height)) *
                            2 * PI / src->width;
        for (uint32_t x = 0; x < src->width && out->n_bright < PRT_BRIGHT_MAX; x++) {
            const float *p = src->rgb + 3 * ((size_t)y * src->width + x);
            if (!(luminance(p) > limit[y])) continue;
            struct prt_bright_pixel *b = &out->bright[out->n_bright++];
            *b = (struct prt_bright_pixel){.phi = 2 * PI * x / src->width - PI,
                                           .theta = PI * y / src->height,
                                           .width = 2 * PI / src->width,
                                           .height = PI / src->height};
            for (int c = 0; c < 3; c++) b->power[c] = (float)(p[c] * area);
        }
    }
    return PRT_OK;
}

/* to[] += share times the means of one row of `src` over the reduced image's columns. */
static void add_row(const struct prt_image *src, uint32_t y, double limit, double share,
                    uint32_t width, v4f *to)
{
    const float *from = src->rgb + (size_t)y * src->width * 3;
    const double scale = (double)src->width / width;
    for (uint32_t c = 0; c < width; c++) {
        const double left = c * scale, right = (c + 1) * scale;
        for (uint32_t x = (uint32_t)left; x < src->width && x < right; x++) {
            const double begin = x > left ? x : left, end = x + 1.0 < right ? x + 1.0 : right;
            const float w = (float)(share * (end - begin) / scale);
            const float *p = from + 3 * (size_t)x;
            if (!(luminance(p) > limit)) to[c] += w * (v4f){p[0], p[1], p[2], 0};
        }
    }
}

static int reduce(const struct prt_image *src, struct prt_turned_image *out)
{
    const double scale = (double)src->height / out->height;
    const uint32_t width = out->width;
    out->pixel = prt_calloc((size_t)2 * width * out->height, sizeof *out->pixel);
    double *limit = bright_limits(src, out->width);
    int status = out->pixel && limit ? find_bright(src, limit, out) : PRT_NOMEM;
    for (uint32_t r = 0; r < out->height && !status; r++) {
        const double top = r * scale, low = (r + 1) * scale;
        const double area = cos(PI * r / out->height) - cos(PI * (r + 1.0) / out->height);
        for (uint32_t y = (uint32_t)top; y < src->height && y < low; y++) {
            const double a = y > top ? y : top, b = y + 1.0 < low ? y + 1.0 : low;
            const double share = (cos(PI * a / src->height) - cos(PI * b / src->height)) / area;
            add_row(src, y, limit[y], share, width, (v4f *)out->pixel + (size_t)2 * r * width);
        }
        v4f *row = (v4f *)out->pixel + (size_t)2 * r * width;
        memcpy(row + width, row, width * sizeof *row);
    }
    prt_free(limit);
    if (status) prt_turned_image_finish(out);
    return status;
}

static int reduced_get(const struct prt_context *ctx, const struct prt_env *env, uint32_t n,
                       struct prt_turned_image **out)
{
    struct prt_env_cache *cache = env->cache;
    const struct prt_image *source = &env->latlong;
    struct prt_turned_image *kept,
        image = {.width = 4 * PER_TEXEL * n, .height = 2 * PER_TEXEL * n};
    int status = env->kind == PRT_ENV_CUBE
                     ? prt_env_turned_source(ctx, env, &(struct prt_image){0}, &source)
                     : PRT_OK;
    if (status) return status;
    pthread_mutex_lock(&cache->lock);
    kept = &cache->reduced[size_index(n)];
    if (!kept->pixel && !(status = reduce(source, &image))) *kept = image;
    pthread_mutex_unlock(&cache->lock);
    *out = kept;
    return status;
}

void prt_turned_image_finish(struct prt_turned_image *image)
{
    for (int i = 0; i < PRT_MOVED_KEPT; i++) {
        prt_free(image->moved[i].texel);
        image->moved[i].texel = NULL;
    }
    prt_free(image->pixel);
    prt_free(image->bright);
    image->pixel = NULL;
    image->bright = NULL;
}

/* ---- a turned cube */

/* The cube of the image whose columns are moved by a whole number. */
static float *moved_cube(const struct prt_turned_image *image, const struct matrix *m,
                         uint32_t n, uint32_t column)
{
    const uint32_t rows = 6 * n * n;
    float *texel = prt_alloc((size_t)rows, 3 * sizeof *texel);
    const v4f *pixel = (const v4f *)image->pixel + column;
    for (uint32_t t = 0, i = 0; texel && t < rows; t++) {
        v4f sum = {0, 0, 0, 0};
        for (const uint32_t end = m->begin[t + 1]; i < end; i++)
            sum += m->weight[i] * pixel[m->index[i]];
        for (int c = 0; c < 3; c++) texel[3 * (size_t)t + (uint32_t)c] = sum[c];
    }
    return texel;
}

static struct prt_moved_cube *find_moved(struct prt_turned_image *image, uint32_t column)
{
    for (int i = 0; i < PRT_MOVED_KEPT; i++)
        if (image->moved[i].texel && image->moved[i].column == column) {
            image->moved[i].used = ++image->n_use;
            return &image->moved[i];
        }
    return NULL;
}

/* Keeps the cube in place of the one that was not used for longest. */
static struct prt_moved_cube *keep_moved(struct prt_turned_image *image, uint32_t column,
                                         float *texel)
{
    struct prt_moved_cube *oldest = image->moved;
    for (int i = 1; i < PRT_MOVED_KEPT; i++)
        if (image->moved[i].used < oldest->used) oldest = &image->moved[i];
    prt_free(oldest->texel);
    *oldest = (struct prt_moved_cube){++image->n_use, column, texel};
    return oldest;
}

/* to[] = share times the cube of the image moved by `column`, or that added. The cube is kept:
 * a light that is turned by hand has many angles between two columns. Columns repeat behind the
 * image's width. */
static int add_moved(struct prt_env_cache *cache, struct prt_turned_image *image,
                     const struct matrix *m, uint32_t n, uint32_t column, float share, bool add,
                     float *to)
{
    const uint32_t count = 18 * n * n;
    pthread_mutex_lock(&cache->lock);
    struct prt_moved_cube *found = find_moved(image, column);
    if (!found) {
        pthread_mutex_unlock(&cache->lock);
        float *made = moved_cube(image, m, n, column);
        if (!made) return PRT_NOMEM;
        pthread_mutex_lock(&cache->lock);
        found = find_moved(image, column);
        if (found) prt_free(made);
        else found = keep_moved(image, column, made);
    }
    const float *from = found->texel;
    if (add)
        for (uint32_t i = 0; i < count; i++) to[i] += share * from[i];
    else
        for (uint32_t i = 0; i < count; i++) to[i] = share * from[i];
    pthread_mutex_unlock(&cache->lock);
    return PRT_OK;
}

/* The cube of the image moved by `columns`: that of a whole number and the next, weighted. */
static int shifted_cube(struct prt_env_cache *cache, struct prt_turned_image *image,
                        const struct matrix *m, double columns, struct prt_cube *cube)
{
    const uint32_t width = image->width;
    const double whole = floor(columns);
    const float part = (float)(columns - whole);
    const uint32_t first = (uint32_t)(((int64_t)whole % width + width) % width);
    const uint32_t next = first + 1 < width ? first + 1 : 0;
    int status = add_moved(cache, image, m, cube->n, first, 1 - part, false, cube->texel);
    if (!status && part > 0)
        status = add_moved(cache, image, m, cube->n, next, part, true, cube->texel);
    return status;
}

/* Each bright pixel as spots of equal power, a twelfth of a texel apart, turned by `turn`
 * [rad]. */
static void add_bright(const struct prt_turned_image *image, double turn,
                       const float *solid_angle, struct prt_cube *cube)
{
    const uint32_t n = cube->n;
    const double wanted = image->n_bright ? 12 * image->bright->width * n / (PI / 2) : 0;
    const uint32_t spots = wanted < 2 ? 2 : wanted > 12 ? 12 : (uint32_t)ceil(wanted);
    for (uint32_t i = 0; i < image->n_bright; i++)
        for (uint32_t k = 0; k < spots * spots; k++) {
            const struct prt_bright_pixel *b = &image->bright[i];
            const double phi = b->phi + b->width * (k % spots + 0.5) / spots - turn;
            const double z_top = cos(b->theta), z_low = cos(b->theta + b->height);
            const double z = z_top + (z_low - z_top) * (k / spots + 0.5) / spots;
            const double across = sqrt(1 - z * z);
            const float dir[3] = {(float)(sin(phi) * across), (float)z,
                                  (float)(-cos(phi) * across)};
            unsigned face;
            float s, t;
            prt_cube_lookup(dir, &face, &s, &t);
            uint32_t x = (uint32_t)((s + 1) * 0.5f * (float)n);
            uint32_t y = (uint32_t)((t + 1) * 0.5f * (float)n);
            x = x < n ? x : n - 1;
            y = y < n ? y : n - 1;
            float *texel = cube->texel + 3 * (((size_t)face * n + y) * n + x);
            for (int c = 0; c < 3; c++)
                texel[c] += b->power[c] / (float)(spots * spots) / solid_angle[y * n + x];
        }
}

int prt_env_turned(const struct prt_context *ctx, const struct prt_env *env, uint32_t n,
                   double rotate_deg, struct prt_cube *out)
{
    const double degrees = fmod(rotate_deg, 360.0);
    const bool quarter = env->kind == PRT_ENV_CUBE && fmod(degrees, 90.0) == 0;
    if (!env->cache || size_index(n) < 0 || !isfinite(rotate_deg) || degrees == 0 || quarter)
        return prt_env_to_cube(ctx, env, n, rotate_deg, out);
    const struct matrix *m;
    struct prt_turned_image *image;
    struct prt_cube cube = {0};
    int status = matrix_get(n, &m);
    if (!status) status = reduced_get(ctx, env, n, &image);
    if (!status) status = prt_cube_init(&cube, n);
    if (!status)
        status = shifted_cube(env->cache, image, m, degrees / 360.0 * image->width, &cube);
    if (status) {
        prt_cube_finish(&cube);
        return prt_fail(ctx, status, "turning to 6 x %u x %u: %s", n, n,
                        prt_status_text(status));
    }
    add_bright(image, degrees * PI / 180, m->solid_angle, &cube);
    *out = cube;
    return PRT_OK;
}
