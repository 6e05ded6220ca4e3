// SPDX-License-Identifier: MIT
// Materials of any profile: their JSON, CSV curves, and the dipole medium nearest to each.
#include "material.h"
#include "profile.h"

#include <math.h>
#include <stdlib.h>
#include <strings.h>
#include <unistd.h>

void prt_optics_finish(struct prt_optics *optics)
{
    for (int c = 0; c < 3; c++) prt_profile_finish(&optics->channel[c]);
}

static void from_material(const struct prt_material *m, struct prt_optics *out)
{
    *out = (struct prt_optics){.kind = PRT_PROFILE_DIPOLE, .material = *m};
    for (int c = 0; c < 3; c++)
        prt_profile_init_dipole(&out->channel[c], m->sigma_s_prime[c], m->sigma_a[c], m->eta);
}

/* ---- the nearest dipole ---- */

/* rho_d depends on sigma_a/sigma_s' alone, and falls with it; lengths then scale. */
static void nearest_dipole(const struct prt_profile *p, double eta, float *sigma_s_prime,
                           float *sigma_a)
{
    struct prt_profile unit;
    double lo = log(1e-8), hi = log(1e4), ratio;
    for (int i = 0; i < 60; i++) {
        double mid = (lo + hi) / 2;
        prt_profile_init_dipole(&unit, 1, exp(mid), eta);
        if (unit.total > p->total) lo = mid;
        else hi = mid;
    }
    ratio = exp(lo);
    prt_profile_init_dipole(&unit, 1, ratio, eta);
    double s = prt_profile_radius(&unit, 0.5) / prt_profile_radius(p, 0.5);
    s = fmin(fmax(s, 10 * MATERIAL_MIN_SIGMA_S), 0.5 * MATERIAL_MAX_SIGMA);
    *sigma_s_prime = (float)s;
    *sigma_a = (float)fmin(s * ratio, MATERIAL_MAX_SIGMA);
}

/* ---- JSON ---- */

static int read_burley(const struct prt_context *ctx, const char *what, const cJSON *object,
                       struct prt_optics *o)
{
    static const char *const keys[] = {"name", "profile",   "albedo", "mean_free_path",
                                       "eta",  "roughness", NULL};
    double albedo[3], path[3];
    int err;
    if ((err = material_json_keys(ctx, what, object, keys)) < 0 ||
        (err = material_json_rgb(ctx, what, object, "albedo", true, true, albedo)) < 0 ||
        (err = material_json_rgb(ctx, what, object, "mean_free_path", true, true, path)) < 0)
        return err;
    for (int c = 0; c < 3; c++)
        if ((err = prt_profile_init_burley(ctx, &o->channel[c], albedo[c], path[c])) < 0)
            return err;
    return PRT_OK;
}

static int read_layer(const struct prt_context *ctx, const char *what, const cJSON *item,
                      bool last, struct prt_layer out[3])
{
    static const char *const keys[] = {"thickness", "sigma_s_prime", "sigma_a", NULL};
    double s[3], a[3], thickness = NAN;
    int err;
    if (!cJSON_IsObject(item))
        return prt_fail(ctx, PRT_FORMAT, "%s: a layer is an object {…}", what);
    if ((err = material_json_keys(ctx, what, item, keys)) < 0 ||
        (err = material_json_rgb(ctx, what, item, "sigma_s_prime", true, true, s)) < 0 ||
        (err = material_json_rgb(ctx, what, item, "sigma_a", true, true, a)) < 0 ||
        (err = material_json_number(ctx, what, item, "thickness", &thickness)) < 0)
        return err;
    if (!cJSON_HasObjectItem(item, "thickness")) {
        if (!last)
            return prt_fail(
                ctx, PRT_FORMAT,
                "%s: \"thickness\" [mm] is missing; only the last layer has no bottom", what);
        thickness = INFINITY;
    } else if (!isfinite(thickness)) {
        return prt_fail(ctx, PRT_ARG, "%s: thickness is %g mm", what, thickness);
    }
    for (int c = 0; c < 3; c++) out[c] = (struct prt_layer){thickness, s[c], a[c]};
    return PRT_OK;
}

