// SPDX-License-Identifier: MIT
// Shading of a visibility buffer: radiance of planes or points, Fresnel, specular, background.
#include "cube.h"
#include "internal.h"

#include "base/isa.h"

#include <math.h>
#include <string.h>

enum { LANES = 64, SMALL_BACKGROUND = 64 };
enum { PACKED_FLOATS = 12 }; // of a vertex: four planes of red, of green, of blue

typedef float four __attribute__((vector_size(16)));
typedef int four_bits __attribute__((vector_size(16)));
typedef float loose_four __attribute__((vector_size(16), aligned(4), may_alias));
typedef float eight __attribute__((vector_size(32)));
typedef float loose_eight __attribute__((vector_size(32), aligned(4), may_alias));

// A cube with or without borders, as the kernel reads it; offsets in floats.
struct cube_view {
    const float *texel;
    int n, border, texel_floats, row, face;
    int last; // largest column that has a right neighbour
};
struct lookup {
    int first[LANES]; // of four texels
    float fx[LANES], fy[LANES];
};
struct view_terms {
    float transmit[LANES], mirror[LANES], rx[LANES], ry[LANES], rz[LANES], ox[LANES], oy[LANES],
        oz[LANES];
};

/* A pixel's normal as shading takes it: the direction w towards the eye, the normal m bent
 * until m·w is at least half the facet's own cosine (interpolated normals may turn away from
 * the eye; METHODS §6), c = m·w, and the Fresnel terms of c at the job's η. */
struct eyed_normal {
    float wx, wy, wz, mx, my, mz, c;
    float ct;     /* cosine of the refracted direction inside */
    float mirror; /* share reflected, F_r of METHODS §1, exact and unpolarised */
};

struct shade_job {
    const struct prt_visibility *vis;
    const struct prt_gbuffer *g;
    const struct camera_frame *frame;
    uint32_t width, height;
    const float (*radiance)[3]; // per point, or NULL: planes
    const float *planes;
    size_t plane_floats;
    unsigned n_plane;
    const float *packed; // [n_vertex][n_group][3][4] of the planes, or NULL
    unsigned n_group;
    float eye[3], plain[3], sign[16];
    float sky_cos, sky_sin;   // of the background's rotation about +y
    float lobe_cos, lobe_sin; // of the specular's
    const struct cube_view *specular, *background;
    int level_floats;       // distance of the levels of roughness in specular
    const float *eta;       // [n_block]
    const float *roughness; // [n_block] of points without their own
    const float *exit;      // [n_block] factor of F_t; 0: translucent radiance leaves as it is
    bool one_medium;        // all blocks have the first one's
    float *rgb, *alpha;     // alpha NULL: with a background
    uint8_t *rgb8;          // in place of rgb, by `tone`
    struct tone_curve tone;
    const float *shadow; // [height][width][3] of the background, or NULL
    void (*row)(const struct shade_job *job, uint32_t y, float *row);
};

#define PRT_KERNEL_FILE "raster/shade_kernel.h"
#include "base/isa_each.h"

static int shade_rows(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct shade_job *job = arg;
    float one[3 * RASTER_MAX_SIZE];
    const size_t n = (size_t)3 * job->width;
    for (size_t y = begin; y < end; y++) {
        job->row(job, (uint32_t)y, job->rgb8 ? one : job->rgb + y * n);
        if (job->rgb8) job->tone.values(&job->tone, one, n, job->rgb8 + y * n);
    }
    return PRT_OK;
}

static struct cube_view view_bordered(const struct border_cube *c)
{
    int m = (int)c->n + 2;
    return (struct cube_view){c->texel, (int)c->n, 1, 4, 4 * m, 4 * m * m, m - 2};
}

static struct cube_view view_plain(const struct prt_cube *c)
{
    int n = (int)c->n;
    return (struct cube_view){c->texel, n, 0, 3, 3 * n, 3 * n * n, n - 2};
}

// Signs of prt_sh_eval's harmonics relative to the kernel's, found at one direction where none
// is 0: the convention of medium/ is not repeated here.
static void harmonic_signs(float sign[16])
{
    static const float dir[3] = {0.48f, 0.6f, 0.64f};
    float y[16];
    struct view_terms v;
    float mine[4][LANES][4], plus[16];
    for (int k = 0; k < 16; k++) plus[k] = 1;
    v.ox[0] = dir[0];
    v.oy[0] = dir[1];
    v.oz[0] = dir[2];
    harmonics_c(&v, 1, 16, plus, mine);
    prt_sh_eval(4, dir, y);
    sign[0] = 1;
    for (int k = 1; k < 16; k++) sign[k] = y[k] * mine[k / 4][0][k % 4] < 0 ? -1 : 1;
}

