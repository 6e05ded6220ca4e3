// SPDX-License-Identifier: MIT
// Environments pre-filtered with the GGX lobe (METHODS §6). The filter's weights do not depend
// on light: they are computed once in a process, so that a new light costs one sparse product.
#include "internal.h"
#include "cube.h"

#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

// Levels of growing roughness: the size of the level and of the input it is filtered from.
enum { N_LEVEL = SPECULAR_LEVELS, BASE = SPECULAR_SIDE };
// The lobe is cut where it falls to one over this of its peak (METHODS §6); chosen, not
// measured.
#define LOBE_CUT 500.0
static const struct {
    float roughness;
    uint32_t n, from;
} level_shape[N_LEVEL] = {{SPECULAR_ROUGH_0, 32, 32}, {SPECULAR_ROUGH_1, 32, 32},
                          {SPECULAR_ROUGH_2, 16, 16}, {SPECULAR_ROUGH_3, 16, 8},
                          {SPECULAR_ROUGH_4, 8, 8},   {SPECULAR_ROUGH_5, 8, 8}};

// Sparse rows: for each texel of the level, texels of the input with weights that sum to 1.
struct filter {
    uint32_t *begin; // [6 n n + 1]
    uint16_t *index;
    float *weight;
};
static struct filter filter[N_LEVEL];
static pthread_mutex_t filter_lock = PTHREAD_MUTEX_INITIALIZER;
static bool filters_made;

static void face_direction(unsigned face, double s, double t, float d[3])
{
    const double table[6][3] = {{1, -t, -s}, {-1, -t, s}, {s, 1, t},
                                {s, -1, -t}, {s, -t, 1},  {-s, -t, -1}};
    double l = 1 / sqrt(1 + s * s + t * t);
    for (int i = 0; i < 3; i++) d[i] = (float)(table[face][i] * l);
}

static void face_lookup(const float d[3], unsigned *face, float *s, float *t)
{
    float ax = fabsf(d[0]), ay = fabsf(d[1]), az = fabsf(d[2]);
    if (ax >= ay && ax >= az) {
        float k = ax > 0 ? 1 / ax : 0;
        *face = d[0] < 0;
        *s = (d[0] < 0 ? d[2] : -d[2]) * k;
        *t = -d[1] * k;
    } else if (ay >= az) {
        *face = 2 + (d[1] < 0);
        *s = d[0] / ay;
        *t = (d[1] < 0 ? -d[2] : d[2]) / ay;
    } else {
        *face = 4 + (d[2] < 0);
        *s = (d[2] < 0 ? -d[0] : d[0]) / az;
        *t = -d[1] / az;
    }
}

bool prt_border_cube_init(struct border_cube *cube, uint32_t n)
{
    cube->n = n;
    cube->texel = prt_calloc((size_t)6 * (n + 2) * (n + 2) * 4, sizeof(float));
    return cube->texel != NULL;
}

void prt_border_cube_finish(struct border_cube *cube)
{
    prt_free(cube->texel);
    cube->texel = NULL;
}

// The texel of another face that stands at x, y of this face's border; both as indices of
// texels. x, y count from the border: 0 and n+1 lie outside.
static void seal_pair(const struct border_cube *c, unsigned face, uint32_t x, uint32_t y,
                      uint32_t pair[2])
{
    float d[3], s, t;
    unsigned other;
    face_direction(face, 2 * ((double)x - 0.5) / c->n - 1, 2 * ((double)y - 0.5) / c->n - 1, d);
    face_lookup(d, &other, &s, &t);
    int px = (int)((s * 0.5f + 0.5f) * (float)c->n),
        py = (int)((t * 0.5f + 0.5f) * (float)c->n);
    int last = (int)c->n - 1;
    px = px < 0 ? 0 : px > last ? last : px;
    py = py < 0 ? 0 : py > last ? last : py;
    size_t m = c->n + 2;
    pair[0] = (uint32_t)((face * m + y) * m + x);
    pair[1] = (uint32_t)((border_texel(c, other, (uint32_t)px, (uint32_t)py) - c->texel) / 4);
}

static size_t n_seal_pair(uint32_t n)
{
    return (size_t)6 * 4 * (n + 2);
}

static void seal_pairs(const struct border_cube *c, uint32_t (*pair)[2])
{
    for (unsigned face = 0; face < 6; face++)
        for (uint32_t i = 0; i < c->n + 2; i++) {
            seal_pair(c, face, i, 0, *pair++);
            seal_pair(c, face, i, c->n + 1, *pair++);
            seal_pair(c, face, 0, i, *pair++);
            seal_pair(c, face, c->n + 1, i, *pair++);
        }
}

