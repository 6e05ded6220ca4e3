// SPDX-License-Identifier: MIT
// The tensor of single scattering's planes of exit (METHODS §3.6), interpolated from supports.
#include "bake/shard.h"
#include "bake/support.h"
#include "bake/view_fit.h"

// Supports and texels across a face of their light. Bunny of 35k vertices: METHODS §3.6.
static const uint32_t most_supports = 9000, light_across = 8;
// Most columns of a cluster. With 24 the error is .7 % larger; packing drops columns whose
// energy is not worth their bytes.
static const uint32_t view_rank = 64;
static const uint32_t draft_supports = 2500, draft_rank = 16; // chosen

bool prt_bake_has_view(const struct bake *b)
{
    return b->o.exit_planes && !b->o.no_single && !b->o.draft && b->surface &&
           prt_bake_any_single(b) && b->o.storage == PRT_STORAGE_FACTORED &&
           b->o.engine != PRT_TRANSPORT_POLYNOMIAL;
}

int prt_bake_view(struct bake *b, const struct extinction_table *extinction,
                  const struct probes *probes, const struct training *training,
                  uint32_t n_training)
{
    const uint32_t n_base = extinction ? extinction->n_function : 3;
    struct support *s;
    int status = prt_support_create(b, most_supports, VIEW_PLANES * n_base, light_across, &s);
    if (status) return status;
    struct tensor_job job = {.bake = b,
                             .term = PRT_TERM_VIEW,
                             .stage = "exit planes",
                             .range = prt_support_range,
                             .n_function = VIEW_PLANES * n_base,
                             .n_phase = VIEW_PLANES,
                             .probes = probes,
                             .training = training,
                             .n_training = n_training,
                             .most_rank = view_rank,
                             .user = s};
    if (!prt_shard_assembling(b)) status = prt_support_trace_view(b, extinction, s);
    if (status == PRT_OK) status = prt_bake_tensor(&job);
    prt_support_destroy(s);
    return status;
}

int prt_bake_draft_single(struct tensor_job *job, const struct extinction_table *extinction)
{
    struct bake *b = job->bake;
    struct support *s;
    int status = prt_support_create(b, draft_supports, job->n_function, SUPPORT_LIGHT, &s);
    if (status) return status;
    job->range = prt_support_range;
    job->user = s;
    job->most_rank = draft_rank;
    if (!prt_shard_assembling(b)) status = prt_support_trace_axis(b, extinction, s);
    if (status == PRT_OK) status = prt_bake_tensor(job);
    prt_support_destroy(s);
    return status;
}
