// SPDX-License-Identifier: MIT
// Walks of one start, sixteen at a time: each lane flies without rays while the grid's bound
// allows it; then one packet of rays serves all lanes, and lanes whose walks ended take the
// next walks.
#include "prt/medium.h"
#include "walk/walk_private.h"

#include <math.h>
#include <string.h>

enum { LANES = PRT_PACKET, ANGLES = WALK_ANGLES };
static const float many_mean_lengths = 256;

struct lane {
    float p[3], d[3]; // mm, unit
    float left;       // of the flight to the next scattering [mm]
    float length;     // so far [mm]
    uint32_t scatterings, walk;
    uint64_t random; // state
};

struct run {
    const struct prt_walk_space *space;
    const struct prt_walk_start *start;
    float mean_free_path, eta, longest, epsilon;
    float tangent[3], bitangent[3], inward[3];
    float cosine[ANGLES + 1]; // of the first direction outside, at equal shares of F_t cos
    uint32_t n_walk, next;
    uint32_t direction[3][32], shift[3]; // of the stratified first numbers
    struct prt_walk_counts counts;
    void (*sink)(void *arg, const struct prt_walk_exit *exit);
    void *arg;
};

// SplitMix64: its output passes BigCrush, and a state takes 8 bytes.
static uint64_t mix(uint64_t x)
{
    x = (x ^ x >> 30) * 0xbf58476d1ce4e5b9u;
    x = (x ^ x >> 27) * 0x94d049bb133111ebu;
    return x ^ x >> 31;
}

// Two numbers of 24 bits in [0,1).
static void draw2(uint64_t *state, float out[2])
{
    uint64_t x = mix(*state += 0x9e3779b97f4a7c15u);
    out[0] = (float)(x >> 40) * 0x1p-24f;
    out[1] = (float)(x & 0xffffff) * 0x1p-24f;
}

float prt_walk_inner_reflectance(float eta, float cosine)
{
    float sine2 = eta * eta * (1 - cosine * cosine);
    if (sine2 >= 1) return 1;
    float outside = sqrtf(1 - sine2);
    float s = (eta * cosine - outside) / (eta * cosine + outside);
    float p = (cosine - eta * outside) / (cosine + eta * outside);
    return 0.5f * (s * s + p * p);
}

// The inverse of the distribution of F_t cos over the cosine, by the trapezoid rule on a table
// that is sixteen times as fine.
void prt_walk_first_cosines(float eta, float cosine[ANGLES + 1])
{
    static _Thread_local struct {
        float eta, cosine[ANGLES + 1];
    } last_table; // thousands of vertices in turn have one eta
    if (last_table.eta == eta) {
        memcpy(cosine, last_table.cosine, sizeof last_table.cosine);
        return;
    }
    enum { FINE = 16 * ANGLES };
    double sum[FINE + 1], last = 0;
    sum[0] = 0;
    for (int i = 1; i <= FINE; i++) {
        double mu = (double)i / FINE, now = mu * prt_fresnel_transmittance((double)eta, mu);
        sum[i] = sum[i - 1] + 0.5 * (last + now);
        last = now;
    }
    int at = 1;
    for (int k = 0; k <= ANGLES; k++) {
        double want = sum[FINE] * k / ANGLES;
        while (at < FINE && sum[at] < want) at++;
        double step = sum[at] - sum[at - 1], f = step > 0 ? (want - sum[at - 1]) / step : 0;
        cosine[k] = (float)((at - 1 + fmin(fmax(f, 0), 1)) / FINE);
    }
    last_table.eta = eta;
    memcpy(last_table.cosine, cosine, sizeof last_table.cosine);
}

void prt_walk_frame(const float n[3], float t[3], float b[3])
{
    float sign = n[2] < 0 ? -1.0f : 1.0f, a = -1 / (sign + n[2]), c = n[0] * n[1] * a;
    t[0] = 1 + sign * n[0] * n[0] * a, t[1] = sign * c, t[2] = -sign * n[0];
    b[0] = c, b[1] = sign + n[1] * n[1] * a, b[2] = -n[1];
}

// Number `axis` of walk i: Sobol's sequence with a random digital shift. Walks of one start are
// stratified over depth and angle jointly, as a slab's unscattered light needs.
static float stratified(const struct run *r, unsigned axis, uint32_t i)
{
    uint32_t bits = r->shift[axis];
    for (unsigned k = 0; i; i >>= 1, k++)
        if (i & 1) bits ^= r->direction[axis][k];
    return (float)(bits >> 8) * 0x1p-24f;
}

