// SPDX-License-Identifier: MIT
// Reader of Stanford PLY, ascii and binary of either byte order: vertices, polygons (as fans),
// triangle strips.
#include "internal.h"
#include "text.h"

#include <math.h>
#include <string.h>

enum { MAX_ELEMENTS = 32, MAX_PROPERTIES = 256 };
enum use { NOTHING, X, Y, Z, NX, NY, NZ, U, V, INDICES, N_USE };

struct property {
    int type, count_type; // PLY type; count_type 0: not a list
    enum use use;
};

struct element {
    char name[32];
    uint64_t count;
    int first, n; // properties
};

struct ply {
    struct prt_draft *d;
    const char *p, *end;
    int format; // 'a', 'l' or 'b'
    struct element element[MAX_ELEMENTS];
    struct property property[MAX_PROPERTIES];
    int n_element, n_property;
    locale_t c;
    bool have[N_USE];
};

static int fail_ply(const struct ply *p, const char *fault)
{
    return prt_fail(p->d->ctx, PRT_FORMAT, "%s: %s", p->d->name, fault);
}

enum { I8 = 1, U8, I16, U16, I32, U32, F32, F64 };
static const uint8_t size_of[] = {0, 1, 1, 2, 2, 4, 4, 4, 8};

static int type_of(const char *word)
{
    static const char *const old[] = {"char", "uchar", "short", "ushort",
                                      "int",  "uint",  "float", "double"};
    static const char *const new[] = {"int8",  "uint8",  "int16",   "uint16",
                                      "int32", "uint32", "float32", "float64"};
    for (int i = 0; i < 8; i++)
        if (!strcmp(word, old[i]) || !strcmp(word, new[i])) return i + 1;
    return 0;
}

static enum use use_of(const char *element, const char *name)
{
    static const struct {
        const char *name;
        enum use use;
    } names[] = {{"x", X}, {"y", Y}, {"z", Z}, {"nx", NX}, {"ny", NY},       {"nz", NZ},
                 {"s", U}, {"t", V}, {"u", U}, {"v", V},   {"texture_u", U}, {"texture_v", V}};
    if (strcmp(element, "vertex"))
        return !strcmp(name, "vertex_indices") || !strcmp(name, "vertex_index") ? INDICES
                                                                                : NOTHING;
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (!strcmp(name, names[i].name)) return names[i].use;
    return NOTHING;
}

// Splits the next header line into at most 6 words; their number, or -1 at the end of the file.
static int words(struct ply *p, char word[6][32])
{
    int n = 0;
    const char *stop = memchr(p->p, '\n', (size_t)(p->end - p->p));
    if (!stop || stop - p->p > 4096) return -1;
    while (p->p < stop && n < 6) {
        const char *a = text_blank(p->p), *b = a;
        while (b < stop && *b != ' ' && *b != '\t' && *b != '\r') b++;
        size_t length = (size_t)(b - a) < 31 ? (size_t)(b - a) : 31;
        if (a < stop && length) {
            memcpy(word[n], a, length);
            word[n++][length] = 0;
        }
        p->p = b > a ? b : stop;
    }
    p->p = stop + 1;
    return n;
}

static int add_element(struct ply *p, const char *name, const char *count)
{
    char *end;
    if (p->n_element == MAX_ELEMENTS) return fail_ply(p, "too many PLY elements");
    struct element *e = &p->element[p->n_element++];
    unsigned long long n = strtoull(count, &end, 10);
    if (*end || count[0] == '-' || n > 1ull << 40)
        return fail_ply(p, "a PLY element count is not a number up to 2^40");
    *e = (struct element){.count = n, .first = p->n_property};
    memcpy(e->name, name, sizeof e->name);
    return PRT_OK;
}

