// SPDX-License-Identifier: MIT
// What a picture costs and how far off it will be: budgets turned into sample counts.
#include "internal.h"

#include <math.h>
#include <string.h>

// Seconds of two cores: fixed + points * per_point + receivers * per_receiver + samples *
// per_sample + receivers (points for TANGENT) * samples * per_pair. Learned speeds scale all of
// it.
struct cost {
    double fixed, per_point, per_receiver, per_sample, per_pair;
};
static const struct cost cost_of[4] = {
    [PRT_SCREEN_SPLAT] = {1e-3, 4e-8, 2.5e-7, 1.5e-7,
                          0}, // samples: n x n; the tree makes pairs few
    [PRT_SCREEN_TANGENT] = {2e-3, 5e-8, 0, 0, 1.1e-8},
    [PRT_SCREEN_TEXTURE] = {2e-3, 2.2e-8, 0, 1e-6, 2e-10},
    [PRT_SCREEN_HYBRID] = {3e-3, 2.2e-8, 1.7e-7, 2e-6, 2e-10},
};
// The table's bunny is an easy body; MARGIN: better too much than too little.
#define UNKNOWN 1.5
#define MARGIN 1.25
static const uint32_t least[4] = {32, 16, 64, 64}, most[4] = {1200, 4096, 16384, 16384};

static double work_of(enum prt_screen_engine e, uint32_t n)
{
    return e == PRT_SCREEN_SPLAT ? (double)n * n : (double)n;
}

static double receivers(const struct plan_view *v, double scale_mm)
{
    uint32_t size = prt_receiver_size(v->pixel_mm, scale_mm);
    return v->n_point * 0.85 / (size * size);
}

double prt_plan_seconds(enum prt_screen_engine e, uint32_t n, const struct plan_view *v)
{
    const struct cost *c = &cost_of[e];
    double w = work_of(e, n), lights = v->n_light > 1 ? v->n_light : 1;
    // discs of the lit third or so of the surface
    double disc = sqrt(0.35 * v->area_mm2 / w / M_PI), l = v->mean_free_path_mm;
    double pairs = e == PRT_SCREEN_TANGENT ? v->n_point : receivers(v, fmax(l, disc));
    // many lights: every sample traces a ray to each
    double rays = e == PRT_SCREEN_TANGENT ? v->n_point + 4e4
                  : e == PRT_SCREEN_SPLAT ? w
                                          : 16 * w + 16384;
    return c->fixed + v->n_point * c->per_point + receivers(v, l) * c->per_receiver +
           pairs * w * c->per_pair + w * c->per_sample + (lights - 1) * rays * 5e-8;
}

// Fits of the convergence table (prt-bench screen_error). x: samples to a mean free path's
// square of surface; TANGENT's samples are a pixel's own.
double prt_plan_error(enum prt_screen_engine e, uint32_t n, const struct plan_view *v)
{
    double l = v->mean_free_path_mm > 0 ? v->mean_free_path_mm : 1e-3, w = work_of(e, n);
    double diameter_mm = v->diameter_mm;
    double x =
        w * l * l / (e == PRT_SCREEN_SPLAT ? diameter_mm * diameter_mm : v->area_mm2 + 1e-12);
    // the table's media: 0.8 of 50 mm and shorter
    double shorter = fmax(1, 0.016 * diameter_mm / l), few = pow(fmax(1, 900.0 / n), 0.25);
    switch (e) {
    case PRT_SCREEN_SPLAT:
        // under many lights: layers from all sides in place of what one light sees
        return fmin(1, (v->n_light > FEW_LIGHTS ? 2 : 1) *
                           (0.004 + 0.0105 * pow(x, -0.75) / sqrt(1 + 0.05 / x)));
    case PRT_SCREEN_TANGENT:
        return fmin(1, (0.02 + 0.5 * pow(n, -0.9)) * pow(shorter, 0.2));
    case PRT_SCREEN_TEXTURE:
        return fmin(1, 0.0045 * few * pow(x, -0.5) / (1 + 0.08 * pow(x, -0.5)));
    case PRT_SCREEN_HYBRID:
        return fmin(1, (0.004 + 0.005 * pow(900.0 / n, 0.4)) * pow(shorter, 0.35));
    case PRT_SCREEN_REFERENCE:
        break;
    }
    return 0;
}

double prt_plan_expect(const struct prt_screen *screen, enum prt_screen_engine e, uint32_t n,
                       const struct plan_view *v)
{
    int many = v->n_light > FEW_LIGHTS;
    double trouble = screen->checked[e][many].trouble, sum = 0, seen = 0;
    // what troubles one engine troubles the others
    for (int k = 0; k < 4 && !(trouble > 0); k++) {
        if (!(screen->checked[k][many].trouble > 0)) continue;
        sum += log(screen->checked[k][many].trouble);
        seen++;
    }
    if (!(trouble > 0)) trouble = seen > 0 ? exp(sum / seen) : UNKNOWN;
    return fmin(1, MARGIN * trouble * prt_plan_error(e, n, v));
}

void prt_plan_learn(struct prt_screen *screen, enum prt_screen_engine e, uint32_t n,
                    const struct plan_view *v, double seconds)
{
    if ((unsigned)e >= 4 || !(seconds > 0) || !v->n_point) return;
    double seen = seconds / prt_plan_seconds(e, n, v);
    double *speed = &screen->slowness[e];
    // the first frame of a view also builds what later ones keep: it weighs little
    *speed = *speed > 0 ? 0.7 * *speed + 0.3 * seen : fmin(seen, 2);
    *speed = fmin(fmax(*speed, 0.05), 100);
}

