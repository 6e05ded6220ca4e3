// SPDX-License-Identifier: MIT
// A material in the radial basis that a tensor carries. Making a basis from its table takes far
// longer than fitting a material, so the last few bases are kept, named by their content.
#include "answer.h"

#include <pthread.h>
#include <string.h>

#include "prt/radial.h"

enum { N_KEPT = 8 };

struct kept {
    uint64_t key, last_use;
    unsigned users;
    struct prt_radial *radial;
};

static struct kept kept[N_KEPT];
static uint64_t clock_now;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

static struct prt_radial_options options_of(const struct prt_transport *transport,
                                            const struct prt_tensor *tensor)
{
    bool single = tensor->term == PRT_TERM_SINGLE;
    return (struct prt_radial_options){.kind = (enum prt_radial_kind)tensor->basis_kind,
                                       .family =
                                           single ? PRT_FAMILY_EXTINCTION : PRT_FAMILY_DIPOLE,
                                       .eta = (double)transport->material.eta,
                                       .radius_mm = (double)tensor->knot[tensor->n_knot - 1]};
}

static uint64_t key_of(const struct prt_radial_options *o, const struct prt_tensor *t)
{
    uint64_t key = prt_hash64(t->knot, 4ull * t->n_knot, (uint64_t)o->kind);
    key = prt_hash64(t->basis, 4ull * t->n_knot * t->n_radial, key);
    return prt_hash64(&o->eta, sizeof o->eta, key + (uint64_t)o->family);
}

// A slot that nobody uses, the least recently used; NULL when all are in use. Under the lock.
static struct kept *free_slot(void)
{
    struct kept *best = NULL;
    for (int i = 0; i < N_KEPT; i++)
        if (!kept[i].users && (!best || kept[i].last_use < best->last_use)) best = &kept[i];
    return best;
}

static struct kept *find(uint64_t key)
{
    for (int i = 0; i < N_KEPT; i++)
        if (kept[i].radial && kept[i].key == key) {
            kept[i].users++;
            kept[i].last_use = ++clock_now;
            return &kept[i];
        }
    return NULL;
}

// *slot is the place that keeps *radial, NULL when the caller has to destroy it.
static int acquire(const struct prt_context *ctx, const struct prt_transport *transport,
                   const struct prt_tensor *tensor, struct kept **slot,
                   struct prt_radial **radial)
{
    struct prt_radial_options options = options_of(transport, tensor);
    uint64_t key = key_of(&options, tensor);
    pthread_mutex_lock(&lock);
    *slot = find(key);
    pthread_mutex_unlock(&lock);
    if (*slot) {
        *radial = (*slot)->radial;
        return PRT_OK;
    }
    int status = prt_radial_from_table(ctx, &options, tensor->n_radial, tensor->n_knot,
                                       tensor->knot, tensor->basis, radial);
    if (status) return status;
    struct prt_radial *old = NULL;
    pthread_mutex_lock(&lock);
    if ((*slot = free_slot())) {
        old = (*slot)->radial;
        **slot = (struct kept){key, ++clock_now, 1, *radial};
    }
    pthread_mutex_unlock(&lock);
    prt_radial_destroy(old);
    return PRT_OK;
}

static void release(struct kept *slot, struct prt_radial *radial)
{
    if (!slot) {
        prt_radial_destroy(radial);
        return;
    }
    pthread_mutex_lock(&lock);
    slot->users--;
    pthread_mutex_unlock(&lock);
}

__attribute__((destructor)) static void drop_all(void)
{
    for (int i = 0; i < N_KEPT; i++) prt_radial_destroy(kept[i].radial);
}

int relight_material_coef(const struct prt_context *ctx, const struct prt_transport *transport,
                          const struct prt_tensor *tensor, const struct prt_material *material,
                          float *coef)
{
    struct prt_radial *radial;
    struct kept *slot;
    double error = 0;
    if (!tensor->n_knot || !tensor->knot || !tensor->basis)
        return prt_fail(ctx, PRT_FORMAT, "the transport has no radial basis for a material");
    int status = acquire(ctx, transport, tensor, &slot, &radial);
    if (status) return status;
    status = prt_radial_fit_material(radial, material, coef, &error);
    release(slot, radial);
    if (status)
        return prt_fail(ctx, status,
                        "the material cannot be expressed in the transport's basis");
    if (error > 0.02)
        prt_log(ctx, PRT_LOG_WARNING,
                "the transport's %s basis represents this material to %.1f %% only",
                tensor->term == PRT_TERM_SINGLE ? "extinction" : "reflectance", 100 * error);
    return PRT_OK;
}
