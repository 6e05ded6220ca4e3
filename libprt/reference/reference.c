// SPDX-License-Identifier: MIT
// The brute-force engine: irradiance, multiple scattering, single scattering at vertices.
#include "prt/reference.h"
#include "prt/surface.h"
#include "prt/trace.h"
#include "reference/lights.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

struct job {
    const struct prt_context *ctx;
    const struct prt_mesh *mesh;
    const struct prt_material *material;
    const struct prt_reference_options *o;
    struct prt_scene *scene;
    struct prt_surface_points *surface;
    struct light_rays *rays;
    uint32_t *vertex_block;
    uint32_t *corner_begin, *corner; // triangles around each welded vertex
    unsigned n_material, n_light;
    const struct prt_material *const *materials; // one eta
    struct prt_diffusion (*dipoles)[3];          // [n_material]
    struct light_rays **lights; // [n_light] what vertices trace; NULL when nothing does
    float *irradiance;          // [n_light][3][n_sample]
    float (*const *color)[3];   // [n_material * n_light]
};

static bool translucent(const struct job *j, uint32_t vertex)
{
    return j->mesh->surface[j->mesh->block[j->vertex_block[vertex]].surface].translucent != 0;
}

static float dot3(const float a[3], const float b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

double prt_relative_rmse(const float *a, const float *b, size_t n)
{
    double difference = 0, norm = 0;
    for (size_t i = 0; i < n; i++) {
        double d = (double)a[i] - b[i];
        difference += d * d;
        norm += (double)b[i] * b[i];
    }
    return norm > 0 ? sqrt(difference / norm) : difference > 0 ? INFINITY : 0;
}

// E(x) = sum F_t V L (n.w) over one pattern of rays. `faces` are the flat normals a direction
// must not lie below all of; eta 0: no Fresnel (opaque).
static void irradiance_at(const struct job *j, uint32_t pattern, const float origin[3],
                          const float normal[3], const float (*faces)[3], unsigned n_face,
                          double eta, float out[3])
{
    const struct light_rays *r = j->rays;
    size_t base = (size_t)(pattern % r->n_pattern) * r->n_ray;
    double sum[3] = {0, 0, 0};
    struct prt_packet packet;
    float weight[16];
    uint32_t index[16];
    int fill = 0;
    for (uint32_t k = 0; k <= r->n_ray; k++) {
        if (k < r->n_ray) {
            float d[3] = {r->x[base + k], r->y[base + k], r->z[base + k]};
            float cosine = dot3(normal, d), above = -1;
            if (cosine <= 0) continue;
            for (unsigned f = 0; f < n_face; f++) above = fmaxf(above, dot3(faces[f], d));
            if (above <= 0) continue;
            packet.ox[fill] = origin[0], packet.oy[fill] = origin[1],
            packet.oz[fill] = origin[2];
            packet.dx[fill] = d[0], packet.dy[fill] = d[1], packet.dz[fill] = d[2];
            packet.tnear[fill] = 0, packet.tfar[fill] = INFINITY;
            weight[fill] =
                cosine * (float)(eta > 0 ? prt_fresnel_transmittance(eta, cosine) : 1);
            index[fill++] = k;
        }
        if (fill == 16 || (k == r->n_ray && fill)) {
            uint32_t mask = fill == 16 ? 0xffff : (1u << fill) - 1;
            for (int i = fill; i < 16; i++) {
                packet.ox[i] = packet.oy[i] = packet.oz[i] = 0;
                packet.dx[i] = 1, packet.dy[i] = packet.dz[i] = 0;
                packet.tnear[i] = packet.tfar[i] = 0;
            }
            uint32_t open = mask & ~prt_scene_occluded16(j->scene, &packet, mask);
            for (int i = 0; i < fill; i++)
                if (open >> i & 1)
                    for (int c = 0; c < 3; c++)
                        sum[c] += (double)weight[i] * r->rgb[(base + index[i]) * 3 + (size_t)c];
            fill = 0;
        }
    }
    for (int c = 0; c < 3; c++) out[c] = (float)sum[c];
}

static void face_normal(const struct prt_mesh *mesh, uint32_t t, float out[3])
{
    const float *a = mesh->position[mesh->triangle[t][0]];
    const float *b = mesh->position[mesh->triangle[t][1]];
    const float *c = mesh->position[mesh->triangle[t][2]];
    float e[3], f[3], length = 0;
    for (int k = 0; k < 3; k++) e[k] = b[k] - a[k], f[k] = c[k] - a[k];
    out[0] = e[1] * f[2] - e[2] * f[1];
    out[1] = e[2] * f[0] - e[0] * f[2];
    out[2] = e[0] * f[1] - e[1] * f[0];
    length = sqrtf(dot3(out, out));
    for (int k = 0; k < 3; k++) out[k] = length > 0 ? out[k] / length : 0;
}

enum { MOST_FACES = 32 };

// E at a vertex: the vertex normal, blocked below all its faces (DESIGN, command contract).
static void vertex_irradiance(const struct job *j, uint32_t v, double eta, float out[3])
{
    float faces[MOST_FACES][3], origin[3];
    uint32_t w = j->mesh->weld[v], n = 0;
    for (uint32_t k = j->corner_begin[w]; k < j->corner_begin[w + 1] && n < MOST_FACES; k++)
        face_normal(j->mesh, j->corner[k], faces[n++]);
    if (!n) memcpy(faces[n++], j->mesh->normal[v], sizeof faces[0]);
    for (int k = 0; k < 3; k++)
        origin[k] =
            j->mesh->position[v][k] + prt_scene_epsilon(j->scene) * j->mesh->normal[v][k];
    double sum[3] = {0, 0, 0};
    uint32_t first = (uint32_t)(prt_hash64(&v, sizeof v, j->o->seed + 3) >> 8);
    for (uint32_t p = 0; p < 4; p++) {
        float e[3];
        irradiance_at(j, first + p, origin, j->mesh->normal[v], (const float(*)[3])faces, n,
                      eta, e);
        for (int c = 0; c < 3; c++) sum[c] += 0.25 * e[c];
    }
    for (int c = 0; c < 3; c++) out[c] = (float)sum[c];
}

static int sample_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct job *j = arg;
    prt_trace_thread_init();
    float eps = prt_scene_epsilon(j->scene);
    for (size_t i = begin; i < end; i++) {
        const float *f = j->surface->face_normal[i];
        float origin[3];
        for (int k = 0; k < 3; k++) origin[k] = j->surface->position[i][k] + eps * f[k];
        uint32_t pattern = (uint32_t)(prt_hash64(&i, sizeof i, j->o->seed) >> 8);
        float e[3];
        irradiance_at(j, pattern, origin, j->surface->normal[i], (const float(*)[3])f, 1,
                      j->material->eta, e);
        for (size_t c = 0; c < 3; c++) j->irradiance[c * j->surface->n_sample + i] = e[c];
    }
    return PRT_OK;
}

