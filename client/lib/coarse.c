// SPDX-License-Identifier: MIT
// The coarse order of a model's vertices, and colours of its first ones (PROTOCOL.md,
// GEOMETRY).
#include "internal.h"

// Whether the order has each vertex once, and parents that come before their children.
static bool order_holds(const struct relight_coarse_order *o)
{
    uint8_t *seen = calloc((size_t)o->n_vertex + 1, 1);
    bool good = seen && o->n_root <= o->n_vertex && (o->n_root || !o->n_vertex);
    for (uint32_t i = 0; good && i < o->n_vertex; i++) {
        good = o->vertex[i] < o->n_vertex && !seen[o->vertex[i]] &&
               (i < o->n_root || (o->parent[i][0] < i && o->parent[i][1] < i));
        if (good) seen[o->vertex[i]] = 1;
    }
    free(seen);
    return good;
}

int relight_get_coarse_order(const Relight__GeometryAnswer *m, const struct answer *answer,
                             struct relight_coarse_order *out, struct relight_error *error)
{
    const uint64_t n = m->n_vertex, at = m->coarse_parents_offset;
    *out = (struct relight_coarse_order){0};
    if (at % RELIGHT_FRAME_ALIGN || at < 4 * n || at > answer->payload_size ||
        8 * n > answer->payload_size - at)
        return relight_fail(error, RELIGHT_E_PROTOCOL, "",
                            "geometry answer: an order of %u vertices does not fit its bytes",
                            m->n_vertex);
    struct relight_coarse_order order = {
        .hash = m->coarse_order,
        .n_vertex = m->n_vertex,
        .n_root = m->n_coarse_root,
        .vertex = (const uint32_t *)(const void *)answer->payload,
        .parent = (const uint32_t(*)[2])(const void *)(answer->payload + at),
    };
    if (!order_holds(&order))
        return relight_fail(error, RELIGHT_E_PROTOCOL, "",
                            "geometry answer: its order does not have each vertex once, after "
                            "its parents");
    *out = order;
    return 0;
}

int relight_coarse_order(struct relight_client *client, const char *model,
                         struct relight_coarse_order *out, struct relight_error *error)
{
    Relight__GeometryRequest m = RELIGHT__GEOMETRY_REQUEST__INIT;
    struct relight_coarse_order order;
    struct answer *answer;
    m.model = relight_text(model);
    m.coarse = true;
    int status = relight_call(client, RELIGHT_TYPE_GEOMETRY, &m.base, &answer, error);
    if (status) return status;
    status = relight_get_coarse_order((Relight__GeometryAnswer *)answer->message, answer,
                                      &order, error);
    if (status) {
        relight_answer_free(answer);
        return status;
    }
    if (!(order.owner = relight_owner(answer)))
        return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory for an order");
    *out = order;
    return 0;
}

void relight_coarse_order_finish(struct relight_coarse_order *order)
{
    relight_owner_free(order->owner);
    *order = (struct relight_coarse_order){0};
}

int relight_coarse_expand(const struct relight_coarse_order *order,
                          const struct relight_colors *colors, uint32_t plane, float *out)
{
    const uint32_t sent = colors->n_coarse;
    if (!sent) return relight_colors_decode(colors, plane, out);
    if (order->hash != colors->coarse_order || order->n_vertex != colors->n_vertex ||
        sent < order->n_root)
        return -RELIGHT_E_MISMATCH;
    float(*at)[3] = malloc(12 * ((size_t)order->n_vertex + 1)); // by position
    if (!at) return -RELIGHT_E_NO_MEMORY;
    int status = relight_colors_decode(colors, plane, at[0]);
    for (uint32_t i = sent; i < order->n_vertex && !status; i++)
        for (int c = 0; c < 3; c++)
            at[i][c] = 0.5f * (at[order->parent[i][0]][c] + at[order->parent[i][1]][c]);
    for (uint32_t i = 0; i < order->n_vertex && !status; i++)
        memcpy(out + 3 * (size_t)order->vertex[i], at[i], 12);
    free(at);
    return status;
}