// eta, roughness and the exit's factor of each block, [3][n_block]; NULL without memory.
static float *surface_of_blocks(const struct prt_visibility *vis, const struct prt_shade *s)
{
    static const struct prt_material none = {.eta = 1};
    const struct prt_media media = s->media.n ? s->media : prt_media_one(&none);
    const size_t n = vis->n_block;
    float *value = prt_alloc(3 * n, sizeof *value), exit[PRT_MEDIA_MAX];
    for (uint32_t i = 0; i < media.n; i++) {
        const double eta = fmax(1, (double)media.medium[i].eta);
        exit[i] = s->fresnel ? (float)(1 / prt_exit_divisor(eta, s->exit)) : 0;
    }
    for (uint32_t i = 0; value && i < n; i++) {
        const uint32_t medium = prt_media_index(&media, vis->block_object[i]);
        value[i] = fmaxf(1, media.medium[medium].eta);
        value[n + i] = media.medium[medium].roughness;
        value[2 * n + i] = exit[medium];
    }
    return value;
}

static int shade(const struct prt_context *ctx, const struct prt_visibility *vis,
                 const struct prt_shade *s, struct shade_job *job, struct prt_image *out)
{
    int curve = PRT_OK;
    if (s->rgb8 && s->transparent)
        return prt_fail(ctx, PRT_ARG, "shade: pixels of 8 bits have no alpha");
    if (s->rgb8) curve = prt_tone_curve(ctx, s->tone, s->exposure_ev, &job->tone);
    if (curve) return curve;
    job->rgb8 = s->rgb8;
    float *of_block = surface_of_blocks(vis, s);
    struct prt_image image = {vis->width, vis->height, NULL, NULL};
    if (!s->rgb8) image.rgb = prt_alloc((size_t)vis->width * vis->height, 3 * sizeof(float));
    struct border_cube sky = {0};
    struct cube_view specular, background;
    if (s->transparent)
        image.alpha = prt_alloc((size_t)vis->width * vis->height, sizeof(float));
    bool good = (image.rgb || s->rgb8) && of_block && (image.alpha || !s->transparent);
    struct prt_gbuffer own = vis->g;
    if (s->leave_out & PRT_LOOK_BASE) own.base[0] = NULL;
    if (s->leave_out & PRT_LOOK_NORMAL) own.turned[0] = NULL;
    if (s->leave_out & PRT_LOOK_NORMAL && own.smooth) own.variance = own.smooth;
    if (s->leave_out & PRT_LOOK_REST) own.roughness = own.occlusion = own.emission[0] = NULL;
    job->vis = vis;
    job->g = &own;
    job->frame = &vis->frame;
    job->width = vis->width;
    job->height = vis->height;
    job->eta = of_block;
    job->roughness = of_block ? of_block + vis->n_block : NULL;
    job->exit = of_block ? of_block + 2 * (size_t)vis->n_block : NULL;
    job->one_medium = s->media.n <= 1;
    job->rgb = image.rgb;
    job->alpha = image.alpha;
    job->shadow = s->shadow;
    const double degree = 3.14159265358979323846 / 180;
    job->sky_cos = (float)cos((double)s->background_rotate_deg * degree);
    job->sky_sin = (float)sin((double)s->background_rotate_deg * degree);
    job->lobe_cos = (float)cos((double)s->specular_rotate_deg * degree);
    job->lobe_sin = (float)sin((double)s->specular_rotate_deg * degree);
    for (int i = 0; i < 3; i++) {
        job->eye[i] = (float)vis->frame.eye[i];
        job->plain[i] = s->transparent ? 0 : s->background_rgb[i];
    }
    if (good && s->specular) {
        specular = view_bordered(&s->specular->stack);
        job->specular = &specular;
        job->level_floats = SPECULAR_LEVEL_FLOATS;
    }
    if (good && s->background && !s->transparent) {
        bool small = s->background->n <= SMALL_BACKGROUND;
        if (small) good = prt_border_cube_copy(&sky, s->background);
        background = small ? view_bordered(&sky) : view_plain(s->background);
        job->background = &background;
    }
    job->row = shade_row_c;
#if PRT_ISA_X86
    unsigned cpu = ctx ? ctx->cpu : prt_cpu_detect();
    if (cpu & PRT_CPU_AVX2) job->row = shade_row_avx2;
    if (cpu & PRT_CPU_AVX512) job->row = shade_row_avx512;
#endif
    int status = good ? prt_parallel_for(ctx, NULL, vis->height, 8, shade_rows, job)
                      : prt_fail(ctx, PRT_NOMEM, "shade: no memory for %ux%u pixels",
                                 vis->width, vis->height);
    prt_border_cube_finish(&sky);
    prt_free(of_block);
    if (status) {
        prt_image_finish(&image);
        return status;
    }
    *out = image;
    return PRT_OK;
}

