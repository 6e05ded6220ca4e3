// SPDX-License-Identifier: MIT
// Single scattering at a vertex by Monte Carlo: pairs of a depth and a light ray (METHODS §8).
#include "reference/reference_private.h"

#include <math.h>
#include <string.h>

// Phase function of a channel at the scattering cosine (both forms are normalised).
struct phases {
    bool exact;
    struct prt_phase cut[3];
};

static double phase_at(const struct job *j, const struct phases *p, int c, double cos_outward)
{
    return p->exact ? prt_hg_eval(j->material->g[c], -cos_outward)
                    : prt_phase_eval(&p->cut[c], cos_outward);
}

struct path {
    float x[3], inward[3]; // from the vertex into the body, unit
    float out_dir[3];      // w_o' outward
    double length;         // to the far side [mm]
    float sigma_t[3], sigma_s[3];
};

// Density of depth: an equal mixture over channels, each exponential cut at the far side.
static double depth_density(const struct path *p, double s)
{
    double sum = 0;
    for (int c = 0; c < 3; c++)
        sum += p->sigma_t[c] * exp(-p->sigma_t[c] * s) / (1 - exp(-p->sigma_t[c] * p->length));
    return sum / 3;
}

static double depth_sample(const struct path *p, double xi)
{
    int c = (int)(xi * 3);
    if (c > 2) c = 2;
    double u = xi * 3 - c;
    return -log(1 - u * (1 - exp(-p->sigma_t[c] * p->length))) / p->sigma_t[c];
}

// Up to 16 pairs of a depth and a light ray, traced together.
struct batch {
    uint32_t n;
    double depth[16], weight[16];
    float w[16][3];
    const float *rgb[16];
};

// The exit of a ray from inside: shading normal and cosine. False: the ray does not leave the
// body.
static bool exit_of(const struct prt_mesh *mesh, const struct prt_packet *p, int i,
                    const float w[3], float g[3], float n[3], float *cosine)
{
    if (p->triangle[i] == UINT32_MAX) return false;
    prt_reference_face_normal(mesh, p->triangle[i], g);
    // A ray that hits a face from outside would be blocked by that face beyond. Without this
    // test 20 of 5891 vertices of a dragon differ, all shorter inside than 2 eps, by 5e-5 of
    // the RMS.
    if (dot3(g, w) <= 0) return false;
    const uint32_t *tv = mesh->triangle[p->triangle[i]];
    float u = p->u[i], v = p->v[i], length = 0;
    for (int k = 0; k < 3; k++) {
        n[k] = (1 - u - v) * mesh->normal[tv[0]][k] + u * mesh->normal[tv[1]][k] +
               v * mesh->normal[tv[2]][k];
        length += n[k] * n[k];
    }
    length = sqrtf(length);
    for (int k = 0; k < 3; k++) n[k] /= length;
    *cosine = fminf(dot3(n, w), 1);
    return *cosine > 0;
}

// Adds the contributions of a batch. Rays that do not leave the body or are blocked beyond add
// nothing.
static void scatter(const struct job *j, const struct path *path, const struct phases *phases,
                    bool isotropic, struct batch *batch, double sum[3])
{
    struct prt_packet p = {0}, shadow = {0};
    float n[16][3], cosine[16], eps = prt_scene_epsilon(j->scene), eta = j->material->eta;
    uint32_t mask = batch->n == 16 ? 0xffff : (1u << batch->n) - 1, leaving = 0;
    for (uint32_t i = 0; i < batch->n; i++) {
        const float *w = batch->w[i];
        p.ox[i] = (float)(path->x[0] + batch->depth[i] * path->inward[0]);
        p.oy[i] = (float)(path->x[1] + batch->depth[i] * path->inward[1]);
        p.oz[i] = (float)(path->x[2] + batch->depth[i] * path->inward[2]);
        p.dx[i] = w[0], p.dy[i] = w[1], p.dz[i] = w[2], p.tfar[i] = INFINITY;
    }
    prt_scene_intersect16(j->scene, &p, mask, false);
    for (int i = 0; i < (int)batch->n; i++) {
        const float *w = batch->w[i];
        float g[3];
        if (!exit_of(j->mesh, &p, i, w, g, n[i], &cosine[i])) continue;
        leaving |= 1u << i;
        shadow.ox[i] = p.ox[i] + p.t[i] * w[0] + eps * g[0];
        shadow.oy[i] = p.oy[i] + p.t[i] * w[1] + eps * g[1];
        shadow.oz[i] = p.oz[i] + p.t[i] * w[2] + eps * g[2];
        shadow.dx[i] = w[0], shadow.dy[i] = w[1], shadow.dz[i] = w[2];
        shadow.tfar[i] = INFINITY;
    }
    uint32_t open = leaving ? leaving & ~prt_scene_occluded16(j->scene, &shadow, leaving) : 0;
    for (int i = 0; i < (int)batch->n; i++) {
        if (!(open >> i & 1)) continue;
        const float *w = batch->w[i];
        double c1 = cosine[i], root = sqrt(1 - (1 - c1 * c1) / ((double)eta * eta));
        double path_mm = p.t[i] * c1 / root, cos_outward = 0; // METHODS §1, s_i'
        double ft = prt_fresnel_transmittance(eta, c1);
        for (int k = 0; k < 3; k++)
            cos_outward += path->out_dir[k] * (w[k] / eta + (root - c1 / eta) * n[i][k]);
        for (int c = 0; c < 3; c++) {
            double phase = isotropic ? 1 / (4 * M_PI) : phase_at(j, phases, c, cos_outward);
            sum[c] += batch->weight[i] * ft * phase * path->sigma_s[c] * batch->rgb[i][c] *
                      exp(-path->sigma_t[c] * (batch->depth[i] + path_mm));
        }
    }
    batch->n = 0;
}

