/* SPDX-License-Identifier: MIT */
/* prt/screen.h owns pictures without a bake: splatting (S09), tangent-plane sampling (M03) and
 * texture-space sampling (C08) of B(x_o) = int R_d(|x_o - x_i|) E(x_i) dA (METHODS §6). */
#ifndef PRT_SCREEN_H
#define PRT_SCREEN_H

#include "prt/raster.h"
#include "prt/trace.h"

#ifdef __cplusplus
extern "C" {
#endif

enum prt_screen_engine {
    PRT_SCREEN_SPLAT = 0, /* S09: surface points the light sees, each spread to all pixels */
    PRT_SCREEN_TANGENT,   /* M03: radii drawn from R_d in the tangent plane of each pixel */
    PRT_SCREEN_TEXTURE,   /* C08: points drawn from irradiance over an area-preserving atlas */
    PRT_SCREEN_HYBRID,    /* C08: near part from dense points, far part as TEXTURE */
    PRT_SCREEN_REFERENCE, /* every texel of the atlas to every pixel, exact R_d: slow */
};
/* "splat" "tangent" "texture" "hybrid" "reference"; PRT_ARG for other words. */
int prt_screen_engine_parse(const char *word, enum prt_screen_engine *out);
const char *prt_screen_engine_name(enum prt_screen_engine engine);

/* A distant or point light. direction: unit, towards the light, and irradiance on a plane
 * facing it; or a position [mm] and radiant intensity [irradiance * mm^2]. */
struct prt_screen_light {
    float where[3];
    float rgb[3];
    bool point;
};
/* At most n distant lights that stand for a cube: strata of equal power, each at its power's
 * mean direction. Powers add up to the cube's integral. Returns the number made. */
uint32_t prt_screen_lights_from_cube(const struct prt_cube *cube, uint32_t n,
                                     struct prt_screen_light *out);

/* What does not depend on light, material or view: the atlas and the peeled depth layers.
 * Immutable mesh; make another when positions change. Thread-safe after creation but for
 * prt_screen_radiance, which one thread may run at a time. */
struct prt_screen;
/* scene may be NULL: one is made. mesh and scene must outlive it. */
int prt_screen_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                      const struct prt_scene *scene, struct prt_screen **out);
void prt_screen_destroy(struct prt_screen *screen);

/* A reflectance profile in place of the dipole's, for layered media: R_d at n radii, ascending
 * from 0, linear in between, 0 beyond. rd [n][3] mm^-2. */
struct prt_screen_profile {
    uint32_t n;
    const float *r_mm;
    const float (*rd)[3];
};
/* The multipole (Donner & Jensen 2005) of one slab of this thickness at r_mm[n]; becomes the
 * dipole as the slab grows thick. *rho, if not NULL, gets the total reflectances. PRT_ARG for a
 * thickness that is not positive. */
int prt_screen_multipole(const struct prt_context *ctx, const struct prt_material *material,
                         double thickness_mm, uint32_t n, const float *r_mm, float (*rd)[3],
                         double rho[3]);

/* An image over the mesh's uv, row 0 at v = 0, repeated: linear values [height][width][3],
 * finite. */
struct prt_screen_map {
    uint32_t width, height;
    const float (*rgb)[3];
};

/* What an image's numbers mean: colours that multiply a medium's reflectance by absorption;
 * tangent-space normals 0.5 + 0.5 n; heights, of which white is height_mm (0: 0.5). */
enum prt_screen_map_kind {
    PRT_SCREEN_MAP_ALBEDO,
    PRT_SCREEN_MAP_NORMAL,
    PRT_SCREEN_MAP_HEIGHT
};
/* A map of an image whose pixels were decoded to linear RGB; `linear`: so were they stored,
 * else normals and heights are taken back to what was stored. Shrunk to most_side (0: as it
 * is). material: of ALBEDO. The caller finishes *out. */
int prt_screen_map_make(const struct prt_context *ctx, enum prt_screen_map_kind kind,
                        const struct prt_image *image, bool linear, uint32_t most_side,
                        const struct prt_material *material, float height_mm,
                        struct prt_screen_map *out);
void prt_screen_map_finish(struct prt_screen_map *map);
/* Whether files of this name keep numbers as they are meant (.exr .hdr .pfm .pic); others are
 * sRGB. */
bool prt_screen_map_linear(const char *file);

