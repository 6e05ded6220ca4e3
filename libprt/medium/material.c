// SPDX-License-Identifier: MIT
// Materials: the measured presets, the ranges of all parameters, loading by name or file.
#include "material.h"
#include "profile.h"

#include <math.h>
#include <stdio.h>
#include <strings.h>
#include <unistd.h>

/* JMLH01 fig. 5. It has no g, so g is 0; the roughness 0.3 is chosen, not measured. */
#define MEDIUM(NAME, sr, sg, sb, ar, ag, ab, ETA)                                         \
    {                                                                                     \
        .name = NAME, .sigma_s_prime = {sr, sg, sb}, .sigma_a = {ar, ag, ab}, .eta = ETA, \
        .roughness = 0.3f                                                                 \
    }
static const struct prt_material presets[] = {
    MEDIUM("apple", 2.29f, 2.39f, 1.97f, 0.003f, 0.0034f, 0.046f, 1.3f),
    MEDIUM("chicken1", 0.15f, 0.21f, 0.38f, 0.015f, 0.077f, 0.19f, 1.3f),
    MEDIUM("chicken2", 0.19f, 0.25f, 0.32f, 0.018f, 0.088f, 0.2f, 1.3f),
    MEDIUM("cream", 7.38f, 5.47f, 3.15f, 0.0002f, 0.0028f, 0.0163f, 1.3f),
    MEDIUM("ketchup", 0.18f, 0.07f, 0.03f, 0.061f, 0.97f, 1.45f, 1.3f),
    MEDIUM("marble", 2.19f, 2.62f, 3.0f, 0.0021f, 0.0041f, 0.0071f, 1.5f),
    MEDIUM("potato", 0.68f, 0.7f, 0.55f, 0.0024f, 0.009f, 0.12f, 1.3f),
    MEDIUM("skimmilk", 0.7f, 1.22f, 1.9f, 0.0014f, 0.0025f, 0.0142f, 1.3f),
    MEDIUM("skin1", 0.74f, 0.88f, 1.01f, 0.032f, 0.17f, 0.48f, 1.3f),
    MEDIUM("skin2", 1.09f, 1.59f, 1.79f, 0.013f, 0.07f, 0.145f, 1.3f),
    MEDIUM("spectralon", 11.6f, 20.4f, 14.9f, 0, 0, 0, 1.3f),
    MEDIUM("wholemilk", 2.55f, 3.21f, 3.77f, 0.0011f, 0.0024f, 0.014f, 1.3f),
};
enum { N_PRESET = sizeof presets / sizeof presets[0], MOST_NAMED = N_PRESET + 64 };

const struct prt_material *prt_material_preset(unsigned index)
{
    return index < N_PRESET ? &presets[index] : NULL;
}

const struct prt_material *prt_material_preset_named(const char *name, char *remedy, size_t n)
{
    const char *list[MOST_NAMED];
    unsigned count = 0;
    for (; count < N_PRESET; count++) list[count] = presets[count].name;
    const struct prt_material *m;
    int found = prt_name_choose(name, list, N_PRESET, remedy, n);
    if (found >= 0 || strstr(remedy, "several")) return found < 0 ? NULL : &presets[found];
    for (; (m = prt_material_named_medium(count - N_PRESET)) && count < MOST_NAMED; count++)
        list[count] = m->name;
    found = prt_name_choose(name, list, count, remedy, n);
    return found < 0 ? NULL : prt_material_named_medium((unsigned)found - N_PRESET);
}

int prt_material_range(const struct prt_context *ctx, const char *what,
                       const struct material_range *range, int channel, double value)
{
    if (value >= range->lo && value <= range->hi) return PRT_OK; /* NaN falls through */
    char index[16] = "";
    if (channel >= 0) snprintf(index, sizeof index, "[%d]", channel);
    return prt_fail(ctx, PRT_ARG, "%s: %s%s is %g, allowed range %g to %g%s%s", what,
                    range->parameter, index, value, range->lo, range->hi,
                    range->unit[0] ? " " : "", range->unit);
}

