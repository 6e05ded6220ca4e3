/* SPDX-License-Identifier: MIT */
/* prt/screen.h owns pictures without a bake: splatting (S09), tangent-plane sampling (M03) and
 * texture-space sampling (C08) of B(x_o) = int R_d(|x_o - x_i|) E(x_i) dA (METHODS §6).
 *
 * Colours are linear RGB. Lengths are in mm, R_d in mm^-2, coefficients of media in mm^-1.
 * Functions that return int return PRT_OK or a negative status (prt/base.h), and report its
 * reason to ctx->log; *out is not written then unless the function's comment says so. ctx may
 * be NULL. Pointers that a struct holds must stay valid for as long as the call that reads
 * them. */
#ifndef PRT_SCREEN_H
#define PRT_SCREEN_H

#include "prt/raster.h"
#include "prt/trace.h"
#include "prt/walk_ratio.h"

#ifdef __cplusplus
extern "C" {
#endif

enum prt_screen_engine {
    PRT_SCREEN_SPLAT = 0, /* S09: points that the light sees, each spread to all pixels */
    PRT_SCREEN_TANGENT,   /* M03: radii drawn from R_d in the tangent plane of each pixel */
    PRT_SCREEN_TEXTURE,   /* C08: points drawn from irradiance over an area-preserving atlas */
    PRT_SCREEN_HYBRID,    /* C08: near part from dense points, far part as TEXTURE */
    PRT_SCREEN_REFERENCE, /* every texel of the atlas to every pixel, exact R_d: slow */
};
/* The engine of a word: "splat" "tangent" "texture" "hybrid" "reference". PRT_ARG, without a
 * log line, for other words. Thread-safe. */
int prt_screen_engine_parse(const char *word, enum prt_screen_engine *out);
/* The word of an engine, "unknown" for values outside the enum; static storage. Thread-safe. */
const char *prt_screen_engine_name(enum prt_screen_engine engine);

/* A distant or point light. */
struct prt_screen_light {
    float where[3]; /* direction towards the light, any length > 0; point: position [mm] */
    float rgb[3]; /* >= 0; irradiance on a plane that faces the light; point: radiant intensity
                     [irradiance * mm^2] */
    bool point;
};

/* A picture is computed of this. */
struct prt_screen_input {
    const struct prt_visibility *visibility; /* of the screen's mesh */
    struct prt_media media;                  /* of the objects */
    const struct prt_cube
        *cube;        /* environment; NULL: none. options' n_light lights replace it */
    uint32_t n_extra; /* further lights, at most 4096 */
    const struct prt_screen_light *extra; /* [n_extra] */
};

/* State that depends on neither light, material nor view (atlas, peeled depth layers), and
 * caches of the last views drawn. */
struct prt_screen;
/* Prepares pictures of a mesh whose positions stay; create another when they change. scene:
 * rays against the same mesh; NULL: one is built. mesh and scene must outlive the screen.
 * PRT_ARG for a mesh without extent, PRT_NOMEM. Different screens may be used by different
 * threads; calls with one screen must not overlap. Blocks while a scene is built. */
int prt_screen_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                      const struct prt_scene *scene, struct prt_screen **out);
/* Frees a screen; NULL is allowed. */
void prt_screen_destroy(struct prt_screen *screen);

/* An image over the mesh's uv, row 0 at v = 0, repeated beyond [0,1]. */
struct prt_screen_map {
    uint32_t width, height; /* [1,16384] */
    const float (*rgb)[3];  /* [height][width] linear, finite */
};

/* The meaning of an image's numbers. */
enum prt_screen_map_kind {
    PRT_SCREEN_MAP_ALBEDO, /* colours: they multiply a medium's reflectance, by absorption */
    PRT_SCREEN_MAP_NORMAL, /* tangent-space normals, stored as 0.5 + 0.5 n */
    PRT_SCREEN_MAP_HEIGHT  /* heights, white is height_mm */
};
/* Makes a map of an image. image: linear RGB as decoded. linear: the file stored linear numbers
 * (prt_screen_map_linear); otherwise normals and heights are encoded back to sRGB first, since
 * their numbers are data and not colours. most_side: the longer side is reduced to this many
 * texels by averaging; 0: kept. material: read for ALBEDO. height_mm: of white, for HEIGHT; 0:
 * 0.5. The caller ends *out with prt_screen_map_finish; *out is all 0 after an error. PRT_ARG
 * for an image without pixels or a medium without absorption, PRT_NOMEM. Thread-safe. Runs on
 * ctx->pool and blocks until done. */
