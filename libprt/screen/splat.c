// SPDX-License-Identifier: MIT
// Splatting (S09): points on a grid that the light sees, or on peeled layers under an
// environment, each spread to the pixels within r_max. Far splats are joined in a tree, which
// bounds the cost.
#include "internal.h"

#include <math.h>
#include <string.h>

// Points a side of the grid: by default at a spacing of SPACING mean free paths, and at the
// most after refinement. Peeled layers are three grids with all their depths, hence fewer.
// Chosen, not measured.
enum { GRID_MIN = 32, GRID_MAX = 300, PEEL_MAX = 160, GRID_FINE = 1200 };
enum { MAX_LIGHT_VIEWS = 4 }; // more lights take peeled layers; chosen, not measured
#define SPACING 0.75f
#define DEFAULT_EPSILON 0.002f
#define OPENING 0.8f // of the tree; chosen, not measured

// S09 eq 4 with the closed form of METHODS §1: the tail beyond r_max is epsilon of rho_d, for
// the channel that reaches furthest.
static float cut_radius(const struct frame *f, double epsilon)
{
    double most = 0;
    for (uint32_t o = 0; o < f->n_object; o++) {
        for (int c = 0; c < 3; c++) {
            const struct prt_diffusion *d = &f->dipole[o][c];
            double lo = 0, hi = 4 * (double)f->screen->diameter_mm + 1;
            for (int k = 0; k < 48; k++) {
                double r = (lo + hi) / 2;
                if (prt_diffusion_tail(d, r) < epsilon * d->rho_d) hi = r;
                else lo = r;
            }
            most = fmax(most, hi);
        }
    }
    return (float)most;
}

struct grid prt_frame_grid(const struct frame *f, float spacing_mm)
{
    struct grid grid = {f->screen->triangle_block, spacing_mm, {0, 0}, 0};
    if (!f->seed) return grid;
    struct prt_rng rng;
    prt_rng_init(&rng, f->seed, 7);
    for (int k = 0; k < 2; k++) grid.phase[k] = prt_rng_f32(&rng);
    grid.turn = (float)M_PI / 2 * prt_rng_f32(&rng);
    return grid;
}

int prt_scatter_discs(struct frame *f, const struct samples *s, double r_p, float opening,
                      float r_max)
{
    struct radial_table *table = prt_calloc(f->n_object ? f->n_object : 1, sizeof *table);
    if (!table) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    for (uint32_t first = 0, last; first < s->n; first = last) {
        uint32_t object = s->object[first];
        double area = 0, power = 0;
        for (last = first; last < s->n && s->object[last] == object; last++) {
            double w =
                (double)((s->e[0][last] + s->e[1][last] + s->e[2][last]) * s->area[last]);
            area += w * (double)s->area[last];
            power += w;
        }
        double disc = power > 0 ? sqrt(area / power / M_PI) : 0;
        prt_split_table(f, object, r_p, 0, true, disc,
                        r_p >= 0 ? r_max : f->screen->diameter_mm, &table[object]);
    }
    int status = prt_scatter_tree(f, table, s, opening, r_max);
    prt_free(table);
    return status;
}

int prt_frame_light_view(struct frame *f, uint32_t l, const struct grid *grid,
                         struct samples *out)
{
    int status = prt_samples_light_view(f->ctx, f->screen->scene, &f->light[l], grid, f->eta,
                                        out, &f->report->grid, &f->report->n_ray);
    if (status) return status;
    if (!maps_turn(f)) {
        if ((status = prt_map_occlude(f, out))) prt_samples_finish(out);
        return status;
    }
    // the irradiance that the light view carries has the mesh's normals: computed again
    uint32_t n = f->n_light;
    struct prt_screen_light *all = f->light;
    f->light += l;
    f->n_light = 1;
    status = prt_frame_irradiance(f, out);
    f->light = all;
    f->n_light = n;
    if (status) prt_samples_finish(out);
    return status;
}

// Adds light of the grid points that each light sees.
int prt_scatter_light_views(struct frame *f, double r_p, float spacing, float opening,
                            float r_max)
{
    struct grid grid = prt_frame_grid(f, spacing);
    for (uint32_t l = 0; l < f->n_light; l++) {
        struct samples s;
        double t0 = prt_time_s();
        int status = prt_frame_light_view(f, l, &grid, &s);
        if (status) return status;
        double t1 = prt_time_s();
        f->report->irradiance_s += t1 - t0;
        f->report->n_sample += s.n;
        status = prt_scatter_discs(f, &s, r_p, opening, r_max);
        f->report->scatter_s += prt_time_s() - t1;
        prt_samples_finish(&s);
        if (status) return status;
    }
    return PRT_OK;
}

bool prt_frame_light_views_only(const struct frame *f)
{
    bool views = !f->cube && !f->options->vertex_irradiance && f->n_light <= MAX_LIGHT_VIEWS;
    for (uint32_t l = 0; l < f->n_light; l++) views &= !f->light[l].point;
    return views;
}

int prt_engine_splat(struct frame *f)
{
    struct prt_screen *screen = f->screen;
    float lu = prt_frame_mean_free_path(f), diameter = screen->diameter_mm;
    float epsilon = f->options->epsilon > 0 ? f->options->epsilon : DEFAULT_EPSILON;
    float r_max = cut_radius(f, epsilon), spacing = SPACING * lu;
    bool views = prt_frame_light_views_only(f);
    uint32_t least = GRID_MIN, most = views ? GRID_MAX : PEEL_MAX;
    float n = diameter / spacing;
    if (f->options->n_sample) least = most = f->options->n_sample;
    else if (f->options->budget_ms > 0) {
        struct plan_view view = prt_frame_plan(f);
        n = min_f(n, (float)prt_plan_samples(screen, PRT_SCREEN_SPLAT, &view,
                                             (double)f->options->budget_ms * 1e-3));
    }
    n = n < least ? least : n > most ? most : n;
    // refinement doubles the points, not the grid's side
    n = min_f(n * exp2f(0.5f * (float)min_u(f->options->refine, 12)), max_f(n, GRID_FINE));
    f->report->n_asked = (uint32_t)n;
    spacing = diameter / n;
    f->report->r_max_mm = r_max;
    f->report->grid = (uint32_t)n;
    int status = prt_receivers_begin(f, (double)lu);
    if (status) return status;
    if (views) {
        status = prt_scatter_light_views(f, -1, spacing, OPENING, r_max);
        return status ? status : prt_receivers_resolve(f);
    }
    if (!screen->peel.n || screen->peel_spacing != spacing || screen->peel_seed != f->seed) {
        struct grid grid = prt_frame_grid(f, spacing);
        prt_samples_finish(&screen->peel);
        status =
            prt_samples_peel(f->ctx, screen->scene, &grid, &screen->peel, &f->report->n_ray);
        if (status) return status;
        screen->peel_spacing = spacing;
        screen->peel_seed = f->seed;
    }
    double t0 = prt_time_s();
    status = prt_frame_irradiance(f, &screen->peel);
    double t1 = prt_time_s();
    if (!status) status = prt_scatter_discs(f, &screen->peel, -1, OPENING, r_max);
    f->report->irradiance_s = t1 - t0;
    f->report->scatter_s = prt_time_s() - t1;
    f->report->n_sample = screen->peel.n;
    return status ? status : prt_receivers_resolve(f);
}
