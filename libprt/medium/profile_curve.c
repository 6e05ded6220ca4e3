// SPDX-License-Identifier: MIT
// A user's curve: points (r, R_d) from JSON or a CSV file, linear in between.
#include "material.h"
#include "profile.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

int prt_profile_init_curve(const struct prt_context *ctx, const char *what,
                           struct prt_profile *profile, unsigned n, const double *r_mm,
                           const double *rd)
{
    struct prt_profile p = {.kind = PRT_PROFILE_CURVE};
    if (n < 2 || n > PRT_PROFILE_MAX_POINT)
        return prt_fail(ctx, PRT_ARG, "%s: a curve of %u points, allowed range 2 to %d", what,
                        n, PRT_PROFILE_MAX_POINT);
    for (unsigned i = 0; i < n; i++) {
        if (!(r_mm[i] >= 0 && r_mm[i] <= 1e5) || (i && !(r_mm[i] > r_mm[i - 1])))
            return prt_fail(ctx, PRT_ARG,
                            "%s: radius %u is %g mm; radii ascend within 0 to 100000 mm", what,
                            i, r_mm[i]);
        if (!(rd[i] >= 0 && rd[i] <= 1e9))
            return prt_fail(ctx, PRT_ARG, "%s: R_d %u is %g, allowed range 0 to 1e9 mm^-2",
                            what, i, rd[i]);
    }
    if (prt_profile_table_alloc(&p, n) < 0)
        return prt_fail(ctx, PRT_NOMEM, "%s: no memory", what);
    memcpy(p.r, r_mm, n * sizeof(double));
    memcpy(p.rd, rd, n * sizeof(double));
    prt_profile_table_integrate(&p);
    p.total = prt_profile_table_tail(&p, 0);
    if (!(p.total > 0 && p.total <= 1.0001)) {
        double total = p.total;
        prt_profile_finish(&p);
        return prt_fail(ctx, PRT_ARG,
                        "%s: the curve reflects %g of the light (2 pi r R_d dr), allowed range "
                        "0 (excluded) to 1",
                        what, total);
    }
    *profile = p;
    return PRT_OK;
}

struct curve {
    unsigned n;
    double r[PRT_PROFILE_MAX_POINT], rd[3][PRT_PROFILE_MAX_POINT];
};

static int curve_numbers(const struct prt_context *ctx, const char *what, const char *key,
                         const cJSON *list, double *out, unsigned *n)
{
    *n = 0;
    for (const cJSON *item = cJSON_IsArray(list) ? list->child : NULL; item;
         item = item->next) {
        if (!cJSON_IsNumber(item) || *n == PRT_PROFILE_MAX_POINT) {
            *n = 0;
            break;
        }
        out[(*n)++] = item->valuedouble;
    }
    if (*n) return PRT_OK;
    return prt_fail(ctx, PRT_FORMAT, "%s: \"%s\" must hold 2 to %d numbers", what, key,
                    PRT_PROFILE_MAX_POINT);
}

static int curve_inline(const struct prt_context *ctx, const char *what, const cJSON *object,
                        struct curve *curve)
{
    const cJSON *rd = cJSON_GetObjectItemCaseSensitive(object, "rd");
    int err =
        curve_numbers(ctx, what, "radius", cJSON_GetObjectItemCaseSensitive(object, "radius"),
                      curve->r, &curve->n);
    if (err < 0) return err;
    if (!cJSON_IsArray(rd) || cJSON_GetArraySize(rd) != 3)
        return prt_fail(ctx, PRT_FORMAT, "%s: \"rd\" must be three lists, red, green, blue",
                        what);
    int c = 0;
    for (const cJSON *item = rd->child; item; item = item->next, c++) {
        unsigned n;
        if ((err = curve_numbers(ctx, what, "rd", item, curve->rd[c], &n)) < 0) return err;
        if (n != curve->n)
            return prt_fail(ctx, PRT_FORMAT, "%s: \"rd\" has %u values for %u radii", what, n,
                            curve->n);
    }
    return PRT_OK;
}

/* Reads one line: r and one value, or r and three. Skips empty lines, # comments and a header
 * in the first line. */
