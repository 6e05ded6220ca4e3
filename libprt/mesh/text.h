// SPDX-License-Identifier: MIT
// Reading numbers from text, independent of the locale.
#ifndef PRT_MESH_TEXT_H
#define PRT_MESH_TEXT_H

#include <locale.h>
#include <stdbool.h>
#include <stdlib.h>

static inline const char *text_blank(const char *p)
{
    while (*p == ' ' || *p == '\t' || *p == '\r' || *p == '\v' || *p == '\f') p++;
    return p;
}

// Reads the next number on this line; the text behind it, or NULL when there is none.
static inline const char *text_double(const char *p, locale_t c, double *out)
{
    char *end;
    p = text_blank(p);
    if (!*p || *p == '\n') return NULL;
    *out = strtod_l(p, &end, c);
    return end == p ? NULL : end;
}

#endif
