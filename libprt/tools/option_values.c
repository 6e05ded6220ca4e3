// SPDX-License-Identifier: MIT
// Values of options: text to numbers, words and sizes, checked against the option's range.
#include "options.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// A finite decimal number; hexadecimal, nan and inf are refused.
static bool parse_real(const char *text, double *out)
{
    if (!*text || text[strspn(text, "0123456789+-.eE")]) return false;
    char *end;
    *out = strtod(text, &end);
    return !*end && isfinite(*out);
}

static bool parse_whole(const char *text, uint64_t *out)
{
    if (!*text || text[strspn(text, "0123456789")]) return false;
    errno = 0;
    *out = strtoull(text, NULL, 10);
    return !errno;
}

bool parse_vector(const char *text, float v[3])
{
    char part[64];
    for (int i = 0; i < 3; i++) {
        size_t n = strcspn(text, ",");
        double x;
        if (n >= sizeof part || (i < 2 && text[n] != ',') || (i == 2 && text[n])) return false;
        memcpy(part, text, n);
        part[n] = 0;
        if (!parse_real(part, &x) || fabs(x) > 1e30) return false;
        v[i] = (float)x;
        text += n + 1;
    }
    return true;
}

// "I/N" or "WxH": two whole numbers separated by a mark.
static bool parse_pair(const char *text, char mark, uint64_t *a, uint64_t *b)
{
    char part[32];
    const char *at = strchr(text, mark);
    if (!at || (size_t)(at - text) >= sizeof part) return false;
    memcpy(part, text, (size_t)(at - text));
    part[at - text] = 0;
    return parse_whole(part, a) && parse_whole(at + 1, b);
}

static int set_word(struct options *o, const struct option_row *row, const char *value)
{
    char list[128] = "";
    for (const char *const *word = row->words; *word; word++) {
        if (!strcmp(*word, value)) {
            *(const char **)((char *)o + row->field) = *word;
            return -1;
        }
        size_t n = strlen(list);
        snprintf(list + n, sizeof list - n, "%s%s", n ? ", " : "", *word);
    }
    return usage_error(o, "--%s %s: expected one of %s", row->name, value, list);
}

static int set_number(struct options *o, const struct option_row *row, const char *value)
{
    if (row->kind == OPTION_WHOLE) {
        uint64_t x;
        if (!parse_whole(value, &x) || (double)x < row->low || (double)x > row->high)
            return usage_error(o, "--%s %s: expected a whole number in [%.10g, %.10g]",
                               row->name, value, row->low, row->high);
        *(uint64_t *)((char *)o + row->field) = x;
        return -1;
    }
    double x;
    bool open = row->kind == OPTION_REAL;
    if (!parse_real(value, &x) || x < row->low || (open && x == row->low) || x > row->high)
        return usage_error(o, "--%s %s: expected a number in %c%.10g, %.10g]", row->name, value,
                           open ? '(' : '[', row->low, row->high);
    *(double *)((char *)o + row->field) = x;
    return -1;
}

static int set_cube(struct options *o, const struct option_row *row, const char *value)
{
    uint64_t n = 0;
    bool bake = o->command == CMD_BAKE;
    if (!bake && !strcmp(value, "full")) {
        o->cube_full = true;
        o->cube = 0;
        return -1;
    }
    if (!parse_whole(value, &n) || (double)n < row->low || (double)n > row->high ||
        (bake && (n & (n - 1))))
        return usage_error(o, "--cube %s: expected %s", value,
                           bake ? "16, 32, 64 or 128" : "a whole number in [4, 2048], or full");
    o->cube = (uint32_t)n;
    o->cube_full = false;
    return -1;
}

static int set_size(struct options *o, const struct option_row *row, const char *value)
{
    uint64_t w = 0, h = 0;
    bool ok = row->kind == OPTION_SIDE && parse_whole(value, &w);
    if (!ok) ok = parse_pair(value, 'x', &w, &h) && h >= 1;
    if (!ok || w < 1 || (double)w > row->high || (double)h > row->high)
        return usage_error(o, "--%s %s: expected %s with sides in [1, %g]", row->name, value,
                           row->label, row->high);
    o->width = (uint32_t)w;
    o->height = (uint32_t)h;
    return -1;
}

int option_set(struct options *o, const struct option_row *row, const char *value)
{
    uint64_t a, b;
    void *field = (char *)o + row->field;
    switch (row->kind) {
    case OPTION_FLAG:
        *(bool *)field = true;
        return -1;
    case OPTION_TEXT:
        if (!*value) return usage_error(o, "--%s: expected %s", row->name, row->label);
        *(const char **)field = value;
        return -1;
    case OPTION_OPAQUE:
        if (o->n_opaque == MAX_OPAQUE)
            return usage_error(o, "--%s: at most %d names", row->name, MAX_OPAQUE);
        o->opaque[o->n_opaque++] = value;
        return -1;
    case OPTION_MATERIAL:
        if (!*value) return usage_error(o, "--%s: expected %s", row->name, row->label);
        if (o->n_material == PRT_MEDIA_MAX)
            return usage_error(o, "--%s: at most %d", row->name, PRT_MEDIA_MAX);
        o->material[o->n_material++] = value;
        return -1;
    case OPTION_ENVS:
        if (!*value) return usage_error(o, "--%s: expected %s", row->name, row->label);
        if (o->n_env == MAX_ENV)
            return usage_error(o, "--%s: at most %d lights", row->name, MAX_ENV);
        o->envs[o->n_env++] = value;
        o->env = o->envs[0];
        return -1;
    case OPTION_WORD:
        return set_word(o, row, value);
    case OPTION_REAL:
    case OPTION_SIGNED:
    case OPTION_WHOLE:
        if (field == &o->max_rmse) o->max_rmse_set = true;
        if (field == &o->memory) o->memory_set = true;
        return set_number(o, row, value);
    case OPTION_VECTOR:
        if (!parse_vector(value, ((struct vector_option *)field)->v))
            return usage_error(o, "--%s %s: expected three numbers x,y,z", row->name, value);
        ((struct vector_option *)field)->set = true;
        return -1;
    case OPTION_SIZE:
    case OPTION_SIDE:
        return set_size(o, row, value);
    case OPTION_CUBE:
        return set_cube(o, row, value);
    case OPTION_SHARD:
        if (!parse_pair(value, '/', &a, &b) || b < 1 || b > 100000 || a >= b)
            return usage_error(o,
                               "--shard %s: expected I/N with N in [1, 100000] and I in "
                               "[0, N-1]",
                               value);
        o->shard = (uint32_t)a;
        o->n_shard = (uint32_t)b;
        return -1;
    case OPTION_FD:
        if (!parse_whole(value, &a) || a > 1 << 20)
            return usage_error(o, "--%s %s: expected a file descriptor", row->name, value);
        *(int *)field = (int)a;
        return -1;
    }
    return -1;
}
