// SPDX-License-Identifier: MIT
// The error of a finished transport against the reference engine, under synthetic lights.
#include "bake/measure.h"

#include "prt/reference.h"
#include "prt/relight.h"
#include "prt/surface.h"

#include <cjson/cJSON.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char *const prt_measure_light_name[MEASURE_LIGHTS] = {"sky", "boxes", "sun"};

struct lamp {
    float dir[3], cosine; // centre and cosine of the half angle
    float rgb[3];
};

static const struct lamp boxes[] = {
    {{0.70f, 0.55f, 0.46f}, 0.975f, {40, 38, 34}},
    {{-0.80f, 0.20f, 0.56f}, 0.98f, {18, 20, 26}},
    {{0.10f, 0.45f, -0.89f}, 0.985f, {60, 50, 44}},
};
static const struct lamp sun[] = {{{-0.66f, 0.33f, 0.67f}, 0.9993f, {26000, 19000, 11000}}};

int prt_measure_light(unsigned which, uint32_t n, struct prt_cube *out)
{
    int status = prt_cube_init(out, n);
    const struct lamp *lamp = which == 1 ? boxes : sun;
    unsigned n_lamp = which == 1 ? 3 : which == 2 ? 1 : 0;
    for (uint32_t i = 0; status == PRT_OK && i < 6 * n * n; i++) {
        float *texel = out->texel + (size_t)i * 3, sum[3] = {0, 0, 0};
        for (int sub = 0; sub < 16; sub++) {
            float dir[3];
            double s = 2 * (i % n + (sub % 4 + 0.5) / 4) / n - 1;
            double t = 2 * (i / n % n + (sub / 4 + 0.5) / 4) / n - 1;
            prt_cube_direction(i / (n * n), s, t, dir);
            float up = 0.5f + 0.5f * dir[1], base = which == 1 ? 0.03f : 0.35f;
            float rgb[3] = {base * (0.25f + 0.6f * up), base * (0.25f + 0.8f * up),
                            base * (0.2f + 1.2f * up)};
            for (unsigned l = 0; l < n_lamp; l++) {
                float c = 0, length = 0;
                for (int k = 0; k < 3; k++) {
                    c += dir[k] * lamp[l].dir[k];
                    length += lamp[l].dir[k] * lamp[l].dir[k];
                }
                if (c > lamp[l].cosine * sqrtf(length))
                    for (int k = 0; k < 3; k++) rgb[k] += lamp[l].rgb[k];
            }
            for (int k = 0; k < 3; k++) sum[k] += rgb[k] / 16;
        }
        memcpy(texel, sum, sizeof sum);
    }
    return status;
}

// Random translucent vertices; the draw does not depend on the bake.
static uint32_t draw_vertices(const struct prt_mesh *mesh, uint32_t n, uint64_t seed,
                              uint32_t *out)
{
    uint32_t *block = prt_mesh_vertex_blocks(mesh), found = 0;
    struct prt_rng rng;
    prt_rng_init(&rng, seed, 0x3ea5);
    for (uint32_t attempt = 0; block && attempt < 20 * n && found < n; attempt++) {
        uint32_t v = prt_rng_u32(&rng) % mesh->n_vertex;
        if (mesh->surface[mesh->block[block[v]].surface].translucent) out[found++] = v;
    }
    prt_free(block);
    return found;
}

// Moves the vertices of objects that are walked to the front; *n_walked gets their number.
// PRT_NOMEM.
static int sort_walked(const struct prt_mesh *mesh, const uint8_t *walked, uint32_t n,
                       uint32_t *vertex, uint32_t *n_walked)
{
    *n_walked = n;
    if (!walked) return PRT_OK;
    uint32_t *block = prt_mesh_vertex_blocks(mesh), *rest = prt_alloc(n + 1u, sizeof *rest);
    uint32_t front = 0, back = 0;
    for (uint32_t i = 0; block && rest && i < n; i++)
        if (walked[mesh->block[block[vertex[i]]].object]) vertex[front++] = vertex[i];
        else rest[back++] = vertex[i];
    if (block && rest) memcpy(vertex + front, rest, back * sizeof *rest);
    const int status = block && rest ? PRT_OK : PRT_NOMEM;
    *n_walked = front;
    prt_free(block);
    prt_free(rest);
    return status;
}