// Translucent area and the smallest mean free path.
static int examine(const struct prt_context *ctx, const struct prt_screen *screen,
                   const struct prt_material *material, double *path)
{
    int status = prt_material_check(ctx, material);
    if (status) return status;
    *path = INFINITY;
    for (int c = 0; c < 3; c++)
        *path = fmin(*path, 1.0 / (double)(material->sigma_s_prime[c] + material->sigma_a[c]));
    return screen->diameter_mm > 0 ? PRT_OK : PRT_ARG;
}

uint32_t prt_plan_samples(const struct prt_screen *screen, enum prt_screen_engine e,
                          const struct plan_view *v, double seconds)
{
    double slow = screen->slowness[e] > 0 ? screen->slowness[e] : 1;
    uint32_t lo = least[e], hi = most[e];
    while (hi - lo > 1) {
        uint32_t mid = lo + (hi - lo) / 2;
        if (prt_plan_seconds(e, mid, v) * slow <= seconds) lo = mid;
        else hi = mid;
    }
    return lo;
}

static int check(const struct prt_context *ctx, const struct prt_screen *screen,
                 const struct prt_screen_input *input, double budget_ms)
{
    if (!screen || !input || !input->visibility || !input->material)
        return prt_fail(ctx, PRT_ARG, "screen: an argument is missing");
    if (!(budget_ms > 0) || !isfinite(budget_ms))
        return prt_fail(ctx, PRT_ARG, "screen: a budget of %g ms: must be positive", budget_ms);
    return PRT_OK;
}

// Everything that cost and error depend on but the engine and its samples.
static int plan_view_of(const struct prt_context *ctx, const struct prt_screen *screen,
                        const struct prt_screen_input *input, double budget_ms,
                        const struct prt_screen_options *options, struct plan_view *out)
{
    double path;
    int status = check(ctx, screen, input, budget_ms);
    if (!status) status = examine(ctx, screen, input->material, &path);
    if (status) return status;
    struct prt_gbuffer g;
    prt_visibility_gbuffer(input->visibility, &g);
    uint32_t n_light = prt_cube_lights(input, options) + input->n_extra;
    *out = (struct plan_view){.n_point = g.n_point,
                              .n_light = n_light ? n_light : 1,
                              .pixel_mm = (double)prt_view_pixel_mm(input->visibility),
                              .area_mm2 = screen->area_mm2,
                              .diameter_mm = (double)screen->diameter_mm,
                              .mean_free_path_mm = path};
    return PRT_OK;
}

static struct prt_screen_plan plan_engine(const struct prt_screen *screen,
                                          enum prt_screen_engine e,
                                          const struct plan_view *view, double budget_ms)
{
    double slow = screen->slowness[e] > 0 ? screen->slowness[e] : 1;
    struct prt_screen_plan plan = {.engine = e};
    plan.n_sample = prt_plan_samples(screen, e, view, budget_ms * 1e-3);
    plan.expected_ms = 1e3 * slow * prt_plan_seconds(e, plan.n_sample, view);
    plan.expected_error = prt_plan_expect(screen, e, plan.n_sample, view);
    return plan;
}

static void set_options(struct prt_screen_options *options, const struct prt_screen_plan *plan)
{
    if (!options) return;
    options->engine = plan->engine;
    options->n_sample = plan->n_sample;
}

int prt_screen_plan(const struct prt_context *ctx, const struct prt_screen *screen,
                    const struct prt_screen_input *input, enum prt_screen_engine engine,
                    double budget_ms, struct prt_screen_options *options,
                    struct prt_screen_plan *out)
{
    struct plan_view view;
    int status = plan_view_of(ctx, screen, input, budget_ms, options, &view);
    if (status) return status;
    if ((unsigned)engine >= PRT_SCREEN_REFERENCE)
        return prt_fail(ctx, PRT_ARG, "screen: engine '%s' takes no budget",
                        prt_screen_engine_name(engine));
    struct prt_screen_plan plan = plan_engine(screen, engine, &view, budget_ms);
    set_options(options, &plan);
    if (out) *out = plan;
    return PRT_OK;
}

// An engine that exceeds the budget by more than a tenth is taken only when all do.
static bool better_plan(const struct prt_screen_plan *a, const struct prt_screen_plan *b,
                        double budget_ms)
{
    bool a_fits = a->expected_ms <= 1.1 * budget_ms, b_fits = b->expected_ms <= 1.1 * budget_ms;
    if (a_fits != b_fits) return a_fits;
    return a_fits ? a->expected_error < b->expected_error : a->expected_ms < b->expected_ms;
}

int prt_screen_choose(const struct prt_context *ctx, const struct prt_screen *screen,
                      const struct prt_screen_input *input, double budget_ms,
                      struct prt_screen_options *options, struct prt_screen_plan *out)
{
    struct plan_view view;
    struct prt_screen_plan best = {0};
    int status = plan_view_of(ctx, screen, input, budget_ms, options, &view);
    if (status) return status;
    for (int e = 0; e < PRT_SCREEN_REFERENCE; e++) {
        struct prt_screen_plan plan =
            plan_engine(screen, (enum prt_screen_engine)e, &view, budget_ms);
        if (!e || better_plan(&plan, &best, budget_ms)) best = plan;
    }
    set_options(options, &best);
    if (out) *out = best;
    return PRT_OK;
}
