// SPDX-License-Identifier: MIT
// Blender's Principled BSDF as JSON: the node's inputs by their names, of Blender 2.8 to 4.
#include "import.h"

#include <ctype.h>
#include <math.h>

#define MM_PER_UNIT 1000.0 // Blender's unit is the metre
enum { MOST_DEPTH = 3 };

// "Subsurface Weight" and "subsurface_weight" are the same.
static bool same_key(const char *key, const char *wanted)
{
    for (; *key && *wanted; key++, wanted++) {
        char c = (char)tolower((unsigned char)*key);
        if ((c == ' ' ? '_' : c) != *wanted) return false;
    }
    return !*key && !*wanted;
}

static const cJSON *find(const cJSON *object, const char *wanted)
{
    for (const cJSON *i = object->child; i; i = i->next)
        if (i->string && same_key(i->string, wanted)) return i;
    return NULL;
}

static const char *const own_keys[] = {"base_color",        "subsurface_weight",
                                       "subsurface_radius", "subsurface_scale",
                                       "subsurface",        "subsurface_color"};

static bool has_inputs(const cJSON *object)
{
    for (size_t i = 0; i < sizeof own_keys / sizeof *own_keys; i++)
        if (find(object, own_keys[i])) return true;
    return false;
}

static bool is_blender(const cJSON *object, int depth)
{
    if (!cJSON_IsObject(object) || depth > MOST_DEPTH) return false;
    if (has_inputs(object)) return true;
    for (const cJSON *i = object->child; i; i = i->next)
        if (is_blender(i, depth + 1)) return true;
    return false;
}

bool prt_import_is_blender(const cJSON *object)
{
    return is_blender(object, 0);
}

struct reading {
    struct import_list *list;
    struct prt_import *item;
    const cJSON *object;
    struct import_shader *to;
};

static bool number_of(const cJSON *value, double *out)
{
    if (cJSON_IsBool(value)) *out = cJSON_IsTrue(value);
    else if (cJSON_IsNumber(value) && fabs(value->valuedouble) <= 1e12)
        *out = value->valuedouble;
    else return false;
    return true;
}

// The input's one, three or four numbers; `otherwise` where it is absent, `unread` where it is
// linked (< 0: `otherwise`, too).
static void read_rgb(const struct reading *r, const char *key, const double otherwise[3],
                     double unread, double out[3])
{
    const cJSON *value = find(r->object, key);
    double got[3] = {0};
    memcpy(out, otherwise, 3 * sizeof *out);
    if (!value) return;
    if (cJSON_IsObject(value) && find(value, "default_value"))
        value = find(value, "default_value");
    if (number_of(value, &got[0])) {
        out[0] = out[1] = out[2] = got[0];
        return;
    }
    int n = cJSON_IsArray(value) ? cJSON_GetArraySize(value) : 0;
    const cJSON *at = n == 3 || n == 4 ? value->child : NULL;
    for (int c = 0; c < 3 && at; c++, at = at->next)
        if (!number_of(at, &got[c])) break;
        else if (c == 2) {
            memcpy(out, got, sizeof got);
            return;
        }
    prt_import_append(r->to->unread, "%s (not a number or a colour: a linked node?)", key);
    for (int c = 0; c < 3 && unread >= 0; c++) out[c] = unread;
}

static double read_one(const struct reading *r, const char *key, const char *old_key,
                       double otherwise, double unread)
{
    double out[3], from[3] = {otherwise, otherwise, otherwise};
    if (old_key && !find(r->object, key)) key = old_key;
    read_rgb(r, key, from, unread, out);
    return out[0];
}

static double read_number(const struct reading *r, const char *key, const char *old_key,
                          double otherwise)
{
    return read_one(r, key, old_key, otherwise, -1);
}

static void read_lost(const struct reading *r, struct import_shader *s)
{
    prt_import_lost(s, "coat", read_number(r, "coat_weight", "clearcoat", 0));
    prt_import_lost(s, "sheen", read_number(r, "sheen_weight", "sheen", 0));
    prt_import_lost(s, "thin film", read_number(r, "thin_film_thickness", NULL, 0));
    prt_import_lost(s, "emission", read_number(r, "emission_strength", NULL, 0));
    prt_import_lost(s, "anisotropic roughness", read_number(r, "anisotropic", NULL, 0));
    prt_import_lost(s, "alpha below 1", 1 - read_number(r, "alpha", NULL, 1));
    prt_import_lost(s, "partial metal", read_number(r, "metallic", NULL, 0));
}

// Blender 2 and 3 have neither a scale nor a weight beside the radius: "Subsurface" is both.
static int read_principled(struct import_list *list, const char *name, const cJSON *object)
{
    struct prt_import *item = prt_import_add(list, name);
    if (!item) return PRT_LIMIT;
    struct import_shader s = {.ior = 1.5};
    struct reading r = {list, item, object, &s};
    double radius[3], unit = list->mm_per_unit > 0 ? list->mm_per_unit : MM_PER_UNIT;
    snprintf(item->format, sizeof item->format, "Principled BSDF");
    read_rgb(&r, "base_color", (double[]){0.8, 0.8, 0.8}, IMPORT_UNREAD_COLOR, s.base);
    read_rgb(&r, "subsurface_color", s.base, IMPORT_UNREAD_COLOR, s.subsurface_color);
    read_rgb(&r, "subsurface_radius", (double[]){1, 0.2, 0.1}, -1, radius);
    bool old = find(object, "subsurface") && !find(object, "subsurface_weight");
    double scale = read_number(&r, "subsurface_scale", NULL, old ? 1 : 0.05);
    for (int c = 0; c < 3; c++) s.free_path[c] = radius[c] * scale * unit;
    s.subsurface = read_one(&r, "subsurface_weight", "subsurface", 0, IMPORT_UNREAD_WEIGHT);
    s.subsurface_g = read_number(&r, "subsurface_anisotropy", NULL, 0);
    s.transmission =
        read_one(&r, "transmission_weight", "transmission", 0, IMPORT_UNREAD_WEIGHT);
    s.metal = read_number(&r, "metallic", NULL, 0);
    s.roughness = read_number(&r, "roughness", NULL, 0.5);
    s.ior = read_number(&r, "ior", NULL, old ? 1.45 : 1.5);
    s.specular = 2 * read_number(&r, "specular_ior_level", "specular", 0.5);
    read_lost(&r, &s);
    prt_import_shader(list, &s, item);
    return PRT_OK;
}

static int read_any(struct import_list *list, const char *name, const cJSON *object, int depth)
{
    int status = PRT_OK;
    const cJSON *own = cJSON_GetObjectItemCaseSensitive(object, "name");
    if (cJSON_IsString(own)) name = own->valuestring;
    if (has_inputs(object)) return read_principled(list, name, object);
    for (const cJSON *i = object->child; i && !status && depth < MOST_DEPTH; i = i->next) {
        const char *key = i->string && !strstr(i->string, "BSDF") ? i->string : name;
        if (cJSON_IsObject(i)) status = read_any(list, key, i, depth + 1);
    }
    return status;
}

int prt_import_blender(struct import_list *list, const cJSON *object)
{
    return read_any(list, "Principled", object, 0);
}