// The bake's own media and, where the material is free, media that are not in the training,
// each for all objects.
enum { MEDIA = 4 };
static const char *const free_media[MEDIA - 1] = {"skin1", "ketchup", "skimmilk"};

struct examination {
    const struct prt_context *ctx;
    const struct prt_transport *transport;
    const struct measure_options *o;
    uint32_t n, *vertex, n_walked; // the first n_walked vertices' references may be by walks
    float (*all)[3], (*got)[3];
    float *divisor; // [n] of the exit at each vertex
    // By medium, then light. Two references of walks differ in their noise alone, so that the
    // mean product of the differences from them holds none of it; one of the dipole is both.
    float (*want[2][MEDIA * MEASURE_LIGHTS])[3];
    unsigned n_medium;
    struct prt_media media[MEDIA];
    struct prt_material *medium[MEDIA]; // of media, but of the first, which are the transport's
    // Largest error over lights, of the term at hand; NAN: none has one.
    double worst[MEDIA];
    // The sum of the terms of the bake's own medium under each light, of the bake and of the
    // references.
    float (*sum_got[MEASURE_LIGHTS])[3], (*sum_want[2][MEASURE_LIGHTS])[3];
    double together[MEASURE_LIGHTS]; // error of the sums
};

static int choose_media(struct examination *e)
{
    const struct prt_transport *t = e->transport;
    int status = PRT_OK;
    e->media[0] = t->media;
    e->n_medium = 1;
    for (unsigned i = 0; t->engine != PRT_TRANSPORT_WAVELET && i < MEDIA - 1 && !status; i++) {
        const bool own = t->media.n == 1 && !strcmp(free_media[i], t->media.medium[0].name);
        struct prt_material *m = own ? NULL : prt_alloc(t->media.n, sizeof *m);
        if (own) continue;
        if (!m) return PRT_NOMEM;
        e->medium[e->n_medium] = m;
        e->media[e->n_medium++] = (struct prt_media){t->media.n, m, t->media.of_object};
        for (uint32_t k = 0; k < t->media.n && !status; k++) {
            status = prt_material_load(e->ctx, free_media[i], &m[k]);
            m[k].eta = t->media.medium[k].eta;
        }
    }
    return status;
}

static void drop_warnings(void *user, enum prt_log_level level, const char *line)
{
    const struct prt_context *ctx = user;
    if (level == PRT_LOG_ERROR) prt_log(ctx, level, "%s", line);
}

// The reference's samples: enough for the densest medium to pass prt_surface_check.
static uint32_t reference_samples(const struct examination *e)
{
    double densest = 0;
    for (unsigned m = 0; m < e->n_medium; m++)
        for (uint32_t c = 0; c < 3 * e->media[m].n; c++) {
            const struct prt_material *own = &e->media[m].medium[c / 3];
            densest =
                fmax(densest, (double)own->sigma_s_prime[c % 3] + (double)own->sigma_a[c % 3]);
        }
    double least_samples = e->o->least_samples;
    double least = prt_surface_area(&e->transport->mesh) * densest * densest / (200.0 * 200.0);
    return (uint32_t)fmin(fmax(least_samples, least), 2e7);
}

// The relative RMSE of `got` from what two references agree on; 0 where their noise hides it,
// and NAN where they are black and `got` is not: no error is relative to nothing.
static double error_from(const float *got, const float *a, const float *b, size_t n)
{
    double error = 0, all = 0;
    for (size_t i = 0; i < n; i++) {
        error += ((double)got[i] - (double)a[i]) * ((double)got[i] - (double)b[i]);
        all += (double)a[i] * (double)b[i];
    }
    if (!(all > 0)) return error > 0 ? NAN : 0;
    return sqrt(fmax(error, 0) / all);
}