// In sixteen sums, which a compiler may keep in registers.
static float dot_array(const float *a, const float *b, uint32_t n)
{
    float sum[16] = {0}, all = 0;
    uint32_t i = 0;
    for (; i + 16 <= n; i += 16)
        for (uint32_t k = 0; k < 16; k++) sum[k] += a[i + k] * b[i + k];
    for (; i < n; i++) all += a[i] * b[i];
    for (uint32_t k = 0; k < 16; k++) all += sum[k];
    return all;
}

enum { CHUNK = 1024 };

// B(x) = sum over all samples of the object: point values far away, cells nearby. out[n_light].
static void multiple_at(const struct job *j, uint32_t v, const struct prt_diffusion dipole[3],
                        double (*out)[3])
{
    const struct prt_surface_points *s = j->surface;
    uint32_t object = j->mesh->block[j->vertex_block[v]].object;
    const float *x = j->mesh->position[v];
    float near_mm = 6 * s->spacing, r2[CHUNK], afar[2 * CHUNK], rd[3][2 * CHUNK];
    memset(out, 0, j->n_light * sizeof *out);
    for (uint32_t begin = s->object_begin[object], end = s->object_begin[object + 1];
         begin < end; begin += CHUNK) {
        uint32_t n = end - begin < CHUNK ? end - begin : CHUNK;
        for (uint32_t i = 0; i < n; i++) {
            const float *p = s->centre[begin + i];
            float a = p[0] - x[0], b = p[1] - x[1], c = p[2] - x[2];
            r2[i] = a * a + b * b + c * c;
            prt_surface_afar(r2[i], s->spread[begin + i], &afar[i], &afar[n + i]);
        }
        for (int c = 0; c < 3; c++) {
            prt_diffusion_rd_array(&dipole[c], j->ctx->cpu, 2 * n, afar, rd[c]);
            for (uint32_t i = 0; i < n; i++)
                rd[c][i] = 0.5f * s->area[begin + i] * (rd[c][i] + rd[c][n + i]);
        }
        for (uint32_t i = 0; i < n; i++) {
            float k[3];
            if (r2[i] >= near_mm * near_mm) continue;
            prt_surface_kernel(s, dipole, j->ctx->cpu, x, begin + i, near_mm, k);
            for (int c = 0; c < 3; c++) rd[c][i] = k[c];
        }
        for (unsigned l = 0; l < j->n_light; l++)
            for (unsigned c = 0; c < 3; c++)
                out[l][c] += (double)dot_array(
                    rd[c], j->irradiance + ((size_t)l * 3 + c) * s->n_sample + begin, n);
    }
    for (unsigned l = 0; l < j->n_light; l++)
        for (int c = 0; c < 3; c++) out[l][c] /= M_PI;
}

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

