// SPDX-License-Identifier: MIT
// Reader of STL, binary and text: three vertices a facet, in the file's order. The facets'
// normals are not read: topology.c welds equal positions and computes smooth ones.
#include "internal.h"
#include "text.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

enum { STL_HEAD = 84, STL_FACET = 50 };

static uint32_t facets_of(const void *bytes)
{
    const uint8_t *b = (const uint8_t *)bytes + 80;
    return b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24;
}

// A binary file may begin with "solid" too; its length tells the two apart.
bool prt_is_binary_stl(const void *bytes, size_t n)
{
    return n >= STL_HEAD + STL_FACET &&
           (uint64_t)STL_HEAD + (uint64_t)STL_FACET * facets_of(bytes) == n;
}

static int add_facet(struct prt_draft *d, float corner[3][3])
{
    uint32_t first;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            if (!(fabsf(corner[i][k]) <= 1e15f))
                return prt_fail(d->ctx, PRT_FORMAT,
                                "%s: facet %u: a coordinate is not finite or beyond 1e15",
                                d->name, d->n_triangle);
    int status = prt_draft_vertices(d, 3, &first);
    if (status) return status;
    memcpy(d->position[first], corner, 9 * sizeof(float));
    return prt_draft_triangle(d, first, first + 1, first + 2);
}

static int read_binary(struct prt_draft *d, const char *bytes, size_t n)
{
    uint32_t count = n >= STL_HEAD ? facets_of(bytes) : 0;
    uint64_t need = STL_HEAD + (uint64_t)STL_FACET * count;
    if (n < STL_HEAD || need > n)
        return prt_fail(d->ctx, PRT_FORMAT,
                        "%s: a binary STL of %u facets has %llu bytes, and the file has %zu",
                        d->name, count, (unsigned long long)need, n);
    if (need < n)
        prt_log(d->ctx, PRT_LOG_WARNING, "%s: %llu bytes behind its last facet are ignored",
                d->name, (unsigned long long)(n - need));
    if (count > d->max_triangles)
        return prt_fail(d->ctx, PRT_LIMIT, "%s: more than %u triangles", d->name,
                        d->max_triangles);
    int status = PRT_OK;
    for (uint32_t i = 0; i < count && !status; i++) {
        float corner[3][3]; // behind the normal, little-endian
        memcpy(corner, bytes + STL_HEAD + (size_t)STL_FACET * i + 12, sizeof corner);
        status = add_facet(d, corner);
    }
    return status;
}

struct text {
    struct prt_draft *d;
    const char *p;
    locale_t c;
    size_t line;
    char name[64]; // of the first solid
    bool opaque;
};

static int fail_line(const struct text *t, const char *fault)
{
    return prt_fail(t->d->ctx, PRT_FORMAT, "%s: line %zu: %s", t->d->name, t->line, fault);
}

static bool starts(const char *p, const char *word, const char **rest)
{
    size_t n = strlen(word);
    if (strncasecmp(p, word, n) || (p[n] && !strchr(" \t\r\n", p[n]))) return false;
    *rest = text_blank(p + n);
    return true;
}

static void take_name(struct text *t, const char *p)
{
    size_t n = strcspn(p, "\r\n");
    char name[64];
    while (n && (p[n - 1] == ' ' || p[n - 1] == '\t')) n--;
    snprintf(name, sizeof name, "%.*s", (int)(n < 63 ? n : 63), p);
    if (!t->name[0]) memcpy(t->name, name, sizeof name);
    t->opaque |= prt_draft_opaque(t->d, name);
}

// One line; corners counts those of the facet that is open, -1: none is.
static int read_line(struct text *t, const char *p, int *corners, float corner[3][3])
{
    const char *rest;
    double x;
    if (starts(p, "vertex", &rest)) {
        if (*corners < 0 || *corners > 2) return fail_line(t, "a facet has three vertices");
        for (int k = 0; k < 3; k++) {
            if (!(rest = text_double(rest, t->c, &x)))
                return fail_line(t, "a vertex needs three numbers");
            corner[*corners][k] = (float)x;
        }
        ++*corners;
    } else if (starts(p, "facet", &rest)) {
        if (*corners >= 0) return fail_line(t, "a facet begins inside another");
        *corners = 0;
    } else if (starts(p, "endfacet", &rest)) {
        if (*corners != 3) return fail_line(t, "a facet has three vertices");
        *corners = -1;
        return add_facet(t->d, corner);
    } else if (starts(p, "solid", &rest)) {
        take_name(t, rest);
    } else if (*p && *p != '\n' && !starts(p, "outer", &rest) && !starts(p, "endloop", &rest) &&
               !starts(p, "endsolid", &rest)) {
        return fail_line(t, "none of solid, facet, outer loop, vertex, endloop, endfacet, "
                            "endsolid");
    }
    return PRT_OK;
}

static int read_text(struct text *t)
{
    float corner[3][3] = {{0}};
    int corners = -1, status = PRT_OK;
    for (const char *p = t->p; p && *p && !status; t->line++) {
        status = read_line(t, text_blank(p), &corners, corner);
        p = strchr(p, '\n');
        if (p) p++;
    }
    return status || corners < 0 ? status : fail_line(t, "the file ends inside a facet");
}

int prt_read_stl(struct prt_draft *d, const char *bytes, size_t n)
{
    struct text t = {.d = d, .p = bytes, .line = 1};
    struct prt_surface s;
    uint32_t index;
    t.c = newlocale(LC_ALL_MASK, "C", (locale_t)0);
    if (!t.c) return prt_fail(d->ctx, PRT_NOMEM, "%s: no memory", d->name);
    if (n >= 3 && !memcmp(bytes, "\xef\xbb\xbf", 3)) t.p += 3;
    bool binary = prt_is_binary_stl(bytes, n) || memchr(bytes, 0, n);
    int status = binary ? read_binary(d, bytes, n) : read_text(&t);
    freelocale(t.c);
    prt_surface_default(&s, t.name[0] ? t.name : NULL);
    s.translucent = !(t.opaque || prt_draft_opaque(d, s.name));
    if (!status) status = prt_draft_surface(d, &s, &index);
    if (!status) status = prt_draft_object(d, NULL);
    return status ? status
                  : prt_draft_block(d, (struct prt_block){.n_vertex = d->n_vertex,
                                                          .n_triangle = d->n_triangle});
}
