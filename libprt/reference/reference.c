// SPDX-License-Identifier: MIT
// The reference engine: irradiance and multiple scattering by brute force, at vertices (METHODS
// §8).
#include "reference/reference_private.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// Rays of a sample, paths of a vertex, rays of a vertex's own irradiance; independent sets of
// rays.
enum { SAMPLE_RAYS = 2048, SINGLE_PATHS = 4096, VERTEX_RAYS = 8192, PATTERNS = 64 };

static bool translucent(const struct job *j, uint32_t vertex)
{
    return j->mesh->surface[j->mesh->block[j->vertex_block[vertex]].surface].translucent != 0;
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

// E(x) = sum F_t V L (n.w) over one pattern of rays (METHODS §1). A direction counts when it is
// above at least one of `faces`, flat normals. eta 0: no Fresnel (opaque).
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

void prt_reference_face_normal(const struct prt_mesh *mesh, uint32_t t, float out[3])
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

enum { MOST_FACES = 32 }; // of a vertex that are tested

// E at a vertex, with the vertex normal, blocked below all its faces (METHODS §1, irradiance).
static void vertex_irradiance(const struct job *j, uint32_t v, double eta, float out[3])
{
    float faces[MOST_FACES][3], origin[3];
    uint32_t w = j->mesh->weld[v], n = 0;
    for (uint32_t k = j->corner_begin[w]; k < j->corner_begin[w + 1] && n < MOST_FACES; k++)
        prt_reference_face_normal(j->mesh, j->corner[k], faces[n++]);
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
                      prt_media_of(&j->media[0], j->surface->object[i])->eta, e);
        float tint = j->surface->tint ? j->surface->tint[i] : 1;
        for (size_t c = 0; c < 3; c++)
            j->irradiance[c * j->surface->n_sample + i] = tint * e[c];
    }
    return PRT_OK;
}

// The sum of products in sixteen partial sums, which a compiler may keep in registers.
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
static const float near_spacings = 6; // a bake integrates cells within 3.5

// B(x)/pi: the sum over all samples of the object, as points in the far field and as cells in
// the near field. Adds to out[n_light].multiple.
static void multiple_at(const struct job *j, uint32_t v, const struct prt_diffusion dipole[3],
                        struct walk_light *out)
{
    const struct prt_surface_points *s = j->surface;
    uint32_t object = j->mesh->block[j->vertex_block[v]].object;
    const float *x = j->mesh->position[v];
    float near_mm = near_spacings * s->spacing, r2[CHUNK], afar[2 * CHUNK], rd[3][2 * CHUNK];
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
                out[l].multiple[c] += (double)dot_array(
                    rd[c], j->irradiance + ((size_t)l * 3 + c) * s->n_sample + begin, n);
    }
    for (unsigned l = 0; l < j->n_light; l++)
        for (int c = 0; c < 3; c++) out[l].multiple[c] /= M_PI;
}

// F_t of the exit: towards the eye, or its mean over the hemisphere.
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

static void opaque_color(const struct job *j, uint32_t v, float out[3])
{
    const float *albedo =
        j->mesh->surface[j->mesh->block[j->vertex_block[v]].surface].base_color;
    vertex_irradiance(j, v, 0, out);
    for (int c = 0; c < 3; c++) out[c] *= (float)(albedo[c] / M_PI);
}

static bool scatters_within(const struct job *j)
{
    return j->o->term == PRT_REFERENCE_MULTIPLE || j->o->term == PRT_REFERENCE_TOTAL ||
           j->o->term == PRT_REFERENCE_UNSCATTERED;
}

// The term of the options at one translucent vertex; all has the multiple scattering.
static void shade_inside(const struct job *j, uint32_t v, const struct walk_light *all,
                         float out[3], float error[3])
{
    enum prt_reference_term term = j->o->term;
    float part[3];
    double divisor = prt_exit_divisor(j->material->eta, j->o->exit);
    for (int c = 0; c < 3; c++) {
        out[c] = (float)(term == PRT_REFERENCE_UNSCATTERED ? all->unscattered[c]
                         : term == PRT_REFERENCE_TOTAL ? all->multiple[c] + all->unscattered[c]
                                                       : all->multiple[c]);
        error[c] = (float)all->error[c];
    }
    if (term == PRT_REFERENCE_IRRADIANCE) vertex_irradiance(j, v, j->material->eta, out);
    if ((term == PRT_REFERENCE_SINGLE || term == PRT_REFERENCE_TOTAL) &&
        !j->material->profile) {
        prt_reference_single(j, v, part);
        double gain = term == PRT_REFERENCE_TOTAL ? divisor : 1;
        for (int c = 0; c < 3; c++) out[c] += (float)gain * part[c];
    }
    if (term == PRT_REFERENCE_TOTAL && !j->o->no_exit) {
        double leaves = view_transmittance(j, v) / divisor;
        for (int c = 0; c < 3; c++) {
            out[c] = fmaxf((float)(leaves * out[c]), 0);
            error[c] *= (float)leaves;
        }
    }
}