// The pairs of this size, which are the same for every cube: computed once for small ones, and
// kept. NULL: to be computed, as there is no memory or the cube is large.
static const uint32_t (*kept_pairs(const struct border_cube *c))[2]
{
    enum { MOST = 64 };
    static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
    static uint32_t(*kept[MOST + 1])[2];
    if (c->n > MOST) return NULL;
    pthread_mutex_lock(&lock);
    uint32_t(*pair)[2] = kept[c->n];
    if (!pair && (pair = prt_alloc(n_seal_pair(c->n), sizeof *pair))) {
        seal_pairs(c, pair);
        kept[c->n] = pair;
    }
    pthread_mutex_unlock(&lock);
    return (const uint32_t(*)[2])pair;
}

void prt_border_cube_seal(struct border_cube *c)
{
    const uint32_t(*pair)[2] = kept_pairs(c);
    for (size_t i = 0; pair && i < n_seal_pair(c->n); i++)
        memcpy(c->texel + 4 * (size_t)pair[i][0], c->texel + 4 * (size_t)pair[i][1], 16);
    for (unsigned face = 0; !pair && face < 6; face++)
        for (uint32_t i = 0; i < 4 * (c->n + 2); i++) {
            uint32_t one[2], k = i / 4, end = c->n + 1;
            seal_pair(c, face,
                      i % 4 < 2    ? k
                      : i % 4 == 2 ? 0
                                   : end,
                      i % 4 >= 2   ? k
                      : i % 4 == 0 ? 0
                                   : end,
                      one);
            memcpy(c->texel + 4 * (size_t)one[0], c->texel + 4 * (size_t)one[1], 16);
        }
}

void prt_border_cube_sample(const struct border_cube *c, const float dir[3], float rgb[3])
{
    unsigned face;
    float s, t;
    face_lookup(dir, &face, &s, &t);
    float x = (s * 0.5f + 0.5f) * (float)c->n + 0.5f,
          y = (t * 0.5f + 0.5f) * (float)c->n + 0.5f;
    int x0 = (int)x, y0 = (int)y, last = (int)c->n;
    x0 = x0 < 0 ? 0 : x0 > last ? last : x0;
    y0 = y0 < 0 ? 0 : y0 > last ? last : y0;
    float fx = x - (float)x0, fy = y - (float)y0;
    size_t m = c->n + 2;
    const float *p = c->texel + ((face * m + (size_t)y0) * m + (size_t)x0) * 4;
    for (int k = 0; k < 3; k++)
        rgb[k] = (p[k] * (1 - fx) + p[4 + k] * fx) * (1 - fy) +
                 (p[m * 4 + (size_t)k] * (1 - fx) + p[m * 4 + 4 + (size_t)k] * fx) * fy;
}

bool prt_border_cube_copy(struct border_cube *out, const struct prt_cube *cube)
{
    if (!prt_border_cube_init(out, cube->n)) return false;
    for (unsigned face = 0; face < 6; face++)
        for (uint32_t y = 0; y < cube->n; y++)
            for (uint32_t x = 0; x < cube->n; x++)
                memcpy(border_texel(out, face, x, y),
                       cube->texel + (((size_t)face * cube->n + y) * cube->n + x) * 3, 12);
    prt_border_cube_seal(out);
    return true;
}

// One level's filter while it is computed. With view = normal = lobe axis the GGX density of
// reflected directions is D(h)/4 (WMLT07).
struct filter_job {
    unsigned level;
    uint32_t n_in;
    double alpha, cos_cut; // directions at a smaller cosine to the axis weigh 0
    float (*in_direction)[3];
    float (*place)[3]; // [n_in texels][n_place] directions in each texel
    uint32_t n_place;
    float *solid_angle;
    uint16_t **index; // [rows] lists of texels and weights
    float **weight;
    uint32_t *count;
};

// Weight of input texel i for lobe axis d: the lobe averaged over n_place directions of the
// texel.
static double texel_weight(const struct filter_job *job, uint32_t i, const float d[3])
{
    float sum = 0, a2 = (float)(job->alpha * job->alpha), cut = (float)job->cos_cut;
    const float(*place)[3] = (const float(*)[3])job->place + (size_t)i * job->n_place;
    for (uint32_t k = 0; k < job->n_place; k++) {
        float c = place[k][0] * d[0] + place[k][1] * d[1] + place[k][2] * d[2];
        // D(h) up to a constant, cos² of the half angle being (1+c)/2
        float e = (1 + c) * 0.5f * (a2 - 1) + 1;
        if (c > cut) sum += c / (e * e);
    }
    return (double)sum * job->solid_angle[i];
}