// Where a ray from inside leaves: shading normal and cosine. false: not a way out.
static bool leaves(const struct prt_mesh *mesh, const struct prt_packet *p, int i,
                   const float w[3], float g[3], float n[3], float *cosine)
{
    if (p->triangle[i] == UINT32_MAX) return false;
    face_normal(mesh, p->triangle[i], g);
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

// Adds a batch's contributions; what does not leave the body into the open adds nothing.
static void scatter(const struct job *j, const struct path *path, const struct phases *phases,
                    bool isotropic, struct batch *batch, double sum[3])
{
    struct prt_packet p = {0}, shadow = {0};
    float n[16][3], cosine[16], eps = prt_scene_epsilon(j->scene), eta = j->material->eta;
    uint32_t mask = batch->n == 16 ? 0xffff : (1u << batch->n) - 1, ask = 0;
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
        if (!leaves(j->mesh, &p, i, w, g, n[i], &cosine[i])) continue;
        ask |= 1u << i;
        shadow.ox[i] = p.ox[i] + p.t[i] * w[0] + eps * g[0];
        shadow.oy[i] = p.oy[i] + p.t[i] * w[1] + eps * g[1];
        shadow.oz[i] = p.oz[i] + p.t[i] * w[2] + eps * g[2];
        shadow.dx[i] = w[0], shadow.dy[i] = w[1], shadow.dz[i] = w[2];
        shadow.tfar[i] = INFINITY;
    }
    uint32_t open = ask ? ask & ~prt_scene_occluded16(j->scene, &shadow, ask) : 0;
    for (int i = 0; i < (int)batch->n; i++) {
        if (!(open >> i & 1)) continue;
        const float *w = batch->w[i];
        double c1 = cosine[i], root = sqrt(1 - (1 - c1 * c1) / ((double)eta * eta));
        double way = p.t[i] * c1 / root, cos_outward = 0; // METHODS §1, s_i'
        double ft = prt_fresnel_transmittance(eta, c1);
        for (int k = 0; k < 3; k++)
            cos_outward += path->out_dir[k] * (w[k] / eta + (root - c1 / eta) * n[i][k]);
        for (int c = 0; c < 3; c++) {
            double phase = isotropic ? 1 / (4 * M_PI) : phase_at(j, phases, c, cos_outward);
            sum[c] += batch->weight[i] * ft * phase * path->sigma_s[c] * batch->rgb[i][c] *
                      exp(-path->sigma_t[c] * (batch->depth[i] + way));
        }
    }
    batch->n = 0;
}

