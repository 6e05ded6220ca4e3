// SPDX-License-Identifier: MIT
#include "common/program.h"

#include "relight/relight.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int exit_status(int code)
{
    switch (code) {
    case RELIGHT_E_UNREACHABLE:
    case RELIGHT_E_DISCONNECTED:
        return EXIT_UNREACHABLE;
    case RELIGHT_E_ARGUMENT:
    case RELIGHT_E_OUT_OF_RANGE:
    case RELIGHT_E_MISMATCH:
        return EXIT_USAGE;
    default:
        return EXIT_FAILED;
    }
}

double option_number(struct argp_state *state, const char *what, const char *text, double min,
                     double max)
{
    char *end;
    double x = strtod(text, &end);
    if (end == text || *end || !isfinite(x) || x < min || x > max)
        argp_error(state, "--%s %s: expected a number in [%g, %g]", what, text, min, max);
    return x;
}

void option_size(struct argp_state *state, const char *text, uint32_t *width, uint32_t *height)
{
    enum { MOST = 4096 };
    int used = 0;
    // Four digits at most: %u alone takes a longer number modulo 2^32.
    if (sscanf(text, "%4ux%4u%n", width, height, &used) != 2 || text[used] || *width < 1 ||
        *height < 1 || *width > MOST || *height > MOST || strchr(text, '-')) // %u takes -1
        argp_error(state, "--size %s: expected WxH, each in [1, %d]", text, MOST);
}