// Direction numbers of the polynomials 1 (van der Corput), x + 1 and x^2 + x + 1.
static void sobol_directions(uint32_t direction[3][32])
{
    for (unsigned k = 0; k < 32; k++) {
        direction[0][k] = 0x80000000u >> k;
        uint32_t *second = direction[1], *third = direction[2];
        second[k] = k ? second[k - 1] ^ second[k - 1] >> 1 : 0x80000000u;
        third[k] = k > 1   ? third[k - 1] ^ third[k - 2] ^ third[k - 2] >> 2
                   : k > 0 ? 0xc0000000u
                           : 0x80000000u;
    }
}

static float flight(const struct run *r, float uniform)
{
    return -r->mean_free_path * logf(1 - uniform);
}

static void begin_walk(struct run *r, struct lane *l)
{
    uint32_t i = r->next++;
    const float *n = r->start->normal;
    float at = stratified(r, 0, i) * ANGLES, phi = 2 * (float)M_PI * stratified(r, 1, i);
    int k = (int)at;
    float outside = r->cosine[k] + (at - (float)k) * (r->cosine[k + 1] - r->cosine[k]);
    float sine = sqrtf(fmaxf(1 - outside * outside, 0)) / r->eta;
    float inside = sqrtf(1 - sine * sine);
    for (int c = 0; c < 3; c++) {
        l->d[c] =
            -inside * n[c] + sine * (cosf(phi) * r->tangent[c] + sinf(phi) * r->bitangent[c]);
        l->p[c] = r->start->position[c] + r->epsilon * r->inward[c];
    }
    l->left = flight(r, stratified(r, 2, i));
    l->length = 0;
    l->scatterings = 0;
    l->walk = i;
    l->random = mix(r->start->seed ^ mix(i + 1));
    r->counts.walks++;
}

static void scatter(const struct run *r, struct lane *l)
{
    float u[2], w[2];
    draw2(&l->random, u);
    draw2(&l->random, w);
    float z = 2 * u[0] - 1, s = sqrtf(1 - z * z), phi = 2 * (float)M_PI * u[1];
    l->d[0] = s * cosf(phi), l->d[1] = s * sinf(phi), l->d[2] = z;
    l->left = flight(r, w[0]);
    l->scatterings++;
}

static void move(struct lane *l, float distance)
{
    for (int c = 0; c < 3; c++) l->p[c] += distance * l->d[c];
    l->length += distance;
}

// Flies and scatters while no surface can be in the way. False: the walk has become too long.
static bool fly_free(struct run *r, struct lane *l)
{
    while (l->left < walk_bound(r->space, l->p)) {
        move(l, l->left);
        scatter(r, l);
        r->counts.segments++;
        if (l->length > r->longest) return false;
    }
    return true;
}

static bool outside_box(const struct prt_walk_space *s, const float p[3])
{
    for (int k = 0; k < 3; k++)
        if (!(p[k] >= s->low[k] && p[k] <= s->high[k])) return true;
    return false;
}

enum { GOES_ON, LEAVES, LEAKS, IS_ABSORBED };

// The lane's ray hit the boundary: the light is reflected inside or leaves. g: (b-a) x (c-a).
static int at_boundary(struct run *r, struct lane *l, float t, const float g[3],
                       uint32_t triangle)
{
    uint32_t object = r->space->triangle_object[triangle];
    if (object != r->start->object) return IS_ABSORBED;
    float scale = 1 / sqrtf(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]), n[3], cosine = 0;
    for (int k = 0; k < 3; k++) {
        n[k] = g[k] * scale;
        cosine += n[k] * l->d[k];
    }
    if (!(cosine > 0)) return LEAKS;
    float u[2];
    draw2(&l->random, u);
    move(l, t);
    l->left -= t;
    if (u[0] >= prt_walk_inner_reflectance(r->eta, fminf(cosine, 1))) return LEAVES;
    for (int k = 0; k < 3; k++) {
        l->d[k] -= 2 * cosine * n[k];
        l->p[k] -= r->epsilon * n[k];
    }
    return GOES_ON;
}