static int curve_line(const struct prt_context *ctx, const char *what, unsigned line,
                      char *text, struct curve *curve)
{
    double v[4];
    int n = 0;
    text += strspn(text, " \t");
    if (!*text || *text == '#' || *text == '\r') return PRT_OK;
    for (char *at = text, *end;; at = end + 1) {
        double x = strtod(at, &end);
        if (end == at || n == 4) {
            if (line == 1 && n == 0) return PRT_OK; /* a header */
            return prt_fail(ctx, PRT_FORMAT, "%s: line %u: expected r,R_d or r,R,G,B", what,
                            line);
        }
        v[n++] = x;
        end += strspn(end, " \t\r");
        if (!*end) break;
        if (*end != ',' && *end != ';')
            return prt_fail(ctx, PRT_FORMAT, "%s: line %u: expected a comma", what, line);
    }
    if (n != 2 && n != 4)
        return prt_fail(ctx, PRT_FORMAT,
                        "%s: line %u has %d columns; expected r,R_d or r,R,G,B", what, line, n);
    if (curve->n == PRT_PROFILE_MAX_POINT)
        return prt_fail(ctx, PRT_LIMIT, "%s: more than %d points", what, PRT_PROFILE_MAX_POINT);
    curve->r[curve->n] = v[0];
    for (int c = 0; c < 3; c++) curve->rd[c][curve->n] = v[n == 2 ? 1 : 1 + c];
    curve->n++;
    return PRT_OK;
}

static int curve_file(const struct prt_context *ctx, const char *what, const char *folder,
                      const char *name, struct curve *curve)
{
    char path[4096];
    if (!folder)
        return prt_fail(ctx, PRT_ARG,
                        "%s: \"file\" is not allowed here; give \"radius\" and \"rd\"", what);
    if (name[0] == '/' || !folder[0]) snprintf(path, sizeof path, "%s", name);
    else if ((size_t)snprintf(path, sizeof path, "%s/%s", folder, name) >= sizeof path)
        return prt_fail(ctx, PRT_ARG, "%s: the curve's path is too long", what);
    struct prt_blob file;
    int err = prt_read_file(ctx, path, 1 << 20, &file);
    if (err < 0) return err;
    char *text = prt_alloc(file.size + 1, 1);
    if (!text) err = PRT_NOMEM;
    if (text) {
        memcpy(text, file.bytes, file.size);
        text[file.size] = 0;
        if (memchr(text, 0, file.size))
            err = prt_fail(ctx, PRT_FORMAT, "%s: not a text file", path);
        unsigned line = 1;
        for (char *at = text, *end; err == PRT_OK && at; at = end, line++) {
            if ((end = strchr(at, '\n'))) *end++ = 0;
            err = curve_line(ctx, path, line, at, curve);
        }
    }
    prt_free(text);
    prt_free(file.bytes);
    return err;
}

static int parse_curve(const struct prt_context *ctx, const char *what, const char *folder,
                       const cJSON *object, struct prt_optics *o)
{
    static const char *const keys[] = {"name", "profile", "file",      "radius",
                                       "rd",   "eta",     "roughness", NULL};
    const cJSON *file = cJSON_GetObjectItemCaseSensitive(object, "file");
    int err = prt_material_json_keys(ctx, what, object, keys);
    if (err < 0) return err;
    if (file && (!cJSON_IsString(file) || cJSON_HasObjectItem(object, "radius") ||
                 cJSON_HasObjectItem(object, "rd")))
        return prt_fail(ctx, PRT_FORMAT, "%s: give \"file\", or \"radius\" and \"rd\"", what);
    struct curve *curve = prt_calloc(1, sizeof *curve);
    if (!curve) return PRT_NOMEM;
    err = file ? curve_file(ctx, what, folder, file->valuestring, curve)
               : curve_inline(ctx, what, object, curve);
    for (int c = 0; err == PRT_OK && c < 3; c++)
        err =
            prt_profile_init_curve(ctx, what, &o->channel[c], curve->n, curve->r, curve->rd[c]);
    prt_free(curve);
    return err;
}

const struct prt_profile_type prt_profile_type_curve = {.word = "curve",
                                                        .parse = parse_curve,
                                                        .rd = prt_profile_table_rd,
                                                        .tail = prt_profile_table_tail,
                                                        .is_points = true};
