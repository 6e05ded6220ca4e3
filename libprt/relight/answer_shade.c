// SPDX-License-Identifier: MIT
// Makes colours of the planes of answers: multiplies the outgoing directions in
// (W05 section 5, eq 10; METHODS §1, exit).
#include "answer_parts.h"
#include "kernels.h"

#include <math.h>

enum { SINK_GRAIN = 512 }; // vertices of a sink's block: 6 kB of colours

struct shade_job {
    const struct answer *a;
    // of each medium: the divisor of the exit, and outgoing transmittance without an eye over
    // it
    double divisor[PRT_MEDIA_MAX];
    float mean[PRT_MEDIA_MAX];
};

// w_o': the view direction refracted into the medium (Snell). Returns the cosine of w.
static float refract_out(double eta, const float n[3], const float w[3], float out[3])
{
    float cosine = n[0] * w[0] + n[1] * w[1] + n[2] * w[2];
    float inverse = (float)(1 / eta), c = cosine > 0 ? cosine : 0;
    float inside = sqrtf(fmaxf(0, 1 - inverse * inverse * (1 - c * c)));
    for (int i = 0; i < 3; i++) out[i] = w[i] * inverse + (inside - c * inverse) * n[i];
    return cosine;
}

static void view_of(const struct answer *a, size_t v, float w[3])
{
    const float *p = a->transport->mesh.position[v];
    float d[3] = {a->query->eye[0] - p[0], a->query->eye[1] - p[1], a->query->eye[2] - p[2]};
    float length = sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    for (int i = 0; i < 3; i++)
        w[i] = length > 0 ? d[i] / length : a->transport->mesh.normal[v][i];
}

static void shade_vertex(const struct shade_job *job, size_t v, uint32_t medium, float out[3])
{
    const struct answer *a = job->a;
    const double eta = (double)a->media->medium[medium].eta;
    const size_t size = 3 * a->n_vertex;
    const float *plane = a->planes + 3 * v;
    // adds the planes that depend on the view
    float w[3], inside[3], y[MOST_PHASES], rgb[3] = {plane[0], plane[1], plane[2]};
    unsigned n_band = a->n_plane > 9 ? 4 : a->n_plane > 4 ? 3 : a->n_plane > 1 ? 2 : 1;
    view_of(a, v, w);
    float cosine = refract_out(eta, a->transport->mesh.normal[v], w, inside);
    prt_sh_eval(n_band, inside, y);
    for (unsigned k = 1; k < a->n_plane; k++)
        for (int ch = 0; ch < 3; ch++) rgb[ch] += y[k] * plane[k * size + (size_t)ch];
    double transmittance =
        cosine > 0 ? prt_fresnel_transmittance(eta, (double)cosine) / job->divisor[medium] : 0;
    if (a->query->term != PRT_ANSWER_TOTAL && cosine > 0) transmittance = 1;
    for (int ch = 0; ch < 3; ch++) out[ch] = fmaxf(0, rgb[ch] * (float)transmittance);
}

// Shades vertices [begin_v, end) of one block. Without an eye only plane 0 (l = 0) is used.
// out[0] is vertex begin_v's colour; it may be its plane 0. gain: factors of an opaque block's
// channels; NULL: 1.
static void shade_block(const struct shade_job *job, size_t begin_v, size_t end,
                        uint32_t object, bool translucent, const float *gain, float (*out)[3])
{
    const struct answer *a = job->a;
    const bool total = a->query->term == PRT_ANSWER_TOTAL;
    const float *plane = a->planes + 3 * begin_v;
    float *color = out[0];
    const bool seen = total || a->query->term == PRT_ANSWER_SINGLE;
    if (a->query->eye && translucent && seen) {
        const uint32_t medium = prt_media_index(a->media, object);
        for (size_t v = begin_v; v < end; v++) shade_vertex(job, v, medium, out[v - begin_v]);
        return;
    }
    const float transmittance =
        translucent && total ? job->mean[prt_media_index(a->media, object)] : 1;
    const size_t n = 3 * (end - begin_v);
    for (size_t i = 0; i < n; i++) {
        const float x = plane[i] * transmittance;
        color[i] = x > 0 ? x : 0;
    }
    for (size_t i = 0; gain && !translucent && i < n; i++) color[i] *= gain[i % 3];
}