// W05 eq 4 by Monte Carlo: along the refracted path with an eye, else along -n_o.
static void single_at(const struct job *j, uint32_t v, float out[3])
{
    const struct prt_material *m = j->material;
    const float *normal = j->mesh->normal[v];
    struct path path;
    struct phases phases = {.exact = j->o->n_phase_term == 0};
    float down[3], t = 0, bu, bv, eps = prt_scene_epsilon(j->scene), start[3];
    uint32_t triangle;
    double sum[3] = {0, 0, 0};
    memcpy(path.x, j->mesh->position[v], sizeof path.x);
    memcpy(path.out_dir, normal, sizeof path.out_dir);
    bool view_free = !j->o->eye;
    if (!view_free) {
        float w[3], length = 0, cosine;
        for (int k = 0; k < 3; k++) w[k] = j->o->eye[k] - path.x[k], length += w[k] * w[k];
        length = sqrtf(length);
        for (int k = 0; k < 3; k++) w[k] /= length > 0 ? length : 1;
        cosine = dot3(w, normal);
        out[0] = out[1] = out[2] = 0;
        if (cosine <= 0) return; // faces away: nothing is seen of it
        double root = sqrt(1 - (1 - (double)cosine * cosine) / ((double)m->eta * m->eta));
        for (int k = 0; k < 3; k++)
            path.out_dir[k] = (float)(w[k] / m->eta + (root - cosine / m->eta) * normal[k]);
    }
    for (int k = 0; k < 3; k++) {
        down[k] = !view_free && !j->o->straight_single ? -path.out_dir[k] : -normal[k];
        start[k] = path.x[k] - eps * normal[k];
    }
    memcpy(path.inward, down, sizeof down);
    for (int c = 0; c < 3; c++) {
        path.sigma_s[c] = m->sigma_s_prime[c] / (1 - m->g[c]);
        path.sigma_t[c] = path.sigma_s[c] + m->sigma_a[c];
        if (!phases.exact) (void)prt_phase_hg(&phases.cut[c], m->g[c], j->o->n_phase_term);
    }
    path.length = 40 / fmin(path.sigma_t[0], fmin(path.sigma_t[1], path.sigma_t[2]));
    if (prt_scene_intersect(j->scene, start, down, eps, INFINITY, &t, &triangle, &bu, &bv))
        path.length = fmin(path.length, fmax(t, 2 * eps));
    const struct light_rays *r = j->rays;
    size_t base = (size_t)(prt_hash64(&v, sizeof v, j->o->seed + 5) % r->n_pattern) * r->n_ray;
    struct prt_rng rng;
    prt_rng_init(&rng, j->o->seed, v);
    double xi = prt_rng_f32(&rng);
    struct batch batch = {0};
    for (uint32_t k = 0; k < r->n_ray; k++) {
        uint32_t i = batch.n++;
        xi += 0.6180339887498949;
        xi -= floor(xi);
        batch.depth[i] = depth_sample(&path, xi);
        batch.weight[i] = 1 / depth_density(&path, batch.depth[i]);
        batch.w[i][0] = r->x[base + k], batch.w[i][1] = r->y[base + k];
        batch.w[i][2] = r->z[base + k];
        batch.rgb[i] = r->rgb + (base + k) * 3;
        if (batch.n == 16 || k + 1 == r->n_ray)
            scatter(j, &path, &phases, view_free, &batch, sum);
    }
    for (int c = 0; c < 3; c++) out[c] = (float)sum[c];
}

static double view_transmittance(const struct job *j, uint32_t v)
{
    if (!j->o->eye) return prt_fresnel_mean_transmittance(j->material->eta);
    float w[3], length = 0;
    for (int k = 0; k < 3; k++) {
        w[k] = j->o->eye[k] - j->mesh->position[v][k];
        length += w[k] * w[k];
    }
    double cosine = dot3(w, j->mesh->normal[v]) / sqrt(length);
    return cosine > 0 ? prt_fresnel_transmittance(j->material->eta, fmin(cosine, 1)) : 0;
}

static void opaque_at(const struct job *j, uint32_t v, float out[3])
{
    const float *albedo =
        j->mesh->surface[j->mesh->block[j->vertex_block[v]].surface].base_color;
    vertex_irradiance(j, v, 0, out);
    for (int c = 0; c < 3; c++) out[c] *= (float)(albedo[c] / M_PI);
}

