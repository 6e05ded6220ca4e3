// SPDX-License-Identifier: MIT
// A joint transport contracted with its objects' media. It owns the folded rows and the media,
// and borrows everything else from the transport.
#include "answer.h"
#include "prt/columns.h"

#include <string.h>

struct prt_contracted_transport {
    struct prt_transport transport;
    struct prt_rows
        rows[PRT_MOST_TENSORS]; // owned; n_row 0: this tensor uses the transport's rows
    struct prt_columns *columns[PRT_MOST_TENSORS]; // owned; of `rows`, or NULL
    struct prt_media *media;                       // owned
    size_t bytes;
};

static bool is_joint(const struct prt_tensor *t)
{
    return t->coupling == PRT_COUPLE_FULL && t->storage == PRT_STORAGE_FACTORED;
}

// coef[medium][n_phase][n_radial][3], multiplied by each phase plane's factor.
static int plane_coefs(const struct prt_context *ctx, const struct prt_transport *transport,
                       const struct prt_tensor *t, const struct prt_media *media, float *coef)
{
    const size_t n = 3 * (size_t)t->n_radial;
    // in place, the last medium first: nothing moves to a lower address
    int status = prt_basis_coef(ctx, transport, t, media, coef);
    for (uint32_t m = media->n; m-- > 0 && !status;)
        for (uint32_t k = t->n_phase; k-- > 0;) {
            float factor[3] = {1, 1, 1}, *to = coef + (m * t->n_phase + k) * n;
            if (prt_term_is_single(t->term))
                prt_phase_plane_factor(&media->medium[m], t, k, factor);
            for (size_t i = 0; i < n; i++) to[i] = coef[m * n + i] * factor[i % 3];
        }
    return status;
}

static int contract_tensor(const struct prt_context *ctx, const struct prt_transport *transport,
                           const struct prt_media *media, uint32_t i,
                           struct prt_contracted_transport *fixed)
{
    const struct prt_tensor *from = &transport->tensor[i];
    struct prt_tensor *t = &fixed->transport.tensor[i];
    struct prt_rows *rows = &fixed->rows[i];
    float *coef = prt_alloc(3ull * from->n_radial * from->n_phase * media->n, sizeof *coef);
    uint8_t *medium = NULL;
    uint32_t *object = NULL;
    int status = coef ? prt_cluster_media(transport, from, media, &medium) : PRT_NOMEM;
    if (!status) status = prt_cluster_objects(transport, from, &object);
    if (status) prt_fail(ctx, status, "no memory to apply a material");
    if (!status) status = plane_coefs(ctx, transport, from, media, coef);
    if (!status)
        status = prt_rows_fold_planes(ctx, from, coef, medium, object, PRT_FIXED_ERROR, rows);
    prt_free(coef);
    prt_free(object);
    prt_free(medium);
    if (status) return status;
    const uint64_t n = rows->begin[rows->n_row];
    fixed->bytes += n * (rows->index_bytes + 2ull * rows->n_function) +
                    rows->n_row * (8 + 12ull * rows->n_function);
    t->coupling = PRT_COUPLE_DIAGONAL;
    t->n_function = rows->n_function;
    t->n_radial = t->n_knot = t->n_eta = 0;
    t->knot = t->basis = t->eta = NULL;
    t->rows = *rows;
    t->columns = NULL;
    return PRT_OK;
}

int prt_contracted_transport_create(const struct prt_context *ctx,
                                    const struct prt_transport *transport,
                                    const struct prt_media *media,
                                    struct prt_contracted_transport **out)
{
    bool any = false;
    *out = NULL;
    for (uint32_t i = 0; i < transport->n_tensor; i++) any |= is_joint(&transport->tensor[i]);
    if (!any)
        return prt_fail(
            ctx, PRT_MISMATCH,
            "only a joint transport can be contracted with a material; this one is not");
    int status = prt_free_media_check(ctx, transport, media);
    if (status) return status;
    struct prt_contracted_transport *fixed = prt_calloc(1, sizeof *fixed);
    if (fixed) fixed->media = prt_media_copy(media, transport->mesh.n_object);
    if (!fixed || !fixed->media) {
        prt_free(fixed);
        return prt_fail(ctx, PRT_NOMEM, "no memory to apply a material");
    }
    fixed->transport = *transport;
    fixed->transport.media = *fixed->media;
    fixed->transport.engine = PRT_TRANSPORT_WAVELET;
    fixed->bytes = sizeof *fixed + media->n * sizeof *media->medium;
    for (uint32_t i = 0; i < transport->n_tensor && !status; i++)
        if (is_joint(&transport->tensor[i]))
            status = contract_tensor(ctx, transport, media, i, fixed);
    if (status) prt_contracted_transport_destroy(fixed);
    else *out = fixed;
    return status;
}

int prt_contracted_transport_columns(const struct prt_context *ctx,
                                     struct prt_contracted_transport *fixed)
{
    int status = PRT_OK;
    for (uint32_t i = 0; i < fixed->transport.n_tensor && !status; i++) {
        struct prt_tensor *t = &fixed->transport.tensor[i];
        struct prt_columns *columns = NULL;
        if (!fixed->rows[i].n_row || !prt_columns_possible(t)) continue;
        status = prt_columns_make(ctx, t, &columns);
        if (columns) fixed->bytes += columns->bytes;
        t->columns = fixed->columns[i] = columns;
    }
    return status;
}

void prt_contracted_transport_destroy(struct prt_contracted_transport *fixed)
{
    for (int i = 0; fixed && i < PRT_MOST_TENSORS; i++) {
        prt_rows_finish(&fixed->rows[i]);
        prt_columns_destroy(fixed->columns[i]);
    }
    if (fixed) prt_free(fixed->media);
    prt_free(fixed);
}

const struct prt_transport *
prt_contracted_transport_get(const struct prt_contracted_transport *fixed)
{
    return &fixed->transport;
}

size_t prt_contracted_transport_bytes(const struct prt_contracted_transport *fixed)
{
    return fixed->bytes;
}
