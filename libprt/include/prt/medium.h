/* SPDX-License-Identifier: MIT */
/* prt/medium.h owns the optics of a homogeneous translucent medium: materials, BSSRDF, Fresnel,
 * phase functions. Lengths in mm, coefficients in mm^-1, three channels in linear RGB. All
 * functions are thread-safe. */
#ifndef PRT_MEDIUM_H
#define PRT_MEDIUM_H

#include "prt/base.h"

#ifdef __cplusplus
extern "C" {
#endif

enum {
    PRT_MATERIAL_MAX_POINT = 256, /* points of a material's own profile */
    PRT_MATERIAL_TEXT = 24576,    /* bytes: any material's JSON with its closing NUL */
    PRT_MATERIAL_SUMMARY = 512,   /* bytes: any material's summary with its closing NUL */
};

/* A medium. Coefficients in mm^-1, one for each RGB channel. */
struct prt_material {
    char name[32];
    float sigma_s_prime[3]; /* [1e-5, 1000] */
    float sigma_a[3];       /* [0, 1000] */
    float g[3];             /* |g| <= 0.95; sigma_a + sigma_s'/(1-g) <= 5000 */
    float eta;              /* [1, 3] relative index inside/outside */
    float roughness;        /* [0.01, 1] of the specular lobe */
    /* A profile in place of the dipole's R_d (prt/profile.h): linear between n_point radii,
     * constant before the first, 0 beyond the last. The coefficients above are then those of
     * the dipole medium of the same total and half-energy radius, which gives the sample
     * spacing; the medium has no single scattering. */
    uint32_t profile; /* enum prt_profile_kind of the source; 0: the dipole */
    uint32_t n_point; /* [2, PRT_MATERIAL_MAX_POINT] with a profile, else 0 */
    float radius[PRT_MATERIAL_MAX_POINT];         /* mm, ascending from >= 0 */
    float reflectance[3][PRT_MATERIAL_MAX_POINT]; /* mm^-2, >= 0; 2 pi r R_d dr <= 1 */
};

/* PRT_OK, or PRT_ARG for values out of range, with a log line that names parameter, value,
 * allowed range and unit. */
int prt_material_check(const struct prt_context *ctx, const struct prt_material *material);
/* Loads a preset by name, a JSON file, or JSON text that begins with '{' (proto/PROTOCOL.md
 * lists the keys). *out is written on success only. PRT_ARG (range, neither file nor preset),
 * PRT_FORMAT (JSON), PRT_LIMIT (size), PRT_IO, PRT_NOMEM. prt_material_parse takes JSON text
 * only, which cannot name files; `what` stands in messages. */
int prt_material_load(const struct prt_context *ctx, const char *name_or_file,
                      struct prt_material *out);
int prt_material_parse(const struct prt_context *ctx, const char *what, const char *json,
                       size_t n, struct prt_material *out);
/* The JSON text of a material into buf[n]; parsing it gives the same material. Returns the
 * length without the NUL; PRT_LIMIT when n is too small (PRT_MATERIAL_TEXT suffices),
 * PRT_NOMEM. On failure buf holds the JSON null. */
int prt_material_print(const struct prt_material *material, char *buf, size_t n);
/* The same with a profile's kind, number of points and totals in place of its points; for
 * people, not for parsing. PRT_MATERIAL_SUMMARY bytes suffice. */
int prt_material_summary(const struct prt_material *material, char *buf, size_t n);
/* Hash of all fields but the name and the profile's kind. */
uint64_t prt_material_hash(const struct prt_material *material);
/* An artist's medium: light attenuates by `color` over `distance_mm` [mm], and a half-space
 * under even light returns `albedo`. */
struct prt_attenuation {
    char name[32];
    float color[3], albedo[3]; /* [0,1] */
    float distance_mm;         /* > 0 */
    float g;                   /* |g| <= 0.95 */
    float eta, roughness;
    bool scatters; /* attenuation is sigma_t (KHR_materials_volume_scatter), else sigma_a
                      (KHR_materials_volume) */
};
enum {
    PRT_LOWERED_ALBEDO = 1, /* an albedo above 0.98, which no finite medium has, was lowered */
    PRT_LOWERED_RATE = 2,   /* coefficients were moved into prt_material's ranges */
};
/* The medium: albedo is inverted against the dipole's total reflectance rho_d, so that rho_d of
 * the result is the albedo. Returns bits PRT_LOWERED_*. */
unsigned prt_material_from_attenuation(const struct prt_attenuation *in,
                                       struct prt_material *out);
/* A dense medium by its mean free path 1/sigma_t, as subsurface shaders have it. */
struct prt_dense {
    char name[32];
    float albedo[3];       /* [0,1] diffuse, of a half-space under even light */
    float free_path_mm[3]; /* > 0 */
    float g;               /* |g| <= 0.95 */
    float eta, roughness;
};
/* The medium, its albedo inverted like that of an attenuation. Returns bits PRT_LOWERED_*. */
unsigned prt_material_from_dense(const struct prt_dense *in, struct prt_material *out);

/* One material of another program's file, and what it became (METHODS §10). */
struct prt_import {
    char name[64], format[32]; /* format: "open_pbr_surface", "Principled BSDF", … */
    bool has_medium;
    char why_not[160]; /* without a medium */
    struct prt_material material;
};
/* Reads MaterialX (open_pbr_surface, standard_surface), Blender's Principled as JSON and pbrt's
 * media from text of n bytes, with a 0 after them. mm_per_unit: millimetres in a unit of length
 * of the text where it names none; 0: the format's own (MaterialX 10, Principled 1000, pbrt 1).
 * Losses are warnings to ctx; `what` opens messages. *out: [*n_out] materials, the caller's to
 * prt_free. Thread-safe. PRT_FORMAT, PRT_LIMIT, PRT_NOMEM. */
int prt_material_import(const struct prt_context *ctx, const char *what, const char *text,
                        size_t n, double mm_per_unit, struct prt_import **out, unsigned *n_out);
/* The same of a file, FILE, or of one material of it, FILE#NAME (or a beginning of NAME),
 * parsed in an isolated child. */
int prt_material_import_file(const struct prt_context *ctx, const char *file,
                             double mm_per_unit, struct prt_import **out, unsigned *n_out);
/* The one medium of FILE, or that of FILE#NAME; prt_material_load calls it where
 * prt_material_is_foreign. PRT_ARG where the choice is not clear. */
int prt_material_load_foreign(const struct prt_context *ctx, const char *file,
                              struct prt_material *out);
bool prt_material_is_foreign(const char *file);
/* The same of an open file, which messages call `what`: its only medium, or that of this name
 * (NULL or "": none given). */
int prt_material_load_foreign_fd(const struct prt_context *ctx, const char *what, int fd,
                                 const char *name, struct prt_material *out);
/* The item of this name or of its only beginning; without a name the only one that has a
 * medium. PRT_ARG after a message that lists them. */
int prt_import_choose(const struct prt_context *ctx, const char *what,
                      const struct prt_import *item, unsigned n, const char *name,
                      const struct prt_import **out);
/* pbrt's named media beside the presets (NSJ06 undiluted): NULL past the end. */
const struct prt_material *prt_material_named_medium(unsigned index);

/* The reduced albedo whose half-space returns this share of diffuse light. */
double prt_albedo_invert(double reflectance, double eta);
/* The media of a model's objects (METHODS §10): one for all, or one for each object. Arrays are
 * borrowed. Zeroed: not given. */
enum { PRT_MEDIA_MAX = 64 }; /* media of one model */
struct prt_media {
    uint32_t n;                        /* media, [1, PRT_MEDIA_MAX] */
    const struct prt_material *medium; /* [n] */
    const uint8_t *of_object; /* [n_object] index into medium; NULL: all have the first.
                                 That of an object without translucent surface is not
                                 used */
};
/* The index of an object's medium, and the medium. */
static inline uint32_t prt_media_index(const struct prt_media *media, uint32_t object)
{
    return media->of_object ? media->of_object[object] : 0;
}
static inline const struct prt_material *prt_media_of(const struct prt_media *media,
                                                      uint32_t object)
{
    return &media->medium[prt_media_index(media, object)];
}
/* One medium for all objects. */
static inline struct prt_media prt_media_one(const struct prt_material *material)
{
    struct prt_media media = {1, material, NULL};
    return media;
}
/* PRT_OK, or PRT_ARG after a log line: the number, an index, or a medium is out of range. */
int prt_media_check(const struct prt_context *ctx, const struct prt_media *media,
                    uint32_t n_object);
/* A copy in memory of its own, which the caller prt_free()s; NULL without memory. */
struct prt_media *prt_media_copy(const struct prt_media *media, uint32_t n_object);
/* Hash of the media and of which object has which, names left out; equal maps of n_object
 * objects have equal hashes. */
uint64_t prt_media_hash(const struct prt_media *media, uint32_t n_object);
/* The distinct relative indices of the media in their order into eta[PRT_MEDIA_MAX]; returns
 * their number. */
uint32_t prt_media_etas(const struct prt_media *media, double eta[]);

/* The twelve media of JMLH01 fig. 5: index 0..11; NULL past the end. */
const struct prt_material *prt_material_preset(unsigned index);
/* The preset of this name, whatever its case, or the only one that begins so, else such a named
 * medium; NULL with a remedy of n bytes, as prt_name_choose writes it. */
const struct prt_material *prt_material_preset_named(const char *name, char *remedy, size_t n);

/* Classical dipole of one channel (METHODS §1; JMLH01, W05 eq 3, X07 eq 4). */
struct prt_diffusion {
    double sigma_s_prime, sigma_a, sigma_t_prime, sigma_tr, albedo_prime, eta;
    double z_r, z_v; /* mm */
    double rho_d;    /* closed-form total diffuse reflectance */
    /* A table in place of the formula; n_point 0: none. Borrowed from a prt_material. */
    uint32_t n_point;
    const float *radius, *reflectance;
};
/* R_d of a material's three channels, from its profile where it has one, for all the functions
 * below. `out` borrows the material's table: `material` must outlive it. */
void prt_material_dipoles(const struct prt_material *material, struct prt_diffusion out[3]);
void prt_diffusion_init(struct prt_diffusion *dipole, double sigma_s_prime, double sigma_a,
                        double eta);
double prt_diffusion_rd(const struct prt_diffusion *dipole, double r_mm); /* mm^-2 */
/* Integral of 2 pi r R_d from r_mm to infinity (METHODS §1; S09 eq 4 erratum). */
double prt_diffusion_tail(const struct prt_diffusion *dipole, double r_mm);
/* out[i] = R_d(sqrt(r2[i])), relative error < 1e-5 where sigma_tr d <= 40 (beyond it R_d has
 * fallen by e^-40); r2 finite, >= 0. cpu: mask of enum prt_cpu, selects the vector code. */
void prt_diffusion_rd_array(const struct prt_diffusion *dipole, unsigned cpu, size_t n,
                            const float *r2_mm2, float *out);
/* The same for three channels that share r2. */
void prt_diffusion_rd3_array(const struct prt_diffusion dipole[3], unsigned cpu, size_t n,
                             const float *r2_mm2, float *out0, float *out1, float *out2);

/* F_dr, METHODS §1: a fit, 0.0016 at eta 1. */
double prt_fresnel_dr(double eta);
double prt_fresnel_transmittance(double eta, double cos_theta); /* exact, unpolarised */
/* Cosine-weighted hemispherical mean of F_t: 0.938868 at 1.3, 0.908222 at 1.5. */
double prt_fresnel_mean_transmittance(double eta);
/* How diffuse light leaves (METHODS §1, exit). */
enum prt_exit {
    PRT_EXIT_NORMALISED, /* F_t/T of the exitance over pi: no light is lost */
    PRT_EXIT_PAPERS,     /* F_t of it, as the papers print */
};
/* The divisor of diffuse light at its exit: T, the mean of F_t, or 1. Totals are F_t (multiple
 * / divisor + single), computed as (F_t / divisor) (multiple + divisor x single): opaque
 * vertices and image-space engines then need no scale of their own. */
double prt_exit_divisor(double eta, enum prt_exit exit);
/* Refracts the outside direction w (away from the surface, w.n >= 0) at a surface of unit
 * normal n: out is the unit direction of the refracted light, into the body (out.n < 0). The
 * outward inside direction w' of METHODS is its negative. */
void prt_refract_in(double eta, const float n[3], const float w[3], float out[3]);

/* Phase functions as Legendre coefficients: p(c) = sum_l (2l+1)/(4 pi) a_l P_l(c), a_0 = 1, c
 * the cosine between OUTWARD light and view directions (so HG has a_l = (-g)^l). */
enum { PRT_PHASE_MAX_L = 4 };
struct prt_phase {
    unsigned degree;           /* highest l kept */
    double a[PRT_PHASE_MAX_L]; /* a[l], l <= degree < PRT_PHASE_MAX_L */
};
enum { PRT_PHASE_ISOTROPIC = 1, PRT_PHASE_EDDINGTON = 4, PRT_PHASE_9 = 9, PRT_PHASE_16 = 16 };
/* Henyey-Greenstein cut to n_term = (degree+1)^2 in {1,4,9,16}. n_term 4 is not Eddington: it
 * is HG's l <= 1, which equals Eddington's p = (1+3g cos)/4pi. */
int prt_phase_hg(struct prt_phase *phase, double g, unsigned n_term);
double prt_phase_eval(const struct prt_phase *phase, double cos_outward);
double prt_hg_eval(double g, double cos_scatter); /* exact HG, scattering angle, sr^-1 */
/* Real spherical harmonics Y_lm, l < n_band <= 4, out[l*l+l+m], at a unit direction.
 * Orthonormal. p(w.w') = sum_l a_l sum_m Y_lm(w) Y_lm(w'). */
void prt_sh_eval(unsigned n_band, const float dir[3], float *out);

/* Corrects vertices [begin, end) of planes [n_plane][n_vertex][3] of single scattering alone,
 * of which the first n_phase (1, 4, 9, 16) were computed along -n_o, for the view at which they
 * will be shaded (METHODS §3.6). normal: [n_vertex] unit. n_plane: 4 at least; planes from
 * n_phase to 4 are filled. Uses ctx->pool. */
int prt_view_correct(const struct prt_context *ctx, uint32_t n_vertex, uint32_t begin,
                     uint32_t end, const float (*normal)[3], double eta, unsigned n_phase,
                     unsigned n_plane, float *planes);
/* The slope s of that correction: single scattering towards w_o' is that along -n_o times
 * 1 + s (1 - mu_o'), mu_o' the cosine of w_o' with the normal. eta > 1. */
float prt_view_slope(double eta);

#ifdef __cplusplus
}
#endif
#endif