int prt_material_check_values(const struct prt_context *ctx, const char *what,
                              const struct material_values *v)
{
    int err;
    for (int c = 0; c < 3; c++) {
        if ((err = prt_material_range(ctx, what,
                                      &(struct material_range){"sigma_s_prime",
                                                               MATERIAL_MIN_SIGMA_S,
                                                               MATERIAL_MAX_SIGMA, "mm^-1"},
                                      c, v->sigma_s_prime[c])) < 0 ||
            (err = prt_material_range(
                 ctx, what, &(struct material_range){"sigma_a", 0, MATERIAL_MAX_SIGMA, "mm^-1"},
                 c, v->sigma_a[c])) < 0 ||
            (err = prt_material_range(ctx, what,
                                      &(struct material_range){"g", -MATERIAL_MAX_G,
                                                               MATERIAL_MAX_G,
                                                               "(mean cosine, no unit)"},
                                      c, v->g[c])) < 0)
            return err;
        /* Single scattering is sampled in steps of the unreduced mean free path. */
        double sigma_t = v->sigma_a[c] + v->sigma_s_prime[c] / (1 - v->g[c]);
        if ((err = prt_material_range(
                 ctx, what,
                 &(struct material_range){"extinction sigma_a + sigma_s_prime/(1-g) of channel",
                                          0, MATERIAL_MAX_SIGMA_T, "mm^-1"},
                 c, sigma_t)) < 0)
            return err;
    }
    if ((err = prt_material_range(
             ctx, what,
             &(struct material_range){"eta", 1, 3, "(relative refractive index, no unit)"}, -1,
             v->eta)) < 0)
        return err;
    return prt_material_range(
        ctx, what,
        &(struct material_range){"roughness", MATERIAL_MIN_ROUGHNESS, 1, "(no unit)"}, -1,
        v->roughness);
}

int prt_material_check(const struct prt_context *ctx, const struct prt_material *material)
{
    struct material_values v = {.eta = material->eta, .roughness = material->roughness};
    if (!memchr(material->name, 0, sizeof material->name))
        return prt_fail(ctx, PRT_ARG, "material: name is longer than %zu bytes",
                        sizeof material->name - 1);
    for (int c = 0; c < 3; c++) {
        v.sigma_s_prime[c] = material->sigma_s_prime[c];
        v.sigma_a[c] = material->sigma_a[c];
        v.g[c] = material->g[c];
    }
    int err =
        prt_material_check_values(ctx, material->name[0] ? material->name : "material", &v);
    return err < 0 ? err : prt_material_check_profile(ctx, material);
}

static void preset_names(char *buf, size_t n)
{
    size_t used = 0;
    for (unsigned i = 0; i < N_PRESET && used < n; i++)
        used += (size_t)snprintf(buf + used, n - used, "%s%s", i ? ", " : "", presets[i].name);
}

int prt_material_load(const struct prt_context *ctx, const char *name_or_file,
                      struct prt_material *out)
{
    bool text = name_or_file[strspn(name_or_file, " \t\r\n")] == '{';
    bool file = text || !access(name_or_file, F_OK) || prt_material_is_foreign(name_or_file);
    char remedy[160];
    const struct prt_material *preset =
        prt_material_preset_named(name_or_file, remedy, sizeof remedy);
    if (preset && (!file || !strcasecmp(name_or_file, preset->name))) {
        *out = *preset;
        return PRT_OK;
    }
    if (!file) {
        char names[160];
        preset_names(names, sizeof names);
        return prt_fail(ctx, PRT_ARG, "%s: neither a material file nor a preset (%s)%s%s",
                        name_or_file, names, remedy[0] ? "; " : "", remedy);
    }
    struct prt_optics optics; /* the exact profiles are not needed here */
    int err = prt_optics_load(ctx, name_or_file, &optics);
    if (err < 0) return err;
    *out = optics.material;
    prt_optics_finish(&optics);
    return PRT_OK;
}
