// SPDX-License-Identifier: MIT
// Reader of Wavefront OBJ. Vertices are the `v` lines in their order; polygons become fans of
// triangles. Objects, groups and materials become blocks where they divide the vertices
// (obj_parts.c), else the file is one block.
#include "internal.h"
#include "obj_material.h"
#include "obj_parts.h"
#include "text.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// Lines mtllib and bytes of all libraries; chosen, not measured.
enum { MOST_LIBRARIES = 64, MOST_TEXT = 64 << 20 };

struct list {
    float *x;
    size_t n, cap; // floats
};

struct obj {
    struct prt_draft *d;
    locale_t c;
    size_t line;
    struct list vn, vt;
    char library[MOST_LIBRARIES][256]; // of each line mtllib, once
    uint32_t n_library;
    bool left_out;       // a further library
    uint32_t cap_corner; // of d->corner_uv
    struct obj_parts parts;
    bool uv_seam;
    uint8_t *has_uv; // [cap_uv] which vertices have one
    uint32_t cap_uv;
};

static int fail_line(const struct obj *o, const char *fault)
{
    return prt_fail(o->d->ctx, PRT_FORMAT, "%s: line %zu: %s", o->d->name, o->line, fault);
}

static int push(struct obj *o, struct list *l, const float *x, size_t n)
{
    if (l->n + n > l->cap) {
        size_t cap = l->cap ? l->cap * 2 : 1024;
        float *p = cap * sizeof *p > o->d->max_bytes ? NULL : realloc(l->x, cap * sizeof *p);
        if (!p) return prt_fail(o->d->ctx, PRT_NOMEM, "%s: no memory", o->d->name);
        l->x = p;
        l->cap = cap;
    }
    memcpy(l->x + l->n, x, n * sizeof *x);
    l->n += n;
    return PRT_OK;
}

// Reads `need` finite numbers; NULL unless the line has them.
static const char *numbers(const struct obj *o, const char *p, int need, float *out)
{
    for (int i = 0; i < need; i++) {
        double x;
        p = text_double(p, o->c, &x);
        if (!p || !(fabs(x) <= 1e15)) return NULL;
        out[i] = (float)x;
    }
    return p;
}

static int read_vertex(struct obj *o, const char *p)
{
    uint32_t at;
    float x[3];
    if (!numbers(o, p, 3, x))
        return fail_line(o, "a vertex needs three finite numbers below 1e15");
    int status = prt_draft_vertices(o->d, 1, &at);
    if (!status) memcpy(o->d->position[at], x, sizeof x);
    return status;
}

// 1-based or, when negative, relative to the end; -1 when out of range.
static int64_t resolve(long long i, size_t n)
{
    if (i > 0 && (unsigned long long)i <= n) return i - 1;
    if (i < 0 && i >= -(long long)n) return (long long)n + i;
    return -1;
}

struct corner {
    int64_t v, vt, vn; // -1: none
};

// v, v/vt, v//vn or v/vt/vn
static const char *read_corner(const struct obj *o, const char *p, struct corner *out)
{
    char *end;
    errno = 0;
    long long v = strtoll(p, &end, 10), t = 0, n = 0;
    if (end == p || errno) return NULL;
    if (*end == '/') {
        p = end + 1;
        if (*p != '/') {
            t = strtoll(p, &end, 10);
            if (end == p || errno) return NULL;
            p = end;
        }
        end = (char *)p;
        if (*p == '/') {
            n = strtoll(p + 1, &end, 10);
            if (end == p + 1 || errno) return NULL;
        }
    }
    if (*end && !strchr(" \t\r\n", *end)) return NULL;
    *out = (struct corner){resolve(v, o->d->n_vertex), t ? resolve(t, o->vt.n / 2) : -1,
                           n ? resolve(n, o->vn.n / 3) : -1};
    bool ok = out->v >= 0 && (!t || out->vt >= 0) && (!n || out->vn >= 0);
    return ok ? end : NULL;
}

