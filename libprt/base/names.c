// SPDX-License-Identifier: MIT
// Names by a unique beginning, and the nearest name to a misspelt one.
#include "prt/base.h"

#include <stdio.h>
#include <string.h>
#include <strings.h>

enum { LONGEST = 127 }; // characters of a name that count

// Distance of Levenshtein between a and the first m characters of b, ASCII case ignored; words
// are cut to LONGEST.
static unsigned edit_distance(const char *a, const char *b, size_t m)
{
    unsigned row[LONGEST + 1];
    size_t n = strnlen(a, LONGEST);
    m = m < LONGEST ? m : LONGEST;
    for (size_t j = 0; j <= m; j++) row[j] = (unsigned)j;
    for (size_t i = 1; i <= n; i++) {
        unsigned diagonal = row[0];
        row[0] = (unsigned)i;
        for (size_t j = 1; j <= m; j++) {
            unsigned change = diagonal + (strncasecmp(a + i - 1, b + j - 1, 1) != 0);
            unsigned best = row[j - 1] < row[j] ? row[j - 1] + 1 : row[j] + 1;
            diagonal = row[j];
            row[j] = change < best ? change : best;
        }
    }
    return row[m];
}

int prt_name_nearest(const char *text, const char *const name[], unsigned n)
{
    unsigned best = (unsigned)strnlen(text, LONGEST) / 3 + 1;
    int found = -1;
    for (unsigned i = 0; i < n; i++) {
        const char *dot = strrchr(name[i], '.'); // a file's ending may be left out
        unsigned d = edit_distance(text, name[i], strlen(name[i]));
        unsigned stem = dot ? edit_distance(text, name[i], (size_t)(dot - name[i])) : d;
        d = stem < d ? stem : d;
        if (d < best || (d == best && found < 0)) best = d, found = (int)i;
    }
    return found;
}

static void say_many(const char *text, const char *const name[], unsigned n, char *say,
                     size_t size)
{
    size_t length = strlen(text), at = 0;
    unsigned shown = 0;
    at += (size_t)snprintf(say, size, "it begins several names:");
    for (unsigned i = 0; i < n && at < size && shown < 8; i++)
        if (!strncasecmp(name[i], text, length))
            at +=
                (size_t)snprintf(say + at, size - at, "%s %.60s", shown++ ? "," : "", name[i]);
}

int prt_name_choose(const char *text, const char *const name[], unsigned n, char *say,
                    size_t size)
{
    size_t length = strlen(text);
    unsigned begins = 0;
    int found = -1;
    say[0] = 0;
    for (unsigned i = 0; i < n; i++)
        if (!strcmp(name[i], text)) return (int)i;
    for (unsigned i = 0; i < n; i++) {
        if (!strcasecmp(name[i], text)) return (int)i;
        if (!length || strncasecmp(name[i], text, length)) continue;
        begins++;
        found = (int)i;
    }
    if (begins == 1) return found;
    if (begins) {
        say_many(text, name, n, say, size);
        return -1;
    }
    found = prt_name_nearest(text, name, n);
    if (found >= 0) snprintf(say, size, "did you mean %.60s?", name[found]);
    return -1;
}
