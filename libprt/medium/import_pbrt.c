// SPDX-License-Identifier: MIT
// Media of pbrt scenes: MakeNamedMedium, and Material and MakeNamedMaterial "subsurface". All
// other directives are skipped.
#include "import.h"

#include <ctype.h>
#include <math.h>
#include <stdlib.h>
#include <strings.h>

enum { MOST_WORD = 64 };

enum token { END, WORD, TEXT, NUMBER, OPEN, CLOSE, BAD };

struct scan {
    const char *at;
    enum token token;
    char word[MOST_WORD]; // of WORD and TEXT, cut
    double number;
};

static void skip_blank(struct scan *s)
{
    for (;;) {
        s->at += strspn(s->at, " \t\r\n");
        if (*s->at != '#') return;
        s->at += strcspn(s->at, "\n");
    }
}

static void keep(struct scan *s, const char *from, size_t n)
{
    size_t kept = n < MOST_WORD - 1 ? n : MOST_WORD - 1;
    memcpy(s->word, from, kept);
    s->word[kept] = 0;
}

static void next(struct scan *s)
{
    skip_blank(s);
    const char *from = s->at;
    if (!*from) {
        s->token = END;
    } else if (*from == '[' || *from == ']') {
        s->token = *from == '[' ? OPEN : CLOSE;
        s->at++;
    } else if (*from == '"') {
        size_t n = strcspn(from + 1, "\"\n");
        s->token = from[1 + n] == '"' ? TEXT : BAD;
        keep(s, from + 1, n);
        s->at += n + (s->token == TEXT ? 2 : 1);
    } else if (isalpha((unsigned char)*from)) {
        size_t n = strcspn(from, " \t\r\n\"[]#");
        s->token = WORD;
        keep(s, from, n);
        s->at += n;
    } else {
        char *end;
        s->number = strtod(from, &end);
        bool good = end > from && isfinite(s->number) && fabs(s->number) <= 1e12;
        s->token = good ? NUMBER : BAD;
        s->at = end > from ? end : from + 1;
    }
}

// The parameters of one directive.
struct parameters {
    double sigma_a[3], sigma_s[3], reflectance[3], mfp[3], g, eta, scale, roughness;
    bool has_reflectance;
    char type[MOST_WORD], preset[MOST_WORD], unread[MOST_WORD];
};

static const struct number_row {
    const char *name;
    size_t field;
    int n;
} number_rows[] = {
    {"sigma_a", offsetof(struct parameters, sigma_a), 3},
    {"sigma_s", offsetof(struct parameters, sigma_s), 3},
    {"reflectance", offsetof(struct parameters, reflectance), 3},
    {"Kd", offsetof(struct parameters, reflectance), 3}, // of pbrt-v3's kdsubsurface
    {"mfp", offsetof(struct parameters, mfp), 3},
    {"g", offsetof(struct parameters, g), 1},
    {"eta", offsetof(struct parameters, eta), 1},
    {"scale", offsetof(struct parameters, scale), 1},
    {"roughness", offsetof(struct parameters, roughness), 1},
};

static void set_numbers(struct parameters *p, const char *name, const double *v, int n)
{
    for (size_t i = 0; i < sizeof number_rows / sizeof *number_rows; i++) {
        if (strcmp(name, number_rows[i].name)) continue;
        double *to = (double *)((char *)p + number_rows[i].field);
        if (n != 1 && n != number_rows[i].n) // a spectrum, or nothing that has a value
            snprintf(p->unread, sizeof p->unread, "%s", name);
        else
            for (int c = 0; c < number_rows[i].n; c++) to[c] = v[n == 1 ? 0 : c];
        p->has_reflectance |= number_rows[i].field == offsetof(struct parameters, reflectance);
        return;
    }
}

static void set_text(struct parameters *p, const char *name, const char *text)
{
    char *to = !strcmp(name, "type")                              ? p->type
               : !strcmp(name, "preset") || !strcmp(name, "name") ? p->preset
                                                                  : NULL;
    if (to) snprintf(to, MOST_WORD, "%s", text);
    else set_numbers(p, name, NULL, 0); // a named spectrum of a number
}

// One parameter: "type name" and its values, with or without brackets.
static bool parameter(struct scan *s, struct parameters *p)
{
    char name[MOST_WORD], text[MOST_WORD] = "";
    double v[4] = {0};
    int n = 0;
    const char *space = strrchr(s->word, ' ');
    snprintf(name, sizeof name, "%s", space ? space + 1 : s->word);
    next(s);
    bool list = s->token == OPEN;
    if (list) next(s);
    while (s->token == NUMBER || s->token == TEXT ||
           (list && s->token == WORD)) { // true, false
        if (s->token == NUMBER && n < 4) v[n++] = s->number;
        if (s->token == TEXT) snprintf(text, sizeof text, "%s", s->word);
        bool one = !list;
        next(s);
        if (one) break;
    }
    if (list && s->token != CLOSE) return false;
    if (list) next(s);
    if (text[0]) set_text(p, name, text);
    else set_numbers(p, name, v, n);
    return true;
}