static int filter_rows(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct filter_job *job = arg;
    uint32_t n_in = 6 * job->n_in * job->n_in, n = level_shape[job->level].n;
    uint16_t *index = malloc(n_in * sizeof *index);
    float *weight = malloc(n_in * sizeof *weight);
    int status = index && weight ? PRT_OK : PRT_NOMEM;
    double near = job->cos_cut - 1.5 / job->n_in; // texels that overlap the cone
    for (size_t row = begin; !status && row < end; row++) {
        float d[3];
        unsigned face = (unsigned)(row / (n * n)), y = (unsigned)(row / n % n);
        face_direction(face, 2 * ((double)(row % n) + 0.5) / n - 1, 2 * (y + 0.5) / n - 1, d);
        uint32_t count = 0;
        double total = 0;
        for (uint32_t i = 0; i < n_in; i++) {
            const float *w = job->in_direction[i];
            if (w[0] * d[0] + w[1] * d[1] + w[2] * d[2] < near) continue;
            double k = texel_weight(job, i, d);
            if (!(k > 0)) continue;
            index[count] = (uint16_t)i;
            weight[count++] = (float)k;
            total += k;
        }
        for (uint32_t i = 0; i < count; i++) weight[i] = (float)(weight[i] / total);
        job->count[row] = count;
        job->index[row] = malloc(count * sizeof *index + 1);
        job->weight[row] = malloc(count * sizeof *weight + 1);
        if (!job->index[row] || !job->weight[row]) {
            status = PRT_NOMEM;
            break;
        }
        memcpy(job->index[row], index, count * sizeof *index);
        memcpy(job->weight[row], weight, count * sizeof *weight);
    }
    free(index);
    free(weight);
    return status;
}

static double texel_area(double x, double y)
{
    return atan2(x * y, sqrt(x * x + y * y + 1));
}

// Solid angle of texel (x, y) of a face whose texels are k wide in [-1,1]².
static double texel_solid_angle(double x, double y, double k)
{
    return texel_area((x + 1) * k - 1, (y + 1) * k - 1) -
           texel_area(x * k - 1, (y + 1) * k - 1) - texel_area((x + 1) * k - 1, y * k - 1) +
           texel_area(x * k - 1, y * k - 1);
}

static void job_finish(struct filter_job *job, uint32_t rows)
{
    for (uint32_t r = 0; job->index && job->weight && r < rows; r++) {
        free(job->index[r]);
        free(job->weight[r]);
    }
    free(job->in_direction);
    free(job->place);
    free(job->solid_angle);
    free(job->index);
    free(job->weight);
    free(job->count);
}

// Directions and solid angles of the input's texels; `fine` x `fine` directions in each.
static bool job_init(struct filter_job *job, uint32_t rows, uint32_t fine)
{
    uint32_t n_in = job->n_in, in = 6 * n_in * n_in;
    job->n_place = fine * fine;
    job->in_direction = malloc(in * sizeof *job->in_direction);
    job->solid_angle = malloc(in * sizeof *job->solid_angle);
    job->place = malloc((size_t)in * job->n_place * sizeof *job->place);
    job->index = calloc(rows, sizeof *job->index);
    job->weight = calloc(rows, sizeof *job->weight);
    job->count = calloc(rows, sizeof *job->count);
    if (!job->in_direction || !job->solid_angle || !job->place || !job->index || !job->weight ||
        !job->count)
        return false;
    for (uint32_t i = 0; i < in; i++) {
        unsigned face = i / (n_in * n_in);
        double x = i % n_in, y = i / n_in % n_in, k = 2.0 / n_in;
        face_direction(face, (x + 0.5) * k - 1, (y + 0.5) * k - 1, job->in_direction[i]);
        for (uint32_t q = 0; q < job->n_place; q++)
            face_direction(face, (x + (q % fine + 0.5) / fine) * k - 1,
                           (y + (double)(q / fine + 0.5) / fine) * k - 1,
                           job->place[(size_t)i * job->n_place + q]);
        job->solid_angle[i] = (float)texel_solid_angle(x, y, k);
    }
    return true;
}