static int add_property(struct ply *p, char word[6][32], int n)
{
    bool list = n == 5 && !strcmp(word[1], "list");
    if (!p->n_element || p->n_property == MAX_PROPERTIES || (n != 3 && !list))
        return fail_ply(p, "a PLY property line is damaged");
    struct element *e = &p->element[p->n_element - 1];
    struct property *q = &p->property[p->n_property++];
    q->count_type = list ? type_of(word[2]) : 0;
    q->type = type_of(word[list ? 3 : 1]);
    q->use = use_of(e->name, word[list ? 4 : 2]);
    e->n++;
    if (!q->type || (list && (!q->count_type || q->count_type >= F32)))
        return fail_ply(p, "a PLY property has an unknown type");
    if ((q->use == INDICES) != list && q->use != NOTHING)
        return fail_ply(
            p, "a PLY property is a list in place of a number, or a number in place of a list");
    if (!strcmp(e->name, "vertex")) p->have[q->use] = true;
    return PRT_OK;
}

static int read_header(struct ply *p)
{
    char word[6][32];
    int n, status = PRT_OK;
    n = words(p, word);
    if (n != 1 || strcmp(word[0], "ply")) return fail_ply(p, "the PLY header is damaged");
    while (!status) {
        n = words(p, word);
        if (n < 0) return fail_ply(p, "the PLY header has no end");
        if (n == 0 || !strcmp(word[0], "comment") || !strcmp(word[0], "obj_info")) continue;
        if (!strcmp(word[0], "end_header")) break;
        if (!strcmp(word[0], "format") && n == 3)
            p->format = !strcmp(word[1], "ascii")                  ? 'a'
                        : !strcmp(word[1], "binary_little_endian") ? 'l'
                        : !strcmp(word[1], "binary_big_endian")    ? 'b'
                                                                   : 0;
        else if (!strcmp(word[0], "element") && n == 3)
            status = add_element(p, word[1], word[2]);
        else if (!strcmp(word[0], "property")) status = add_property(p, word, n);
        else status = fail_ply(p, "an unknown line in the PLY header");
    }
    if (!status && !p->format) status = fail_ply(p, "an unknown PLY format");
    return status;
}

static bool read_binary(struct ply *p, int type, double *out)
{
    uint8_t b[8];
    size_t n = size_of[type];
    if ((size_t)(p->end - p->p) < n) return false;
    for (size_t i = 0; i < n; i++) b[i] = (uint8_t)p->p[p->format == 'b' ? n - 1 - i : i];
    p->p += n;
    uint64_t w = 0;
    for (size_t i = 0; i < n; i++) w |= (uint64_t)b[i] << 8 * i;
    uint32_t w4 = (uint32_t)w;
    float f;
    switch (type) {
    case I8:
        *out = (int8_t)w;
        break;
    case I16:
        *out = (int16_t)w;
        break;
    case I32:
        *out = (int32_t)w4;
        break;
    case F32:
        memcpy(&f, &w4, 4);
        *out = f;
        break;
    case F64:
        memcpy(out, &w, 8);
        break;
    default:
        *out = (double)w;
    }
    return true;
}

static bool read_value(struct ply *p, int type, double *out)
{
    if (p->format != 'a') return read_binary(p, type, out);
    char *end;
    *out = strtod_l(p->p, &end, p->c); // a value may be on the next line, as PLY allows
    if (end == p->p || end > p->end) return false;
    p->p = end;
    return true;
}

static int add_index(struct ply *p, double x, uint32_t corner[3], uint64_t *n, bool strip,
                     bool *odd)
{
    if (strip && x == -1) { // -1 ends a strip
        *n = 0;
        *odd = false;
        return PRT_OK;
    }
    if (!(x >= 0 && x < p->d->n_vertex) || x != floor(x))
        return fail_ply(p, "a face has an index without a vertex");
    uint32_t v = (uint32_t)x;
    int status = PRT_OK;
    if (*n >= 2)
        status = strip && *odd ? prt_draft_triangle(p->d, corner[1], corner[0], v)
                               : prt_draft_triangle(p->d, corner[0], corner[1], v);
    if (*n >= 2) *odd = !*odd;
    if (*n == 0 || (strip && *n >= 2)) corner[0] = *n ? corner[1] : v;
    if (*n >= 1) corner[1] = v;
    ++*n;
    return status;
}

