// SPDX-License-Identifier: MIT
// Coefficients of media in the radial basis of a tensor.
//
// Making a basis from its table takes far longer than fitting a material to it, so the last
// N_KEPT bases are cached. The cache belongs to the process: its key is a hash of the
// table's content, its values are read-only, its size is bounded, and neither a transport (a
// const map, often shared) nor a context (made for each call) lives long enough or alone to own
// it. A lock guards it; entries in use are counted and never dropped.
#include "answer.h"

#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "prt/eta_nodes.h"
#include "prt/radial.h"
#include "prt/walk_grid.h"

enum { N_KEPT = 8, N_FIT = 64, MOST_FUNCTIONS = 64 };

struct kept {
    uint64_t key, last_use;
    unsigned users;
    struct prt_radial *radial;
};

// Coefficients of the last fits: an edit of one object's medium leaves the others' as they are.
struct fitted {
    uint64_t basis, material, last_use; // material: prt_material_hash; last_use 0: empty
    uint32_t n;
    double error;
    float coef[3 * MOST_FUNCTIONS];
};

static struct kept kept[N_KEPT];
static struct fitted fitted[N_FIT];
static uint64_t clock_now;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

// The indices of a basis for any index: those that its family was made of.
static void options_any_eta(const struct prt_tensor *tensor, struct prt_radial_options *o)
{
    o->eta = (double)tensor->eta[0];
    o->eta_more[0] = (double)tensor->eta[1];
    o->n_eta_more = 1;
    o->eta_between = true;
}

static struct prt_radial_options options_of(const struct prt_transport *transport,
                                            const struct prt_tensor *tensor)
{
    bool path = tensor->term != PRT_TERM_MULTIPLE; // functions of a path's length
    double eta[PRT_MEDIA_MAX];
    uint32_t n = prt_media_etas(&transport->media, eta); // bakes have at most the basis' number
    struct prt_radial_options o = {.kind = (enum prt_radial_kind)tensor->basis_kind,
                                   .family = path ? PRT_FAMILY_EXTINCTION : PRT_FAMILY_DIPOLE,
                                   .eta = eta[0],
                                   .radius_mm = (double)tensor->knot[tensor->n_knot - 1]};
    o.n_eta_more = n - 1 < PRT_RADIAL_MORE_ETA ? n - 1 : PRT_RADIAL_MORE_ETA;
    memcpy(o.eta_more, eta + 1, o.n_eta_more * sizeof *eta);
    if (tensor->n_eta) options_any_eta(tensor, &o);
    return o;
}

static uint64_t key_of(const struct prt_radial_options *o, const struct prt_tensor *t)
{
    uint64_t key = prt_hash64(t->knot, 4ull * t->n_knot, (uint64_t)o->kind);
    key =
        prt_hash64(t->basis, 4ull * prt_tensor_basis_width(t) * prt_tensor_basis_size(t), key);
    if (t->n_eta) key = prt_hash64(t->eta, 4ull * t->n_eta, key);
    key = prt_hash64(&o->eta, sizeof o->eta, key + (uint64_t)o->family);
    return o->n_eta_more ? prt_hash64(o->eta_more, o->n_eta_more * sizeof o->eta, key) : key;
}

// The least recently used slot without users; NULL when all are in use. The lock is held.
static struct kept *free_slot(void)
{
    struct kept *best = NULL;
    for (int i = 0; i < N_KEPT; i++)
        if (!kept[i].users && (!best || kept[i].last_use < best->last_use)) best = &kept[i];
    return best;
}

// Takes a use of the slot with this key; NULL when there is none. The lock is held.
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

int prt_tensor_radial(const struct prt_context *ctx, const struct prt_transport *transport,
                      const struct prt_tensor *tensor, struct prt_radial **out)
{
    if (!tensor->n_knot || !tensor->knot || !tensor->basis)
        return prt_fail(ctx, PRT_ARG, "the tensor has no radial basis: its material is fixed");
    if (tensor->basis_kind == PRT_RADIAL_WALK)
        return prt_fail(ctx, PRT_ARG, "the tensor holds walks: it has no radial basis");
    struct prt_radial_options options = options_of(transport, tensor);
    return prt_radial_from_table(ctx, &options, prt_tensor_basis_size(tensor), tensor->n_knot,
                                 tensor->knot, tensor->basis, out);
}

// *slot is the cache entry of *radial; NULL: the caller owns *radial and destroys it.
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
    int status = prt_radial_from_table(ctx, &options, prt_tensor_basis_size(tensor),
                                       tensor->n_knot, tensor->knot, tensor->basis, radial);
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

