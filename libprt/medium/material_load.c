// SPDX-License-Identifier: MIT
// Materials of any profile: loading, and the dipole medium nearest to each profile.
#include "material.h"
#include "profile.h"

#include <math.h>
#include <stdio.h>
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

/* The dipole medium of p's total and half-energy radius. rho_d depends on sigma_a/sigma_s'
 * alone and falls with it: bisection finds the ratio; the radius then gives the scale. */
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

static void allowed_words(char *buf, size_t n)
{
    size_t used = 0;
    for (uint32_t kind = 0; kind < PRT_PROFILE_N_KIND && used < n; kind++)
        if (prt_profile_type(kind)->parse)
            used += (size_t)snprintf(buf + used, n - used, "%s%s", used ? ", " : "",
                                     prt_profile_type(kind)->word);
}

static int find_kind(const struct prt_context *ctx, const char *what, const cJSON *object,
                     enum prt_profile_kind *out)
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(object, "profile");
    const char *word = cJSON_IsString(item) ? item->valuestring : "";
    char allowed[128];
    for (uint32_t kind = 0; kind < PRT_PROFILE_N_KIND; kind++)
        if (prt_profile_type(kind)->parse && !strcmp(word, prt_profile_type(kind)->word)) {
            *out = (enum prt_profile_kind)kind;
            return PRT_OK;
        }
    allowed_words(allowed, sizeof allowed);
    return prt_fail(ctx, PRT_FORMAT, "%s: unknown profile \"%.40s\"; allowed: %s", what, word,
                    allowed);
}

static int read_object(const struct prt_context *ctx, const char *what, const char *folder,
                       const cJSON *object, struct prt_optics *o)
{
    struct material_values v = {.sigma_s_prime = {1, 1, 1}, .eta = 1.3, .roughness = 0.3};
    int err;
    if ((err = prt_material_json_number(ctx, what, object, "eta", &v.eta)) < 0 ||
        (err = prt_material_json_number(ctx, what, object, "roughness", &v.roughness)) < 0 ||
        (err = prt_material_check_values(ctx, what, &v)) < 0)
        return err;
    o->material = (struct prt_material){
        .name = "custom", .eta = (float)v.eta, .roughness = (float)v.roughness};
    if ((err = prt_material_json_name(ctx, what, object, o->material.name)) < 0) return err;
    if ((err = find_kind(ctx, what, object, &o->kind)) < 0) return err;
    err = prt_profile_type(o->kind)->parse(ctx, what, folder, object, o);
    for (int c = 0; err == PRT_OK && c < 3; c++)
        nearest_dipole(&o->channel[c], o->material.eta, &o->material.sigma_s_prime[c],
                       &o->material.sigma_a[c]);
    return err < 0 ? err : prt_material_from_optics(ctx, what, o);
}

int prt_optics_parse(const struct prt_context *ctx, const char *what, const char *folder,
                     const char *json, size_t n, struct prt_optics *out)
{
    struct prt_optics o = {0};
    struct prt_material material;
    cJSON *object;
    int err = prt_material_json_object(ctx, what, json, n, &object);
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
    bool foreign = prt_material_is_foreign(name_or_file);
    if (!foreign && (is_preset(name_or_file) || access(name_or_file, F_OK))) {
        if ((err = prt_material_load(ctx, name_or_file, &material)) < 0) return err;
        from_material(&material, out);
        return PRT_OK;
    }
    if (foreign) {
        if ((err = prt_material_load_foreign(ctx, name_or_file, &material)) < 0) return err;
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
