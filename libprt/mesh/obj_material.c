// SPDX-License-Identifier: MIT
// Reader of an OBJ's material library (.mtl): colours, roughness and maps of one material.
// Nothing in it stops the model: what cannot be read is left out with a warning.
#include "obj_material.h"

#include "text.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

struct mtl {
    struct prt_draft *d;
    locale_t c;
    struct obj_material *out;
    bool inside; // the material that is wanted
};

static bool is_word(const char *p, const char *word, const char **rest)
{
    size_t n = strlen(word);
    if (strncasecmp(p, word, n) || (p[n] != ' ' && p[n] != '\t')) return false;
    *rest = text_blank(p + n);
    return true;
}

// The rest of the line as a name.
static void take_name(const char *p, char *out, size_t size)
{
    size_t n = strcspn(p, "\r\n");
    while (n && (p[n - 1] == ' ' || p[n - 1] == '\t')) n--;
    if (n >= size) n = size - 1;
    memcpy(out, p, n);
    out[n] = 0;
}

static bool number_in(const struct mtl *m, const char **p, double lo, double hi, float *out)
{
    double x;
    const char *end = text_double(*p, m->c, &x);
    if (!end || !(x >= lo && x <= hi)) return false;
    *p = end;
    *out = (float)x;
    return true;
}

static void read_color(const struct mtl *m, const char *p, double most, float out[3])
{
    float rgb[3];
    for (int c = 0; c < 3; c++)
        if (!number_in(m, &p, 0, most, &rgb[c])) return;
    memcpy(out, rgb, sizeof rgb);
}

// Up to three numbers of -o, -s or -t. A word that only begins with digits is the file's name.
static void read_triple(const struct mtl *m, const char **p, float out[3])
{
    for (int k = 0; k < 3; k++) {
        const char *end = *p;
        float x;
        if (!number_in(m, &end, -1e5, 1e5, &x) || (*end && !strchr(" \t\r\n", *end))) break;
        out[k] = x;
        *p = text_blank(end);
    }
}

static const char *skip_word(const char *p)
{
    while (*p && !strchr(" \t\r\n", *p)) p++;
    return text_blank(p);
}

// Options before the file's name; the texture's place and wrap mode follow from them.
static const char *read_options(const struct mtl *m, const char *p, struct obj_map *map)
{
    float offset[3] = {0, 0, 0}, scale[3] = {1, 1, 1}, unused[3], bump;
    const char *rest;
    while (*p == '-') {
        if (is_word(p, "-o", &rest)) {
            read_triple(m, &rest, offset);
        } else if (is_word(p, "-s", &rest)) {
            read_triple(m, &rest, scale);
        } else if (is_word(p, "-t", &rest) || is_word(p, "-mm", &rest)) {
            read_triple(m, &rest, unused);
        } else if (is_word(p, "-bm", &rest)) {
            if (number_in(m, &rest, -1e3, 1e3, &bump)) map->ref.scale = bump;
        } else if (is_word(p, "-clamp", &rest)) {
            if (!strncasecmp(rest, "on", 2)) map->ref.wrap_u = map->ref.wrap_v = PRT_WRAP_CLAMP;
            rest = skip_word(rest);
        } else {
            rest = skip_word(skip_word(p)); // an option of one word
        }
        p = text_blank(rest);
    }
    // OBJ counts v upwards, the mesh downwards
    const float t[6] = {scale[0], 0, offset[0], 0, scale[1], 1 - scale[1] - offset[1]};
    memcpy(map->ref.transform, t, sizeof t);
    return p;
}

static void read_map(const struct mtl *m, const char *p, enum prt_map kind)
{
    struct obj_map *map = &m->out->map[kind];
    *map = (struct obj_map){.ref.image = UINT32_MAX, .ref.scale = 1};
    p = read_options(m, p, map);
    take_name(p, map->file, sizeof map->file);
    for (char *c = map->file; *c; c++)
        if (*c == '\\') *c = '/';
}

