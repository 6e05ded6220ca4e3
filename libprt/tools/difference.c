// SPDX-License-Identifier: MIT
// Where the dipole errs: its multiple scattering against that of random walks, at every vertex,
// as a false colour (METHODS §9).
#include "difference.h"

#include <math.h>
#include <stdlib.h>

static double sum3(const float rgb[3])
{
    return (double)rgb[0] + (double)rgb[1] + (double)rgb[2];
}

const double difference_legend[DIFFERENCE_LEGEND] = {-0.5, -0.2, -0.1, 0, 0.1, 0.25, 1};

void difference_color(double excess, float out[3])
{
    const double t = fmin(fmax(log2(fmax(1 + excess, 0.5)), -1), 1);
    out[0] = (float)(t < 0 ? 1 + t : 1);
    out[1] = (float)(1 - fabs(t));
    out[2] = (float)(t > 0 ? 1 - t : 1);
}

static int ratio_order(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

// Translucent vertices that walks leave any light.
static int measure(const struct source *source, const float (*dipole)[3],
                   const float (*walk)[3], struct difference *out)
{
    const struct prt_mesh *mesh = source->mesh;
    double *ratio = malloc((mesh->n_vertex + 1u) * sizeof *ratio), error = 0, all = 0;
    uint32_t *block = prt_mesh_vertex_blocks(mesh), n = 0;
    if (!ratio || !block) {
        free(ratio);
        prt_free(block);
        return PRT_NOMEM;
    }
    for (uint32_t v = 0; v < mesh->n_vertex; v++) {
        if (!mesh->surface[mesh->block[block[v]].surface].translucent) continue;
        for (int c = 0; c < 3; c++) {
            const double d = (double)dipole[v][c] - (double)walk[v][c];
            error += d * d;
            all += (double)walk[v][c] * (double)walk[v][c];
        }
        if (sum3(walk[v]) > 0) ratio[n++] = sum3(dipole[v]) / sum3(walk[v]) - 1;
    }
    qsort(ratio, n, sizeof *ratio, ratio_order);
    out->rms = all > 0 ? sqrt(error / all) : 0;
    out->darkest = n ? ratio[n / 50] : 0;
    out->brightest = n ? ratio[n - 1 - n / 50] : 0;
    free(ratio);
    prt_free(block);
    return PRT_OK;
}

// Multiple scattering of the walks: of the bake, or of the reference.
static int walked(struct tool *tool, const struct source *source, const struct prt_cube *light,
                  bool baked, float (*out)[3])
{
    if (baked) {
        const bool own_light = source->transport->engine == PRT_TRANSPORT_POLYNOMIAL;
        struct prt_query query = {.term = PRT_ANSWER_MULTIPLE,
                                  .light = own_light ? NULL : light};
        if (source->media_given) query.media = source->media;
        return prt_answer_colors(&tool->ctx, source->transport, &query, out);
    }
    struct prt_reference_options options =
        reference_options(&tool->opt, source, "multiple", NULL);
    return prt_reference_colors(&tool->ctx, source->mesh, &source->media, light, &options, out);
}

int difference_colors(struct tool *tool, const struct source *source,
                      const struct prt_cube *light, bool baked, float (*color)[3],
                      struct difference *out)
{
    const uint32_t n = source->mesh->n_vertex;
    float(*dipole)[3] = prt_alloc(n, sizeof *dipole), (*walk)[3] = prt_alloc(n, sizeof *walk);
    int status = dipole && walk
                     ? PRT_OK
                     : prt_fail(&tool->ctx, PRT_NOMEM, "no memory for the difference");
    if (!status) status = walked(tool, source, light, baked, walk);
    if (!status) {
        struct prt_reference_options options =
            reference_options(&tool->opt, source, "multiple", NULL);
        options.n_walk = 0;
        status = prt_reference_colors(&tool->ctx, source->mesh, &source->media, light, &options,
                                      dipole);
    }
    if (!status)
        status = measure(source, (const float(*)[3])dipole, (const float(*)[3])walk, out);
    for (uint32_t v = 0; v < n && !status; v++)
        difference_color(sum3(walk[v]) > 0     ? sum3(dipole[v]) / sum3(walk[v]) - 1
                         : sum3(dipole[v]) > 0 ? 1
                                               : 0,
                         color[v]);
    prt_free(dipole);
    prt_free(walk);
    return tool_exit(tool, status);
}