static const struct prt_material *preset_named(const char *name)
{
    const struct prt_material *m;
    for (unsigned i = 0; (m = prt_material_preset(i)); i++)
        if (!strcasecmp(m->name, name)) return m;
    for (unsigned i = 0; (m = prt_material_named_medium(i)); i++)
        if (!strcasecmp(m->name, name)) return m;
    return NULL;
}

// Albedo and mean free path; a medium has no surface, and takes the defaults of one.
static void dense(const struct import_list *list, const struct parameters *p, double unit,
                  struct prt_import *item)
{
    struct import_shader s = {.subsurface = 1,
                              .subsurface_g = p->g,
                              .ior = p->eta,
                              .specular = 1,
                              .roughness = p->roughness};
    for (int c = 0; c < 3; c++) {
        s.subsurface_color[c] = p->reflectance[c];
        s.free_path[c] = p->mfp[c] * p->scale * unit;
    }
    prt_import_shader(list, &s, item);
}

static void make_medium(const struct import_list *list, const struct parameters *p,
                        struct prt_import *item)
{
    double unit = list->mm_per_unit > 0 ? list->mm_per_unit : 1, s[3], a[3], g = p->g;
    const struct prt_material *preset = p->preset[0] ? preset_named(p->preset) : NULL;
    if (p->preset[0] && !preset) {
        prt_import_none(item, "its preset \"%.60s\" is none of pbrt's", p->preset);
        return;
    }
    if (p->unread[0]) {
        prt_import_none(item, "its %.40s is a spectrum, which is not read: give rgb",
                        p->unread);
        return;
    }
    item->material.eta = (float)fmin(fmax(p->eta, 1), 3);
    item->material.roughness = (float)fmin(fmax(p->roughness, MEDIUM_LEAST_ROUGHNESS), 1);
    if (p->has_reflectance && !preset) {
        dense(list, p, unit, item);
        return;
    }
    for (int c = 0; c < 3; c++) { // a preset's sigma_s is the reduced one, for any g
        s[c] = preset ? (double)preset->sigma_s_prime[c] / (1 - fmin(g, 0.95)) : p->sigma_s[c];
        a[c] = preset ? (double)preset->sigma_a[c] : p->sigma_a[c];
        s[c] *= p->scale / unit;
        a[c] *= p->scale / unit;
    }
    if (!(fmax(s[0], fmax(s[1], s[2])) > 0))
        prt_import_none(item, "nothing in it scatters light");
    else prt_import_coefficients(list, item, s, a, g);
}

// The directive `word`, whose first text is the current token.
static int directive(struct import_list *list, struct scan *s, const char *word)
{
    bool medium = !strcmp(word, "MakeNamedMedium"), named = !strcmp(word, "MakeNamedMaterial");
    struct parameters p = {.sigma_a = {0.0011, 0.0024, 0.014}, // of pbrt-v4
                           .sigma_s = {2.55, 3.21, 3.77},
                           .mfp = {1, 1, 1},
                           .eta = 1.33,
                           .scale = 1,
                           .roughness = medium ? 0.3 : 0};
    char name[MOST_WORD];
    snprintf(name, sizeof name, "%s", s->word);
    if (!medium && !named) snprintf(p.type, sizeof p.type, "%s", s->word);
    next(s);
    while (s->token == TEXT)
        if (!parameter(s, &p))
            return prt_fail(list->ctx, PRT_FORMAT, "%s: %s \"%s\": a list has no ]", list->what,
                            word, name);
    if (!medium && strcmp(p.type, "subsurface") && strcmp(p.type, "kdsubsurface"))
        return PRT_OK; // an opaque material
    if (!strcmp(p.type, "kdsubsurface") && !p.has_reflectance) {
        p.has_reflectance = true;
        p.reflectance[0] = p.reflectance[1] = p.reflectance[2] = 0.5; // of pbrt-v3
    }
    struct prt_import *item = prt_import_add(list, name);
    if (!item) return PRT_LIMIT;
    snprintf(item->format, sizeof item->format, "pbrt %s", medium ? "medium" : "subsurface");
    if (medium && p.type[0] && strcmp(p.type, "homogeneous"))
        prt_import_none(item, "its type is %.40s: homogeneous media are read", p.type);
    else make_medium(list, &p, item);
    return PRT_OK;
}

int prt_import_pbrt(struct import_list *list, const char *text)
{
    struct scan s = {.at = text};
    int status = PRT_OK;
    next(&s);
    while (s.token != END && !status) {
        char word[MOST_WORD] = "";
        if (s.token == BAD)
            return prt_fail(list->ctx, PRT_FORMAT, "%s: not a pbrt scene: byte %zu", list->what,
                            (size_t)(s.at - text));
        if (s.token == WORD) snprintf(word, sizeof word, "%s", s.word);
        next(&s);
        bool ours = !strcmp(word, "MakeNamedMedium") || !strcmp(word, "Material") ||
                    !strcmp(word, "MakeNamedMaterial");
        if (ours && s.token == TEXT) status = directive(list, &s, word);
    }
    if (!status && !list->n)
        return prt_fail(list->ctx, PRT_FORMAT,
                        "%s: a pbrt scene without MakeNamedMedium and subsurface materials",
                        list->what);
    return status;
}
