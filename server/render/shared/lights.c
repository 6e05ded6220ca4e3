// SPDX-License-Identifier: MIT
// Lights as cubes: several environments and inline cubes turned, weighted and summed, once for
// everybody who asks for the same.
#include "render/evaluation.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { BACKGROUND_CUBE = 256 };

struct summand {
    const struct prt_env *env;
    struct prt_cube texels; // of an inline cube
    double rotate_deg;
    float gain[3];
};
struct lighting {
    struct work work;
    struct cache_entry *entry;
    struct cache_entry *env[RENDER_MAX_LIGHTS];
    unsigned n;
    struct summand part[RENDER_MAX_LIGHTS];
    struct held_bytes *texels; // of inline cubes
    uint32_t cube_n;
    struct prt_cube *cube;
    float ms;
};

static void destroy_cube(void *value)
{
    prt_cube_finish(value);
    free(value);
}

static int add_summand(const struct prt_context *ctx, const struct lighting *l,
                       const struct summand *s, bool first)
{
    struct prt_cube cube = {0};
    struct prt_env inline_env = {.kind = PRT_ENV_CUBE, .cube = s->texels};
    const struct prt_env *env = s->env ? s->env : &inline_env;
    bool as_it_is = !s->env && s->texels.n == l->cube_n && s->rotate_deg == 0;
    int status = as_it_is ? PRT_OK : prt_env_to_cube(ctx, env, l->cube_n, s->rotate_deg, &cube);
    if (status) return status;
    const float *from = as_it_is ? s->texels.texel : cube.texel;
    size_t n = (size_t)6 * l->cube_n * l->cube_n;
    for (size_t i = 0; i < n; i++)
        for (int c = 0; c < 3; c++) {
            float x = from[3 * i + (size_t)c] * s->gain[c];
            float *to = &l->cube->texel[3 * i + (size_t)c];
            *to = first ? x : *to + x;
        }
    prt_cube_finish(&cube);
    return PRT_OK;
}

static int run_lighting(struct work *work, const struct prt_context *ctx)
{
    struct lighting *l = (struct lighting *)work;
    double start = prt_time_s();
    l->cube = calloc(1, sizeof *l->cube);
    int status = l->cube ? prt_cube_init(l->cube, l->cube_n) : PRT_NOMEM;
    for (unsigned i = 0; !status && i < l->n; i++)
        status = add_summand(ctx, l, &l->part[i], i == 0);
    l->ms = (float)((prt_time_s() - start) * 1e3);
    return status;
}

static void done_lighting(struct work *work)
{
    struct lighting *l = (struct lighting *)work;
    l->entry->ms = l->ms;
    if (work->status) {
        if (l->cube) destroy_cube(l->cube);
        cache_fail(l->entry, error_of_status(work->status), work->error);
    } else {
        cache_fill(l->entry, l->cube, (size_t)72 * l->cube_n * l->cube_n, destroy_cube);
    }
    for (unsigned i = 0; i < l->n; i++) cache_release(l->env[i]);
    cache_release(l->entry);
    held_bytes_release(l->texels);
    free(l);
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
    bool fresh;
    struct cache_entry *entry = cache_get(server->cache, key, &fresh);
    if (!fresh) return entry;
    struct lighting *l = calloc(1, sizeof *l);
    if (!l) {
        cache_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return entry;
    }
    l->texels = spec->texels;
    if (l->texels) held_bytes_hold(l->texels);
    for (unsigned i = 0; i < n; i++) {
        const struct render_light *light = &spec->light[first + i];
        struct summand *s = &l->part[i];
        s->rotate_deg = turned ? light->rotate_deg : 0;
        memcpy(s->gain, light->gain, sizeof s->gain);
        if (light->cube_n) {
            // Read only: prt_cube has no const texels.
            s->texels = (struct prt_cube){light->cube_n,
                                          (float *)(uintptr_t)render_texels(spec, light)};
        } else {
            l->env[i] = env[first + i];
            cache_hold(l->env[i]);
            s->env = &((struct decoded_env *)l->env[i]->value)->env;
        }
    }
    l->n = n;
    l->cube_n = cube_n;
    l->entry = entry;
    cache_hold(entry);
    l->work.run = run_lighting;
    l->work.done = done_lighting;
    work_submit(server->work, &l->work);
    return entry;
}

struct cache_entry *sky_get(struct server *server, const struct render_spec *spec,
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
        render_light_name(&spec.light[0], NULL);
        cache_release(sky_get(p->server, &spec, &p->entry));
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