static int store_corner(struct obj *o, const struct corner *c)
{
    struct prt_draft *d = o->d;
    if (c->vn >=
        0) // the normals of a vertex's corners are averaged, because a vertex has one colour
        for (int k = 0; k < 3; k++) d->normal[c->v][k] += o->vn.x[c->vn * 3 + k];
    if (c->vt < 0) return PRT_OK;
    if (o->cap_uv < d->cap_vertex) {
        uint8_t *p = realloc(o->has_uv, d->cap_vertex);
        if (!p) return prt_fail(d->ctx, PRT_NOMEM, "%s: no memory", d->name);
        memset(p + o->cap_uv, 0, d->cap_vertex - o->cap_uv);
        o->has_uv = p;
        o->cap_uv = d->cap_vertex;
    }
    float *uv = d->uv[c->v];
    const float *from = o->vt.x + c->vt * 2;
    if (!o->has_uv[c->v]) {
        uv[0] = from[0];
        uv[1] = 1 - from[1]; // v counts downwards, as in glTF
        o->has_uv[c->v] = 1;
        d->has_uv = true;
    } else if (uv[0] != from[0] || uv[1] != 1 - from[1]) {
        o->uv_seam = true;
    }
    return PRT_OK;
}

// The texture coordinates of a triangle's corners, which differ from its vertices' at seams.
static int store_corner_uv(struct obj *o, const struct corner *corner[3])
{
    struct prt_draft *d = o->d;
    if (o->cap_corner < d->cap_triangle) {
        void *p = realloc(d->corner_uv, (size_t)d->cap_triangle * sizeof *d->corner_uv);
        if (!p) return prt_fail(d->ctx, PRT_NOMEM, "%s: no memory", d->name);
        d->corner_uv = p;
        o->cap_corner = d->cap_triangle;
    }
    for (int k = 0; k < 3; k++) {
        float *uv = d->corner_uv[d->n_triangle - 1][k];
        const float *from = corner[k]->vt < 0 ? NULL : o->vt.x + corner[k]->vt * 2;
        uv[0] = from ? from[0] : 0;
        uv[1] = from ? 1 - from[1] : 0;
    }
    return PRT_OK;
}

static int read_face(struct obj *o, const char *p)
{
    struct corner first = {0}, last = {0}, next;
    uint32_t n = 0;
    int status = PRT_OK;
    for (;; n++) {
        p = text_blank(p);
        if (!*p || *p == '\n' || *p == '#') break;
        p = read_corner(o, p, &next);
        if (!p) return fail_line(o, "a face has an unreadable index or one without a vertex");
        if ((status = store_corner(o, &next))) return status;
        if (n >= 2 &&
            ((status = prt_draft_triangle(o->d, (uint32_t)first.v, (uint32_t)last.v,
                                          (uint32_t)next.v)) ||
             (status = prt_obj_parts_triangle(o->d, &o->parts)) ||
             (status = store_corner_uv(o, (const struct corner *[3]){&first, &last, &next}))))
            return status;
        if (n == 0) first = next;
        last = next;
    }
    return n < 3 ? fail_line(o, "a face needs three corners") : PRT_OK;
}