// Adds the term at hand of the bake's own medium, in the proportion that a total has, to the
// sums under a light.
static void add_to_sums(struct examination *e, bool single, unsigned light)
{
    const float *got = e->got[0], *want[2] = {e->want[0][light][0], e->want[1][light][0]};
    float *sum = e->sum_got[light][0];
    float *sums[2] = {e->sum_want[0][light][0], e->sum_want[1][light][0]};
    for (size_t i = 0; i < (size_t)e->n * 3; i++) {
        const float gain = single ? e->divisor[i / 3] : 1;
        sum[i] += gain * got[i];
        for (unsigned k = 0; k < 2; k++) sums[k][i] += gain * want[k][i];
    }
    e->together[light] = error_from(sum, sums[0], sums[1], (size_t)e->n * 3);
}

// The bake's answer for medium m under a light, beside the references'.
static int compare(struct examination *e, const struct prt_query *query, unsigned m,
                   unsigned at, double *error)
{
    int status = prt_answer_colors(e->ctx, e->transport, query, e->all);
    for (uint32_t i = 0; status == PRT_OK && i < e->n; i++)
        memcpy(e->got[i], e->all[e->vertex[i]], sizeof e->got[i]);
    if (status) return status;
    *error = error_from(e->got[0], e->want[0][at][0], e->want[1][at][0], (size_t)e->n * 3);
    e->worst[m] = fmax(e->worst[m], *error);
    return PRT_OK;
}

// A reference at the vertices that were drawn, out [n_medium * n_light]: by the options' walks,
// where there are some, of the first n_walked, by the dipole of the others.
static int take_reference(const struct examination *e, const struct prt_context *ctx,
                          unsigned n_light, const struct prt_cube *const light[],
                          const struct prt_reference_options *options, float (*const out[])[3])
{
    const struct prt_mesh *mesh = &e->transport->mesh;
    const bool apart = options->n_walk && e->n_walked < e->n;
    float(*rest[MEDIA * MEASURE_LIGHTS])[3];
    struct prt_reference_options o = *options;
    int status = PRT_OK;
    if (apart) o.n_vertex = e->n_walked;
    if (o.n_vertex)
        status = prt_reference_many(ctx, mesh, e->n_medium, e->media, n_light, light, &o, out);
    if (status || !apart) return status;
    for (unsigned i = 0; i < e->n_medium * n_light; i++) rest[i] = out[i] + e->n_walked;
    o.vertex = options->vertex + e->n_walked;
    o.n_vertex = e->n - e->n_walked;
    o.n_walk = 0;
    return prt_reference_many(ctx, mesh, e->n_medium, e->media, n_light, light, &o, rest);
}

// Every medium under every light, without a view, or towards an eye [mm]; error [n_light]: of
// the bake's own medium. One call of the reference, whose kernels serve all lights.
static int examine(struct examination *e, enum prt_term term, unsigned n_light,
                   const struct prt_cube *const light[], const float *eye, double error[])
{
    static const enum prt_reference_term wanted[] = {
        PRT_REFERENCE_MULTIPLE, PRT_REFERENCE_SINGLE, PRT_REFERENCE_UNSCATTERED};
    static const enum prt_answer_term answered[] = {PRT_ANSWER_MULTIPLE, PRT_ANSWER_SINGLE,
                                                    PRT_ANSWER_UNSCATTERED};
    const bool walks = term != PRT_TERM_SINGLE && e->o->n_walk;
    // A draft has no unscattered light: the noise of one reference of it adds little.
    const bool twice = walks && !(e->o->draft && term == PRT_TERM_UNSCATTERED);
    struct prt_reference_options options = {.term = wanted[term],
                                            .eye = eye,
                                            .vertex = e->vertex,
                                            .n_vertex = e->n,
                                            .n_sample = reference_samples(e),
                                            .n_ray = e->o->draft && walks ? 256 : 512,
                                            .n_single = e->o->draft ? 1024 : 4096,
                                            .n_walk = walks ? e->o->n_walk : 0,
                                            .seed = 99};
    struct prt_context quiet = *e->ctx;
    quiet.progress = NULL;
    quiet.log = drop_warnings, quiet.log_user = (void *)(uintptr_t)e->ctx;
    int status = take_reference(e, &quiet, n_light, light, &options, e->want[0]);
    options.seed = 177;
    if (status == PRT_OK && twice)
        status = take_reference(e, &quiet, n_light, light, &options, e->want[1]);
    for (unsigned i = 0; status == PRT_OK && !twice && i < e->n_medium * n_light; i++)
        memcpy(e->want[1][i], e->want[0][i], (size_t)e->n * sizeof *e->want[1][i]);
    for (unsigned i = 0; status == PRT_OK && i < e->n_medium * n_light; i++) {
        const unsigned m = i / n_light, l = i % n_light;
        struct prt_query query = {.term = answered[term], .light = light[l], .eye = eye};
        if (m) query.media = e->media[m];
        double now;
        status = compare(e, &query, m, i, &now);
        if (status || m) continue;
        error[l] = now;
        if (!eye) add_to_sums(e, term == PRT_TERM_SINGLE, l);
    }
    return status;
}