/* Factors of sigma_a (>= 1) that give a medium albedo[n] (clamped to [0,1]) times its own total
 * reflectance, for sigma_a_map. PRT_ARG where sigma_a is 0. */
int prt_screen_albedo_factors(const struct prt_context *ctx,
                              const struct prt_material *material, size_t n,
                              const float (*albedo)[3], float (*factor)[3]);

struct prt_screen_options {
    enum prt_screen_engine engine;
    uint32_t n_sample;  /* SPLAT: grid is n x n over the light's view; TANGENT: samples a
                           pixel; TEXTURE, HYBRID: samples; REFERENCE: texels. 0: from the
                           material, or the engine's default (64, 2500, 900, 262144) */
    uint32_t refine;    /* pictures drawn since anything changed: each doubles the samples, up
                           to what the reference uses; 0 for the first */
    uint32_t n_light;   /* distant lights that stand for a cube; 0: 64 */
    float budget_ms;    /* > 0: n_sample is chosen to fit, from the speed seen so far */
    float bound;        /* HYBRID: R_p is where 2 pi r R_d last crosses it [mm^-1]; 0: 0.05 */
    float epsilon;      /* SPLAT: r_max leaves this share of rho_d outside; 0: 0.002 */
    bool sh_irradiance; /* S09's unshadowed irradiance from 16 harmonics, cube lights only */
    bool
        measure_error; /* compare some pixels with REFERENCE (costs rays); not with `profile` */
    uint64_t seed;
    const struct prt_material *object_material; /* [n_object], or NULL: one for all */
    const struct prt_screen_profile *profile; /* SPLAT, TEXTURE, HYBRID: [n_object] in place of
                             the materials' own R_d, which all engines know; or NULL */
    uint32_t frame; /* which picture of a running mean this is: each takes other samples,
                       and the mean of 0..k goes to REFERENCE as k grows (TANGENT: to some
                       1 % of it); see prt_screen_progress. The same seed and frame give the
                       same picture */
    /* On meshes with uv: factors >= 0 of the medium's coefficients at each pixel (TANGENT and
       REFERENCE take R_d of the medium where light leaves; the others spread light in the plain
       medium and scale it by the pixel's total reflectance); heights [mm] (first channel) or
       tangent-space normals (0.5 + 0.5 n) for the irradiance. NULL: none */
    const struct prt_screen_map *sigma_s_map, *sigma_a_map, *bump_map, *normal_map;
    bool maps_by_surface; /* each of them is [n_surface], rgb NULL: none on that surface */
    bool maps_checked; /* they come from prt_screen_map_make: values are not looked through */
    const float (
        *vertex_irradiance)[3]; /* [n_vertex] E of all the lights where it is known already
                      (a bake's, prt_reference's): interpolated, no rays; or NULL */
    uint32_t rings, spokes; /* HYBRID under at most 4 distant lights: > 0: the near part from
                               C08's pattern of rings * spokes + 1 points of the light's view,
                               instead of all points within reach. C08: 20 and 20 */
};
struct prt_screen_report {
    enum prt_screen_engine engine;
    uint32_t n_sample;  /* points of the surface used (a pixel's own, for TANGENT) */
    uint32_t n_asked;   /* n_sample of the options, or what was chosen in its place */
    uint32_t grid;      /* SPLAT: n */
    uint32_t receivers; /* places light was summed for; points of the view lie between them */
    uint32_t n_light;
    uint64_t n_ray, n_pair; /* shadow and view rays; evaluations of R_d */
    float r_max_mm, r_p_mm;
    bool uv_atlas;     /* texels lie in the model's own uv; else along triangles */
    uint32_t n_medium; /* TANGENT with maps: sets of coefficients the pixels were sorted into */
    double irradiance_s, scatter_s;
    double error;          /* relative RMSE over covered pixels; < 0: not measured */
    double expected_error; /* the same as foreseen from engine, medium, model and n_sample, and
                              from what a check of an earlier frame (or this, the first of its
                              engine under few or many lights) at some points told */
    uint32_t frame;        /* pictures before this one in the running mean */
};