// Map m under every light at one vertex: the term of the options into color[l].
static void shade_vertex(const struct job *all, unsigned m, uint32_t v, size_t at,
                         struct walk_light *light)
{
    struct job j = *all;
    float ignored[3];
    const uint32_t object = j.mesh->block[j.vertex_block[v]].object;
    const uint32_t medium = prt_media_index(&j.media[m], object);
    j.material = &j.media[m].medium[medium];
    bool inside = translucent(&j, v);
    memset(light, 0, j.n_light * sizeof *light);
    if (inside && scatters_within(&j) && j.o->n_walk)
        prt_reference_walk(&j, j.material, v, light);
    else if (inside && scatters_within(&j)) multiple_at(&j, v, j.dipoles[m][medium], light);
    for (unsigned l = 0; l < j.n_light; l++) {
        float *out = j.color[m * j.n_light + l][at];
        float *error =
            j.o->standard_error ? j.o->standard_error[m * j.n_light + l][at] : ignored;
        j.rays = j.lights ? j.lights[l] : NULL;
        memset(out, 0, 3 * sizeof *out);
        memset(error, 0, 3 * sizeof *error);
        if (inside) shade_inside(&j, v, &light[l], out, error);
        else if (j.o->term != PRT_REFERENCE_SINGLE && j.o->term != PRT_REFERENCE_UNSCATTERED)
            opaque_color(&j, v, out);
    }
}

static int vertex_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct job *j = arg;
    struct walk_light *light = prt_alloc(j->n_light, sizeof *light);
    if (!light) return PRT_NOMEM;
    prt_trace_thread_init();
    for (size_t i = begin; i < end; i++)
        for (unsigned m = 0; m < j->n_map; m++)
            shade_vertex(j, m, j->o->vertex ? j->o->vertex[i] : (uint32_t)i, i, light);
    prt_free(light);
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
    for (unsigned m = 0; m < j->n_map; m++)
        for (uint32_t i = 0; i < j->media[m].n; i++)
            for (int c = 0; c < 3; c++)
                finest = fmin(finest, 1 / j->dipoles[m][i][c].sigma_t_prime);
    return finest;
}

// One sample for each (l_u/4)^2 of the densest channel, within limits. Doubling samples and
// rays moves the result by less than 0.5 % (tests/physics/reference.c).
static const double least_samples = 60000, most_samples = 240000;

static uint32_t sample_count(const struct job *j)
{
    if (j->o->n_sample) return j->o->n_sample;
    double finest = finest_path(j), area = prt_surface_area(j->mesh);
    double n = area / (finest * finest / 16);
    return (uint32_t)fmin(fmax(n, least_samples), most_samples);
}

// E depends on the light and eta alone: one pass over the samples for each light serves all
// media.
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
        status =
            prt_light_rays_create(light[l], PATTERNS, j->o->n_ray ? j->o->n_ray : SAMPLE_RAYS,
                                  j->o->seed + 1, &j->rays);
        if (!status)
            status = prt_parallel_for(j->ctx, "reference irradiance", n, 64, sample_range, j);
        prt_light_rays_destroy(j->rays);
        j->rays = NULL;
    }
    j->irradiance = all;
    return status;
}

// Rays that are traced at vertices: single scattering, irradiance, opaque surfaces.
static int prepare_lights(struct job *j, const struct prt_cube *const light[])
{
    uint32_t n_ray = j->o->n_ray ? j->o->n_ray : SAMPLE_RAYS;
    if (j->o->term == PRT_REFERENCE_SINGLE || j->o->term == PRT_REFERENCE_TOTAL)
        n_ray = j->o->n_single ? j->o->n_single : SINGLE_PATHS;
    else if (j->o->term == PRT_REFERENCE_IRRADIANCE && !j->o->n_ray) n_ray = VERTEX_RAYS;
    j->lights = prt_calloc(j->n_light, sizeof *j->lights);
    int status = j->lights ? PRT_OK : PRT_NOMEM;
    for (unsigned l = 0; l < j->n_light && !status; l++)
        status =
            prt_light_rays_create(light[l], PATTERNS, n_ray, j->o->seed + 2, &j->lights[l]);
    return status;
}