// An error that there is none of is null: JSON has neither NaN nor infinity, and a reader that
// stops at one loses all errors.
static void add_error(cJSON *to, const char *name, double value)
{
    char text[32] = "null";
    // six decimals: the measurement has no more
    if (isfinite(value)) snprintf(text, sizeof text, "%.6f", value);
    cJSON_AddRawToObject(to, name, text);
}

// At one vertex: five decimals.
static cJSON *error_number(double value)
{
    char text[32];
    snprintf(text, sizeof text, "%.5f", value);
    return cJSON_CreateRaw(text);
}

// "media": the worst light of each free medium; "worst": the largest error of all.
static void add_worst(const struct examination *e, cJSON *to)
{
    double worst = e->worst[0];
    cJSON *media = e->n_medium > 1 ? cJSON_AddObjectToObject(to, "media") : NULL;
    for (unsigned m = 1; m < e->n_medium; m++) {
        add_error(media, e->media[m].medium[0].name, e->worst[m]);
        worst = fmax(worst, e->worst[m]);
    }
    add_error(to, "worst", worst);
}

// One term under every light.
static int measure_term(struct examination *e, enum prt_term term, double at, cJSON *to)
{
    const struct prt_cube *own = e->o->own;
    struct prt_cube made[MEASURE_LIGHTS] = {{0}};
    const struct prt_cube *light[MEASURE_LIGHTS] = {own};
    const unsigned n_light = own ? 1 : MEASURE_LIGHTS;
    double error[MEASURE_LIGHTS] = {0};
    int status = prt_progress(e->ctx, "measuring", at);
    for (unsigned m = 0; m < MEDIA; m++) e->worst[m] = NAN; // fmax() takes the other number
    for (unsigned l = 0; status == PRT_OK && !own && l < n_light; l++) {
        status = prt_measure_light(l, e->transport->cube, &made[l]);
        light[l] = &made[l];
    }
    if (status == PRT_OK && e->n) status = examine(e, term, n_light, light, NULL, error);
    for (unsigned l = 0; l < MEASURE_LIGHTS; l++) prt_cube_finish(&made[l]);
    for (unsigned l = 0; e->n && l < n_light; l++)
        add_error(to, own ? "own" : prt_measure_light_name[l], error[l]);
    add_worst(e, to);
    return status;
}

