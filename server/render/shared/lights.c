// SPDX-License-Identifier: MIT
// Lights as cubes: several environments and inline cubes, rotated, weighted and summed.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { BACKGROUND_CUBE = 256 }; // the largest side of a background; chosen, not measured

struct summand {
    const struct prt_env *env;
    struct prt_cube texels; // of an inline cube
    double rotate_deg;
    float gain[3];
};
struct light_job {
    struct cache_job job;
    unsigned n;
    struct summand part[RENDER_MAX_LIGHTS];
    struct held_bytes *texels; // of inline cubes
    uint32_t cube_n;
};

static void destroy_cube(void *value)
{
    prt_cube_finish(value);
    free(value);
}

// Multiplies the cube by a gain, and adds it to the sum where there is one.
static void gain_cube(struct prt_cube *cube, const float gain[3], struct prt_cube *sum)
{
    const size_t n = (size_t)6 * cube->n * cube->n;
    for (size_t i = 0; i < n; i++)
        for (size_t c = 0; c < 3; c++) {
            const float x = cube->texel[3 * i + c] * gain[c];
            if (sum) sum->texel[3 * i + c] += x;
            else cube->texel[3 * i + c] = x;
        }
}

// Turns texels as env_of_texels() does: cached and uncached ones give the same answer.
static int turned_texels(const struct prt_context *ctx, const struct light_job *l,
                         const struct summand *s, struct prt_cube *out)
{
    struct prt_env env = {.kind = PRT_ENV_CUBE, .cube = s->texels};
    int status = s->texels.n <= ENV_TURNED_CUBE ? prt_env_cache_create(&env) : PRT_OK;
    if (!status) status = prt_env_turned(ctx, &env, l->cube_n, s->rotate_deg, out);
    prt_env_cache_destroy(&env);
    return status;
}

// A summand's own cube, without its gain.
static int turned(const struct prt_context *ctx, const struct light_job *l,
                  const struct summand *s, struct prt_cube *out)
{
    const bool as_it_is = !s->env && s->texels.n == l->cube_n && s->rotate_deg == 0;
    if (s->env) return prt_env_turned(ctx, s->env, l->cube_n, s->rotate_deg, out);
    if (!as_it_is) return turned_texels(ctx, l, s, out);
    int status = prt_cube_init(out, l->cube_n);
    if (!status) memcpy(out->texel, s->texels.texel, 72ull * l->cube_n * l->cube_n);
    return status;
}

static int add_summand(const struct prt_context *ctx, const struct light_job *l,
                       const struct summand *s, struct prt_cube *sum)
{
    struct prt_cube cube = {0};
    int status = turned(ctx, l, s, &cube);
    if (!status) gain_cube(&cube, s->gain, sum);
    prt_cube_finish(&cube);
    return status;
}

static int run(struct cache_job *job, const struct prt_context *ctx)
{
    static const float unit[3] = {1, 1, 1};
    const struct light_job *l = (struct light_job *)job;
    struct prt_cube *sum = job->value = calloc(1, sizeof *sum);
    int status = !sum    ? PRT_NOMEM
                 : !l->n ? prt_cube_init(sum, l->cube_n)
                         : turned(ctx, l, &l->part[0], sum);
    if (!status && l->n && memcmp(l->part[0].gain, unit, sizeof unit))
        gain_cube(sum, l->part[0].gain, NULL);
    for (unsigned i = 1; !status && i < l->n; i++)
        status = add_summand(ctx, l, &l->part[i], sum);
    job->bytes = (size_t)72 * l->cube_n * l->cube_n;
    return status;
}

static void done(struct cache_job *job)
{
    held_bytes_release(((struct light_job *)job)->texels);
}

static const struct cache_job_kind kind = {
    .size = sizeof(struct light_job), .run = run, .destroy = destroy_cube, .done = done};

// Few models have cubes of side 64, and what these keep is three times that of the others.
static void charge_large_turns(struct cache_entry *env, uint32_t cube_n)
{
    struct decoded_env *d = env->value;
    if (cube_n != 64 || d->turned_64 || !d->cache_bytes) return;
    d->turned_64 = true;
    cache_grow(env, PRT_ENV_TURNED_BYTES(64));
}

static void set_summand(struct light_job *l, unsigned i, const struct render_spec *spec,
                        const struct render_light *light, struct cache_entry *env, bool turned)
{
    struct summand *s = &l->part[i];
    s->rotate_deg = turned ? light->rotate_deg : 0;
    memcpy(s->gain, light->gain, sizeof s->gain);
    if (light->cube_n && !env) {
        // run() reads the texels only; struct prt_cube has no const texels.
        s->texels =
            (struct prt_cube){light->cube_n, (float *)(uintptr_t)render_texels(spec, light)};
    } else {
        cache_job_hold(&l->job, env);
        if (s->rotate_deg != 0) charge_large_turns(env, l->cube_n);
        s->env = &((struct decoded_env *)env->value)->env;
    }
}

struct cache_entry *light_get(struct server *server, const struct render_spec *spec,
                              struct cache_entry *const env[], unsigned first, unsigned n,
                              uint32_t cube_n, bool turned)
{
    char key[RENDER_MAX_LIGHTS * sizeof spec->light->key + 64];
    size_t at = (size_t)snprintf(key, sizeof key, "light/%u", cube_n);
    for (unsigned i = first; i < first + n; i++)
        at += (size_t)snprintf(key + at, sizeof key - at, "+%s",
                               turned ? spec->light[i].key : spec->light[i].still_key);
    struct cache_job *job;
    struct cache_entry *entry = cache_compute(server, key, &kind, &job);
    if (!job) return entry;
    struct light_job *l = (struct light_job *)job;
    l->cube_n = cube_n;
    l->texels = spec->texels;
    if (l->texels) held_bytes_hold(l->texels);
    for (unsigned i = 0; i < n; i++)
        set_summand(l, i, spec, &spec->light[first + i], env[first + i], turned);
    l->n = n;
    cache_job_submit(job);
    return entry;
}

struct cache_entry *background_get(struct server *server, const struct render_spec *spec,
                                   struct cache_entry *const env[])
{
    uint32_t n = spec->light[0].cube_n;
    if (!n) n = prt_env_full_cube(&((struct decoded_env *)env[0]->value)->env);
    return light_get(server, spec, env, 0, 1, n < BACKGROUND_CUBE ? n : BACKGROUND_CUBE, false);
}

struct prefetch {
    struct cache_waiter waiter;
    struct server *server;
    struct cache_entry *entry;
    char env[96];
};

static void prefetched(struct cache_waiter *waiter)
{
    struct prefetch *p = (struct prefetch *)waiter;
    struct render_spec spec = {.n_light = 1, .light[0] = {.gain = {1, 1, 1}}};
    if (p->entry->state == CACHE_READY) {
        snprintf(spec.light[0].env, sizeof spec.light[0].env, "%s", p->env);
        render_light_name(&spec.light[0], NULL, "");
        cache_release(background_get(p->server, &spec, &p->entry));
    }
    cache_release(p->entry);
    free(p);
}

void env_prefetch(struct server *server, const char *hash)
{
    struct prefetch *p = calloc(1, sizeof *p);
    int code;
    char error[300];
    if (!p) return;
    snprintf(p->env, sizeof p->env, "env:%s", hash);
    p->server = server;
    p->waiter.wake = prefetched;
    p->entry = env_get(server, p->env, &code, error);
    if (p->entry && p->entry->state == CACHE_PENDING) cache_wait(p->entry, &p->waiter);
    else if (p->entry) prefetched(&p->waiter);
    else free(p);
}
