// SPDX-License-Identifier: MIT
// A transport contracted with one light, which many materials can then be applied to.
#include "answer.h"

#include <string.h>

struct prt_contracted_light {
    const struct prt_transport *transport;
    size_t bytes;
    float *b[PRT_MOST_TENSORS]; // results of prt_contract_light; NULL for tensors without bases
};

size_t prt_contracted_light_floats(const struct prt_tensor *t)
{
    size_t wide = t->coupling == PRT_COUPLE_FULL ? 3 : 1;
    size_t n = (size_t)t->rows.n_row * t->n_function * wide;
    return t->storage == PRT_STORAGE_FACTORED
               ? n + 1
               : 0; // at least one, so that an allocation of it succeeds
}

static int contract_all(const struct prt_context *ctx, const struct prt_light *light,
                        struct prt_contracted_light *lit)
{
    const struct prt_transport *t = lit->transport;
    int status = PRT_OK;
    for (uint32_t i = 0; i < t->n_tensor && !status; i++) {
        size_t n = prt_contracted_light_floats(&t->tensor[i]);
        if (!n) continue;
        lit->b[i] = prt_alloc(n, sizeof *lit->b[i]);
        lit->bytes += n * sizeof *lit->b[i];
        if (!lit->b[i]) return prt_fail(ctx, PRT_NOMEM, "no memory for a contracted light");
        status = prt_contract_light(ctx, &t->tensor[i], 1, &light, lit->b[i]);
    }
    return status;
}

int prt_contracted_light_create(const struct prt_context *ctx,
                                const struct prt_transport *transport,
                                const struct prt_cube *light, struct prt_contracted_light **out)
{
    *out = NULL;
    for (uint32_t i = 0; i < transport->n_tensor; i++)
        if (transport->tensor[i].storage == PRT_STORAGE_SPARSE)
            return prt_fail(
                ctx, PRT_MISMATCH,
                "sparse storage has no bases that a light could be contracted with: bake with "
                "--storage factored");
    struct prt_contracted_light *lit = prt_calloc(1, sizeof *lit);
    struct prt_light haar = {0};
    int status = lit ? prt_light_from_cube(light, &haar) : PRT_NOMEM;
    if (status) {
        prt_free(lit);
        return prt_fail(ctx, status, "no memory for the wavelet transform of a light");
    }
    lit->transport = transport;
    status = contract_all(ctx, &haar, lit);
    prt_light_finish(&haar);
    if (status) prt_contracted_light_destroy(lit);
    else *out = lit;
    return status;
}

void prt_contracted_light_destroy(struct prt_contracted_light *lit)
{
    for (int i = 0; lit && i < PRT_MOST_TENSORS; i++) prt_free(lit->b[i]);
    prt_free(lit);
}

size_t prt_contracted_light_bytes(const struct prt_contracted_light *lit)
{
    return lit->bytes;
}

bool prt_contracted_light_is_of(const struct prt_contracted_light *lit,
                                const struct prt_transport *transport)
{
    return lit->transport == transport;
}

const float *prt_contracted_light_rows(const struct prt_contracted_light *lit,
                                       const struct prt_tensor *tensor)
{
    return lit->b[tensor - lit->transport->tensor];
}

int prt_contracted_light_relight(const struct prt_context *ctx,
                                 const struct prt_contracted_light *lit,
                                 const struct prt_tensor *tensor, const float *coef, bool add,
                                 float *color)
{
    const float *b = prt_contracted_light_rows(lit, tensor);
    if (!b) return prt_relight(ctx, tensor, 1, NULL, coef, add, color); // RADIAL: no light
    if (tensor->coupling != PRT_COUPLE_FULL) return prt_expand(ctx, tensor, 1, b, add, color);
    float *folded =
        prt_alloc((size_t)tensor->rows.n_row * 3 * tensor->n_phase + 1, sizeof *folded);
    int status = folded ? prt_contract_material(ctx, tensor, b, coef, folded)
                        : prt_fail(ctx, PRT_NOMEM, "no memory to apply a material");
    if (!status) status = prt_expand(ctx, tensor, 1, folded, add, color);
    prt_free(folded);
    return status;
}
