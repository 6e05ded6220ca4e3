// SPDX-License-Identifier: MIT
// Checked access to a glTF's JSON.
#include "gltf.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int gltf_bad(const struct gltf *g, const char *fmt, ...)
{
    char line[512];
    va_list args;
    va_start(args, fmt);
    vsnprintf(line, sizeof line, fmt, args);
    va_end(args);
    return prt_fail(g->d->ctx, PRT_FORMAT, "%s: %s", g->d->name, line);
}

int gltf_no_memory(const struct gltf *g)
{
    return prt_fail(g->d->ctx, PRT_NOMEM, "%s: no memory", g->d->name);
}

void *gltf_own(struct gltf *g, uint64_t bytes)
{
    if (bytes > g->d->max_bytes) return NULL;
    struct gltf_owned *p = calloc(1, sizeof *p + (size_t)bytes + 8);
    if (!p) return NULL;
    p->next = g->owned;
    g->owned = p;
    return p + 1;
}

const cJSON *gltf_member(const cJSON *object, const char *key)
{
    return cJSON_IsObject(object) ? cJSON_GetObjectItemCaseSensitive(object, key) : NULL;
}

const char *gltf_text(const cJSON *object, const char *key)
{
    const cJSON *item = gltf_member(object, key);
    return cJSON_IsString(item) ? item->valuestring : NULL;
}

int gltf_number(const struct gltf *g, const char *kind, size_t index, const cJSON *object,
                const char *key, uint64_t max, uint64_t missing, uint64_t *out)
{
    const cJSON *item = gltf_member(object, key);
    *out = missing;
    if (!item) return PRT_OK;
    double x = item->valuedouble;
    if (!cJSON_IsNumber(item) || !(x >= 0 && x <= 0x1p53) || x != floor(x))
        return gltf_bad(g, "%s %zu: %s is not a whole number", kind, index, key);
    if (x > (double)max)
        return gltf_bad(g, "%s %zu: %s %.0f is too large", kind, index, key, x);
    *out = (uint64_t)x;
    return PRT_OK;
}

int gltf_numbers(const struct gltf *g, const char *kind, size_t index, const cJSON *object,
                 const char *key, size_t n, double *out, bool *have)
{
    const cJSON *array = gltf_member(object, key);
    *have = array != NULL;
    if (!array) return PRT_OK;
    const cJSON *item = cJSON_IsArray(array) ? array->child : NULL;
    for (size_t i = 0; i < n; i++, item = item->next) {
        if (!item || !cJSON_IsNumber(item) || !isfinite(item->valuedouble))
            return gltf_bad(g, "%s %zu: %s needs %zu numbers", kind, index, key, n);
        out[i] = item->valuedouble;
    }
    return PRT_OK;
}

int gltf_table(struct gltf *g, const char *key, struct gltf_table *out)
{
    const cJSON *array = gltf_member(g->json, key), *item;
    *out = (struct gltf_table){NULL, 0};
    if (!array) return PRT_OK;
    if (!cJSON_IsArray(array)) return gltf_bad(g, "%s is not an array", key);
    size_t n = 0;
    for (item = array->child; item; item = item->next) n++;
    out->item = gltf_own(g, n * sizeof *out->item);
    if (!out->item) return gltf_no_memory(g);
    for (item = array->child; item; item = item->next) {
        if (!cJSON_IsObject(item)) return gltf_bad(g, "%s %zu is not an object", key, out->n);
        out->item[out->n++] = item;
    }
    return PRT_OK;
}