static int read_multipole(const struct prt_context *ctx, const char *what, const cJSON *object,
                          struct prt_optics *o)
{
    static const char *const keys[] = {"name", "profile", "layers", "eta", "roughness", NULL};
    struct prt_layer layer[PRT_PROFILE_MAX_LAYER][3], one[PRT_PROFILE_MAX_LAYER];
    const cJSON *list = cJSON_GetObjectItemCaseSensitive(object, "layers");
    int err = material_json_keys(ctx, what, object, keys), n = cJSON_GetArraySize(list);
    if (err < 0) return err;
    if (!cJSON_IsArray(list) || n < 1 || n > PRT_PROFILE_MAX_LAYER)
        return prt_fail(ctx, PRT_FORMAT, "%s: \"layers\" must be 1 to %d layers, top first",
                        what, PRT_PROFILE_MAX_LAYER);
    int i = 0;
    for (const cJSON *item = list->child; item; item = item->next, i++)
        if ((err = read_layer(ctx, what, item, i + 1 == n, layer[i])) < 0) return err;
    for (int c = 0; c < 3; c++) {
        for (i = 0; i < n; i++) one[i] = layer[i][c];
        if ((err = prt_profile_init_multipole(ctx, &o->channel[c], (unsigned)n, one,
                                              o->material.eta)) < 0)
            return err;
    }
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

/* One line: r and one value, or r and three. Empty lines, # comments and one header pass. */
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

static int read_curve(const struct prt_context *ctx, const char *what, const char *folder,
                      const cJSON *object, struct prt_optics *o)
{
    static const char *const keys[] = {"name", "profile", "file",      "radius",
                                       "rd",   "eta",     "roughness", NULL};
    const cJSON *file = cJSON_GetObjectItemCaseSensitive(object, "file");
    int err = material_json_keys(ctx, what, object, keys);
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

static int read_object(const struct prt_context *ctx, const char *what, const char *folder,
                       const cJSON *object, struct prt_optics *o)
{
    const cJSON *kind = cJSON_GetObjectItemCaseSensitive(object, "profile");
    struct material_values v = {.sigma_s_prime = {1, 1, 1}, .eta = 1.3, .roughness = 0.3};
    int err;
    if ((err = material_json_number(ctx, what, object, "eta", &v.eta)) < 0 ||
        (err = material_json_number(ctx, what, object, "roughness", &v.roughness)) < 0 ||
        (err = material_check_values(ctx, what, &v)) < 0)
        return err;
    o->material = (struct prt_material){
        .name = "custom", .eta = (float)v.eta, .roughness = (float)v.roughness};
    if ((err = material_json_name(ctx, what, object, o->material.name)) < 0) return err;
    const char *word = cJSON_IsString(kind) ? kind->valuestring : "";
    if (!strcmp(word, "burley")) {
        o->kind = PRT_PROFILE_BURLEY;
        err = read_burley(ctx, what, object, o);
    } else if (!strcmp(word, "multipole")) {
        o->kind = PRT_PROFILE_MULTIPOLE;
        err = read_multipole(ctx, what, object, o);
    } else if (!strcmp(word, "curve")) {
        o->kind = PRT_PROFILE_CURVE;
        err = read_curve(ctx, what, folder, object, o);
    } else {
        return prt_fail(ctx, PRT_FORMAT,
                        "%s: unknown profile \"%.40s\"; allowed: burley, multipole, curve",
                        what, word);
    }
    for (int c = 0; err == PRT_OK && c < 3; c++)
        nearest_dipole(&o->channel[c], o->material.eta, &o->material.sigma_s_prime[c],
                       &o->material.sigma_a[c]);
    return err < 0 ? err : material_from_optics(ctx, what, o);
}

int prt_optics_parse(const struct prt_context *ctx, const char *what, const char *folder,
                     const char *json, size_t n, struct prt_optics *out)
{
    struct prt_optics o = {0};
    struct prt_material material;
    cJSON *object;
    int err = material_json_object(ctx, what, json, n, &object);
    if (err < 0) return err;
    if (cJSON_GetObjectItemCaseSensitive(object, "profile")) {
        err = read_object(ctx, what, folder, object, &o);
    } else if ((err = prt_material_parse(ctx, what, json, n, &material)) == PRT_OK) {
        from_material(&material, &o);
    }
    cJSON_Delete(object);
    if (err < 0) prt_optics_finish(&o);
    else *out = o;
    return err;
}

static bool is_preset(const char *name)
{
    for (unsigned i = 0; prt_material_preset(i); i++)
        if (!strcasecmp(name, prt_material_preset(i)->name)) return true;
    return false;
}

int prt_optics_load(const struct prt_context *ctx, const char *name_or_file,
                    struct prt_optics *out)
{
    struct prt_material material;
    int err;
    if (name_or_file[strspn(name_or_file, " \t\r\n")] == '{')
        return prt_optics_parse(ctx, "material", "", name_or_file, strlen(name_or_file), out);
    if (is_preset(name_or_file) || access(name_or_file, F_OK)) {
        if ((err = prt_material_load(ctx, name_or_file, &material)) < 0) return err;
        from_material(&material, out);
        return PRT_OK;
    }
    struct prt_blob file;
    if ((err = prt_read_file(ctx, name_or_file, MATERIAL_MAX_BYTES, &file)) < 0) return err;
    char folder[4096] = ".";
    const char *slash = strrchr(name_or_file, '/');
    size_t n_folder = slash ? (size_t)(slash - name_or_file) : 0;
    if (n_folder && n_folder < sizeof folder) {
        memcpy(folder, name_or_file, n_folder);
        folder[n_folder] = 0;
    }
    if (slash == name_or_file) strcpy(folder, "/");
    err = prt_optics_parse(ctx, name_or_file, folder, file.bytes, file.size, out);
    prt_free(file.bytes);
    return err;
}
