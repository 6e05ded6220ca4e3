// SPDX-License-Identifier: MIT
// Materials as JSON text: complete, or a profile by its kind, points and totals.
#include "material.h"
#include "profile.h"

#include <stdio.h>
#include <stdlib.h>

/* The number whose decimal text is the shortest that reads back as the same float: cJSON prints
 * a double with up to 17 digits, so 0.74f as it is would print as 0.74000000953674316. */
static double shortest(float x)
{
    char digits[32];
    for (int n = 1; n <= 9; n++) {
        snprintf(digits, sizeof digits, "%.*g", n, (double)x);
        if (strtof(digits, NULL) == x) break;
    }
    return strtod(digits, NULL);
}

static bool add_number(cJSON *object, const char *key, float x)
{
    return cJSON_AddNumberToObject(object, key, shortest(x));
}

static bool append(cJSON *list, cJSON *item)
{
    if (item && cJSON_AddItemToArray(list, item)) return true;
    cJSON_Delete(item);
    return false;
}

static bool fill(cJSON *list, unsigned n, const float *x)
{
    for (unsigned i = 0; list && i < n; i++)
        if (!append(list, cJSON_CreateNumber(shortest(x[i])))) return false;
    return list;
}

static bool add_numbers(cJSON *object, const char *key, unsigned n, const float *x)
{
    return fill(cJSON_AddArrayToObject(object, key), n, x);
}

static bool add_curve(cJSON *object, const struct prt_material *m)
{
    if (!cJSON_AddStringToObject(object, "profile", "curve") ||
        !add_numbers(object, "radius", m->n_point, m->radius))
        return false;
    cJSON *rd = cJSON_AddArrayToObject(object, "rd");
    for (int c = 0; rd && c < 3; c++) {
        cJSON *list = cJSON_CreateArray();
        if (!append(rd, list) || !fill(list, m->n_point, m->reflectance[c])) return false;
    }
    return rd;
}

static bool add_medium(cJSON *object, const struct prt_material *m)
{
    return add_numbers(object, "sigma_s_prime", 3, m->sigma_s_prime) &&
           add_numbers(object, "sigma_a", 3, m->sigma_a);
}

static bool add_surface(cJSON *object, const struct prt_material *m)
{
    return add_number(object, "eta", m->eta) && add_number(object, "roughness", m->roughness);
}

/* Prints `object` where it is complete, and deletes it. */
static int finish(cJSON *object, bool complete, char *buf, size_t n)
{
    char *text = complete ? cJSON_PrintUnformatted(object) : NULL;
    size_t length = text ? strlen(text) : 0;
    int err = !text ? PRT_NOMEM : length >= n ? PRT_LIMIT : PRT_OK;
    if (err == PRT_OK) memcpy(buf, text, length + 1);
    else snprintf(buf, n, "null");
    cJSON_free(text);
    cJSON_Delete(object);
    return err == PRT_OK ? (int)length : err;
}

int prt_material_print(const struct prt_material *material, char *buf, size_t n)
{
    cJSON *object = cJSON_CreateObject();
    bool ok = cJSON_AddStringToObject(object, "name", material->name);
    if (material->profile) ok = ok && add_curve(object, material);
    else ok = ok && add_medium(object, material) && add_numbers(object, "g", 3, material->g);
    return finish(object, ok && add_surface(object, material), buf, n);
}

static float four_digits(float x)
{
    char digits[32];
    snprintf(digits, sizeof digits, "%.4g", (double)x);
    return strtof(digits, NULL);
}

static bool add_summary(cJSON *object, const struct prt_material *m)
{
    struct prt_diffusion d[3];
    const struct prt_profile_type *type = prt_profile_type(m->profile);
    prt_material_dipoles(m, d);
    const float total[3] = {(float)d[0].rho_d, (float)d[1].rho_d, (float)d[2].rho_d};
    const float range[2] = {four_digits(m->radius[0]), four_digits(m->radius[m->n_point - 1])};
    cJSON *nearest = NULL;
    return cJSON_AddStringToObject(object, "profile", type ? type->word : "unknown") &&
           cJSON_AddNumberToObject(object, "points", m->n_point) &&
           add_numbers(object, "radius_mm", 2, range) &&
           add_numbers(object, "reflectance", 3, total) &&
           (nearest = cJSON_AddObjectToObject(object, "nearest_dipole")) &&
           add_medium(nearest, m);
}

int prt_material_summary(const struct prt_material *material, char *buf, size_t n)
{
    if (!material->profile) return prt_material_print(material, buf, n);
    cJSON *object = cJSON_CreateObject();
    bool ok = cJSON_AddStringToObject(object, "name", material->name) &&
              add_summary(object, material);
    return finish(object, ok && add_surface(object, material), buf, n);
}