// Whether map m gives every object the eta of the first map.
static int check_etas(const struct job *j, unsigned m)
{
    for (uint32_t o = 0; o < j->mesh->n_object; o++) {
        const float eta = prt_media_of(&j->media[m], o)->eta;
        const float first = prt_media_of(&j->media[0], o)->eta;
        if (eta != first)
            return prt_fail(j->ctx, PRT_MISMATCH,
                            "eta is %g and %g: the media that one object has in one call must "
                            "have the same",
                            (double)first, (double)eta);
    }
    return PRT_OK;
}

static int check_media(struct job *j)
{
    j->dipoles = prt_calloc(j->n_map, sizeof *j->dipoles);
    if (!j->dipoles) return PRT_NOMEM;
    for (unsigned m = 0; m < j->n_map; m++) {
        const struct prt_media *media = &j->media[m];
        int status = prt_media_check(j->ctx, media, j->mesh->n_object);
        if (status || (status = check_etas(j, m))) return status;
        j->dipoles[m] = prt_calloc(media->n, sizeof *j->dipoles[m]);
        if (!j->dipoles[m]) return PRT_NOMEM;
        for (uint32_t i = 0; i < media->n; i++) {
            if (j->o->n_walk && media->medium[i].profile)
                return prt_fail(
                    j->ctx, PRT_MISMATCH,
                    "a material with a profile has no random walk: give sigma_s' and "
                    "sigma_a, or scattering by the dipole");
            prt_material_dipoles(&media->medium[i], j->dipoles[m][i]);
        }
    }
    return PRT_OK;
}

// Walks that leaked or became too long have brought no light.
static void report_lost(const struct job *j)
{
    const struct walk_tally *t = j->tally;
    double share = t->walks ? (double)t->lost / (double)t->walks : 0;
    if (share > 0.01)
        prt_log(j->ctx, PRT_LOG_WARNING,
                "%.2g %% of the walks did not leave the model: its surface is open, crosses "
                "itself or is wound inwards; the colours are too dark by as much",
                100 * share);
}

int prt_reference_many(const struct prt_context *ctx, const struct prt_mesh *mesh,
                       unsigned n_map, const struct prt_media media[], unsigned n_light,
                       const struct prt_cube *const light[],
                       const struct prt_reference_options *options, float (*const color[])[3])
{
    if (!n_map || n_map > PRT_REFERENCE_MAX_MANY || !n_light ||
        n_light > PRT_REFERENCE_MAX_MANY)
        return prt_fail(ctx, PRT_ARG, "%u media under %u lights: 1 to %d of each", n_map,
                        n_light, PRT_REFERENCE_MAX_MANY);
    struct walk_tally tally = {0};
    // In mm, as a .prt has its positions: its samples are those of its model.
    struct prt_mesh in_mm = *mesh;
    in_mm.model = NULL;
    mesh = &in_mm;
    struct job j = {.ctx = ctx,
                    .tally = &tally,
                    .mesh = mesh,
                    .o = options,
                    .n_map = n_map,
                    .n_light = n_light,
                    .media = media,
                    .color = color};
    bool any = false;
    for (uint32_t b = 0; b < mesh->n_block; b++)
        any |= mesh->surface[mesh->block[b].surface].translucent && mesh->block[b].n_triangle;
    int status = check_media(&j);
    if (status == PRT_OK && !(j.vertex_block = prt_mesh_vertex_blocks(mesh)))
        status = PRT_NOMEM;
    if (status == PRT_OK) status = build_corners(&j);
    if (status == PRT_OK) status = prt_scene_create(ctx, mesh, &j.scene);
    if (status == PRT_OK && scatters_within(&j) && any) {
        status = prepare_multiple(&j, light);
        if (status == PRT_OK && options->n_walk) status = prt_reference_walk_prepare(&j);
    }
    if (status == PRT_OK) status = prepare_lights(&j, light);
    size_t n = options->vertex ? options->n_vertex : mesh->n_vertex;
    if (status == PRT_OK)
        status =
            prt_parallel_for(ctx, "reference", n, options->n_walk ? 1 : 16, vertex_range, &j);
    if (status == PRT_OK) report_lost(&j);
    for (unsigned l = 0; j.lights && l < n_light; l++) prt_light_rays_destroy(j.lights[l]);
    prt_free(j.lights);
    for (unsigned m = 0; j.dipoles && m < n_map; m++) prt_free(j.dipoles[m]);
    prt_free(j.dipoles);
    prt_surface_strata_destroy(j.strata);
    prt_walk_space_destroy(j.space);
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
                         const struct prt_media *media, const struct prt_cube *light,
                         const struct prt_reference_options *options, float (*color)[3])
{
    return prt_reference_many(ctx, mesh, 1, media, 1, &light, options, &color);
}