// The job's lists as one sparse matrix.
static bool pack_filter(const struct filter_job *job, uint32_t rows, struct filter *out)
{
    struct filter f = {calloc(rows + 1, sizeof *f.begin), NULL, NULL};
    if (!f.begin) return false;
    for (uint32_t r = 0; r < rows; r++) f.begin[r + 1] = f.begin[r] + job->count[r];
    f.index = malloc(f.begin[rows] * sizeof *f.index);
    f.weight = malloc(f.begin[rows] * sizeof *f.weight);
    if (!f.index || !f.weight) {
        free(f.begin);
        free(f.index);
        free(f.weight);
        return false;
    }
    for (uint32_t r = 0; r < rows; r++) {
        memcpy(f.index + f.begin[r], job->index[r], job->count[r] * sizeof *f.index);
        memcpy(f.weight + f.begin[r], job->weight[r], job->count[r] * sizeof *f.weight);
    }
    *out = f;
    return true;
}

static int make_filter(const struct prt_context *ctx, unsigned level)
{
    uint32_t n = level_shape[level].n, rows = 6 * n * n;
    double alpha = (double)level_shape[level].roughness * level_shape[level].roughness;
    double theta = atan(alpha * sqrt(sqrt(LOBE_CUT) - 1)); // half angle of the cut
    struct filter_job job = {.level = level,
                             .n_in = level_shape[level].from,
                             .alpha = alpha,
                             .cos_cut = 2 * theta < M_PI / 2 ? cos(2 * theta) : 0};
    // the narrowest lobe is not much wider than a texel
    int status = job_init(&job, rows, level == 1 ? 4 : 2) ? PRT_OK : PRT_NOMEM;
    if (!status) status = prt_parallel_for(ctx, NULL, rows, 16, filter_rows, &job);
    if (!status && !pack_filter(&job, rows, &filter[level])) status = PRT_NOMEM;
    job_finish(&job, rows);
    return status;
}

static int make_filters(const struct prt_context *ctx)
{
    int status = PRT_OK;
    pthread_mutex_lock(&filter_lock);
    for (unsigned k = 1; !filters_made && !status && k < N_LEVEL; k++)
        if (!filter[k].begin) status = make_filter(ctx, k);
    if (!status) filters_made = true;
    pthread_mutex_unlock(&filter_lock);
    return status;
}

// Mean of k x k texels of one face from (x, y) on, by their weights.
static void average_block(const float *face, const float *area, uint32_t n, uint32_t x,
                          uint32_t y, uint32_t k, float out[4])
{
    float sum[3] = {0}, total = 0;
    for (uint32_t b = y; b < y + k; b++) {
        for (uint32_t a = x; a < x + k; a++) {
            const float *p = face + ((size_t)b * n + a) * 4;
            float w = area[b * n + a];
            total += w;
            for (int c = 0; c < 3; c++) sum[c] += w * p[c];
        }
    }
    for (int c = 0; c < 3; c++) out[c] = sum[c] / total;
    out[3] = 0;
}

// Average radiance over blocks of texels, weighted by solid angle: conserves power.
static bool reduce(const float *in, uint32_t n_in, uint32_t n, float *out)
{
    uint32_t k = n_in / n;
    float *area = prt_alloc((size_t)n_in * n_in, sizeof *area);
    if (!area) return false;
    for (uint32_t y = 0; y < n_in; y++) {
        for (uint32_t x = 0; x < n_in; x++) {
            double s = (2 * x + 1.0) / n_in - 1, t = (2 * y + 1.0) / n_in - 1;
            area[y * n_in + x] = (float)pow(1 + s * s + t * t, -1.5);
        }
    }
    for (uint32_t i = 0; i < 6 * n * n; i++) {
        uint32_t face = i / (n * n), y = i / n % n, x = i % n;
        average_block(in + (size_t)face * n_in * n_in * 4, area, n_in, x * k, y * k, k,
                      out + (size_t)i * 4);
    }
    prt_free(area);
    return true;
}

// Resamples a cube of any size to BASE x BASE, four floats a texel.
static bool to_base(const struct prt_cube *light, float *base)
{
    uint32_t n = light->n;
    if (n > BASE && n % BASE == 0) {
        float *wide = prt_calloc((size_t)6 * n * n, 16);
        if (!wide) return false;
        for (size_t i = 0; i < (size_t)6 * n * n; i++)
            memcpy(wide + 4 * i, light->texel + 3 * i, 12);
        bool good = reduce(wide, n, BASE, base);
        prt_free(wide);
        return good;
    }
    for (uint32_t i = 0; i < 6 * BASE * BASE; i++) {
        uint32_t face = i / (BASE * BASE), y = i / BASE % BASE * n / BASE,
                 x = i % BASE * n / BASE;
        memcpy(base + 4 * i, light->texel + (((size_t)face * n + y) * n + x) * 3, 12);
        base[4 * i + 3] = 0;
    }
    return true;
}

struct apply_job {
    struct prt_specular *out;
    const float *input[N_LEVEL];
};

