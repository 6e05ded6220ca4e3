// SPDX-License-Identifier: MIT
// Progressive pictures: the running mean of frames of one view.
#include "internal.h"

#include <string.h>

struct prt_screen_progress {
    struct prt_screen *screen;
    const struct prt_visibility *vis;
    uint32_t n_frame, n_point;
    float (*mean)[3], (*next)[3];
};

int prt_screen_progress_create(const struct prt_context *ctx, struct prt_screen *screen,
                               const struct prt_visibility *vis,
                               struct prt_screen_progress **out)
{
    struct prt_gbuffer g;
    if (!screen || !vis) return prt_fail(ctx, PRT_ARG, "screen: an argument is missing");
    prt_visibility_gbuffer(vis, &g);
    struct prt_screen_progress *p = prt_calloc(1, sizeof *p);
    if (p) {
        *p = (struct prt_screen_progress){.screen = screen, .vis = vis, .n_point = g.n_point};
        p->mean = prt_alloc((size_t)g.n_point + 1, sizeof *p->mean);
        p->next = prt_alloc((size_t)g.n_point + 1, sizeof *p->next);
    }
    if (!p || !p->mean || !p->next) {
        prt_screen_progress_destroy(p);
        return prt_fail(ctx, PRT_NOMEM, "screen: no memory for %u points", g.n_point);
    }
    *out = p;
    return PRT_OK;
}

void prt_screen_progress_destroy(struct prt_screen_progress *p)
{
    if (!p) return;
    prt_free(p->mean);
    prt_free(p->next);
    prt_free(p);
}

void prt_screen_progress_restart(struct prt_screen_progress *p)
{
    p->n_frame = 0;
}

uint32_t prt_screen_progress_frames(const struct prt_screen_progress *p)
{
    return p->n_frame;
}

int prt_screen_progress_image(const struct prt_context *ctx, struct prt_screen_progress *p,
                              const struct prt_material *material, const struct prt_cube *cube,
                              uint32_t n_extra, const struct prt_screen_light *extra,
                              const struct prt_screen_options *options,
                              const struct prt_shade *shade, struct prt_image *out,
                              struct prt_screen_report *report)
{
    if (!options || !shade || !out)
        return prt_fail(ctx, PRT_ARG, "screen: an argument is missing");
    struct prt_screen_options own = *options;
    struct prt_screen_report unused;
    if (!report) report = &unused;
    own.frame = p->n_frame;
    own.refine = 0;
    own.measure_error = false;
    // a count chosen anew each time would weigh frames that differ alike
    int status = prt_screen_radiance(ctx, p->screen, p->vis, material, cube, n_extra, extra,
                                     &own, p->next, report);
    if (status) return status;
    // frame k weighs k+1: what the first ones smoothed away fades
    float share = 2 / (float)(p->n_frame + 2);
    for (uint32_t i = 0; i < p->n_point; i++)
        for (int k = 0; k < 3; k++)
            p->mean[i][k] = p->n_frame ? p->mean[i][k] + share * (p->next[i][k] - p->mean[i][k])
                                       : p->next[i][k];
    if (p->n_frame < UINT32_MAX - 1) p->n_frame++;
    if (options->measure_error && frame_measurable(options)) {
        status = screen_measure(ctx, p->screen, p->vis, material, cube, n_extra, extra, options,
                                (const float(*)[3])p->mean, &report->error);
        if (status) return status;
    }
    return prt_shade_points(ctx, p->vis, (const float(*)[3])p->mean, shade, out);
}
