// SPDX-License-Identifier: MIT
// Maps over a mesh's uv: factors of the medium's coefficients at a pixel, and normals that
// irradiance is computed with (textures and bumps as in M03).
#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

int prt_map_check(const struct prt_context *ctx, const struct prt_mesh *mesh,
                  const struct prt_screen_map *map, bool factor, bool checked)
{
    if (!mesh->uv)
        return prt_fail(ctx, PRT_ARG,
                        "screen: maps need texture coordinates, and the model has none");
    if (!map->rgb || !map->width || !map->height || map->width > 16384 || map->height > 16384)
        return prt_fail(ctx, PRT_ARG,
                        "screen: a map of %ux%u texels: 1 to 16384 a side are allowed",
                        map->width, map->height);
    for (size_t i = 0; !checked && i < (size_t)map->width * map->height; i++)
        for (int c = 0; c < 3; c++)
            if (!isfinite(map->rgb[i][c]) || (factor && map->rgb[i][c] < 0))
                return prt_fail(ctx, PRT_ARG, "screen: texel %zu of a map is not finite%s", i,
                                factor ? " and >= 0" : "");
    return PRT_OK;
}

static uint32_t wrap(int64_t i, uint32_t n)
{
    int64_t r = i % (int64_t)n;
    return (uint32_t)(r < 0 ? r + n : r);
}

void prt_map_lookup(const struct prt_screen_map *map, const float uv[2], float rgb[3])
{
    double x = ((double)uv[0] - floor((double)uv[0])) * map->width - 0.5;
    double y = ((double)uv[1] - floor((double)uv[1])) * map->height - 0.5;
    double x0 = floor(x), y0 = floor(y);
    float fx = (float)(x - x0), fy = (float)(y - y0);
    for (int c = 0; c < 3; c++) rgb[c] = 0;
    for (int k = 0; k < 4; k++) {
        uint32_t i = wrap((int64_t)x0 + (k & 1), map->width);
        uint32_t j = wrap((int64_t)y0 + (k >> 1), map->height);
        float w = (k & 1 ? fx : 1 - fx) * (k >> 1 ? fy : 1 - fy);
        for (int c = 0; c < 3; c++) rgb[c] += w * map->rgb[(size_t)j * map->width + i][c];
    }
}

static void uv_at(const struct prt_mesh *mesh, uint32_t triangle, float a, float b, float uv[2])
{
    prt_mesh_uv(mesh, triangle, 0, a, b, uv);
    for (int k = 0; k < 2; k++)
        if (!isfinite(uv[k])) uv[k] = 0;
}

// The map of a block's surface; NULL: none.
static const struct prt_screen_map *map_of(const struct frame *f,
                                           const struct prt_screen_map *map, uint32_t block)
{
    if (!map || !f->options->maps_by_surface) return map;
    map += f->screen->mesh->block[block].surface;
    return map->rgb ? map : NULL;
}

// Factors of sigma_s' and sigma_a at a point of the G-buffer.
void prt_map_point_factor(const struct frame *f, uint32_t i, float factor[6])
{
    const struct prt_screen_map *s = map_of(f, f->options->sigma_s_map, f->g.block[i]);
    const struct prt_screen_map *a = map_of(f, f->options->sigma_a_map, f->g.block[i]);
    float uv[2];
    for (int k = 0; k < 6; k++) factor[k] = 1;
    uv_at(f->screen->mesh, f->g.triangle[i], f->g.bary[0][i], f->g.bary[1][i], uv);
    if (s) prt_map_lookup(s, uv, factor);
    if (a) prt_map_lookup(a, uv, factor + 3);
}

// Derivatives of position by u and v [mm] on a triangle; false where its uv have no area.
static bool uv_frame(const struct prt_mesh *m, uint32_t triangle, float du[3], float dv[3])
{
    const uint32_t *c = m->triangle[triangle];
    float s[2][2], e[2][3], uv[3][2];
    prt_mesh_corner_uv(m, triangle, 0, uv);
    for (int j = 0; j < 2; j++) {
        for (int k = 0; k < 2; k++) s[j][k] = uv[j + 1][k] - uv[0][k];
        for (int k = 0; k < 3; k++) e[j][k] = m->position[c[j + 1]][k] - m->position[c[0]][k];
    }
    float det = s[0][0] * s[1][1] - s[0][1] * s[1][0];
    if (!(fabsf(det) > 1e-20f) || !isfinite(det)) return false;
    for (int k = 0; k < 3; k++) {
        du[k] = (s[1][1] * e[0][k] - s[0][1] * e[1][k]) / det;
        dv[k] = (s[0][0] * e[1][k] - s[1][0] * e[0][k]) / det;
    }
    return true;
}

static void cross(const float a[3], const float b[3], float out[3])
{
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        out[k] = a[i] * b[j] - a[j] * b[i];
    }
}