// Single scattering as eyes all around see it, under the soft boxes or the bake's own light.
// Vertices that face away are 0 on both sides. The mean over eyes: one error for any view.
static int measure_views(struct examination *e, cJSON *to)
{
    const struct prt_cube *own = e->o->own;
    enum { EYES = 4 };
    static const float from[EYES][3] = {{0.6f, 0.3f, 0.74f},
                                        {-0.86f, 0.1f, 0.5f},
                                        {0.2f, 0.75f, -0.63f},
                                        {-0.3f, -0.5f, -0.81f}};
    const struct prt_mesh *mesh = &e->transport->mesh;
    double distance = 2 * prt_mesh_diagonal(mesh), sum = 0;
    unsigned n_medium = e->n_medium, n = 0;
    struct prt_cube light = {0};
    float box[2][3];
    int status = own ? PRT_OK : prt_measure_light(1, e->transport->cube, &light);
    prt_mesh_bounds(mesh, box);
    e->n_medium = 1;
    for (int i = 0; status == PRT_OK && e->n && i < EYES; i++) {
        float eye[3];
        double error = 0;
        for (int k = 0; k < 3; k++)
            eye[k] = (box[0][k] + box[1][k]) / 2 + (float)distance * from[i][k];
        const struct prt_cube *const lights[] = {own ? own : &light};
        status = prt_progress(e->ctx, "measuring", 0.7 + 0.3 * i / EYES);
        if (status == PRT_OK) status = examine(e, PRT_TERM_SINGLE, 1, lights, eye, &error);
        if (!isfinite(error)) continue; // this eye sees none of it
        sum += error * error;
        n++;
    }
    e->n_medium = n_medium;
    prt_cube_finish(&light);
    add_error(to, "worst", n ? sqrt(sum / n) : NAN);
    return status;
}

// The exit's divisor at the vertices that were drawn.
static int find_divisors(struct examination *e)
{
    const struct prt_transport *t = e->transport;
    uint32_t *block = prt_mesh_vertex_blocks(&t->mesh);
    float of_medium[PRT_MEDIA_MAX];
    e->divisor = prt_alloc(e->n + 1u, sizeof *e->divisor);
    if (!block || !e->divisor) {
        prt_free(block);
        return PRT_NOMEM;
    }
    for (uint32_t m = 0; m < t->media.n; m++)
        of_medium[m] =
            (float)prt_exit_divisor((double)t->media.medium[m].eta, PRT_EXIT_NORMALISED);
    for (uint32_t i = 0; i < e->n; i++)
        e->divisor[i] =
            of_medium[prt_media_index(&t->media, t->mesh.block[block[e->vertex[i]]].object)];
    prt_free(block);
    return PRT_OK;
}