static void read_line(struct mtl *m, const char *p)
{
    const char *rest;
    char name[64];
    struct obj_material *out = m->out;
    float x;
    if (is_word(p, "newmtl", &rest)) {
        take_name(rest, name, sizeof name);
        m->inside = !out->found && (!*out->name || !strcmp(name, out->name));
        if (m->inside) {
            out->found = true;
            memcpy(out->name, name, sizeof name);
        }
    }
    if (!m->inside) return;
    if (is_word(p, "Kd", &rest)) read_color(m, rest, 1, out->base);
    else if (is_word(p, "Ke", &rest)) read_color(m, rest, 1e6, out->emissive);
    else if (is_word(p, "Pr", &rest) && number_in(m, &rest, 0, 1, &x)) out->roughness = x;
    else if (is_word(p, "Pm", &rest) && number_in(m, &rest, 0, 1, &x)) out->metallic = x;
    // GGX of the same width as Phong's lobe: alpha = sqrt(2 / (Ns + 2)), roughness its root
    else if (is_word(p, "Ns", &rest) && out->roughness < 0 && number_in(m, &rest, 0, 1e6, &x))
        out->roughness = powf(2 / (x + 2), 0.25f);
    else if (is_word(p, "map_Kd", &rest)) read_map(m, rest, PRT_MAP_BASE);
    else if (is_word(p, "map_Ke", &rest)) read_map(m, rest, PRT_MAP_EMISSIVE);
    else if (is_word(p, "map_Pr", &rest)) read_map(m, rest, PRT_MAP_ROUGHNESS);
    else if (is_word(p, "norm", &rest) || is_word(p, "map_Kn", &rest) ||
             is_word(p, "map_Bump", &rest) || is_word(p, "bump", &rest))
        read_map(m, rest, PRT_MAP_NORMAL);
}

void prt_obj_material_parse(struct prt_draft *d, const char *text, struct obj_material *out)
{
    struct mtl m = {.d = d, .out = out};
    m.c = newlocale(LC_ALL_MASK, "C", (locale_t)0);
    if (!m.c) return;
    for (const char *p = text; p && *p;) {
        read_line(&m, text_blank(p));
        p = strchr(p, '\n');
        if (p) p++;
    }
    freelocale(m.c);
}

// Whether an image is a tangent-space normal map: its mean points along z.
static bool is_normal_map(const struct prt_draft *d, uint32_t image)
{
    const struct prt_texture_image *i = &d->image[image];
    const uint8_t *mean = d->texel[image] + i->bytes - 4; // the last level has one texel
    return mean[2] > 180 && abs(mean[0] - 128) < 40 && abs(mean[1] - 128) < 40;
}

static int load_map(struct prt_draft *d, struct obj_map *map, enum prt_map kind,
                    struct prt_texture_ref *out)
{
    const struct prt_context *user, lenient = prt_draft_lenient(d, &user);
    const char *last = strrchr(map->file, '/');
    struct prt_blob file = {NULL, 0};
    char name[400];
    if (!*map->file) return PRT_OK;
    const char *path =
        map->file[0] == '/' || strchr(map->file, ':') ? last ? last + 1 : "" : map->file;
    if (prt_draft_file(d, &lenient, "image", path, d->max_bytes, &file)) return PRT_OK;
    enum prt_texture_kind of = kind == PRT_MAP_NORMAL      ? PRT_TEXTURE_NORMAL
                               : kind == PRT_MAP_ROUGHNESS ? PRT_TEXTURE_DATA
                                                           : PRT_TEXTURE_COLOR;
    snprintf(name, sizeof name, "%.200s: image %.150s", d->name, map->file);
    int status = prt_draft_image(d, name, file.bytes, file.size, of, &map->ref.image);
    prt_free(file.bytes);
    if (status || map->ref.image == UINT32_MAX) return status;
    if (kind == PRT_MAP_NORMAL && !is_normal_map(d, map->ref.image)) {
        prt_log(d->ctx, PRT_LOG_WARNING,
                "%s: a map of heights, which --bump-map takes; it is left out", name);
        return PRT_OK;
    }
    *out = map->ref;
    return PRT_OK;
}

int prt_obj_material_apply(struct prt_draft *d, struct obj_material *m,
                           struct prt_surface *surface, struct prt_surface_maps *maps)
{
    int status = PRT_OK;
    prt_surface_maps_default(maps);
    for (int c = 0; c < 3; c++) {
        surface->base_color[c] = m->base[c];
        maps->emissive[c] = m->emissive[c];
    }
    if (m->roughness >= 0) surface->roughness = fmaxf(m->roughness, 1e-3f);
    maps->metallic = m->metallic;
    for (int k = 0; !status && k < PRT_N_MAP; k++)
        status = load_map(d, &m->map[k], (enum prt_map)k, &maps->map[k]);
    if (maps->map[PRT_MAP_ROUGHNESS].image != UINT32_MAX) surface->roughness = 1;
    return status;
}

void prt_obj_material_init(struct obj_material *m)
{
    memset(m, 0, sizeof *m);
    m->roughness = -1;
    for (int c = 0; c < 3; c++) m->base[c] = 1;
}
