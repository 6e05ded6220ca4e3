// SPDX-License-Identifier: MIT
// Objects, groups and materials of an OBJ as blocks. The order of the vertices is the file's: a
// file is divided only where each part's vertices are one piece of it, as exporters write them.
#include "obj_parts.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { NO_PART = UINT16_MAX };

void prt_obj_parts_name(struct obj_parts *parts, char kind, const char *name)
{
    char *to = kind == 'o' ? parts->object : kind == 'g' ? parts->group : parts->surface;
    snprintf(to, sizeof parts->object, "%s", name);
    parts->has_objects |= kind == 'o';
    parts->now = UINT32_MAX;
}

// The part of the names so far, which may be new.
static uint32_t find_part(struct obj_parts *parts)
{
    const char *object = parts->has_objects ? parts->object : parts->group;
    uint32_t i = 0;
    while (i < parts->n && (strcmp(parts->part[i].object, object) ||
                            strcmp(parts->part[i].surface, parts->surface)))
        i++;
    if (i < parts->n) return i;
    if (parts->n == OBJ_MOST_PARTS) {
        parts->too_many = true;
        return 0;
    }
    struct obj_part *p = &parts->part[parts->n];
    *p = (struct obj_part){{0}};
    memcpy(p->object, object, sizeof p->object);
    memcpy(p->surface, parts->surface, sizeof p->surface);
    return parts->n++;
}

int prt_obj_parts_triangle(const struct prt_draft *d, struct obj_parts *parts)
{
    if (!parts->n || parts->now == UINT32_MAX) parts->now = find_part(parts);
    if (parts->cap < d->cap_triangle) {
        uint16_t *p = realloc(parts->of_triangle, d->cap_triangle * sizeof *p);
        if (!p) return prt_fail(d->ctx, PRT_NOMEM, "%s: no memory", d->name);
        parts->of_triangle = p;
        parts->cap = d->cap_triangle;
    }
    parts->of_triangle[d->n_triangle - 1] = (uint16_t)parts->now;
    return PRT_OK;
}

// The part of each vertex; false where faces of two parts share one.
static bool divide_vertices(const struct prt_draft *d, const struct obj_parts *parts,
                            uint16_t *of_vertex)
{
    memset(of_vertex, 0xff, d->n_vertex * sizeof *of_vertex);
    for (uint32_t t = 0; t < d->n_triangle; t++)
        for (int c = 0; c < 3; c++) {
            uint16_t *part = &of_vertex[d->triangle[t][c]];
            if (*part != NO_PART && *part != parts->of_triangle[t]) return false;
            *part = parts->of_triangle[t];
        }
    // Vertices of no face belong to the part before them, or to the first.
    uint16_t last = NO_PART;
    for (uint32_t v = 0; v < d->n_vertex; v++) {
        if (of_vertex[v] == NO_PART) of_vertex[v] = last;
        last = of_vertex[v];
    }
    for (uint32_t v = d->n_vertex; v-- > 0;) {
        if (of_vertex[v] == NO_PART) of_vertex[v] = last;
        last = of_vertex[v];
    }
    return true;
}

// Orders the parts by their vertices; false where one is in several pieces. order[old] = new.
static bool order_parts(const struct prt_draft *d, struct obj_parts *parts,
                        const uint16_t *of_vertex, uint16_t *order)
{
    struct obj_part *sorted = calloc(parts->n, sizeof *sorted);
    uint32_t n = 0;
    bool good = sorted != NULL;
    for (uint32_t i = 0; i < parts->n; i++) order[i] = NO_PART;
    for (uint32_t v = 0; v < d->n_vertex && good; v++) {
        const uint16_t part = of_vertex[v];
        if (!v || part != of_vertex[v - 1]) {
            good = order[part] == NO_PART;
            if (!good) break;
            order[part] = (uint16_t)n;
            sorted[n] = parts->part[part];
            sorted[n++].vertex_begin = v;
        }
        sorted[n - 1].n_vertex++;
    }
    if (good && n == parts->n) memcpy(parts->part, sorted, n * sizeof *sorted);
    good &= n == parts->n;
    free(sorted);
    return good;
}