static int ratio_order(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

// The error of the dipole: its multiple scattering of medium m under the built-in lights
// against two references by walks. Under the sky also the dipole over the walks less 1: `ratio`
// at each vertex of `places`, and what one vertex in fifty exceeds.
static int add_dipole_error(const struct examination *e, float (*const dipole[])[3],
                            float (*const walk[2][MEASURE_LIGHTS])[3], cJSON *to)
{
    double *ratio = prt_alloc(e->n + 1u, sizeof *ratio);
    cJSON *at = cJSON_AddArrayToObject(to, "ratio");
    if (!ratio) return PRT_NOMEM;
    for (unsigned l = 0; l < MEASURE_LIGHTS; l++)
        add_error(to, prt_measure_light_name[l],
                  error_from(dipole[l][0], walk[0][l][0], walk[1][l][0], (size_t)e->n * 3));
    for (uint32_t i = 0; i < e->n; i++) {
        double sum = 0, walks = 0;
        for (int c = 0; c < 3; c++) {
            sum += (double)dipole[0][i][c];
            walks += 0.5 * ((double)walk[0][0][i][c] + (double)walk[1][0][i][c]);
        }
        ratio[i] = walks > 0 ? sum / walks - 1 : 0;
        cJSON_AddItemToArray(at, error_number(ratio[i]));
    }
    qsort(ratio, e->n, sizeof *ratio, ratio_order);
    if (e->n) {
        add_error(to, "darkest", ratio[e->n / 50]);
        add_error(to, "brightest", ratio[e->n - 1 - e->n / 50]);
    }
    prt_free(ratio);
    return PRT_OK;
}

// References of multiple scattering under the built-in lights; n_walk 0: by the dipole. A walk
// ends at one of some 80,000 samples, so that the noise of their few rays is less than that of
// the walks, and it differs in the two references: 64 in place of 256 moved the errors of the
// dipole from 7.1, 9.3 and 12.4 % to 7.2, 9.3 and 12.4 % (bunny, marble).
enum { WALKED_RAYS = 64 };
static int reference_multiple(const struct examination *e, uint32_t n_walk, uint64_t seed,
                              float (*const out[])[3])
{
    struct prt_cube made[MEASURE_LIGHTS] = {{0}};
    const struct prt_cube *light[MEASURE_LIGHTS];
    const struct prt_reference_options options = {.term = PRT_REFERENCE_MULTIPLE,
                                                  .vertex = e->vertex,
                                                  .n_vertex = e->n,
                                                  .n_sample = reference_samples(e),
                                                  .n_ray = n_walk ? WALKED_RAYS : 512,
                                                  .n_walk = n_walk,
                                                  .seed = seed};
    struct prt_context quiet = *e->ctx;
    int status = PRT_OK;
    quiet.progress = NULL;
    quiet.log = drop_warnings, quiet.log_user = (void *)(uintptr_t)e->ctx;
    for (unsigned l = 0; status == PRT_OK && l < MEASURE_LIGHTS; l++) {
        status = prt_measure_light(l, e->transport->cube, &made[l]);
        light[l] = &made[l];
    }
    if (status == PRT_OK)
        status = prt_reference_many(&quiet, &e->transport->mesh, 1, e->media, MEASURE_LIGHTS,
                                    light, &options, out);
    for (unsigned l = 0; l < MEASURE_LIGHTS; l++) prt_cube_finish(&made[l]);
    return status;
}

// After measure_term left the references of multiple scattering in `want`: by walks, so that
// the dipole's are added; or by the dipole of a fixed medium, so that few walks are added.
static int measure_dipole(struct examination *e, cJSON *to)
{
    enum { FEW_WALKS = 128 };
    float(*made[2][MEASURE_LIGHTS])[3] = {{NULL}}, (*want[2][MEASURE_LIGHTS])[3];
    const bool walks = e->o->n_walk;
    int status = PRT_OK;
    for (unsigned l = 0; l < MEASURE_LIGHTS; l++)
        for (unsigned k = 0; k < 2; k++) {
            made[k][l] = prt_alloc(e->n + 1u, sizeof *made[k][l]);
            want[k][l] = e->want[k][l];
            if (!made[k][l]) status = PRT_NOMEM;
        }
    if (!status) status = reference_multiple(e, walks ? 0 : FEW_WALKS, 99, made[0]);
    if (!status && !walks) status = reference_multiple(e, FEW_WALKS, 177, made[1]);
    if (!status)
        status = walks ? add_dipole_error(e, made[0], want, to)
                       : add_dipole_error(e, want[0], made, to);
    for (unsigned l = 0; l < MEASURE_LIGHTS; l++) prt_free(made[0][l]), prt_free(made[1][l]);
    return status;
}

// Whether the medium is fixed and has walks, in closed bodies; drafts are to be quick.
static bool has_walks(const struct examination *e)
{
    const struct prt_transport *t = e->transport;
    bool all = t->engine == PRT_TRANSPORT_WAVELET && !e->o->draft && e->n &&
               !t->mesh.n_boundary_edge && !t->mesh.n_nonmanifold_edge;
    for (uint32_t i = 0; i < t->media.n; i++) all &= !t->media.medium[i].profile;
    return all;
}

// Error of the sum where the transport has no single scattering: that of the reference counts
// as missing. Of the bake's own media, under every light.
static int measure_missing_single(struct examination *e, cJSON *to)
{
    struct prt_cube made[MEASURE_LIGHTS] = {{0}};
    const struct prt_cube *own = e->o->own, *light[MEASURE_LIGHTS] = {own};
    const unsigned n_light = own ? 1 : MEASURE_LIGHTS;
    const struct prt_reference_options options = {.term = PRT_REFERENCE_SINGLE,
                                                  .vertex = e->vertex,
                                                  .n_vertex = e->n,
                                                  .n_single = 1024,
                                                  .seed = 99};
    struct prt_context quiet = *e->ctx;
    quiet.progress = NULL;
    double worst = NAN;
    int status = PRT_OK;
    for (unsigned l = 0; status == PRT_OK && !own && l < n_light; l++) {
        status = prt_measure_light(l, e->transport->cube, &made[l]);
        light[l] = &made[l];
    }
    if (status == PRT_OK && e->n)
        status = prt_reference_many(&quiet, &e->transport->mesh, 1, e->media, n_light, light,
                                    &options, e->want[0]);
    memset(e->got, 0, e->n * sizeof *e->got);
    for (unsigned l = 0; status == PRT_OK && e->n && l < n_light; l++) {
        memcpy(e->want[1][l], e->want[0][l], (size_t)e->n * sizeof *e->want[1][l]);
        add_to_sums(e, true, l);
        add_error(to, own ? "own" : prt_measure_light_name[l], e->together[l]);
        worst = fmax(worst, e->together[l]);
    }
    add_error(to, "worst", worst);
    for (unsigned l = 0; l < MEASURE_LIGHTS; l++) prt_cube_finish(&made[l]);
    return status;
}

// Error of the sums at each vertex: the root mean square over the lights, relative to the
// references' over all vertices. Its mean square is the mean square of "together".
static double error_at(const struct examination *e, unsigned n_light, uint32_t i,
                       const double bright[MEASURE_LIGHTS])
{
    double sum = 0;
    for (unsigned l = 0; l < n_light; l++) {
        const float *got = e->sum_got[l][i];
        const float *a = e->sum_want[0][l][i], *b = e->sum_want[1][l][i];
        double square = 0;
        for (int c = 0; c < 3; c++)
            square += ((double)got[c] - (double)a[c]) * ((double)got[c] - (double)b[c]);
        if (bright[l] > 0) sum += fmax(square, 0) / bright[l] / n_light;
    }
    return sqrt(sum);
}

// Where the errors are: vertices and the error at each.
static void add_places(const struct examination *e, unsigned n_light, cJSON *to)
{
    double bright[MEASURE_LIGHTS] = {0};
    cJSON *vertex = cJSON_AddArrayToObject(to, "vertex");
    cJSON *error = cJSON_AddArrayToObject(to, "error");
    for (unsigned l = 0; l < n_light; l++)
        for (uint32_t i = 0; i < e->n; i++)
            for (int c = 0; c < 3; c++)
                bright[l] +=
                    (double)e->sum_want[0][l][i][c] * (double)e->sum_want[1][l][i][c] / e->n;
    for (uint32_t i = 0; i < e->n; i++) {
        cJSON_AddItemToArray(vertex, cJSON_CreateNumber(e->vertex[i]));
        cJSON_AddItemToArray(error, error_number(error_at(e, n_light, i, bright)));
    }
}

static bool all_profiles(const struct prt_media *media)
{
    bool all = true;
    for (uint32_t i = 0; i < media->n; i++) all &= media->medium[i].profile != 0;
    return all;
}

static int measure_terms(struct examination *e, char **errors)
{
    const struct prt_transport *t = e->transport;
    const struct prt_cube *own = e->o->own;
    const bool left_out = e->o->draft && e->o->n_walk; // the unscattered light of a draft
    bool single = false, unscattered = false;
    for (uint32_t i = 0; i < t->n_tensor; i++) {
        single |= t->tensor[i].term == PRT_TERM_SINGLE;
        unscattered |= t->tensor[i].term == PRT_TERM_UNSCATTERED;
    }
    cJSON *json = cJSON_CreateObject();
    cJSON_AddNumberToObject(json, "vertices", e->n);
    if (e->o->n_walk) {
        cJSON_AddNumberToObject(json, "reference_walks", 2.0 * e->o->n_walk);
        if (!e->o->draft) add_error(json, "walk_noise", e->o->noise);
    }
    int status =
        measure_term(e, PRT_TERM_MULTIPLE, 0, cJSON_AddObjectToObject(json, "multiple"));
    if (status == PRT_OK && !own && (e->o->n_walk ? !e->o->draft : has_walks(e)))
        status = measure_dipole(e, cJSON_AddObjectToObject(json, "dipole"));
    if (status == PRT_OK && (unscattered || left_out))
        status = measure_term(e, PRT_TERM_UNSCATTERED, 0.2,
                              cJSON_AddObjectToObject(json, "unscattered"));
    if (status == PRT_OK && single)
        status = measure_term(e, PRT_TERM_SINGLE, 0.4, cJSON_AddObjectToObject(json, "single"));
    if (status == PRT_OK && (single || unscattered)) {
        cJSON *together = cJSON_AddObjectToObject(json, "together");
        for (unsigned l = 0; l < (own ? 1 : MEASURE_LIGHTS); l++)
            add_error(together, own ? "own" : prt_measure_light_name[l], e->together[l]);
    }
    if (status == PRT_OK && single)
        status = measure_views(e, cJSON_AddObjectToObject(json, "single_toward_eyes"));
    if (status == PRT_OK && e->o->draft && !single && !unscattered && !all_profiles(&t->media))
        status = measure_missing_single(e, cJSON_AddObjectToObject(json, "total"));
    if (status == PRT_OK)
        add_places(e, own ? 1 : MEASURE_LIGHTS, cJSON_AddObjectToObject(json, "places"));
    if (status == PRT_OK && !(*errors = cJSON_PrintUnformatted(json))) status = PRT_NOMEM;
    cJSON_Delete(json);
    return status;
}

int prt_measure_bake(const struct prt_context *ctx, const struct prt_transport *transport,
                     const struct measure_options *options, char **errors)
{
    const uint32_t n_vertex = options->n_vertex;
    struct examination e = {.ctx = ctx, .transport = transport, .o = options};
    e.vertex = prt_alloc(n_vertex, sizeof *e.vertex);
    e.all = prt_alloc(transport->mesh.n_vertex, sizeof *e.all);
    e.got = prt_alloc(n_vertex, sizeof *e.got);
    int status = e.vertex && e.all && e.got ? choose_media(&e) : PRT_NOMEM;
    for (unsigned i = 0; status == PRT_OK && i < e.n_medium * MEASURE_LIGHTS; i++)
        for (unsigned k = 0; k < 2; k++)
            if (!(e.want[k][i] = prt_alloc(n_vertex, sizeof *e.want[k][i]))) status = PRT_NOMEM;
    for (unsigned l = 0; status == PRT_OK && l < MEASURE_LIGHTS; l++) {
        e.sum_got[l] = prt_calloc(n_vertex, sizeof *e.sum_got[l]);
        e.sum_want[0][l] = prt_calloc(n_vertex, sizeof *e.sum_want[0][l]);
        e.sum_want[1][l] = prt_calloc(n_vertex, sizeof *e.sum_want[1][l]);
        if (!e.sum_got[l] || !e.sum_want[0][l] || !e.sum_want[1][l]) status = PRT_NOMEM;
    }
    if (status == PRT_OK)
        e.n = draw_vertices(&transport->mesh, n_vertex, options->seed, e.vertex);
    if (status == PRT_OK)
        status = sort_walked(&transport->mesh, options->walked, e.n, e.vertex, &e.n_walked);
    if (status == PRT_OK) status = find_divisors(&e);
    if (status == PRT_OK) status = measure_terms(&e, errors);
    prt_free(e.divisor);
    prt_free(e.vertex);
    prt_free(e.all);
    prt_free(e.got);
    for (unsigned i = 0; i < MEDIA * MEASURE_LIGHTS; i++)
        prt_free(e.want[0][i]), prt_free(e.want[1][i]);
    for (unsigned m = 0; m < MEDIA; m++) prt_free(e.medium[m]);
    for (unsigned l = 0; l < MEASURE_LIGHTS; l++)
        prt_free(e.sum_got[l]), prt_free(e.sum_want[0][l]), prt_free(e.sum_want[1][l]);
    return status;
}
