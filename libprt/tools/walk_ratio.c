// SPDX-License-Identifier: MIT
// The ratio of walks to the dipole under even light (METHODS §6): made, and said.
#include "walk_ratio.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

bool ratio_wanted(const struct options *o)
{
    return o->scattering ? !strcmp(o->scattering, "walk") : !(o->budget_ms > 0);
}

int ratio_create(const struct tool *tool, const struct prt_mesh *mesh,
                 const struct prt_media *media, struct prt_walk_ratio **out,
                 struct prt_walk_ratio_report *report)
{
    const struct options *o = &tool->opt;
    struct prt_scene *scene;
    int status = prt_scene_create(&tool->ctx, mesh, &scene);
    if (status) return status;
    status = prt_walk_ratio_create(&tool->ctx, scene, media, (uint32_t)o->walks, o->seed, out,
                                   report);
    prt_scene_destroy(scene);
    return status;
}

void ratio_note(const struct tool *tool, const struct prt_walk_ratio_report *r)
{
    prt_log(&tool->ctx, PRT_LOG_NOTE,
            "multiple scattering is scaled to that of walks under even light: by %.3g to %.3g, "
            "standard error %.2g %%, %.0f walks a group, in %.1f s (--scattering dipole: not)",
            r->least, r->most, 100 * r->standard_error, r->group_walks, r->seconds);
}

void ratio_json(cJSON *to, const struct prt_walk_ratio_report *r)
{
    cJSON *o = cJSON_AddObjectToObject(to, "walk_ratio");
    cJSON_AddNumberToObject(o, "points", r->n_point);
    cJSON_AddNumberToObject(o, "walks", (double)r->walks);
    cJSON_AddNumberToObject(o, "group_walks", r->group_walks);
    cJSON_AddNumberToObject(o, "standard_error", r->standard_error);
    cJSON_AddNumberToObject(o, "least", r->least);
    cJSON_AddNumberToObject(o, "most", r->most);
    cJSON_AddNumberToObject(o, "leaked", r->leaked);
    cJSON_AddNumberToObject(o, "objects_unscaled", r->n_kept);
    cJSON_AddNumberToObject(o, "seconds", r->seconds);
}

// A position in the model's own units.
static void in_units(const struct prt_mesh *mesh, const float mm[3], double out[3])
{
    for (int k = 0; k < 3; k++) {
        const double x = (double)mm[k] / (double)mesh->mm_per_unit;
        char text[24]; // four digits, as people read them
        snprintf(text, sizeof text, "%.4g", x);
        sscanf(text, "%lf", &out[k]);
    }
}

// "up to 40 % too bright, most at 1,2,3", or nothing where it errs to the other side.
static void say_side(char *text, size_t size, double excess, const double at[3], bool bright)
{
    const size_t n = strlen(text);
    if (bright ? excess < 0.005 : excess > -0.005) return;
    snprintf(text + n, size - n, "; up to %.2g %% too %s, most at %g,%g,%g", 100 * fabs(excess),
             bright ? "bright" : "dark", at[0], at[1], at[2]);
}

int ratio_error_json(cJSON *to, const struct prt_walk_ratio *ratio,
                     const struct prt_walk_ratio_report *report, const struct prt_mesh *mesh,
                     const struct prt_media *media)
{
    cJSON *list = cJSON_AddArrayToObject(to, "dipole_error");
    for (uint32_t i = 0; i < media->n; i++) {
        struct prt_dipole_error e;
        double bright[3], dark[3];
        char words[400];
        int status = prt_walk_ratio_dipole_error(ratio, media, i, &e);
        if (status) return status;
        if (!e.n_point) continue;
        in_units(mesh, e.bright_mm, bright);
        in_units(mesh, e.dark_mm, dark);
        snprintf(
            words, sizeof words,
            "the dipole is %.2g %% RMS off walks under even light; more than 10 %% on %.0f "
            "%% of the surface",
            100 * e.rms, 100 * e.above_tenth);
        say_side(words, sizeof words, e.brightest, bright, true);
        say_side(words, sizeof words, e.darkest, dark, false);
        cJSON *o = cJSON_CreateObject();
        cJSON_AddStringToObject(o, "medium", media->medium[i].name);
        cJSON_AddStringToObject(o, "words", words);
        cJSON_AddNumberToObject(o, "rms", e.rms);
        cJSON_AddNumberToObject(o, "above_tenth", e.above_tenth);
        cJSON_AddNumberToObject(o, "brightest", e.brightest);
        cJSON_AddItemToObject(o, "brightest_at", cJSON_CreateDoubleArray(bright, 3));
        cJSON_AddNumberToObject(o, "darkest", e.darkest);
        cJSON_AddItemToObject(o, "darkest_at", cJSON_CreateDoubleArray(dark, 3));
        cJSON_AddNumberToObject(o, "standard_error", report->standard_error);
        cJSON_AddItemToArray(list, o);
    }
    return PRT_OK;
}