struct packing {
    const struct prt_shade *shade;
    size_t plane_floats;
    unsigned n_group;
    float *out;
};

static int pack_planes(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct packing *p = arg;
    const unsigned n = p->shade->n_plane;
    for (unsigned g = 0; g < p->n_group; g++) {
        const float *in[4]; // behind the last plane, plane 0: harmonics() weighs it by 0
        for (unsigned k = 0; k < 4; k++)
            in[k] = p->shade->planes + (4 * g + k < n ? 4 * g + k : 0) * p->plane_floats;
        for (size_t v = begin; v < end; v++) {
            float *out = p->out + (v * p->n_group + g) * PACKED_FLOATS;
            for (size_t i = 3 * v; i < 3 * v + 3; i++, out += 4)
                *(loose_four *)out = (four){in[0][i], in[1][i], in[2][i], in[3][i]};
        }
    }
    return PRT_OK;
}

// Packs several planes where each vertex is read for several points. *out: NULL where not.
static int pack(const struct prt_context *ctx, const struct prt_visibility *vis,
                const struct prt_mesh *mesh, const struct prt_shade *s, unsigned n_group,
                float **out)
{
    const size_t n = mesh->n_vertex;
    struct packing p = {s, 3 * n, n_group, NULL};
    *out = NULL;
    if (s->n_plane == 1 || n > vis->row_point[vis->height]) return PRT_OK;
    p.out = prt_alloc(n * n_group * PACKED_FLOATS, sizeof *p.out);
    if (!p.out) return prt_fail(ctx, PRT_NOMEM, "shade: no memory for %u planes", s->n_plane);
    *out = p.out;
    return prt_parallel_for(ctx, NULL, n, 2048, pack_planes, &p);
}

int prt_shade_image(const struct prt_context *ctx, const struct prt_visibility *vis,
                    const struct prt_mesh *mesh, const struct prt_shade *s,
                    struct prt_image *out)
{
    if (mesh->n_vertex != vis->n_mesh_vertex || mesh->n_triangle != vis->n_mesh_triangle)
        return prt_fail(ctx, PRT_MISMATCH, "shade: the visibility buffer is of another mesh");
    if (!s->planes || !s->n_plane || s->n_plane > 16)
        return prt_fail(ctx, PRT_ARG, "shade: %u phase planes are outside [1,16]", s->n_plane);
    if (s->n_plane > 1 && s->n_plane != 4 && s->n_plane != 9 && s->n_plane != 16)
        return prt_fail(ctx, PRT_ARG, "shade: %u phase planes are not 1, 4, 9 or 16",
                        s->n_plane);
    struct shade_job job = {
        .planes = s->planes, .n_plane = s->n_plane, .plane_floats = (size_t)mesh->n_vertex * 3};
    if (s->n_plane > 1) harmonic_signs(job.sign);
    float *packed;
    job.n_group = (s->n_plane + 3) / 4;
    int status = pack(ctx, vis, mesh, s, job.n_group, &packed);
    job.packed = packed;
    if (!status) status = shade(ctx, vis, s, &job, out);
    prt_free(packed);
    return status;
}

int prt_shade_points(const struct prt_context *ctx, const struct prt_visibility *vis,
                     const float (*radiance)[3], const struct prt_shade *s,
                     struct prt_image *out)
{
    struct shade_job job = {.radiance = radiance};
    return shade(ctx, vis, s, &job, out);
}