int prt_screen_map_make(const struct prt_context *ctx, enum prt_screen_map_kind kind,
                        const struct prt_image *image, bool linear, uint32_t most_side,
                        const struct prt_material *material, float height_mm,
                        struct prt_screen_map *out);
/* Frees the texels of prt_screen_map_make and clears the map. */
void prt_screen_map_finish(struct prt_screen_map *map);
/* Whether files of this name's ending store linear numbers (.exr .hdr .pfm .pic); others are
 * sRGB. Thread-safe. */
bool prt_screen_map_linear(const char *file);

struct prt_screen_options {
    enum prt_screen_engine engine;
    uint32_t n_sample;  /* SPLAT: the grid is n x n over the light's view; TANGENT: samples a
                           pixel; TEXTURE, HYBRID: samples; REFERENCE: texels. 0: by budget_ms,
                           else SPLAT's spacing of 0.75 mean free paths, or 64, 2500, 900,
                           262144 */
    uint32_t refine;    /* pictures drawn since anything changed, 0 for the first: each doubles
                           the samples, up to the engine's limit */
    uint32_t n_light;   /* distant lights that stand for a cube; 0: 64 */
    float budget_ms;    /* > 0: n_sample is chosen to fit, from the speed measured so far */
    float bound;        /* HYBRID: R_p is the last radius where 2 pi r R_d crosses it [mm^-1];
                           0: 0.1 */
    float epsilon;      /* SPLAT: share of rho_d outside r_max, [0,1) (S09 eq 4); 0: 0.002 */
    bool sh_irradiance; /* cube lights: unshadowed irradiance of 16 harmonics, as in S09 */
    bool measure_error; /* compare some 500 points with REFERENCE; costs its rays and time */
    uint64_t seed;
    uint32_t frame; /* index in a running mean (prt_screen_mean_add): each draws other samples,
                       and the mean converges to REFERENCE, TANGENT's to some 1 % of it. Equal
                       seed and frame give equal pictures */
    /* Maps on meshes with uv; NULL: none. sigma_s_map, sigma_a_map: factors >= 0 of the
       medium's coefficients. TANGENT and REFERENCE take R_d of the medium where light leaves;
       the others spread light in the plain medium and scale it by the pixel's total
       reflectance. bump_map: heights [mm] in the first channel; normal_map: 0.5 + 0.5 n; both
       turn the normals that irradiance is computed with. */
    const struct prt_screen_map *sigma_s_map, *sigma_a_map, *bump_map, *normal_map;
    bool maps_by_surface; /* each map is [n_surface]; rgb NULL: none on that surface */
    bool maps_checked;    /* texels are not checked again: maps of prt_screen_map_make */
    const float (
        *vertex_irradiance)[3];         /* [n_vertex] E of all lights, where it is known already
                            (from a bake or prt_reference): interpolated, no rays; or NULL */
    const struct prt_walk_ratio *ratio; /* light that was scattered is multiplied by its W/D
                    (prt/walk_ratio.h), of a mesh of the same vertices and triangles; errors are
                    those before. NULL: the dipole as it is */
    enum prt_walk_share ratio_share;
    uint32_t rings,
        spokes; /* HYBRID under at most 4 distant lights, both > 0: the near part from
                   C08's pattern of rings * spokes + 1 points of the light's view
                   instead of all points within reach. C08: 20 and 20; 1 to 256 */
};
struct prt_screen_report {
    enum prt_screen_engine engine;
    uint32_t n_sample;  /* surface points used; TANGENT: samples a pixel */
    uint32_t n_asked;   /* the options' n_sample, or the count chosen in its place */
    uint32_t grid;      /* SPLAT: n */
    uint32_t receivers; /* points that light was summed for; others are interpolated */
    uint32_t n_light;
    uint64_t n_ray, n_pair; /* shadow and view rays; evaluations of R_d */
    float r_max_mm, r_p_mm; /* SPLAT; HYBRID */
    bool uv_atlas;          /* texels lie in the model's own uv; else along triangles */
    uint32_t n_medium;      /* TANGENT with maps: media that pixels were sorted into */
    double irradiance_s, scatter_s;
    double error;          /* relative RMSE over covered pixels; < 0: not measured */
    double expected_error; /* the same, predicted from engine, medium, model and n_sample and
                              corrected by the last check at 160 points: of an earlier frame, or
                              of this one where it is the first of its engine, medium and kind
                              of light */
    uint32_t frame;        /* the options' */
};

