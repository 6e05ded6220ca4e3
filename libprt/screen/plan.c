// SPDX-License-Identifier: MIT
// Cost and expected error of a picture, and from them the sample count that a budget allows
// (METHODS §6).
#include "internal.h"

#include <math.h>
#include <string.h>

enum { N_PLANNED = PRT_SCREEN_REFERENCE }; // engines that take a budget

// Seconds of two cores: fixed + points * per_point + receivers * per_receiver + samples *
// per_sample + receivers (TANGENT: points) * samples * per_pair. Fits to the times of
// `prt-bench screen_error` on the bunny; prt_plan_learn scales them by the speed of the
// machine.
struct cost {
    double fixed, per_point, per_receiver, per_sample, per_pair; // [s]
};
static const struct cost cost_of[N_PLANNED] = {
    // samples are n x n; the tree bounds the pairs, so that per_sample holds their cost
    [PRT_SCREEN_SPLAT] = {1e-3, 4e-8, 2.5e-7, 1.5e-7, 0},
    [PRT_SCREEN_TANGENT] = {2e-3, 5e-8, 0, 0, 1.1e-8},
    [PRT_SCREEN_TEXTURE] = {2e-3, 2.2e-8, 0, 1e-6, 2e-10},
    [PRT_SCREEN_HYBRID] = {3e-3, 2.2e-8, 1.7e-7, 2e-6, 2e-10},
};
#define SECONDS_PER_RAY 5e-8 // a shadow ray, two cores; the same fit
// Receivers over points / size², and lit share of the surface, about; chosen, not measured.
#define RECEIVER_FILL 0.85
#define LIT_SHARE 0.35

// Safety factors: costs and errors were fitted on one smooth model. Without a check of a frame
// the error was 0.5 to 2.3 of the fit on bunny, dragon and Buddha in three media under three
// lights, 4 under small lights: UNCHECKED is the factor assumed before the first check. With
// checks and MARGIN it was at most 1.5 of the expected error, 0.7 in the mean.
#define UNCHECKED 1.5
#define MARGIN 1.25
// Sample counts that a budget may choose; chosen, not measured.
static const uint32_t least[N_PLANNED] = {32, 16, 64, 64};
static const uint32_t most[N_PLANNED] = {1200, 4096, 16384, 16384};
// Measured over planned seconds: bounds of the running value, the weight of a new frame, and
// the most that a first frame may count, since it also builds what later frames keep.
static const double slow_least = 0.05, slow_most = 100, new_frame = 0.3, first_frame_most = 2;

static double work_of(enum prt_screen_engine e, uint32_t n)
{
    return e == PRT_SCREEN_SPLAT ? (double)n * n : (double)n;
}

static double receivers(const struct plan_view *v, double scale_mm)
{
    uint32_t size = prt_receiver_size(v->pixel_mm, scale_mm);
    return v->n_point * RECEIVER_FILL / (size * size);
}

// Shadow rays to each light after the first: samples, or the points and the texels of the
// atlas.
static double rays_per_light(enum prt_screen_engine e, double work, const struct plan_view *v)
{
    if (e == PRT_SCREEN_TANGENT) return v->n_point + 4e4;
    return e == PRT_SCREEN_SPLAT ? work : 16 * work + 16384;
}

double prt_plan_seconds(enum prt_screen_engine e, uint32_t n, const struct plan_view *v)
{
    const struct cost *c = &cost_of[e];
    double w = work_of(e, n), lights = v->n_light > 1 ? v->n_light : 1;
    double disc = sqrt(LIT_SHARE * v->area_mm2 / w / M_PI), l = v->mean_free_path_mm;
    double pairs = e == PRT_SCREEN_TANGENT ? v->n_point : receivers(v, fmax(l, disc));
    return c->fixed + v->n_point * c->per_point + receivers(v, l) * c->per_receiver +
           pairs * w * c->per_pair + w * c->per_sample +
           (lights - 1) * rays_per_light(e, w, v) * SECONDS_PER_RAY;
}

