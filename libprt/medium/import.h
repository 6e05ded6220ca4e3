/* SPDX-License-Identifier: MIT */
/* Internal to materials: readers of other programs' materials (METHODS §10). Every text is
 * hostile until read: sizes, depths and numbers are bounded. */
#ifndef MEDIUM_IMPORT_H
#define MEDIUM_IMPORT_H

#include "material.h"

#include <stdio.h>

enum {
    IMPORT_MAX_BYTES = 1 << 20, /* of a file */
    IMPORT_MAX_MEDIA = 256,     /* materials of a file */
};

/* The list that a reader fills; the caller of the reader frees item with prt_free. */
struct import_list {
    const struct prt_context *ctx;
    const char *what;   /* opens messages */
    double mm_per_unit; /* of lengths that have no unit of their own; 0: the format's own */
    const char *only;   /* the material whose losses are told; NULL: all */
    struct prt_import *item;
    unsigned n, capacity;
};
/* The next item, zeroed but for its name; NULL after a message. */
struct prt_import *prt_import_add(struct import_list *list, const char *name);
/* Warns of one material: "FILE: NAME: …". */
void prt_import_warn(const struct import_list *list, const struct prt_import *item,
                     const char *fmt, ...) __attribute__((format(printf, 3, 4)));
/* Says why the item gives no medium. */
void prt_import_none(struct prt_import *item, const char *fmt, ...)
    __attribute__((format(printf, 2, 3)));

/* An artist's shader: a surface over a diffuse base, a dense interior with a colour of its own
 * (subsurface), and a transmissive interior. Colours are linear Rec. 709, lengths mm. */
struct import_shader {
    double base[3]; /* of the opaque share, times its weight */
    double subsurface, subsurface_color[3], free_path[3], subsurface_g;
    double transmission, transmission_color[3], depth, scatter[3], scatter_g;
    double ior, roughness,
        specular; /* specular: factor of the reflection at normal incidence */
    double metal;
    char lost[256];   /* features that the medium cannot keep, named */
    char unread[256]; /* inputs without a value of their own, and why */
    char varies[256]; /* inputs that vary over the surface */
};
/* The value that stands for a colour or a weight that an image or an unread graph gives. */
#define IMPORT_UNREAD_COLOR 0.8
#define IMPORT_UNREAD_WEIGHT 1.0
/* Appends to a list of struct import_shader: "a, b". */
void prt_import_append(char list[256], const char *fmt, ...)
    __attribute__((format(printf, 2, 3)));
/* Appends a word to shader->lost when `amount` is above 0. */
void prt_import_lost(struct import_shader *shader, const char *feature, double amount);
/* The medium of a shader into item, by subsurface or transmission, whichever has more weight.
 */
void prt_import_shader(const struct import_list *list, const struct import_shader *shader,
                       struct prt_import *item);
/* Coefficients in mm^-1 into item->material, in range; warns where a bound changed them. */
void prt_import_coefficients(const struct import_list *list, struct prt_import *item,
                             const double sigma_s[3], const double sigma_a[3], double g);

/* The index of refraction whose reflection at normal incidence is `factor` times ior's. */
double prt_import_ior(double ior, double factor);

/* Readers; text[n] is 0. Library status. */
int prt_import_mtlx(struct import_list *list, const char *text, size_t n);
int prt_import_blender(struct import_list *list, const cJSON *object);
int prt_import_pbrt(struct import_list *list, const char *text);
/* Chooses one of them; the caller frees list->item, also after an error. */
int prt_import_text(struct import_list *list, const char *text, size_t n);
/* A Principled shader's JSON, by its keys. */
bool prt_import_is_blender(const cJSON *object);

#endif
