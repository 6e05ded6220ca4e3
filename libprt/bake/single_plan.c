// SPDX-License-Identifier: MIT
// Depths and thresholds of single scattering (METHODS §3.5).
#include "bake/stages.h"
#include "trace/triangle_grid.h"

#include <math.h>

static float smallest(const float c[3])
{
    return fminf(c[0], fminf(c[1], c[2]));
}

static float largest(const float c[3])
{
    return fmaxf(c[0], fmaxf(c[1], c[2]));
}

// The numbers below were chosen together. tests/physics/phases.c prints the error of the plan
// under a small light: .8 to 1.5 % by phase terms and channel. On the bunny a tile
// threshold of .04 in place of .03 spares few rays, and small lamps are missed.
void prt_single_plan_depths(struct single_plan *plan)
{
    plan->max_optical_depth = 6; // e^-6: 0.25 % of the light remains
    if (!plan->horizon)
        (void)prt_horizon_create(plan->scene, 0,
                                 &plan->horizon); // without it all rays are cast
    if (!plan->grid) plan->grid = prt_triangle_grid_create(plan->mesh);
    if (plan->extinction) { // any extinction may follow: nodes over every scale of the body
        plan->n_node = 6;
        plan->differ = plan->uncertain = 0.05f;
        plan->differ_texel = 0.2f, plan->uncertain_texel = INFINITY;
        plan->first_mm = 0.05f, plan->last_mm = 60;
        plan->inward_mm = (float)prt_mesh_diagonal(plan->mesh);
        plan->weakest = 0.2f; // media with less extinction get coarser shadows
        return;
    }
    plan->n_node = 7;
    plan->differ = 0.03f;
    plan->differ_texel = plan->uncertain = plan->uncertain_texel = 0.1f;
    plan->weakest = smallest(plan->sigma_t);
    plan->first_mm = 0.1f / largest(plan->sigma_t);
    plan->last_mm = 4 / plan->weakest;   // e^-4
    plan->inward_mm = 9 / plan->weakest; // e^-9: the light beyond is negligible
}

void prt_single_plan_finish(struct single_plan *plan)
{
    prt_horizon_destroy(plan->horizon);
    plan->horizon = NULL;
    prt_triangle_grid_destroy(plan->grid);
    plan->grid = NULL;
}

void prt_single_plan_nodes(const struct single_plan *plan, float thickness, float *depth)
{
    float first = fminf(plan->first_mm, 0.06f * thickness); // shares chosen, not measured
    float last = fminf(plan->last_mm, 0.85f * thickness);
    for (uint32_t a = 0; a < plan->n_node; a++)
        depth[a] = first * powf(last / first, (float)a / (float)(plan->n_node - 1));
}