// Relative RMSE against REFERENCE: fits of the table that `prt-bench --model bunny.glb
// screen_error` prints (three media, a distant light). x: samples in a square of surface whose
// side is a mean free path; TANGENT's samples are a pixel's.
double prt_plan_error(enum prt_screen_engine e, uint32_t n, const struct plan_view *v)
{
    double l = v->mean_free_path_mm > 0 ? v->mean_free_path_mm : 1e-3, w = work_of(e, n);
    double diameter_mm = v->diameter_mm;
    double x =
        w * l * l / (e == PRT_SCREEN_SPLAT ? diameter_mm * diameter_mm : v->area_mm2 + 1e-12);
    // the longest mean free path of the table is 0.8 mm on a model of 50 mm
    double shorter = fmax(1, 0.016 * diameter_mm / l), few = pow(fmax(1, 900.0 / n), 0.25);
    switch (e) {
    case PRT_SCREEN_SPLAT:
        // many lights: layers from all sides, half of which one light does not see
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
    double ratio = screen->checked[e][many].ratio, sum = 0, checked = 0;
    // errors of the engines correlate: one without a check takes the geometric mean of the
    // others
    for (int k = 0; k < N_PLANNED && !(ratio > 0); k++) {
        if (!(screen->checked[k][many].ratio > 0)) continue;
        sum += log(screen->checked[k][many].ratio);
        checked++;
    }
    if (!(ratio > 0)) ratio = checked > 0 ? exp(sum / checked) : UNCHECKED;
    return fmin(1, MARGIN * ratio * prt_plan_error(e, n, v));
}

void prt_plan_learn(struct prt_screen *screen, enum prt_screen_engine e, uint32_t n,
                    const struct plan_view *v, double seconds)
{
    if ((unsigned)e >= N_PLANNED || !(seconds > 0) || !v->n_point) return;
    double measured = seconds / prt_plan_seconds(e, n, v);
    double *slow = &screen->slowness[e];
    *slow = *slow > 0 ? (1 - new_frame) * *slow + new_frame * measured
                      : fmin(measured, first_frame_most);
    *slow = fmin(fmax(*slow, slow_least), slow_most);
}

// The smallest mean free path of the media; PRT_ARG where one or the model is degenerate.
static int examine(const struct prt_context *ctx, const struct prt_screen *screen,
                   const struct prt_media *media, double *path)
{
    int status = prt_media_check(ctx, media, screen->mesh->n_object);
    if (status) return status;
    *path = INFINITY;
    for (uint32_t c = 0; c < 3 * media->n; c++) {
        const struct prt_material *m = &media->medium[c / 3];
        *path = fmin(*path, 1.0 / (double)(m->sigma_s_prime[c % 3] + m->sigma_a[c % 3]));
    }
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
    if (!screen || !input || !input->visibility || !input->media.n)
        return prt_fail(ctx, PRT_ARG, "screen: screen, visibility or media are missing");
    if (!(budget_ms > 0) || !isfinite(budget_ms))
        return prt_fail(ctx, PRT_ARG, "screen: a budget of %g ms: must be positive", budget_ms);
    return PRT_OK;
}

// All that cost and error depend on besides the engine and its samples.
static int plan_view_of(const struct prt_context *ctx, const struct prt_screen *screen,
                        const struct prt_screen_input *input, double budget_ms,
                        const struct prt_screen_options *options, struct plan_view *out)
{
    double path;
    int status = check(ctx, screen, input, budget_ms);
    if (!status) status = examine(ctx, screen, &input->media, &path);
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
    if ((unsigned)engine >= N_PLANNED)
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
    for (int e = 0; e < N_PLANNED; e++) {
        struct prt_screen_plan plan =
            plan_engine(screen, (enum prt_screen_engine)e, &view, budget_ms);
        if (!e || better_plan(&plan, &best, budget_ms)) best = plan;
    }
    set_options(options, &best);
    if (out) *out = best;
    return PRT_OK;
}