static double most_error(const struct prt_tensor *tensor)
{
    return tensor->basis_kind == PRT_RADIAL_REDUCED || tensor->basis_kind == PRT_RADIAL_WALK
               ? PRT_MATERIAL_MOST_ERROR
               : PRT_MATERIAL_MOST_ERROR_X07;
}

// The range of a basis, [sigma_s'|sigma_t, sigma_a][least, most] mm^-1.
static void range_of(const struct prt_tensor *t, const struct prt_radial *radial,
                     double range[2][2])
{
    struct prt_walk_grid grid;
    if (radial) memcpy(range, radial->range, sizeof radial->range);
    if (radial || prt_walk_grid_from_axes(t->n_knot, t->knot, &grid)) return;
    range[0][0] = (double)grid.level[0], range[0][1] = (double)grid.level[grid.n_level - 1];
    range[1][0] = 0, range[1][1] = (double)grid.node[grid.n_node - 1];
}

// Logs which parameter is outside the range of the basis; returns PRT_ARG. radial: NULL of
// walks.
static int refuse(const struct prt_context *ctx, const struct prt_tensor *tensor,
                  const struct prt_radial *radial, const struct prt_material *m, double error)
{
    const bool single = tensor->term == PRT_TERM_SINGLE, multiple = !tensor->term;
    const char *name = m->name[0] ? m->name : "material";
    double range[2][2] = {{0, 0}, {0, 0}};
    range_of(tensor, radial, range);
    for (int c = 0; c < 3 && !m->profile; c++) {
        double s = (double)m->sigma_s_prime[c], a = (double)m->sigma_a[c];
        const double extinction = a + (single ? s / (1 - (double)m->g[c]) : s);
        const double value[2] = {multiple ? s : extinction, a};
        for (int k = 0; k < (multiple ? 2 : 1); k++)
            if (!(value[k] >= range[k][0] && value[k] <= range[k][1]))
                return prt_fail(ctx, PRT_ARG,
                                "%s: %s[%d] is %g, this bake covers %g to %g mm^-1: its basis "
                                "would lose %.0f %% of the medium (the limit is %.0f %%)",
                                name,
                                k          ? "sigma_a"
                                : multiple ? "sigma_s_prime"
                                : single ? "extinction sigma_a + sigma_s_prime/(1-g) of channel"
                                         : "extinction sigma_a + sigma_s_prime of channel",
                                c, value[k], range[k][0], range[k][1], 100 * error,
                                100 * most_error(tensor));
    }
    if (tensor->basis_kind == PRT_RADIAL_WALK)
        return prt_fail(ctx, PRT_ARG,
                        "%s: a bake by walks has no profiles, only sigma_s_prime and sigma_a "
                        "(it would lose %.0f %%, the limit is %.0f %%): bake with --scattering "
                        "dipole for it",
                        name, 100 * error, 100 * most_error(tensor));
    return prt_fail(
        ctx, PRT_ARG,
        "%s: this bake's basis loses %.0f %% of its profile (the limit is %.0f %%); bake "
        "with it as --material to keep it exactly",
        name, 100 * error, 100 * most_error(tensor));
}

// Coefficients of a material in the functions of walks: combinations of the grid's media.
static int fit_walks(const struct prt_tensor *t, const struct prt_material *m, float *coef,
                     double *error)
{
    struct prt_walk_grid grid;
    const uint32_t n = prt_tensor_basis_width(t);
    *error = 1;
    if (m->profile) return PRT_OK; // refused by its error
    if (!n || prt_walk_grid_from_axes(t->n_knot, t->knot, &grid)) return PRT_FORMAT;
    double *weight = prt_alloc(n, sizeof *weight), most = 0;
    for (int c = 0; c < 3 && weight; c++) {
        double one;
        prt_walk_grid_weights(&grid, (double)m->eta, (double)m->sigma_s_prime[c],
                              (double)m->sigma_a[c], weight, &one);
        most = fmax(most, one);
        for (uint32_t d = 0; d < t->n_radial; d++) {
            double sum = 0;
            for (uint32_t i = 0; i < n; i++)
                sum += weight[i] * (double)t->basis[(size_t)d * n + i];
            coef[3 * d + (uint32_t)c] = (float)sum;
        }
    }
    prt_free(weight);
    *error = most;
    return weight ? PRT_OK : PRT_NOMEM;
}

// Coefficients of unscattered light: by similarity, those of the reduced extinction.
static int fit_path(const struct prt_radial *radial, const struct prt_material *m, float *coef,
                    double *error)
{
    struct prt_material reduced = *m;
    reduced.g[0] = reduced.g[1] = reduced.g[2] = 0;
    return prt_radial_fit_material(radial, &reduced, coef, error);
}

