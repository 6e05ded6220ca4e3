// SPDX-License-Identifier: MIT
// The near-field control variate of texture sampling (METHODS §6): surface closer than the
// spacing of the drawn points is read from the picture, and the points stand for the rest. The
// near part is a pixel's own irradiance, plus the R_d-weighted difference of the irradiance
// about it.
#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// Up to this many lights irradiance is traced at every point, above at receivers only: rays
// grow with points times lights. Chosen, not measured.
enum { OWN_LIGHTS = 4 };
// Below this cosine a grazing pixel's area is bounded; chosen, not measured.
#define LEAST_COSINE 0.15f

// The picture's surface as emitters, one a receiver.
struct near {
    const struct view_cache *view;
    const double *own_mm;
    double (*share)[3]; // [n_object] prt_near_share
    float *e[3], *area; // [n_column]
    float *weight[3];   // [n_column] near part of R_d over the surface about a receiver
};

static void near_finish(struct near *n)
{
    free(n->share);
    free(n->area);
    for (int c = 0; c < 3; c++) {
        free(n->e[c]);
        free(n->weight[c]);
    }
}

static bool near_init(struct near *n, const struct frame *f, const double *own_mm)
{
    size_t columns = (size_t)f->view->n_column + 1;
    *n = (struct near){.view = f->view, .own_mm = own_mm};
    n->share = calloc((size_t)f->n_object + 1, sizeof *n->share);
    n->area = calloc(columns, sizeof *n->area);
    bool good = n->share && n->area;
    for (int c = 0; c < 3; c++) {
        n->e[c] = calloc(columns, sizeof **n->e);
        n->weight[c] = calloc(columns, sizeof **n->weight);
        good = good && n->e[c] && n->weight[c];
    }
    for (uint32_t o = 0; good && o < f->n_object; o++)
        if (own_mm[o] > 0) prt_near_share(f, o, own_mm[o], n->share[o]);
    return good;
}

// Adds every point's area to the receivers that it interpolates; with points not NULL also its
// irradiance, so that receivers hold means, else e stays as it is.
static void spread_points(struct near *n, const struct frame *f, const struct samples *points)
{
    const struct view_cache *v = n->view;
    float eye[3], forward[3], right[3], up[3], tan_x = 0, tan_y = 0;
    prt_visibility_frame(f->vis, eye, forward, right, up);
    for (int k = 0; k < 3; k++) {
        tan_x += right[k] * right[k];
        tan_y += up[k] * up[k];
    }
    float pixel = 4 * sqrtf(tan_x * tan_y) / ((float)f->width * (float)f->height);
    for (uint32_t i = 0; i < f->g.n_point; i++) {
        if (f->g.opaque[i]) continue;
        float z = 0, d2 = 0, along = 0;
        for (int k = 0; k < 3; k++) {
            float d = f->g.position[k][i] - eye[k];
            z += d * forward[k];
            d2 += d * d;
            along += d * f->g.normal[k][i];
        }
        // a pixel's solid angle times d^2 / cos, with z = d cos(view)
        float cosine = max_f(fabsf(along), LEAST_COSINE * sqrtf(d2));
        float area = f->g.weight[i] * pixel * z * z * z / max_f(cosine, 1e-20f);
        for (int k = 0; k < 4; k++) {
            float a = area * v->weight[i][k];
            uint32_t to = v->from[i][k];
            if (!(a > 0) || !isfinite(a)) continue;
            n->area[to] += a;
            for (int c = 0; points && c < 3; c++) n->e[c][to] += a * points->e[c][i];
        }
    }
    for (uint32_t i = 0; points && i < v->n_column; i++)
        for (int c = 0; c < 3 && n->area[i] > 0; c++) n->e[c][i] /= n->area[i];
}

// Receivers with area as samples, object by object in the order of tiles, with their irradiance
// or, with `one`, with 1.
static bool gather_samples(const struct near *n, const struct frame *f, bool one,
                           struct samples *s, double *disc_mm)
{
    const struct view_cache *v = n->view;
    double power = 0, square = 0;
    if (!prt_samples_init(s, v->n_column + 1)) return false;
    for (uint32_t o = 0; o < f->n_object; o++)
        for (uint32_t t = 0; t < v->n_tile; t++) {
            if (v->object[t] != o) continue;
            for (uint32_t i = v->begin[t]; i < v->begin[t + 1]; i++) {
                if (!(n->area[i] > 0)) continue; // padding
                for (int k = 0; k < 3; k++) {
                    s->p[k][s->n] = v->p[k][i];
                    s->e[k][s->n] = one ? 1 : n->e[k][i];
                }
                s->area[s->n] = n->area[i];
                s->object[s->n++] = o;
                power += (double)n->area[i];
                square += (double)n->area[i] * (double)n->area[i];
            }
        }
    *disc_mm = power > 0 ? sqrt(square / power / M_PI) : 0;
    return true;
}

