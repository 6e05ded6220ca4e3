// SPDX-License-Identifier: MIT
// Strict readers of material JSON: an unknown or repeated key is an error.
#include "material.h"
#include "profile.h"

#include <stdio.h>
#include <stdlib.h>

int prt_material_json_object(const struct prt_context *ctx, const char *what, const char *json,
                             size_t n, cJSON **out)
{
    if (n > MATERIAL_MAX_BYTES)
        return prt_fail(ctx, PRT_LIMIT,
                        "%s: the material has %zu bytes, at most %d are allowed", what, n,
                        MATERIAL_MAX_BYTES);
    const char *end = json;
    cJSON *object = cJSON_ParseWithLengthOpts(json, n, &end, 0);
    size_t at = object || (end >= json && end <= json + n) ? (size_t)(end - json) : 0;
    if (!object) return prt_fail(ctx, PRT_FORMAT, "%s: not valid JSON at byte %zu", what, at);
    while (at < n && strchr(" \t\r\n", json[at]) && json[at]) at++;
    if (at < n) {
        cJSON_Delete(object);
        return prt_fail(ctx, PRT_FORMAT, "%s: bytes follow the JSON object at byte %zu", what,
                        at);
    }
    if (!cJSON_IsObject(object)) {
        cJSON_Delete(object);
        return prt_fail(ctx, PRT_FORMAT, "%s: a material is a JSON object {…}", what);
    }
    *out = object;
    return PRT_OK;
}

static bool key_allowed(const char *key, const char *const *allowed)
{
    for (; *allowed; allowed++)
        if (!strcmp(key, *allowed)) return true;
    return false;
}

int prt_material_json_keys(const struct prt_context *ctx, const char *what, const cJSON *object,
                           const char *const *allowed)
{
    for (const cJSON *item = object->child; item; item = item->next) {
        if (!key_allowed(item->string, allowed)) {
            char list[256] = "";
            size_t used = 0;
            for (const char *const *a = allowed; *a && used < sizeof list; a++)
                used += (size_t)snprintf(list + used, sizeof list - used, "%s%s",
                                         a == allowed ? "" : ", ", *a);
            return prt_fail(ctx, PRT_FORMAT, "%s: unknown key \"%.40s\"; allowed: %s", what,
                            item->string, list);
        }
        for (const cJSON *other = item->next; other; other = other->next)
            if (!strcmp(item->string, other->string))
                return prt_fail(ctx, PRT_FORMAT, "%s: \"%s\" is given twice", what,
                                item->string);
    }
    return PRT_OK;
}

int prt_material_json_rgb(const struct prt_context *ctx, const char *what, const cJSON *object,
                          const char *key, bool scalar, bool required, double out[3])
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(object, key);
    if (!item) {
        if (!required) return PRT_OK;
        return prt_fail(ctx, PRT_FORMAT, "%s: \"%s\" is missing; give [r,g,b]", what, key);
    }
    if (scalar && cJSON_IsNumber(item)) {
        out[0] = out[1] = out[2] = item->valuedouble;
        return PRT_OK;
    }
    if (cJSON_IsArray(item) && cJSON_GetArraySize(item) == 3) {
        int c = 0;
        for (const cJSON *x = item->child; x && cJSON_IsNumber(x); x = x->next)
            out[c++] = x->valuedouble;
        if (c == 3) return PRT_OK;
    }
    return prt_fail(ctx, PRT_FORMAT, "%s: \"%s\" must be %sthree numbers [r,g,b]", what, key,
                    scalar ? "a number or " : "");
}

int prt_material_json_number(const struct prt_context *ctx, const char *what,
                             const cJSON *object, const char *key, double *out)
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(object, key);
    if (!item) return PRT_OK;
    if (!cJSON_IsNumber(item))
        return prt_fail(ctx, PRT_FORMAT, "%s: \"%s\" must be a number", what, key);
    *out = item->valuedouble;
    return PRT_OK;
}

int prt_material_json_name(const struct prt_context *ctx, const char *what, const cJSON *object,
                           char out[32])
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(object, "name");
    if (!item) return PRT_OK;
    if (!cJSON_IsString(item) || strlen(item->valuestring) > 31)
        return prt_fail(ctx, PRT_FORMAT, "%s: \"name\" must be a text of at most 31 bytes",
                        what);
    for (const char *c = item->valuestring; *c; c++)
        if ((unsigned char)*c < 32 || *c == 127)
            return prt_fail(ctx, PRT_FORMAT, "%s: \"name\" holds a control character", what);
    strcpy(out, item->valuestring);
    return PRT_OK;
}

static int object_to_material(const struct prt_context *ctx, const char *what,
                              const cJSON *object, struct prt_material *out)
{
    static const char *const keys[] = {"name", "sigma_s_prime", "sigma_a", "g",
                                       "eta",  "roughness",     NULL};
    struct material_values v = {.eta = 1.3, .roughness = 0.3};
    struct prt_material material = {.name = "custom"};
    int err;
    if ((err = prt_material_json_keys(ctx, what, object, keys)) < 0 ||
        (err = prt_material_json_name(ctx, what, object, material.name)) < 0 ||
        (err = prt_material_json_rgb(ctx, what, object, "sigma_s_prime", false, true,
                                     v.sigma_s_prime)) < 0 ||
        (err = prt_material_json_rgb(ctx, what, object, "sigma_a", false, true, v.sigma_a)) <
            0 ||
        (err = prt_material_json_rgb(ctx, what, object, "g", true, false, v.g)) < 0 ||
        (err = prt_material_json_number(ctx, what, object, "eta", &v.eta)) < 0 ||
        (err = prt_material_json_number(ctx, what, object, "roughness", &v.roughness)) < 0 ||
        (err = prt_material_check_values(ctx, what, &v)) < 0)
        return err;
    for (int c = 0; c < 3; c++) {
        material.sigma_s_prime[c] = (float)v.sigma_s_prime[c];
        material.sigma_a[c] = (float)v.sigma_a[c];
        material.g[c] = (float)v.g[c];
    }
    material.eta = (float)v.eta;
    material.roughness = (float)v.roughness;
    *out = material;
    return PRT_OK;
}

int prt_material_parse(const struct prt_context *ctx, const char *what, const char *json,
                       size_t n, struct prt_material *out)
{
    cJSON *object;
    struct prt_optics optics;
    int err = prt_material_json_object(ctx, what, json, n, &object);
    if (err < 0) return err;
    bool profile = cJSON_GetObjectItemCaseSensitive(object, "profile") != NULL;
    if (!profile) err = object_to_material(ctx, what, object, out);
    cJSON_Delete(object);
    if (!profile || (err = prt_optics_parse(ctx, what, NULL, json, n, &optics)) < 0) return err;
    *out = optics.material;
    prt_optics_finish(&optics);
    return PRT_OK;
}