static int read_list(struct ply *p, const struct property *q, bool strip)
{
    double count, x;
    uint32_t corner[3] = {0};
    uint64_t n = 0;
    bool odd = false;
    int status = PRT_OK;
    if (!read_value(p, q->count_type, &count)) return fail_ply(p, "the file ends early");
    if (!(count >= 0 && count <= (double)(p->end - p->p)))
        return fail_ply(p, "a list is longer than the file");
    for (uint64_t i = 0; i < (uint64_t)count && !status; i++) {
        if (!read_value(p, q->type, &x))
            return fail_ply(p, "the file ends early or is no number");
        if (q->use == INDICES) status = add_index(p, x, corner, &n, strip, &odd);
    }
    return status;
}

static int store_vertex(struct ply *p, uint32_t v, const double *x)
{
    struct prt_draft *d = p->d;
    for (int c = 0; c < 3; c++) {
        if (!(fabs(x[X + c]) <= 1e15))
            return fail_ply(p, "a vertex is not finite or beyond 1e15");
        d->position[v][c] = (float)x[X + c];
    }
    double s = x[NX] * x[NX] + x[NY] * x[NY] + x[NZ] * x[NZ];
    if (p->have[NZ] && s > 1e-12 && s < 1e30)
        for (int c = 0; c < 3; c++) d->normal[v][c] = (float)(x[NX + c] / sqrt(s));
    if (p->have[U] && p->have[V] && fabs(x[U]) < 1e30 && fabs(x[V]) < 1e30) {
        d->uv[v][0] = (float)x[U];
        d->uv[v][1] = 1 - (float)x[V]; // v counts downwards, as in glTF
        d->has_uv = true;
    }
    return PRT_OK;
}

static int read_element(struct ply *p, const struct element *e)
{
    bool vertex = !strcmp(e->name, "vertex"), strip = !strcmp(e->name, "tristrips");
    uint32_t first = 0;
    int status = PRT_OK;
    uint64_t row = 0;
    for (int i = 0; i < e->n; i++) {
        const struct property *q = &p->property[e->first + i];
        row += p->format == 'a' ? 1 : size_of[q->count_type ? q->count_type : q->type];
    }
    if (!row)
        return e->count && vertex ? fail_ply(p, "the vertices have no properties") : PRT_OK;
    if (e->count > (uint64_t)(p->end - p->p) / row)
        return fail_ply(p, "the file is shorter than its header declares");
    if (vertex) {
        if (!p->have[X] || !p->have[Y] || !p->have[Z])
            return fail_ply(p, "vertices lack x, y or z");
        if (p->d->n_vertex) return fail_ply(p, "the PLY header has two vertex elements");
        status = prt_draft_vertices(p->d, e->count, &first);
    }
    for (uint64_t r = 0; r < e->count && !status; r++) {
        double x[N_USE] = {0}, value;
        for (int i = 0; i < e->n && !status; i++) {
            const struct property *q = &p->property[e->first + i];
            if (q->count_type) status = read_list(p, q, strip);
            else if (!read_value(p, q->type, &value))
                status = fail_ply(p, "the file ends early or is no number");
            else x[q->use] = value;
        }
        if (!status && vertex) status = store_vertex(p, first + (uint32_t)r, x);
    }
    return status;
}

int prt_read_ply(struct prt_draft *d, const char *text, size_t n)
{
    struct ply p = {.d = d, .p = text, .end = text + n};
    struct prt_surface s;
    uint32_t index;
    p.c = newlocale(LC_ALL_MASK, "C", (locale_t)0);
    if (!p.c) return prt_fail(d->ctx, PRT_NOMEM, "%s: no memory", d->name);
    int status = read_header(&p);
    for (int i = 0; i < p.n_element && !status; i++) status = read_element(&p, &p.element[i]);
    freelocale(p.c);
    prt_surface_default(&s, NULL);
    s.translucent = !prt_draft_opaque(d, s.name);
    if (!status) status = prt_draft_surface(d, &s, &index);
    if (!status) status = prt_draft_object(d, NULL);
    return status ? status
                  : prt_draft_block(d, (struct prt_block){.n_vertex = d->n_vertex,
                                                          .n_triangle = d->n_triangle});
}