static float dot(const float a[3], const float b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static bool normalise(float n[3])
{
    float l = dot(n, n);
    if (!(l > 1e-20f) || !isfinite(l)) return false;
    for (int k = 0; k < 3; k++) n[k] /= sqrtf(l);
    return true;
}

// Tilts the normal by the gradient of height along the surface (B78).
static void bump(const struct prt_screen_map *map, const float uv[2], const float n[3],
                 const float du[3], const float dv[3], float out[3])
{
    float step[2] = {0.5f / (float)map->width, 0.5f / (float)map->height}, slope[2];
    for (int k = 0; k < 2; k++) {
        float a[2] = {uv[0], uv[1]}, b[2] = {uv[0], uv[1]}, lo[3], hi[3];
        a[k] -= step[k];
        b[k] += step[k];
        prt_map_lookup(map, a, lo);
        prt_map_lookup(map, b, hi);
        slope[k] = (hi[0] - lo[0]) / (2 * step[k]);
    }
    float r1[3], r2[3], own[3];
    cross(dv, n, r1);
    cross(n, du, r2);
    float det = dot(du, r1);
    if (!(fabsf(det) > 1e-20f)) return;
    for (int k = 0; k < 3; k++) own[k] = n[k] - (slope[0] * r1[k] + slope[1] * r2[k]) / det;
    if (normalise(own)) memcpy(out, own, sizeof own);
}

// The normal that a tangent-space map gives; out stays as it is where uv are degenerate.
static void tangent_normal(const struct prt_screen_map *map, const float uv[2],
                           const float n[3], const float du[3], const float dv[3], float out[3])
{
    float rgb[3], t[3], b[3], own[3], along = dot(du, n);
    prt_map_lookup(map, uv, rgb);
    for (int k = 0; k < 3; k++) t[k] = du[k] - along * n[k];
    if (!normalise(t)) return;
    cross(n, t, b);
    if (dot(b, dv) > 0) // green points up the image, against v, as in glTF
        for (int k = 0; k < 3; k++) b[k] = -b[k];
    for (int k = 0; k < 3; k++)
        own[k] = (2 * rgb[0] - 1) * t[k] + (2 * rgb[1] - 1) * b[k] + (2 * rgb[2] - 1) * n[k];
    if (normalise(own)) memcpy(out, own, sizeof own);
}

struct turn_job {
    const struct frame *f;
    const struct samples *s;
    float *out[3];
};

// The look of the mesh at a sample, filtered over the sample's own area.
static void look_at(const struct frame *f, const struct samples *s, size_t i,
                    struct prt_look *out)
{
    const struct prt_mesh *mesh = f->screen->mesh;
    const uint32_t t = s->triangle[i];
    float side = s->area[i] > 0 ? sqrtf(s->area[i]) : 0, d[2][2], step[2][3], n[3], length = 0;
    for (int k = 0; k < 3; k++) {
        n[k] = s->normal[k][i];
        step[0][k] =
            mesh->position[mesh->triangle[t][1]][k] - mesh->position[mesh->triangle[t][0]][k];
        length += step[0][k] * step[0][k];
    }
    for (int k = 0; k < 3; k++) step[0][k] *= length > 0 ? side / sqrtf(length) : 0;
    cross(n, step[0], step[1]);
    for (int j = 0; j < 2; j++) prt_mesh_footprint(mesh, t, step[j], d[j]);
    const float da[2] = {d[0][0], d[1][0]}, db[2] = {d[0][1], d[1][1]};
    prt_mesh_look(mesh, t, f->screen->triangle_block[t], s->bary[0][i], s->bary[1][i], da, db,
                  n, out);
}

static int occlude_samples(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct turn_job *job = arg;
    const struct samples *s = job->s;
    for (size_t i = begin; i < end; i++) {
        struct prt_look look;
        look_at(job->f, s, i, &look);
        const uint32_t block = job->f->screen->triangle_block[s->triangle[i]];
        float k = look.occlusion;
        // an albedo map is there instead of the file's base colour
        if (!map_of(job->f, job->f->options->sigma_a_map, block))
            k *= prt_mesh_tint(job->f->screen->mesh, look.base);
        for (int c = 0; c < 3; c++) s->e[c][i] *= k;
    }
    return PRT_OK;
}

bool prt_map_occludes(const struct frame *f)
{
    const struct prt_mesh *mesh = f->screen->mesh;
    bool any = mesh->texture_split > 0;
    for (uint32_t i = 0; mesh->maps && i < mesh->n_surface; i++)
        any |= mesh->maps[i].map[PRT_MAP_OCCLUSION].image != UINT32_MAX;
    return any && prt_mesh_has_look(mesh);
}

int prt_map_occlude(const struct frame *f, struct samples *s)
{
    if (!prt_map_occludes(f)) return PRT_OK;
    struct turn_job job = {.f = f, .s = s};
    return prt_parallel_for(f->ctx, NULL, s->n, 1024, occlude_samples, &job);
}

static int turn_points(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct turn_job *job = arg;
    const struct prt_mesh *mesh = job->f->screen->mesh;
    const struct samples *s = job->s;
    for (size_t i = begin; i < end; i++) {
        uint32_t t = s->triangle[i], block = job->f->screen->triangle_block[t];
        const struct prt_screen_map *turn = map_of(job->f, job->f->options->normal_map, block);
        const struct prt_screen_map *height = map_of(job->f, job->f->options->bump_map, block);
        float uv[2], du[3], dv[3], n[3], out[3];
        for (int k = 0; k < 3; k++) out[k] = n[k] = s->normal[k][i];
        if (!turn && !height && mesh->maps) { // which either replaces
            struct prt_look look;
            look_at(job->f, s, i, &look);
            memcpy(n, look.normal, sizeof n);
            memcpy(out, n, sizeof out);
        }
        if ((turn || height) && uv_frame(mesh, t, du, dv)) {
            uv_at(mesh, t, s->bary[0][i], s->bary[1][i], uv);
            if (turn) tangent_normal(turn, uv, n, du, dv, out);
            memcpy(n, out, sizeof n);
            if (height) bump(height, uv, n, du, dv, out);
        }
        for (int k = 0; k < 3; k++) job->out[k][i] = out[k];
    }
    return PRT_OK;
}

int prt_map_normals(const struct frame *f, struct samples *s)
{
    struct turn_job job = {.f = f, .s = s};
    int status = PRT_OK;
    for (int k = 0; k < 3; k++)
        if (!(job.out[k] = prt_alloc((size_t)s->n + 16, sizeof(float))))
            status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for a map's normals");
    if (!status) status = prt_parallel_for(f->ctx, NULL, s->n, 1024, turn_points, &job);
    for (int k = 0; k < 3; k++) {
        if (status) prt_free(job.out[k]);
        else s->normal[k] = job.out[k];
    }
    return status;
}

int prt_screen_albedo_factors(const struct prt_context *ctx,
                              const struct prt_material *material, size_t n,
                              const float (*albedo)[3], float (*factor)[3])
{
    enum { STEPS = 512 };
    int status = prt_material_check(ctx, material);
    if (status) return status;
    for (int c = 0; c < 3; c++) {
        double base = (double)material->sigma_a[c], rho[STEPS];
        if (!(base > 0))
            return prt_fail(ctx, PRT_ARG,
                            "albedo map: a medium that absorbs nothing (sigma_a 0) "
                            "cannot be tinted by absorption");
        // rho_d decreases with absorption: tabulated at equal steps of log sigma_a up to 1000
        // mm^-1, then inverted by bisection
        double top = fmax(log(1000 / base), 0.1);
        for (int k = 0; k < STEPS; k++) {
            struct prt_diffusion d;
            prt_diffusion_init(&d, (double)material->sigma_s_prime[c],
                               base * exp(top * k / (STEPS - 1)), (double)material->eta);
            rho[k] = d.rho_d;
        }
        for (size_t i = 0; i < n; i++) {
            float x = albedo[i][c];
            double want = rho[0] * (isfinite(x) ? fmin(fmax((double)x, 0), 1) : 0);
            int lo = 0, hi = STEPS - 1;
            while (hi - lo > 1) {
                int mid = lo + (hi - lo) / 2;
                if (rho[mid] >= want) lo = mid;
                else hi = mid;
            }
            double at = rho[lo] > rho[hi] ? (rho[lo] - want) / (rho[lo] - rho[hi]) : 0;
            at = (lo + fmin(fmax(at, 0), 1)) / (STEPS - 1);
            factor[i][c] = (float)exp(top * at);
        }
    }
    return PRT_OK;
}

// A code of the six factors rounded to 1/per_octave of an octave; factors under 1e-4 share one.
static uint64_t step_of(const float scale[6], float per_octave)
{
    uint64_t code = 0;
    for (int k = 0; k < 6; k++) {
        float l = scale[k] > 1e-4f ? log2f(scale[k]) : -13.3f;
        code = code * 1021 + (uint64_t)(int64_t)lrintf((l + 14) * per_octave);
    }
    return code;
}

void prt_map_medium(const struct prt_diffusion *base, const float factor[6], int c,
                    struct prt_diffusion *out)
{
    double s = base->sigma_s_prime * (double)factor[c],
           a = base->sigma_a * (double)factor[3 + c];
    if (base->n_point) *out = *base;
    else prt_diffusion_init(out, fmin(fmax(s, 1e-5), 1000), fmin(a, 1000), base->eta);
}

double prt_map_reflectance(const struct prt_diffusion *base, const float factor[6], int c)
{
    static const float one[6] = {1, 1, 1, 1, 1, 1};
    struct prt_diffusion plain = *base, own, whole;
    plain.n_point = 0;
    prt_map_medium(&plain, factor, c, &own);
    if (!base->n_point) return own.rho_d;
    prt_map_medium(&plain, one, c, &whole);
    return base->rho_d * own.rho_d / fmax(whole.rho_d, 1e-12);
}

struct rho_job {
    const struct frame *f;
    const float (*scale)[6];
    float (*rho)[3];
};

// The total reflectance of every point's own coefficients: light of its class of media is
// scaled by it.
static int point_reflectance(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct rho_job *job = arg;
    const struct frame *f = job->f;
    for (size_t i = begin; i < end; i++) {
        uint32_t object = f->screen->mesh->block[f->g.block[i]].object;
        for (int c = 0; c < 3; c++)
            job->rho[i][c] =
                (float)prt_map_reflectance(&f->dipole[object][c], job->scale[i], c);
    }
    return PRT_OK;
}

static int tint_points(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct frame *f = arg;
    for (size_t i = begin; i < end; i++) {
        uint32_t object = f->screen->mesh->block[f->g.block[i]].object;
        float factor[6];
        if (f->g.opaque[i]) continue;
        prt_map_point_factor(f, (uint32_t)i, factor);
        for (int c = 0; c < 3; c++) {
            const struct prt_diffusion *d = &f->dipole[object][c];
            f->radiance[i][c] *=
                (float)(prt_map_reflectance(d, factor, c) / fmax(d->rho_d, 1e-12));
        }
    }
    return PRT_OK;
}

int prt_map_tint(const struct frame *f)
{
    struct frame own = *f;
    return prt_parallel_for(f->ctx, NULL, f->g.n_point, 1024, tint_points, &own);
}

// Means of the factors of each class: six sums and a count.
typedef double class_sum[7];

// Sorts the points into classes of equal codes. False where there are more than MOST_MEDIA of
// them; with `merge` the last class takes the rest.
static bool sort_media(const struct frame *f, const float (*scale)[6], float per_octave,
                       bool merge, struct media *out, class_sum *sum)
{
    uint64_t code[MOST_MEDIA];
    out->n = 0;
    memset(sum, 0, MOST_MEDIA * sizeof *sum);
    for (uint32_t i = 0; i < f->g.n_point; i++) {
        uint32_t object = f->screen->mesh->block[f->g.block[i]].object, k = 0;
        uint64_t own = step_of(scale[i], per_octave) * 8191 + object;
        out->of[i] = 0;
        if (f->g.opaque[i]) continue;
        while (k < out->n && code[k] != own) k++;
        if (k == MOST_MEDIA && !merge) return false;
        if (k == out->n) {
            if (k == MOST_MEDIA) k--;
            else out->n++;
            code[k] = own;
            out->object[k] = object;
        }
        for (int c = 0; c < 6; c++) sum[k][c] += (double)scale[i][c];
        sum[k][6]++;
        out->of[i] = (uint8_t)k;
    }
    return true;
}

int prt_map_media(const struct frame *f, struct media *out)
{
    uint32_t n = f->g.n_point;
    float(*scale)[6] = malloc(((size_t)n + 1) * sizeof *scale);
    class_sum *sum = malloc(MOST_MEDIA * sizeof *sum);
    memset(out, 0, sizeof *out);
    out->of = malloc(((size_t)n + 1) * sizeof *out->of);
    out->factor = malloc(MOST_MEDIA * sizeof *out->factor);
    out->object = malloc(MOST_MEDIA * sizeof *out->object);
    out->rho = malloc(((size_t)n + 1) * sizeof *out->rho);
    bool good = out->rho && scale && sum && out->of && out->factor && out->object;
    if (good) {
        for (uint32_t i = 0; i < n; i++) prt_map_point_factor(f, i, scale[i]);
        // steps of 1/8 octave, doubled until the classes are few enough
        float per_octave = 8;
        while (
            !sort_media(f, (const float(*)[6])scale, per_octave, per_octave < 0.01f, out, sum))
            per_octave *= 0.5f;
        for (uint32_t k = 0; k < out->n; k++)
            for (int c = 0; c < 6; c++) out->factor[k][c] = (float)(sum[k][c] / sum[k][6]);
        struct rho_job job = {f, (const float(*)[6])scale, out->rho};
        good = prt_parallel_for(f->ctx, NULL, n, 1024, point_reflectance, &job) == PRT_OK;
    }
    free(scale);
    free(sum);
    if (good) return PRT_OK;
    prt_media_finish(out);
    return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for maps");
}

void prt_media_finish(struct media *m)
{
    free(m->of);
    free(m->factor);
    free(m->object);
    free(m->rho);
    memset(m, 0, sizeof *m);
}
