// SPDX-License-Identifier: MIT
// Checks of a bake's settings against prt/bake_limits.h; also a library of its own, for the
// daemon.
#include "prt/bake_limits.h"

#include <stdio.h>

static const struct {
    const char *word;
    uint64_t low, high;
} limits[] = {
#define X(name, word, low, high, standard) {word, low, high},
    PRT_BAKE_LIMITS(X)
#undef X
};

bool prt_bake_setting_ok(enum prt_bake_setting setting, uint64_t value, char reason[128])
{
    uint64_t low = limits[setting].low, high = limits[setting].high;
    const char *list = NULL;
    bool ok = !value || (value >= low && value <= high);
    if (setting == PRT_BAKE_CUBE) {
        list = "16, 32, 64 or 128";
        ok = ok && !(value & (value - 1));
    } else if (setting == PRT_BAKE_PHASE_TERMS) {
        list = "1, 4 or 9";
        ok = !value || value == 1 || value == 4 || value == 9;
    }
    if (ok) return true;
    snprintf(reason, 128, "%s is %llu, allowed range %llu to %llu%s%s", limits[setting].word,
             (unsigned long long)value, (unsigned long long)low, (unsigned long long)high,
             list ? ": " : "", list ? list : "");
    return false;
}

bool prt_bake_error_ok(double max_error, char reason[128])
{
    if (max_error == 0 || (max_error >= PRT_BAKE_ERROR_MIN && max_error <= PRT_BAKE_ERROR_MAX))
        return true;
    snprintf(reason, 128, "max-error is %g, allowed range %g to %g", max_error,
             PRT_BAKE_ERROR_MIN, PRT_BAKE_ERROR_MAX);
    return false;
}