// The fit of a material that is kept, into coef and *error; false where there is none.
static bool recall(uint64_t basis, uint64_t material, uint32_t n, float *coef, double *error)
{
    bool found = false;
    pthread_mutex_lock(&lock);
    for (int i = 0; i < N_FIT && !found; i++) {
        struct fitted *f = &fitted[i];
        if (!f->last_use || f->basis != basis || f->material != material || f->n != n) continue;
        memcpy(coef, f->coef, 3 * n * sizeof *coef);
        *error = f->error;
        f->last_use = ++clock_now;
        found = true;
    }
    pthread_mutex_unlock(&lock);
    return found;
}

static void remember(uint64_t basis, uint64_t material, uint32_t n, const float *coef,
                     double error)
{
    struct fitted *oldest = &fitted[0];
    if (n > MOST_FUNCTIONS) return;
    pthread_mutex_lock(&lock);
    for (int i = 1; i < N_FIT; i++)
        if (fitted[i].last_use < oldest->last_use) oldest = &fitted[i];
    *oldest = (struct fitted){basis, material, ++clock_now, n, error, {0}};
    memcpy(oldest->coef, coef, 3 * n * sizeof *coef);
    pthread_mutex_unlock(&lock);
}

// A fit of one material, and the basis once one is needed.
struct fitting {
    const struct prt_context *ctx;
    const struct prt_transport *transport;
    const struct prt_tensor *tensor;
    uint64_t key;
    struct kept *slot;
    struct prt_radial *radial;
};

// Coefficients of a basis [size][3] become those of its functions at every node of eta,
// [node][size][3].
static int spread_over_eta(const struct prt_tensor *t, double eta, float *coef, double *error)
{
    struct prt_eta_nodes nodes;
    double weight[PRT_ETA_MOST_NODES], misplaced;
    const enum prt_radial_family family =
        t->term == PRT_TERM_MULTIPLE ? PRT_FAMILY_DIPOLE : PRT_FAMILY_EXTINCTION;
    const size_t n = 3 * (size_t)prt_tensor_basis_size(t);
    if (!t->n_eta) return PRT_OK;
    int status = prt_eta_nodes_from_axis(t->n_eta, t->eta, &nodes);
    if (!status) status = prt_eta_weights(family, &nodes, eta, weight, &misplaced);
    if (status) return status;
    for (uint32_t b = nodes.n; b-- > 0;) // the first node's lie where those of all come from
        for (size_t i = 0; i < n; i++) coef[b * n + i] = (float)(weight[b] * (double)coef[i]);
    *error += misplaced;
    return PRT_OK;
}

static int fit_one(struct fitting *f, const struct prt_material *m, float *coef, double *error)
{
    const uint64_t material = prt_material_hash(m);
    const bool walks = f->tensor->basis_kind == PRT_RADIAL_WALK;
    if (recall(f->key, material, f->tensor->n_radial, coef, error)) return PRT_OK;
    int status = f->radial || walks
                     ? PRT_OK
                     : acquire(f->ctx, f->transport, f->tensor, &f->slot, &f->radial);
    if (status) return status;
    status = walks ? fit_walks(f->tensor, m, coef, error)
             : f->tensor->term == PRT_TERM_UNSCATTERED
                 ? fit_path(f->radial, m, coef, error)
                 : prt_radial_fit_material(f->radial, m, coef, error);
    if (!status) status = spread_over_eta(f->tensor, (double)m->eta, coef, error);
    if (status)
        return prt_fail(f->ctx, status,
                        "the material cannot be fitted to the transport's radial basis");
    if (!(*error <= most_error(f->tensor)))
        return refuse(f->ctx, f->tensor, f->radial, m, *error);
    remember(f->key, material, f->tensor->n_radial, coef, *error);
    return PRT_OK;
}