// Material m under every light at one vertex; color[l] gets what was asked.
static void shade_vertex(const struct job *all, unsigned m, uint32_t v, size_t at,
                         double (*multiple)[3])
{
    struct job j = *all;
    enum prt_reference_term term = j.o->term;
    j.material = j.materials[m];
    bool inside = translucent(&j, v);
    if (inside && term != PRT_REFERENCE_SINGLE && term != PRT_REFERENCE_IRRADIANCE)
        multiple_at(&j, v, j.dipoles[m], multiple);
    else memset(multiple, 0, j.n_light * sizeof *multiple);
    for (unsigned l = 0; l < j.n_light; l++) {
        float *out = j.color[m * j.n_light + l][at], part[3];
        j.rays = j.lights ? j.lights[l] : NULL;
        for (int c = 0; c < 3; c++) out[c] = (float)multiple[l][c];
        if (!inside) {
            if (term != PRT_REFERENCE_SINGLE) opaque_at(&j, v, out);
            continue;
        }
        if (term == PRT_REFERENCE_IRRADIANCE) vertex_irradiance(&j, v, j.material->eta, out);
        if ((term == PRT_REFERENCE_SINGLE || term == PRT_REFERENCE_TOTAL) &&
            !j.material->profile) {
            single_at(&j, v, part);
            for (int c = 0; c < 3; c++) out[c] += part[c];
        }
        if (term == PRT_REFERENCE_TOTAL) {
            double ft = view_transmittance(&j, v);
            for (int c = 0; c < 3; c++) out[c] = fmaxf((float)(ft * out[c]), 0);
        }
    }
}

static int vertex_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct job *j = arg;
    double(*multiple)[3] = prt_alloc(j->n_light, sizeof *multiple);
    if (!multiple) return PRT_NOMEM;
    prt_trace_thread_init();
    for (size_t i = begin; i < end; i++)
        for (unsigned m = 0; m < j->n_material; m++)
            shade_vertex(j, m, j->o->vertex ? j->o->vertex[i] : (uint32_t)i, i, multiple);
    prt_free(multiple);
    return PRT_OK;
}

// Triangles around each welded vertex.
static int build_corners(struct job *j)
{
    const struct prt_mesh *mesh = j->mesh;
    j->corner_begin = prt_calloc(mesh->n_weld + 2u, sizeof *j->corner_begin);
    j->corner = prt_alloc((size_t)mesh->n_triangle * 3, sizeof *j->corner);
    if (!j->corner_begin || !j->corner) return PRT_NOMEM;
    for (uint32_t t = 0; t < mesh->n_triangle; t++)
        for (int k = 0; k < 3; k++) j->corner_begin[mesh->weld[mesh->triangle[t][k]] + 2]++;
    for (uint32_t w = 0; w < mesh->n_weld; w++)
        j->corner_begin[w + 2] += j->corner_begin[w + 1];
    for (uint32_t t = 0; t < mesh->n_triangle; t++)
        for (int k = 0; k < 3; k++)
            j->corner[j->corner_begin[mesh->weld[mesh->triangle[t][k]] + 1]++] = t;
    return PRT_OK;
}

// The shortest mean free path of all media [mm].
static double finest_path(const struct job *j)
{
    double finest = INFINITY;
    for (unsigned m = 0; m < j->n_material; m++)
        for (int c = 0; c < 3; c++) finest = fmin(finest, 1 / j->dipoles[m][c].sigma_t_prime);
    return finest;
}

// Samples at l_u/4 of the densest channel where the budget allows, never fewer than 60,000.
static uint32_t sample_count(const struct job *j)
{
    if (j->o->n_sample) return j->o->n_sample;
    double finest = finest_path(j), area = prt_surface_area(j->mesh);
    double n = area / (finest * finest / 16);
    return (uint32_t)fmin(fmax(n, 60000), 240000);
}

// E depends on the light and eta alone: one pass over the samples a light serves all media.
static int prepare_multiple(struct job *j, const struct prt_cube *const light[])
{
    int status = prt_surface_create(j->ctx, j->mesh, sample_count(j), (float)finest_path(j) / 8,
                                    j->o->seed + 11, &j->surface);
    if (!status)
        status =
            prt_surface_check(j->ctx, j->surface, j->mesh, finest_path(j), j->o->n_sample != 0);
    if (status) return status;
    size_t n = j->surface->n_sample;
    float *all = prt_alloc(3 * n * j->n_light, sizeof *all);
    if (!all) return PRT_NOMEM;
    for (unsigned l = 0; l < j->n_light && !status; l++) {
        j->irradiance = all + 3 * n * l;
        status = prt_light_rays_create(light[l], 64, j->o->n_ray ? j->o->n_ray : 2048,
                                   j->o->seed + 1, &j->rays);
        if (!status)
            status = prt_parallel_for(j->ctx, "reference irradiance", n, 64, sample_range, j);
        prt_light_rays_destroy(j->rays);
        j->rays = NULL;
    }
    j->irradiance = all;
    return status;
}