/* Sample counts that a time budget buys. */
struct prt_screen_plan {
    enum prt_screen_engine engine;
    uint32_t n_sample;
    double expected_ms;    /* of prt_screen_radiance, from the speed measured so far */
    double expected_error; /* relative RMSE against REFERENCE over covered pixels */
};
/* Chooses one engine's sample count so that a picture of the input takes about budget_ms (> 0).
 * options, if not NULL: n_light is read, engine and n_sample are set. out may be NULL. PRT_ARG
 * for a budget that is not positive and finite, a medium out of range, or REFERENCE. Does not
 * block; must not overlap other calls with the same screen. */
int prt_screen_plan(const struct prt_context *ctx, const struct prt_screen *screen,
                    const struct prt_screen_input *input, enum prt_screen_engine engine,
                    double budget_ms, struct prt_screen_options *options,
                    struct prt_screen_plan *out);
/* The same for the engine with the least expected error among those that keep the budget; when
 * none does, the fastest. */
int prt_screen_choose(const struct prt_context *ctx, const struct prt_screen *screen,
                      const struct prt_screen_input *input, double budget_ms,
                      struct prt_screen_options *options, struct prt_screen_plan *out);

/* Computes B/pi (C08 eq 11) at every point of the visibility's G-buffer, and albedo/pi E on
 * opaque surfaces: radiance [n_point][3], before the Fresnel transmittance of the exit;
 * prt_shade_points composes it. report may be NULL. PRT_ARG for values out of range, PRT_NOMEM.
 * Runs on ctx->pool and blocks until done; calls ctx->progress between its stages and every
 * tenth of a second within the long ones: PRT_CANCELLED when that returns nonzero. After an
 * error radiance is undefined, and the screen remains usable. */
int prt_screen_radiance(const struct prt_context *ctx, struct prt_screen *screen,
                        const struct prt_screen_input *input,
                        const struct prt_screen_options *options, float (*radiance)[3],
                        struct prt_screen_report *report);
/* The same as an image: shade holds specular light, background and Fresnel; its planes are not
 * read. The caller ends *out with prt_image_finish. */
int prt_screen_image(const struct prt_context *ctx, struct prt_screen *screen,
                     const struct prt_screen_input *input,
                     const struct prt_screen_options *options, const struct prt_shade *shade,
                     struct prt_image *out, struct prt_screen_report *report);

/* Adds picture n (0: the first, which is copied) of n_point points to a running mean in which
 * picture k weighs k + 1, since the first ones are coarser: mean += 2/(n+2) (picture - mean)
 * (METHODS §6). Returns the norm of the change as a share of the mean's: 0 for the first
 * picture, < 0 where the mean is black. Thread-safe for different means. */
double prt_screen_mean_add(uint32_t n, size_t n_point, const float (*picture)[3],
                           float (*mean)[3]);

/* The shadow of a model on the horizontal plane through its lowest point: *out
 * [height][width][3], for each pixel whose ray meets the plane the share of irradiance that the
 * model leaves there, 1 at other pixels and where the eye is below the plane; for
 * prt_shade.shadow. It fades out at three half diagonals of the model's box. Light is constant
 * over the cube's texels. The caller prt_free()s *out. Equal inputs give equal shadows for any
 * number of threads. Reports "floor" as progress; blocks. PRT_NOMEM, PRT_CANCELLED. */
int prt_floor_shadow(const struct prt_context *ctx, const struct prt_mesh *mesh,
                     const struct prt_visibility *visibility, const struct prt_cube *light,
                     float **out);

struct prt_scene;
/* Relative RMSE of the luminance of reflections at points of a picture against traced rays: of
 * specular occlusion as pictures have it, and without. Opaque points do not count.
 * Deterministic. Blocks. PRT_NOMEM, PRT_CANCELLED. */
int prt_specular_error(const struct prt_context *ctx, const struct prt_scene *scene,
                       const struct prt_visibility *visibility, const struct prt_cube *light,
                       float eta, float roughness, double *error, double *without);

#ifdef __cplusplus
}
#endif
#endif
