// SPDX-License-Identifier: MIT
// Animations of a glTF: their list, and the transforms and weights that one of them gives the
// nodes at a time.
#include "gltf_pose.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// Floats read and moved for one pose: some seconds. Chosen, not measured.
static const uint64_t most_work = 1ull << 31;

static const cJSON *member(const cJSON *object, const char *key)
{
    return cJSON_IsObject(object) ? cJSON_GetObjectItemCaseSensitive(object, key) : NULL;
}

static const char *text_of(const cJSON *object, const char *key)
{
    const char *text = cJSON_GetStringValue(member(object, key));
    return text ? text : "";
}

int64_t prt_gltf_whole(const cJSON *object, const char *key)
{
    const cJSON *v = member(object, key);
    if (!cJSON_IsNumber(v) || !(v->valuedouble >= 0 && v->valuedouble < 2147483648.0))
        return -1;
    return (double)(int64_t)v->valuedouble == v->valuedouble ? (int64_t)v->valuedouble : -1;
}

int prt_gltf_pose_work(struct gltf *g, uint64_t n)
{
    g->pose->work += n;
    return g->pose->work <= most_work
               ? PRT_OK
               : prt_fail(g->d->ctx, PRT_LIMIT,
                          "%s: its animation, skins and morph targets are too large",
                          g->d->name);
}

int prt_gltf_read_floats(struct gltf *g, int64_t index, unsigned n_component,
                         struct gltf_accessor *a, float **out)
{
    int status = prt_gltf_accessor(g, index, a);
    const uint64_t n = status ? 0 : a->count * n_component;
    if (!status) status = prt_gltf_pose_work(g, n);
    if (!status && n * sizeof(float) > g->d->max_bytes / 4) status = prt_gltf_no_memory(g);
    if (status) return status;
    float *at = malloc(n * sizeof *at);
    if (!at) return prt_gltf_no_memory(g);
    status = prt_gltf_floats(g, a, n_component, at);
    if (status) free(at);
    else *out = at;
    return status;
}

// ---- the list

// The last time of an animation's samplers, from their accessors' max.
static double duration_of(const cJSON *animation, const cJSON *const *accessor, size_t n)
{
    double last = 0;
    const cJSON *sampler;
    cJSON_ArrayForEach(sampler, member(animation, "samplers"))
    {
        const int64_t input = prt_gltf_whole(sampler, "input");
        if (input < 0 || (size_t)input >= n) continue;
        const cJSON *max = cJSON_GetArrayItem(member(accessor[input], "max"), 0);
        if (cJSON_IsNumber(max) && max->valuedouble > last && max->valuedouble < 1e9)
            last = max->valuedouble;
    }
    return last;
}

// The items of an array of the file by index; [*n], NULL without memory.
static const cJSON **items(struct gltf *g, const char *key, size_t least, size_t *n)
{
    const cJSON *list = member(g->json, key), *one;
    *n = (size_t)cJSON_GetArraySize(list);
    if (*n < least) *n = least;
    const cJSON **out = prt_gltf_own(g, *n * sizeof *out);
    size_t i = 0;
    if (out) cJSON_ArrayForEach(one, list) out[i++] = one;
    return out;
}

static bool is_taken(const struct prt_draft *d, const char *name)
{
    for (uint32_t i = 0; i < d->n_animation; i++)
        if (!strcmp(d->animations[i].name, name)) return true;
    return false;
}

int prt_gltf_animations(struct gltf *g)
{
    struct prt_draft *d = g->d;
    const cJSON *animation;
    size_t n = 0;
    const cJSON **accessor = items(g, "accessors", 0, &n);
    if (!accessor) return prt_gltf_no_memory(g);
    cJSON_ArrayForEach(animation, member(g->json, "animations"))
    {
        if (d->n_animation == PRT_MESH_MOST_ANIMATIONS) break;
        struct prt_mesh_animation *to = &d->animations[d->n_animation];
        *to = (struct prt_mesh_animation){.duration_s =
                                              (float)duration_of(animation, accessor, n)};
        snprintf(to->name, sizeof to->name, "%.63s", text_of(animation, "name"));
        for (uint32_t k = d->n_animation; !to->name[0] || is_taken(d, to->name); k++)
            snprintf(to->name, sizeof to->name, "animation %u", k);
        d->n_animation++;
    }
    return PRT_OK;
}

// ---- one moment

// A channel's sampler: `width` values at each key, and with tangents around them where cubic.
struct sampler {
    float *time, *value;
    size_t n, width;
    char mode; // L, S, C
};

static int bad_channel(const struct gltf *g, size_t channel, const char *why)
{
    return prt_gltf_bad(g, "channel %zu of the animation: %s", channel, why);
}