typedef float v4 __attribute__((vector_size(16), aligned(16)));

// Rows of all levels in one range, from level 1 on.
static int apply_rows(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct apply_job *job = arg;
    for (size_t at = begin; at < end; at++) {
        unsigned level = 1;
        size_t row = at;
        while (row >= (size_t)6 * level_shape[level].n * level_shape[level].n) {
            row -= (size_t)6 * level_shape[level].n * level_shape[level].n;
            level++;
        }
        const struct filter *f = &filter[level];
        const float *in = job->input[level];
        uint32_t n = level_shape[level].n, i = f->begin[row], last = f->begin[row + 1];
        v4 part[4] = {{0, 0, 0, 0}}, sum; // four sums: one waits for its own last addition
        for (; i + 4 <= last; i += 4)
            for (uint32_t k = 0; k < 4; k++)
                part[k] += f->weight[i + k] * *(const v4 *)(in + 4 * f->index[i + k]);
        for (; i < last; i++) part[0] += f->weight[i] * *(const v4 *)(in + 4 * f->index[i]);
        sum = (part[0] + part[1]) + (part[2] + part[3]);
        uint32_t face = (uint32_t)(row / (n * n)), y = (uint32_t)(row / n % n);
        memcpy(border_texel(&job->out->level[level], face, (uint32_t)(row % n), y), &sum, 16);
    }
    return PRT_OK;
}

static void copy_level(struct border_cube *level, const float *texel)
{
    for (uint32_t i = 0; i < 6 * level->n * level->n; i++) {
        uint32_t n = level->n;
        memcpy(border_texel(level, i / (n * n), i % n, i / n % n), texel + 4 * i, 16);
    }
}

int prt_specular_create(const struct prt_context *ctx, const struct prt_cube *light,
                        struct prt_specular **out)
{
    int status = make_filters(ctx);
    struct prt_specular *s = prt_calloc(1, sizeof *s);
    float *base = prt_alloc(6 * BASE * BASE, 16), *half = prt_alloc(6 * 16 * 16, 16);
    float *quarter = prt_alloc(6 * 8 * 8, 16);
    if (!status && !(s && base && half && quarter)) status = PRT_NOMEM;
    size_t rows = 0;
    for (unsigned k = 0; !status && k < N_LEVEL; k++) {
        if (!prt_border_cube_init(&s->level[k], level_shape[k].n)) status = PRT_NOMEM;
        if (k) rows += (size_t)6 * level_shape[k].n * level_shape[k].n;
    }
    if (!status &&
        !(to_base(light, base) && reduce(base, BASE, 16, half) && reduce(half, 16, 8, quarter)))
        status = PRT_NOMEM;
    if (!status) {
        copy_level(&s->level[0], base);
        struct apply_job job = {.out = s};
        for (unsigned k = 1; k < N_LEVEL; k++) {
            uint32_t from = level_shape[k].from;
            job.input[k] = from == 32 ? base : from == 16 ? half : quarter;
        }
        status = prt_parallel_for(ctx, NULL, rows, 64, apply_rows, &job);
        for (unsigned k = 0; k < N_LEVEL; k++) prt_border_cube_seal(&s->level[k]);
        if (!status && !prt_specular_stack(s)) status = PRT_NOMEM;
    }
    prt_free(base);
    prt_free(half);
    prt_free(quarter);
    if (status) {
        prt_specular_destroy(s);
        return prt_fail(ctx, status, "specular: no memory for the filtered environment");
    }
    *out = s;
    return PRT_OK;
}

size_t prt_specular_bytes(void)
{
    size_t n = sizeof(struct prt_specular) +
               (size_t)SPECULAR_LEVELS * SPECULAR_LEVEL_FLOATS * sizeof(float);
    for (unsigned k = 0; k < N_LEVEL; k++)
        n += (size_t)6 * (level_shape[k].n + 2) * (level_shape[k].n + 2) * 4 * sizeof(float);
    return n;
}

void prt_specular_destroy(struct prt_specular *s)
{
    for (unsigned k = 0; s && k < N_LEVEL; k++) prt_border_cube_finish(&s->level[k]);
    if (s) prt_border_cube_finish(&s->stack);
    prt_free(s);
}

void prt_specular_eval(const struct prt_specular *s, const float r[3], float roughness,
                       float rgb[3])
{
    float share, other[3];
    unsigned k = specular_level(roughness, &share);
    prt_border_cube_sample(&s->level[k], r, rgb);
    prt_border_cube_sample(&s->level[k + 1], r, other);
    for (int c = 0; c < 3; c++) rgb[c] += share * (other[c] - rgb[c]);
}