// At a crease the refracted direction may lead out of the body between the vertex's own faces:
// it is bent towards -n until it lies below all of them, or runs along -n.
static void bend_inwards(const struct job *j, uint32_t v, float inward[3])
{
    const float *normal = j->mesh->normal[v];
    const uint32_t w = j->mesh->weld[v];
    float least = 1; // share of the refracted direction that is kept
    for (uint32_t k = j->corner_begin[w]; k < j->corner_begin[w + 1]; k++) {
        float face[3];
        prt_reference_face_normal(j->mesh, j->corner[k], face);
        const float own = dot3(face, inward), straight = -dot3(face, normal);
        const float limit =
            0.05f * straight; // the path leaves the face's plane at 5 % of n's rate at least
        if (straight < 0 && own > limit)
            least = fminf(least, (straight - limit) / (straight - own));
    }
    if (least >= 1) return;
    float length = 0;
    for (int k = 0; k < 3; k++) {
        inward[k] = least * inward[k] - (1 - least) * normal[k];
        length += inward[k] * inward[k];
    }
    for (int k = 0; k < 3; k++) inward[k] /= sqrtf(length);
}

// The path of a vertex: refracted towards the eye, or along -n_o. False: the vertex faces away.
static bool path_of(const struct job *j, uint32_t v, struct path *path)
{
    const struct prt_material *m = j->material;
    const float *normal = j->mesh->normal[v];
    memcpy(path->x, j->mesh->position[v], sizeof path->x);
    memcpy(path->out_dir, normal, sizeof path->out_dir);
    if (j->o->eye) {
        float w[3], length = 0, cosine;
        for (int k = 0; k < 3; k++) w[k] = j->o->eye[k] - path->x[k], length += w[k] * w[k];
        length = sqrtf(length);
        for (int k = 0; k < 3; k++) w[k] /= length > 0 ? length : 1;
        cosine = dot3(w, normal);
        if (cosine <= 0) return false;
        double root = sqrt(1 - (1 - (double)cosine * cosine) / ((double)m->eta * m->eta));
        for (int k = 0; k < 3; k++)
            path->out_dir[k] = (float)(w[k] / m->eta + (root - cosine / m->eta) * normal[k]);
    }
    bool refracted = j->o->eye && !j->o->straight_single;
    for (int k = 0; k < 3; k++) path->inward[k] = refracted ? -path->out_dir[k] : -normal[k];
    if (refracted) bend_inwards(j, v, path->inward);
    return true;
}

// Coefficients of the medium, and the length of the path to the far side.
static void measure_path(const struct job *j, uint32_t v, struct path *path)
{
    const struct prt_material *m = j->material;
    float eps = prt_scene_epsilon(j->scene), start[3], t = 0, bu, bv;
    uint32_t triangle;
    for (int k = 0; k < 3; k++) start[k] = path->x[k] - eps * j->mesh->normal[v][k];
    for (int c = 0; c < 3; c++) {
        path->sigma_s[c] = m->sigma_s_prime[c] / (1 - m->g[c]);
        path->sigma_t[c] = path->sigma_s[c] + m->sigma_a[c];
    }
    // e^-40 of the light is left there
    path->length = 40 / fmin(path->sigma_t[0], fmin(path->sigma_t[1], path->sigma_t[2]));
    if (prt_scene_intersect(j->scene, start, path->inward, eps, INFINITY, &t, &triangle, &bu,
                            &bv))
        path->length = fmin(path->length, fmax(t, 2 * eps));
}

// W05 eq 4, X07 eq 5 by Monte Carlo: along the refracted path with an eye, else along -n_o.
void prt_reference_single(const struct job *j, uint32_t v, float out[3])
{
    struct path path;
    struct phases phases = {.exact = j->o->n_phase_term == 0};
    double sum[3] = {0, 0, 0};
    out[0] = out[1] = out[2] = 0;
    if (!path_of(j, v, &path)) return;
    measure_path(j, v, &path);
    for (int c = 0; c < 3 && !phases.exact; c++)
        (void)prt_phase_hg(&phases.cut[c], j->material->g[c], j->o->n_phase_term);
    const struct light_rays *r = j->rays;
    size_t base = (size_t)(prt_hash64(&v, sizeof v, j->o->seed + 5) % r->n_pattern) * r->n_ray;
    struct prt_rng rng;
    prt_rng_init(&rng, j->o->seed, v);
    double xi = prt_rng_f32(&rng);
    struct batch batch = {0};
    for (uint32_t k = 0; k < r->n_ray; k++) {
        uint32_t i = batch.n++;
        xi += 0.6180339887498949; // golden ratio: evenly spread depths
        xi -= floor(xi);
        batch.depth[i] = depth_sample(&path, xi);
        batch.weight[i] = 1 / depth_density(&path, batch.depth[i]);
        batch.w[i][0] = r->x[base + k], batch.w[i][1] = r->y[base + k];
        batch.w[i][2] = r->z[base + k];
        batch.rgb[i] = r->rgb + (base + k) * 3;
        if (batch.n == 16 || k + 1 == r->n_ray)
            scatter(j, &path, &phases, !j->o->eye, &batch, sum);
    }
    for (int c = 0; c < 3; c++) out[c] = (float)sum[c];
}