static int check_times(const struct gltf *g, size_t channel, const struct sampler *s)
{
    for (size_t i = 0; i < s->n; i++)
        if (!(s->time[i] >= 0 && s->time[i] < 1e9f) || (i && !(s->time[i] > s->time[i - 1])))
            return bad_channel(g, channel, "its times do not increase from 0 on");
    return PRT_OK;
}

// width 0: as many as the values allow (weights). free() both arrays afterwards.
static int read_sampler(struct gltf *g, size_t channel, const cJSON *json, size_t width,
                        struct sampler *out)
{
    const char *mode = text_of(json, "interpolation");
    struct gltf_accessor in, values;
    out->mode = !*mode || !strcmp(mode, "LINEAR") ? 'L'
                : !strcmp(mode, "STEP")           ? 'S'
                : !strcmp(mode, "CUBICSPLINE")    ? 'C'
                                                  : 0;
    if (!out->mode) return bad_channel(g, channel, "its interpolation is unknown");
    int status = prt_gltf_read_floats(g, prt_gltf_whole(json, "input"), 1, &in, &out->time);
    if (status) return status;
    out->n = (size_t)in.count;
    if ((status = check_times(g, channel, out))) return status;
    status = prt_gltf_read_floats(g, prt_gltf_whole(json, "output"),
                                  width ? (unsigned)width : 1, &values, &out->value);
    if (status) return status;
    const uint64_t each = out->n * (out->mode == 'C' ? 3u : 1u);
    out->width = width ? width : (size_t)(values.count / each);
    const uint64_t count = width ? values.count : values.count / (out->width ? out->width : 1);
    if (!out->width || out->width > 65536 || count != each || values.count % each)
        return bad_channel(g, channel, "it has not as many values as times");
    for (uint64_t i = 0; i < values.count * values.n_component; i++)
        if (!(fabsf(out->value[i]) < 1e15f))
            return bad_channel(g, channel, "a value is not finite");
    return PRT_OK;
}

// Values of key k: the value itself, its in-tangent (-1) or its out-tangent (+1).
static const float *key(const struct sampler *s, size_t k, int tangent)
{
    const size_t at = s->mode == 'C' ? 3 * k + (size_t)(1 + tangent) : k;
    return s->value + at * s->width;
}

// Along the shorter great circle, at constant speed.
static void slerp(const float *a, const float *b, double u, double out[4])
{
    double la = 0, lb = 0, dot = 0;
    for (int c = 0; c < 4; c++) {
        la += (double)a[c] * (double)a[c];
        lb += (double)b[c] * (double)b[c];
        dot += (double)a[c] * (double)b[c];
    }
    const double scale = la > 0 && lb > 0 ? 1 / sqrt(la * lb) : 1;
    const double cosine = fmin(fabs(dot * scale), 1), angle = acos(cosine);
    double wa = 1 - u, wb = u;
    if (angle > 1e-4) {
        wa = sin((1 - u) * angle) / sin(angle);
        wb = sin(u * angle) / sin(angle);
    }
    if (dot < 0) wb = -wb;
    wa /= la > 0 ? sqrt(la) : 1;
    wb /= lb > 0 ? sqrt(lb) : 1;
    for (int c = 0; c < 4; c++) out[c] = wa * (double)a[c] + wb * (double)b[c];
}

// The sampler at `time` into out[width]; before its first and after its last key their values.
static void sample(const struct sampler *s, double time, bool rotation, double *out)
{
    size_t k = 0;
    while (k + 1 < s->n && (double)s->time[k + 1] <= time) k++;
    const bool between = k + 1 < s->n && time > (double)s->time[k] && s->mode != 'S';
    const double step = between ? (double)s->time[k + 1] - (double)s->time[k] : 1;
    const double u = between ? (time - (double)s->time[k]) / step : 0;
    const float *a = key(s, k, 0), *b = between ? key(s, k + 1, 0) : a;
    if (rotation && s->mode == 'L' && between) {
        slerp(a, b, u, out);
        return;
    }
    const bool cubic = s->mode == 'C' && between;
    const float *leave = cubic ? key(s, k, 1) : a, *enter = cubic ? key(s, k + 1, -1) : a;
    const double u2 = u * u, u3 = u2 * u;
    for (size_t c = 0; c < s->width; c++)
        out[c] = cubic ? (2 * u3 - 3 * u2 + 1) * (double)a[c] +
                             step * (u3 - 2 * u2 + u) * (double)leave[c] +
                             (3 * u2 - 2 * u3) * (double)b[c] +
                             step * (u3 - u2) * (double)enter[c]
                       : (1 - u) * (double)a[c] + u * (double)b[c];
}

static int set_weights(struct gltf *g, struct gltf_moment *to, const struct sampler *s)
{
    double *value = malloc(s->width * sizeof *value);
    to->weight = prt_gltf_own(g, s->width * sizeof *to->weight);
    to->n_weight = to->weight ? s->width : 0;
    if (value && to->weight) {
        sample(s, g->d->animation_time, false, value);
        for (size_t i = 0; i < s->width; i++) to->weight[i] = (float)value[i];
    }
    const bool good = value && to->weight;
    free(value);
    return good ? PRT_OK : prt_gltf_no_memory(g);
}