/* What a budget buys. */
struct prt_screen_plan {
    enum prt_screen_engine engine;
    uint32_t n_sample;
    double expected_ms;    /* of prt_screen_radiance, from the speed seen so far */
    double expected_error; /* relative RMSE against REFERENCE over covered pixels */
};
/* Sample counts for one engine so that a picture of this view takes about budget_ms (> 0);
 * lights as in prt_screen_radiance (n_light: distant lights for a cube; 0: as the options'
 * default, used only with has_cube). Sets options->engine and n_sample when options is not
 * NULL. PRT_ARG for a budget that is not positive. Does not block. */
int prt_screen_plan(const struct prt_context *ctx, const struct prt_screen *screen,
                    const struct prt_visibility *visibility,
                    const struct prt_material *material, enum prt_screen_engine engine,
                    bool has_cube, uint32_t n_light, double budget_ms,
                    struct prt_screen_options *options, struct prt_screen_plan *out);
/* The same for all four engines, and the one with the least expected error. */
int prt_screen_choose(const struct prt_context *ctx, const struct prt_screen *screen,
                      const struct prt_visibility *visibility,
                      const struct prt_material *material, bool has_cube, uint32_t n_light,
                      double budget_ms, struct prt_screen_options *options,
                      struct prt_screen_plan *out);

/* (1/pi) B at every point of a visibility buffer's G-buffer, albedo/pi E on opaque surfaces:
 * radiance [n_point][3], to be composed by prt_shade_points. Lights: cube (may be NULL) and
 * n_extra more. Asks ctx->progress between its stages and every tenth of a second within the
 * long ones; PRT_CANCELLED, radiance undefined, when that says stop: the screen stays good. */
int prt_screen_radiance(const struct prt_context *ctx, struct prt_screen *screen,
                        const struct prt_visibility *visibility,
                        const struct prt_material *material, const struct prt_cube *cube,
                        uint32_t n_extra, const struct prt_screen_light *extra,
                        const struct prt_screen_options *options, float (*radiance)[3],
                        struct prt_screen_report *report);
/* The same, composed: shade gives specular, background and Fresnel (its planes are ignored). */
int prt_screen_image(const struct prt_context *ctx, struct prt_screen *screen,
                     const struct prt_visibility *visibility,
                     const struct prt_material *material, const struct prt_cube *cube,
                     uint32_t n_extra, const struct prt_screen_light *extra,
                     const struct prt_screen_options *options, const struct prt_shade *shade,
                     struct prt_image *out, struct prt_screen_report *report);

/* Progressive pictures of one view: the running mean of frames while nothing changes. screen
 * and visibility must outlive it. One thread at a time. */
struct prt_screen_progress;
int prt_screen_progress_create(const struct prt_context *ctx, struct prt_screen *screen,
                               const struct prt_visibility *visibility,
                               struct prt_screen_progress **out);
void prt_screen_progress_destroy(struct prt_screen_progress *progress);
/* Light, material, options or the model changed: the next frame is the first again. */
void prt_screen_progress_restart(struct prt_screen_progress *progress);
uint32_t prt_screen_progress_frames(const struct prt_screen_progress *progress);
/* One more frame; *out is the mean so far, in which frame k weighs k + 1, composed.
 * options->frame and refine are ignored. measure_error: of the mean. */
int prt_screen_progress_image(const struct prt_context *ctx,
                              struct prt_screen_progress *progress,
                              const struct prt_material *material, const struct prt_cube *cube,
                              uint32_t n_extra, const struct prt_screen_light *extra,
                              const struct prt_screen_options *options,
                              const struct prt_shade *shade, struct prt_image *out,
                              struct prt_screen_report *report);

/* Building blocks, open for tests. */
/* M03: the radius >= from_mm below which lies a share xi in [0,1) of 2 pi r R_d / rho_d, the
 * mean of three channels. from_mm: a radius known to be smaller, 0 at first. */
double prt_screen_tangent_radius(const struct prt_diffusion dipole[3], double xi,
                                 double from_mm);
/* C08: share of R_d that is local at r (METHODS §7): 1 - 0.5 e^(K(r-R_p)) up to R_p. */
double prt_screen_local_weight(double r_mm, double r_p_mm);
/* C08: R_p for a bound over three channels. */
double prt_screen_split_radius(const struct prt_diffusion dipole[3], double bound);
/* C08: index drawn by u in [0,1) in proportion to value[n], n a power of 4, by walking down the
 * mip chain; mip holds value first, then each coarser level: 4n/3 numbers. */
uint32_t prt_screen_mip_sample(const float *mip, uint32_t n, float u);

#ifdef __cplusplus
}
#endif
#endif