// After a ray: the flight ended in the medium, or at a surface. Returns whether the walk goes
// on.
static bool after_ray(struct run *r, struct lane *l, const struct prt_packet *ray, int i)
{
    r->counts.segments++;
    r->counts.rays++;
    if (ray->triangle[i] == UINT32_MAX) {
        move(l, l->left);
        if (outside_box(r->space, l->p)) {
            r->counts.leaked++;
            return false;
        }
        scatter(r, l);
    } else {
        float g[3] = {ray->gx[i], ray->gy[i], ray->gz[i]};
        int event = at_boundary(r, l, ray->t[i], g, ray->triangle[i]);
        r->counts.leaked += event == LEAKS;
        r->counts.absorbed += event == IS_ABSORBED;
        r->counts.exits += event == LEAVES;
        if (event == LEAVES)
            r->sink(r->arg, &(struct prt_walk_exit){l->walk, ray->triangle[i], ray->u[i],
                                                    ray->v[i], l->length, l->scatterings, 1});
        if (event != GOES_ON) return false;
    }
    if (l->length <= r->longest) return true;
    r->counts.cut++;
    return false;
}

// Brings every lane to a flight that needs a ray; lanes without a walk take the next ones.
// Returns the mask of lanes that have one.
static uint32_t ready_lanes(struct run *r, struct lane lane[LANES], uint32_t busy)
{
    for (int i = 0; i < LANES; i++) {
        while (true) {
            if (!(busy >> i & 1)) {
                if (r->next >= r->n_walk) break;
                begin_walk(r, &lane[i]);
                busy |= 1u << i;
            }
            if (fly_free(r, &lane[i])) break;
            r->counts.cut++;
            busy &= ~(1u << i);
        }
    }
    return busy;
}

static void prepare(struct run *r, const struct prt_walk_medium *m)
{
    uint64_t state = r->start->seed;
    r->mean_free_path = 1 / m->sigma_s_prime;
    r->eta = m->eta;
    r->epsilon = r->space->epsilon;
    r->longest = m->max_length_mm;
    if (!(r->longest > 0))
        r->longest = many_mean_lengths *
                     (float)prt_walk_mean_length(r->space, r->start->object, (double)m->eta);
    if (!(r->longest > 0)) r->longest = INFINITY;
    for (int k = 0; k < 3; k++) r->shift[k] = (uint32_t)mix(state += 0x9e3779b97f4a7c15u);
    sobol_directions(r->direction);
    const float *away = r->start->inward, *n = r->start->normal;
    bool given = away[0] != 0 || away[1] != 0 || away[2] != 0;
    for (int k = 0; k < 3; k++) r->inward[k] = given ? away[k] : -n[k];
    prt_walk_frame(r->start->normal, r->tangent, r->bitangent);
    prt_walk_first_cosines(m->eta, r->cosine);
}

void prt_walk_run(const struct prt_walk_space *space, const struct prt_walk_start *start,
                  const struct prt_walk_medium *medium, uint32_t n_walk,
                  void (*sink)(void *arg, const struct prt_walk_exit *exit), void *arg,
                  struct prt_walk_counts *counts)
{
    struct run r = {.space = space, .start = start, .n_walk = n_walk, .sink = sink, .arg = arg};
    struct lane lane[LANES];
    struct prt_packet ray;
    prepare(&r, medium);
    memset(&ray, 0, sizeof ray);
    for (uint32_t busy = 0; (busy = ready_lanes(&r, lane, busy));) {
        for (int i = 0; i < LANES; i++) {
            if (!(busy >> i & 1)) continue;
            ray.ox[i] = lane[i].p[0], ray.oy[i] = lane[i].p[1], ray.oz[i] = lane[i].p[2];
            ray.dx[i] = lane[i].d[0], ray.dy[i] = lane[i].d[1], ray.dz[i] = lane[i].d[2];
            ray.tfar[i] = lane[i].left;
        }
        prt_scene_intersect16(space->scene, &ray, busy, false);
        for (int i = 0; i < LANES; i++)
            if (busy >> i & 1 && !after_ray(&r, &lane[i], &ray, i)) busy &= ~(1u << i);
    }
    counts->walks += r.counts.walks, counts->exits += r.counts.exits;
    counts->leaked += r.counts.leaked, counts->absorbed += r.counts.absorbed;
    counts->cut += r.counts.cut, counts->segments += r.counts.segments;
    counts->rays += r.counts.rays;
}