// Triangles and their corners' texture coordinates by part, in their order within each.
static int order_triangles(struct prt_draft *d, struct obj_parts *parts, const uint16_t *order)
{
    uint32_t next[OBJ_MOST_PARTS + 1] = {0}, at = 0;
    uint32_t(*triangle)[3] = malloc(d->n_triangle * sizeof *triangle);
    float(*uv)[3][2] = d->corner_uv ? malloc(d->n_triangle * sizeof *uv) : NULL;
    if (!triangle || (d->corner_uv && !uv)) {
        free(triangle);
        free(uv);
        return prt_fail(d->ctx, PRT_NOMEM, "%s: no memory", d->name);
    }
    for (uint32_t t = 0; t < d->n_triangle; t++)
        parts->part[order[parts->of_triangle[t]]].n_triangle++;
    for (uint32_t i = 0; i < parts->n; i++) {
        parts->part[i].triangle_begin = next[i] = at;
        at += parts->part[i].n_triangle;
    }
    for (uint32_t t = 0; t < d->n_triangle; t++) {
        const uint32_t to = next[order[parts->of_triangle[t]]]++;
        memcpy(triangle[to], d->triangle[t], sizeof *triangle);
        if (uv) memcpy(uv[to], d->corner_uv[t], sizeof *uv);
    }
    memcpy(d->triangle, triangle, d->n_triangle * sizeof *triangle);
    if (uv) memcpy(d->corner_uv, uv, d->n_triangle * sizeof *uv);
    free(triangle);
    free(uv);
    return PRT_OK;
}

// Whether vertices of two groups are at one point: they are regions of one body then.
static bool touch(const struct prt_draft *d, const uint16_t *of_vertex, bool *full)
{
    uint32_t size = 64;
    while (size < 2ull * d->n_vertex && size < 1u << 31) size *= 2;
    uint32_t *slot = calloc(size, sizeof *slot);
    bool found = false;
    *full = !slot;
    for (uint32_t v = 0; slot && v < d->n_vertex && !found; v++) {
        const float *p = d->position[v];
        uint32_t i = (uint32_t)prt_hash64(p, sizeof d->position[0], 0) & (size - 1);
        while (slot[i] && memcmp(d->position[slot[i] - 1], p, sizeof d->position[0]))
            i = (i + 1) & (size - 1);
        if (!slot[i]) slot[i] = v + 1;
        found = of_vertex[slot[i] - 1] != of_vertex[v];
    }
    free(slot);
    return found;
}

static void one_part(struct prt_draft *d, struct obj_parts *parts)
{
    bool others = false, opaque = false, all = !parts->too_many;
    char why[80] = "faces of several objects or materials share vertices";
    if (parts->too_many)
        snprintf(why, sizeof why, "it has more than %d objects and materials", OBJ_MOST_PARTS);
    for (uint32_t i = 0; i < parts->n; i++) {
        const struct obj_part *p = &parts->part[i];
        others |= strcmp(p->surface, parts->part[0].surface) != 0;
        opaque |= p->opaque;
        all &= p->opaque;
    }
    if (others)
        prt_log(d->ctx, PRT_LOG_WARNING,
                "%s: %s: it is read as one object of the first material, \"%s\"", d->name, why,
                parts->part[0].surface);
    if (opaque && !all)
        prt_log(d->ctx, PRT_LOG_WARNING, "%s: %s: an opaque part makes the whole model opaque",
                d->name, why);
    parts->part[0].opaque = opaque;
    parts->part[0].begins_object = true;
    parts->part[0].vertex_begin = parts->part[0].triangle_begin = 0;
    parts->part[0].n_vertex = d->n_vertex;
    parts->part[0].n_triangle = d->n_triangle;
    parts->n = 1;
}

// Each run of parts of one name is an object; touching groups are one without a name.
static void name_objects(struct obj_parts *parts, bool touching)
{
    const bool one = !parts->has_objects && touching;
    for (uint32_t i = 0; i < parts->n; i++) {
        struct obj_part *p = &parts->part[i];
        p->begins_object = !i || (!one && strcmp(p->object, p[-1].object));
    }
    if (one) parts->part[0].object[0] = 0;
}

int prt_obj_parts_settle(struct prt_draft *d, struct obj_parts *parts)
{
    uint16_t *of_vertex = NULL, order[OBJ_MOST_PARTS];
    bool divided = false, touching = false, full = false;
    if (!parts->n) return PRT_OK; // no triangles: the caller says so
    for (uint32_t i = 0; i < parts->n; i++) {
        struct obj_part *p = &parts->part[i];
        p->opaque = prt_draft_opaque(d, p->object);
        p->opaque |= prt_draft_opaque(d, *p->surface ? p->surface : PRT_UNNAMED_SURFACE);
    }
    if (parts->n > 1 && !parts->too_many) {
        of_vertex = malloc(d->n_vertex * sizeof *of_vertex);
        full = !of_vertex;
        divided = of_vertex && divide_vertices(d, parts, of_vertex);
        if (divided && !parts->has_objects) touching = touch(d, of_vertex, &full);
        divided = divided && order_parts(d, parts, of_vertex, order);
        free(of_vertex);
    }
    if (full) return prt_fail(d->ctx, PRT_NOMEM, "%s: no memory", d->name);
    if (!divided) {
        one_part(d, parts);
        return PRT_OK;
    }
    name_objects(parts, touching);
    return order_triangles(d, parts, order);
}

void prt_obj_parts_finish(struct obj_parts *parts)
{
    free(parts->of_triangle);
}