static int run_channel(struct gltf *g, size_t index, const cJSON *channel,
                       const cJSON *const *sampler, size_t n_sampler)
{
    const cJSON *target = member(channel, "target");
    const char *path = text_of(target, "path");
    const int64_t which = prt_gltf_whole(channel, "sampler");
    const int64_t node = prt_gltf_whole(target, "node");
    const bool t = !strcmp(path, "translation"), r = !strcmp(path, "rotation"),
               s = !strcmp(path, "scale"), w = !strcmp(path, "weights");
    if (!(t || r || s || w) || !member(target, "node")) {
        g->n_channel_skipped++; // KHR_animation_pointer and later additions
        return PRT_OK;
    }
    if (node < 0 || (uint64_t)node >= g->file.n_node)
        return bad_channel(g, index, "its node does not exist");
    if (which < 0 || (size_t)which >= n_sampler)
        return bad_channel(g, index, "its sampler does not exist");
    struct gltf_moment *to = &g->pose->node[node];
    struct sampler own = {0};
    int status = read_sampler(g, index, sampler[which], r ? 4 : w ? 0 : 3, &own);
    const double time = g->d->animation_time;
    if (!status && t) sample(&own, time, false, to->t);
    if (!status && r) sample(&own, time, true, to->r);
    if (!status && s) sample(&own, time, false, to->s);
    if (!status && w) status = set_weights(g, to, &own);
    to->has_t |= t;
    to->has_r |= r;
    to->has_s |= s;
    free(own.time);
    free(own.value);
    return status;
}

static int run_animation(struct gltf *g, const cJSON *animation)
{
    const cJSON *list = member(animation, "samplers"), *one;
    const size_t n = (size_t)cJSON_GetArraySize(list);
    const cJSON **sampler = prt_gltf_own(g, (n + 1) * sizeof *sampler);
    size_t i = 0;
    int status = PRT_OK;
    if (!sampler) return prt_gltf_no_memory(g);
    cJSON_ArrayForEach(one, list) sampler[i++] = one;
    i = 0;
    cJSON_ArrayForEach(one, member(animation, "channels"))
    {
        if ((status = run_channel(g, i++, one, sampler, n))) return status;
    }
    return PRT_OK;
}

static int choose(const struct gltf *g, uint32_t *out)
{
    const struct prt_draft *d = g->d;
    const char *name[PRT_MESH_MOST_ANIMATIONS];
    char say[640];
    for (uint32_t i = 0; i < d->n_animation; i++) name[i] = d->animations[i].name;
    if (!d->n_animation)
        return prt_fail(d->ctx, PRT_ARG, "%s has no animations: leave --animation out",
                        d->name);
    const int found = prt_name_choose(d->animation, name, d->n_animation, say, sizeof say);
    if (found < 0)
        return prt_fail(d->ctx, PRT_ARG, "%s has no animation \"%.63s\"%s%s", d->name,
                        d->animation, *say ? "; " : "", say);
    *out = (uint32_t)found;
    return PRT_OK;
}

bool prt_gltf_needs_pose(const struct gltf *g)
{
    const struct prt_gltf_document *f = &g->file;
    if (g->d->animation || g->instances) return true;
    for (size_t i = 0; g->json && i < f->n_node; i++)
        if (f->node[i].skin >= 0) return true;
    for (size_t i = 0; g->json && i < f->n_mesh; i++)
        for (size_t k = 0; k < f->mesh[i].n; k++)
            if (f->mesh[i].primitive[k].targets) return true;
    return false;
}

int prt_gltf_pose_begin(struct gltf *g)
{
    uint32_t which = 0;
    size_t n, n_node = g->file.n_node;
    int status = g->d->animation ? choose(g, &which) : PRT_OK;
    if (status) return status;
    struct gltf_pose *p = prt_gltf_own(g, sizeof *p);
    if (!p) return prt_gltf_no_memory(g);
    p->node = prt_gltf_own(g, n_node * sizeof *p->node);
    p->world = prt_gltf_own(g, n_node * sizeof *p->world);
    p->has_world = prt_gltf_own(g, n_node);
    p->mesh = items(g, "meshes", g->file.n_mesh, &n);
    p->json_node = items(g, "nodes", n_node, &n);
    p->skin = items(g, "skins", 0, &p->n_skin);
    if (!p->node || !p->world || !p->has_world || !p->mesh || !p->json_node || !p->skin)
        return prt_gltf_no_memory(g);
    g->pose = p;
    if (!g->d->animation) return PRT_OK;
    return run_animation(g, cJSON_GetArrayItem(member(g->json, "animations"), (int)which));
}