// f->sum = the near part of R_d over the picture's surface times its irradiance, or times 1.
static int sum_near(struct frame *f, const struct near *n, bool one)
{
    struct samples s;
    double disc;
    float reach = 0;
    struct radial_table *table = prt_calloc(f->n_object ? f->n_object : 1, sizeof *table);
    if (!table || !gather_samples(n, f, one, &s, &disc)) {
        prt_free(table);
        return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for the near part");
    }
    for (uint32_t o = 0; o < f->n_object; o++) {
        if (!(n->own_mm[o] > 0)) continue;
        // exp(-(r / own)^2) is 0.2 % there
        reach = max_f(reach, 2.5f * (float)n->own_mm[o]);
        prt_split_table(f, o, -1, n->own_mm[o], true, disc, f->screen->diameter_mm, &table[o]);
    }
    for (int c = 0; c < 3; c++)
        memset(f->sum[c], 0, ((size_t)f->view->n_column + 16) * sizeof(float));
    int status = s.n ? prt_scatter_tree(f, table, &s, 0.7f, reach) : PRT_OK;
    prt_samples_finish(&s);
    prt_free(table);
    return status;
}

// f->sum = R_d-weighted irradiance about each receiver, weight = the sum of its weights. Both
// are scaled down where the weight exceeds that of a plane: areas of curved or grazing surface
// are overestimates.
static int sum_about(struct frame *f, struct near *n)
{
    const struct view_cache *v = n->view;
    int status = sum_near(f, n, true);
    for (int c = 0; c < 3 && !status; c++)
        memcpy(n->weight[c], f->sum[c], v->n_column * sizeof(float));
    if (!status) status = sum_near(f, n, false);
    for (uint32_t t = 0; t < v->n_tile && !status; t++)
        for (uint32_t i = v->begin[t]; i < v->begin[t + 1]; i++)
            for (int c = 0; c < 3; c++) {
                float share = (float)n->share[v->object[t]][c], w = n->weight[c][i];
                if (!(w > share)) continue;
                f->sum[c][i] *= share / w;
                n->weight[c][i] = share;
            }
    return status;
}

// The near part with irradiance known at every point of the G-buffer.
static int own_points(struct frame *f, struct near *n, const struct samples *points)
{
    const struct view_cache *v = n->view;
    spread_points(n, f, points);
    int status = sum_about(f, n);
    for (uint32_t i = 0; i < f->g.n_point && !status; i++) {
        if (f->g.opaque[i]) continue;
        const double *share = n->share[points->object[i]];
        for (int c = 0; c < 3; c++) {
            float about = 0, weight = 0;
            for (int k = 0; k < 4; k++) {
                about += v->weight[i][k] * f->sum[c][v->from[i][k]];
                weight += v->weight[i][k] * n->weight[c][v->from[i][k]];
            }
            float b = about + points->e[c][i] * ((float)share[c] - weight);
            f->radiance[i][c] += max_f(b, 0) * (float)(1 / M_PI);
        }
    }
    prt_receivers_finish(f);
    return status;
}

// The near part with irradiance known at receivers.
static int own_receivers(struct frame *f, struct near *n, const struct samples *s)
{
    const struct view_cache *v = n->view;
    for (int c = 0; c < 3; c++) memcpy(n->e[c], s->e[c], v->n_column * sizeof(float));
    spread_points(n, f, NULL);
    int status = sum_about(f, n);
    for (uint32_t i = 0; i < v->n_column && !status; i++)
        for (int c = 0; c < 3; c++) {
            float share = (float)n->share[s->object[i]][c];
            f->sum[c][i] = max_f(f->sum[c][i] + s->e[c][i] * (share - n->weight[c][i]), 0);
        }
    return status ? status : prt_receivers_resolve(f);
}

int prt_near_field_add(struct frame *f, const double *own_mm)
{
    bool all = f->n_light <= OWN_LIGHTS || f->options->vertex_irradiance;
    struct samples s = {0};
    struct near near = {0};
    double scale = (double)prt_frame_mean_free_path(f), least = INFINITY;
    for (uint32_t o = 0; o < f->n_object; o++)
        if (own_mm[o] > 0) least = fmin(least, own_mm[o]);
    // the sum about a point varies over own_mm; irradiance varies faster, so that receivers are
    // closer where only they have it
    int status = prt_receivers_begin(f, all && isfinite(least) ? fmax(scale, least) : scale);
    uint32_t n = all || status ? f->g.n_point : f->view->n_column;
    if (!status && (!near_init(&near, f, own_mm) ||
                    !prt_visible_samples(f, n, all ? NULL : f->view->leader, &s)))
        status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for %u points", n);
    if (!status) status = prt_frame_irradiance(f, &s);
    if (!status) status = all ? own_points(f, &near, &s) : own_receivers(f, &near, &s);
    prt_receivers_finish(f);
    prt_samples_finish(&s);
    near_finish(&near);
    return status;
}