// coef [medium][n_radial][3]; error [medium]: shares that the basis loses.
static int fit(const struct prt_context *ctx, const struct prt_transport *transport,
               const struct prt_tensor *tensor, const struct prt_media *media, float *coef,
               double *error)
{
    struct fitting f = {.ctx = ctx, .transport = transport, .tensor = tensor};
    const size_t n = 3 * (size_t)tensor->n_radial;
    int status = PRT_OK;
    memset(error, 0, media->n * sizeof *error);
    if (tensor->storage == PRT_STORAGE_RADIAL &&
        !tensor->n_knot) { // colours that no material changes
        for (size_t i = 0; i < n * media->n; i++) coef[i] = 1;
        return PRT_OK;
    }
    if (!tensor->n_knot || !tensor->knot || !tensor->basis)
        return prt_fail(ctx, PRT_FORMAT,
                        "the file has no radial basis for its free material: bake it again");
    const struct prt_radial_options options = options_of(transport, tensor);
    // unscattered light is fitted in single scattering's basis, and otherwise (fit_path)
    f.key = key_of(&options, tensor) + (tensor->term == PRT_TERM_UNSCATTERED);
    for (uint32_t i = 0; i < media->n && !status; i++) {
        const struct prt_material *m = &media->medium[i];
        if (tensor->term != PRT_TERM_MULTIPLE && m->profile) // its R_d is all its light
            memset(coef + i * n, 0, n * sizeof *coef);
        else status = fit_one(&f, m, coef + i * n, &error[i]);
    }
    if (f.radial) release(f.slot, f.radial);
    return status;
}

int prt_basis_coef(const struct prt_context *ctx, const struct prt_transport *transport,
                   const struct prt_tensor *tensor, const struct prt_media *media, float *coef)
{
    double error[PRT_MEDIA_MAX], worst = 0;
    int status = fit(ctx, transport, tensor, media, coef, error);
    for (uint32_t i = 0; i < media->n; i++) worst = fmax(worst, error[i]);
    if (!status && worst > 0.02)
        prt_log(ctx, PRT_LOG_WARNING, "the transport's %s basis loses %.1f %% of this material",
                tensor->term != PRT_TERM_MULTIPLE ? "extinction" : "reflectance", 100 * worst);
    return status;
}

// The error of mean free paths that are shorter than the bake's sample spacing: near-field
// detail is lost, which the fit's error does not contain. Measured against the reference (model
// spot, 20,000 and 150,000 samples): 0.8 % where the spacing is 3 paths, 5 % at 6.7, 10 to 29 %
// at 8 to 9.
static double spacing_error(const struct prt_transport *transport, const struct prt_material *m)
{
    static const char key[] = "\"spacing_mm\":";
    const char *at = transport->settings ? strstr(transport->settings, key) : NULL;
    double spacing = at ? strtod(at + sizeof key - 1, NULL) : 0, most = 0;
    for (int c = 0; c < 3; c++)
        most = fmax(most, spacing * ((double)m->sigma_s_prime[c] + (double)m->sigma_a[c]));
    return most > 1 ? 0.04 * (most - 1) : 0;
}

// The error of one term, of the worst medium: its basis' and that of the sample spacing.
static int media_error(const struct prt_context *ctx, const struct prt_transport *transport,
                       const struct prt_media *media, enum prt_answer_term term, float *coef,
                       double *error)
{
    static const enum prt_term term_of[] = {[PRT_ANSWER_MULTIPLE] = PRT_TERM_MULTIPLE,
                                            [PRT_ANSWER_SINGLE] = PRT_TERM_SINGLE,
                                            [PRT_ANSWER_UNSCATTERED] = PRT_TERM_UNSCATTERED};
    double basis[PRT_MEDIA_MAX] = {0}, one[PRT_MEDIA_MAX];
    int status = PRT_OK;
    for (uint32_t i = 0; i < transport->n_tensor && !status; i++) {
        const struct prt_tensor *t = &transport->tensor[i];
        enum prt_term group = t->term == PRT_TERM_VIEW ? PRT_TERM_SINGLE : t->term;
        if (!t->n_knot || t->n_radial > 256) continue;
        if (term != PRT_ANSWER_TOTAL && group != term_of[term]) continue;
        status = fit(ctx, transport, t, media, coef, one);
        for (uint32_t k = 0; k < media->n; k++) basis[k] = fmax(basis[k], one[k]);
    }
    for (uint32_t k = 0; k < media->n; k++) {
        if (!status && term != PRT_ANSWER_SINGLE)
            basis[k] += spacing_error(transport, &media->medium[k]);
        *error = fmax(*error, basis[k]);
    }
    return status;
}

int prt_answer_material_error(const struct prt_context *ctx,
                              const struct prt_transport *transport,
                              const struct prt_media *media, enum prt_answer_term term,
                              double *error)
{
    *error = 0;
    int status = prt_free_media_check(ctx, transport, media);
    float *coef = status ? NULL : prt_alloc(3 * 256 * (size_t)media->n, sizeof *coef);
    if (!status && !coef) status = prt_fail(ctx, PRT_NOMEM, "no memory to apply a material");
    if (!status) status = media_error(ctx, transport, media, term, coef, error);
    prt_free(coef);
    return status;
}