// Shades vertices [begin_v, end) to out[0] and on. Blocks partition the vertices in order.
static void shade_vertices(const struct shade_job *job, size_t begin_v, size_t end,
                           float (*out)[3])
{
    const struct prt_mesh *mesh = &job->a->transport->mesh;
    const float(*gain)[3] = job->a->query->gain;
    for (uint32_t i = 0; i < mesh->n_block; i++) {
        const struct prt_block *b = &mesh->block[i];
        const size_t from = b->vertex_begin > begin_v ? b->vertex_begin : begin_v;
        const size_t stop = b->vertex_begin + (size_t)b->n_vertex;
        if (from < end && from < stop)
            shade_block(job, from, stop < end ? stop : end, b->object,
                        mesh->surface[b->surface].translucent, gain ? gain[i] : NULL,
                        out + (from - begin_v));
    }
}

static void shade_job_init(struct shade_job *job, const struct answer *a)
{
    job->a = a;
    for (uint32_t i = 0; i < a->media->n; i++) {
        const double eta = (double)a->media->medium[i].eta;
        job->divisor[i] = prt_exit_divisor(eta, a->query->exit);
        job->mean[i] = (float)(prt_fresnel_mean_transmittance(eta) / job->divisor[i]);
    }
}

// The colours of several answers; pieces of all of them are one loop.
struct shade_many {
    struct shade_job job[PRT_RELIGHT_MAX_LIGHTS];
    unsigned of[PRT_RELIGHT_MAX_LIGHTS]; // the query of each job
    float (*out[PRT_RELIGHT_MAX_LIGHTS])[3];
    size_t n_piece; // of one answer
    const struct prt_colors_sink *sink;
};

// Colours of a piece go to the sink block by block: they stay in the L1 cache, and the planes
// behind them are not written.
static void put_pieces(const struct shade_many *many, size_t k, size_t begin, size_t end)
{
    float color[SINK_GRAIN][3];
    const struct shade_job *job = &many->job[k];
    for (size_t v = begin, next; v < end; v = next) {
        next = v + SINK_GRAIN < end ? v + SINK_GRAIN : end;
        shade_vertices(job, v, next, color);
        many->sink->put(many->sink->user, job->a->ctx, many->of[k], v, next,
                        (const float(*)[3])color);
    }
}

static int shade_pieces(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct shade_many *many = arg;
    for (size_t i = begin; i < end; i++) {
        const size_t k = i / many->n_piece, n_vertex = many->job[k].a->n_vertex;
        const size_t from = i % many->n_piece * VERTEX_GRAIN;
        const size_t stop = from + VERTEX_GRAIN < n_vertex ? from + VERTEX_GRAIN : n_vertex;
        if (many->sink && many->sink->takes[many->of[k]]) put_pieces(many, k, from, stop);
        else shade_vertices(&many->job[k], from, stop, many->out[k] + from);
    }
    return PRT_OK;
}

// Colours of the n answers that have no planes[i]; planes NULL: of all.
int prt_answers_shade(const struct answer *a, unsigned n, const bool planes[],
                      float *const out[], const struct prt_colors_sink *sink)
{
    struct shade_many many = {.n_piece = (a->n_vertex + VERTEX_GRAIN - 1) / VERTEX_GRAIN,
                              .sink = sink};
    unsigned m = 0;
    for (unsigned i = 0; i < n; i++) {
        if (planes && planes[i]) continue;
        shade_job_init(&many.job[m], &a[i]);
        many.out[m] = (float(*)[3])out[i];
        many.of[m++] = i;
    }
    return prt_parallel_for(a->ctx, NULL, m * many.n_piece, 1, shade_pieces, &many);
}