static bool is_word(const char *p, const char *word, const char **rest)
{
    size_t n = strlen(word);
    if (strncmp(p, word, n) || (p[n] != ' ' && p[n] != '\t')) return false;
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

static void name_library(struct obj *o, const char *p)
{
    char line[sizeof o->library[0]];
    uint32_t i = 0;
    take_name(p, line, sizeof line);
    while (i < o->n_library && strcmp(o->library[i], line)) i++; // exporters repeat the line
    if (i < o->n_library) return;
    if (i == MOST_LIBRARIES) {
        if (!o->left_out)
            prt_log(o->d->ctx, PRT_LOG_WARNING,
                    "%s: line %zu: more than %d mtllib; the rest is left out", o->d->name,
                    o->line, MOST_LIBRARIES);
        o->left_out = true;
        return;
    }
    memcpy(o->library[o->n_library++], line, sizeof line);
}

static int read_line(struct obj *o, const char *p)
{
    const char *rest;
    char name[64];
    float x[3];
    if (is_word(p, "v", &rest)) return read_vertex(o, rest);
    if (is_word(p, "f", &rest)) return read_face(o, rest);
    if (is_word(p, "vn", &rest)) {
        if (!numbers(o, rest, 3, x)) x[0] = x[1] = x[2] = 0;
        return push(o, &o->vn, x, 3);
    }
    if (is_word(p, "vt", &rest)) {
        if (!numbers(o, rest, 2, x) && !numbers(o, rest, 1, x)) x[0] = 0;
        if (!numbers(o, rest, 2, x)) x[1] = 0;
        return push(o, &o->vt, x, 2);
    }
    if (is_word(p, "usemtl", &rest)) {
        take_name(rest, name, sizeof name);
        prt_obj_parts_name(&o->parts, 'm', name);
    } else if (is_word(p, "mtllib", &rest)) {
        name_library(o, rest);
    } else if (is_word(p, "o", &rest) || is_word(p, "g", &rest)) {
        take_name(rest, name, sizeof name);
        prt_obj_parts_name(&o->parts, p[0], name);
    }
    return PRT_OK; // smoothing, lines, points and curves carry no triangles
}

static void unit_normals(struct prt_draft *d)
{
    for (uint32_t v = 0; v < d->n_vertex; v++) {
        float *n = d->normal[v];
        double s = (double)n[0] * n[0] + (double)n[1] * n[1] + (double)n[2] * n[2];
        bool good = s > 1e-12 && s < 1e30;
        for (int c = 0; c < 3; c++) n[c] = good ? (float)(n[c] / sqrt(s)) : 0;
    }
}

// Appends a library's file to `text`; messages go to ctx.
static int append_library(const struct prt_draft *d, const struct prt_context *ctx,
                          const char *file, struct prt_blob *text)
{
    struct prt_blob more = {NULL, 0};
    const uint64_t room = text->size < MOST_TEXT ? MOST_TEXT - text->size : 1;
    int status = prt_draft_file(d, ctx, "material", file, room, &more);
    if (status) return status;
    const size_t n = strlen(more.bytes);
    char *both = prt_alloc(text->size + n + 2, 1);
    if (both) {
        if (text->size) memcpy(both, text->bytes, text->size);
        memcpy(both + text->size, more.bytes, n);
        memcpy(both + text->size + n, "\n", 2);
        prt_free(text->bytes);
        *text = (struct prt_blob){both, text->size + n + 1};
    }
    prt_free(more.bytes);
    return both ? PRT_OK : prt_fail(ctx, PRT_NOMEM, "%s: no memory for \"%s\"", d->name, file);
}

// A line mtllib is one name that may hold blanks, or, where its first word is a file, several
// names between blanks.
static void append_line(const struct prt_draft *d, const char *line, struct prt_blob *text)
{
    const struct prt_context *user, lenient = prt_draft_lenient(d, &user);
    struct prt_context silent = lenient;
    char word[256];
    size_t n = strcspn(line, " \t");
    silent.log = prt_log_none;
    snprintf(word, sizeof word, "%.*s", (int)n, line);
    if (!append_library(d, &silent, line, text)) return;
    if (!line[n] || append_library(d, &silent, word, text)) {
        (void)append_library(d, &lenient, line, text); // says what is wrong with it
        return;
    }
    for (line += n; *(line = text_blank(line)); line += n) {
        n = strcspn(line, " \t");
        snprintf(word, sizeof word, "%.*s", (int)n, line);
        (void)append_library(d, &lenient, word, text);
    }
}

// The text of all libraries, for all materials; empty where there is none or they are left out.
static struct prt_blob read_libraries(const struct obj *o)
{
    struct prt_blob text = {NULL, 0};
    for (uint32_t i = 0; i < o->n_library && !o->d->no_textures; i++)
        append_line(o->d, o->library[i], &text);
    return text;
}

// The library's material of this name; *mapped where it has maps or emits light.
static int find_material(const struct obj *o, const struct prt_blob *library, const char *name,
                         struct prt_surface *surface, struct prt_surface_maps *maps,
                         bool *mapped)
{
    struct prt_draft *d = o->d;
    struct obj_material m;
    *mapped = false;
    if (!library->bytes) return PRT_OK;
    prt_obj_material_init(&m);
    snprintf(m.name, sizeof m.name, "%s", name);
    prt_obj_material_parse(d, library->bytes, &m);
    if (!m.found) {
        prt_log(d->ctx, PRT_LOG_WARNING, "%s: %s has %smaterial \"%s\"", d->name,
                o->n_library > 1 ? "none of its libraries" : o->library[0],
                o->n_library > 1 ? "" : "no ", name);
        return PRT_OK;
    }
    int status = prt_obj_material_apply(d, &m, surface, maps);
    for (int k = 0; k < PRT_N_MAP; k++) *mapped |= maps->map[k].image != UINT32_MAX;
    for (int c = 0; c < 3; c++) *mapped |= maps->emissive[c] > 0;
    return status;
}

static int add_surface(struct obj *o, const struct prt_blob *library, const char *name,
                       bool opaque, uint32_t *index)
{
    struct prt_draft *d = o->d;
    struct prt_surface s;
    struct prt_surface_maps maps;
    bool mapped;
    prt_surface_default(&s, *name ? name : NULL);
    s.translucent = !opaque;
    int status = find_material(o, library, name, &s, &maps, &mapped);
    if (!status) status = prt_draft_surface(d, &s, index);
    if (status || !mapped) return status;
    struct prt_surface_maps *own = prt_draft_maps(d, *index);
    if (!own) return prt_fail(d->ctx, PRT_NOMEM, "%s: no memory", d->name);
    *own = maps;
    return PRT_OK;
}

// Surfaces, objects and blocks of the parts, which are in the order of their vertices.
static int add_parts(struct obj *o, const struct prt_blob *library)
{
    struct prt_draft *d = o->d;
    const struct obj_parts *parts = &o->parts;
    uint32_t surface[OBJ_MOST_PARTS];
    int status = PRT_OK;
    for (uint32_t i = 0; i < parts->n && !status; i++) {
        const struct obj_part *p = &parts->part[i];
        uint32_t same = 0;
        while (same < i && (strcmp(parts->part[same].surface, p->surface) ||
                            parts->part[same].opaque != p->opaque))
            same++;
        surface[i] = surface[same];
        if (same == i) status = add_surface(o, library, p->surface, p->opaque, &surface[i]);
        if (!status && p->begins_object) status = prt_draft_object(d, p->object);
        if (!status)
            status = prt_draft_block(d, (struct prt_block){.object = d->n_object - 1,
                                                           .surface = surface[i],
                                                           .vertex_begin = p->vertex_begin,
                                                           .n_vertex = p->n_vertex,
                                                           .triangle_begin = p->triangle_begin,
                                                           .n_triangle = p->n_triangle});
    }
    return status;
}

static int finish(struct obj *o)
{
    struct prt_draft *d = o->d;
    unit_normals(d);
    if (!o->uv_seam) {
        free(d->corner_uv);
        d->corner_uv = NULL;
    }
    int status = prt_obj_parts_settle(d, &o->parts);
    if (status) return status;
    struct prt_blob library = read_libraries(o);
    status = add_parts(o, &library);
    prt_free(library.bytes);
    return status;
}

// Puts blanks in place of a backslash at the end of the line and of the line's end behind it;
// the number of further lines that the line has then.
static size_t join_lines(char *line)
{
    size_t n = 0;
    if (*text_blank(line) == '#') return 0;
    for (char *from = line, *end; (end = strchr(from, '\n')); n++) {
        char *last = end > line && end[-1] == '\r' ? end - 1 : end;
        if (last == line || last[-1] != '\\') break;
        memset(last - 1, ' ', (size_t)(end - last) + 2);
        from = end;
    }
    return n;
}

int prt_read_obj(struct prt_draft *d, char *text, size_t n)
{
    struct obj o = {.d = d, .line = 1};
    int status = PRT_OK;
    o.c = newlocale(LC_ALL_MASK, "C", (locale_t)0);
    if (!o.c) return prt_fail(d->ctx, PRT_NOMEM, "%s: no memory", d->name);
    if (memchr(text, 0, n)) status = fail_line(&o, "a zero byte in an OBJ file");
    if (n >= 3 && !memcmp(text, "\xef\xbb\xbf", 3)) text += 3;
    for (char *p = text; p && *p && !status; o.line++) {
        const size_t more = join_lines(p);
        status = read_line(&o, text_blank(p));
        o.line += more;
        p = strchr(p, '\n');
        if (p) p++;
    }
    if (!status) status = finish(&o);
    free(o.vn.x);
    free(o.vt.x);
    free(o.has_uv);
    prt_obj_parts_finish(&o.parts);
    freelocale(o.c);
    return status;
}