// What vertices trace themselves: single scattering, their own irradiance, opaque ones'.
static int prepare_lights(struct job *j, const struct prt_cube *const light[])
{
    uint32_t n_ray = j->o->n_ray ? j->o->n_ray : 2048;
    if (j->o->term == PRT_REFERENCE_SINGLE || j->o->term == PRT_REFERENCE_TOTAL)
        n_ray = j->o->n_single ? j->o->n_single : 4096;
    else if (j->o->term == PRT_REFERENCE_IRRADIANCE && !j->o->n_ray) n_ray = 8192;
    j->lights = prt_calloc(j->n_light, sizeof *j->lights);
    int status = j->lights ? PRT_OK : PRT_NOMEM;
    for (unsigned l = 0; l < j->n_light && !status; l++)
        status = prt_light_rays_create(light[l], 64, n_ray, j->o->seed + 2, &j->lights[l]);
    return status;
}

static int check_materials(struct job *j)
{
    j->dipoles = prt_calloc(j->n_material, sizeof *j->dipoles);
    if (!j->dipoles) return PRT_NOMEM;
    for (unsigned m = 0; m < j->n_material; m++) {
        int status = prt_material_check(j->ctx, j->materials[m]);
        if (status) return status;
        if (j->materials[m]->eta != j->materials[0]->eta)
            return prt_fail(j->ctx, PRT_MISMATCH,
                            "eta is %g and %g: media measured together share theirs",
                            (double)j->materials[0]->eta, (double)j->materials[m]->eta);
        prt_material_dipoles(j->materials[m], j->dipoles[m]);
    }
    return PRT_OK;
}

int prt_reference_many(const struct prt_context *ctx, const struct prt_mesh *mesh,
                       unsigned n_material, const struct prt_material *const material[],
                       unsigned n_light, const struct prt_cube *const light[],
                       const struct prt_reference_options *options, float (*const color[])[3])
{
    if (!n_material || n_material > PRT_REFERENCE_MAX_MANY || !n_light ||
        n_light > PRT_REFERENCE_MAX_MANY)
        return prt_fail(ctx, PRT_ARG, "%u media under %u lights: 1 to %d of each", n_material,
                        n_light, PRT_REFERENCE_MAX_MANY);
    struct job j = {.ctx = ctx,
                    .mesh = mesh,
                    .material = material[0],
                    .o = options,
                    .n_material = n_material,
                    .n_light = n_light,
                    .materials = material,
                    .color = color};
    bool any = false;
    for (uint32_t b = 0; b < mesh->n_block; b++)
        any |= mesh->surface[mesh->block[b].surface].translucent && mesh->block[b].n_triangle;
    bool multiple =
        options->term == PRT_REFERENCE_MULTIPLE || options->term == PRT_REFERENCE_TOTAL;
    int status = check_materials(&j);
    if (status == PRT_OK && !(j.vertex_block = prt_mesh_vertex_blocks(mesh)))
        status = PRT_NOMEM;
    if (status == PRT_OK) status = build_corners(&j);
    if (status == PRT_OK) status = prt_scene_create(ctx, mesh, &j.scene);
    if (status == PRT_OK && multiple && any) status = prepare_multiple(&j, light);
    if (status == PRT_OK) status = prepare_lights(&j, light);
    size_t n = options->vertex ? options->n_vertex : mesh->n_vertex;
    if (status == PRT_OK) status = prt_parallel_for(ctx, "reference", n, 16, vertex_range, &j);
    for (unsigned l = 0; j.lights && l < n_light; l++) prt_light_rays_destroy(j.lights[l]);
    prt_free(j.lights);
    prt_free(j.dipoles);
    prt_surface_destroy(j.surface);
    prt_scene_destroy(j.scene);
    prt_free(j.irradiance);
    prt_free(j.vertex_block);
    prt_free(j.corner_begin);
    prt_free(j.corner);
    return status == PRT_NOMEM ? prt_fail(ctx, status, "no memory for the reference engine")
                               : status;
}

int prt_reference_colors(const struct prt_context *ctx, const struct prt_mesh *mesh,
                         const struct prt_material *material, const struct prt_cube *light,
                         const struct prt_reference_options *options, float (*color)[3])
{
    return prt_reference_many(ctx, mesh, 1, &material, 1, &light, options, &color);
}
