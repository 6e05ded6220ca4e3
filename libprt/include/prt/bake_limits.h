/* SPDX-License-Identifier: MIT */
/* prt/bake_limits.h owns the bounds of a bake's settings: the library checks them, `prt bake`
 * and the daemon's LOAD take them from here. */
#ifndef PRT_BAKE_LIMITS_H
#define PRT_BAKE_LIMITS_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* name, word, minimum, maximum, default (0: chosen from the model or the error) */
#define PRT_BAKE_LIMITS(X)                               \
    X(SAMPLES, "samples", 16, 10000000, 0)               \
    X(CUBE, "cube", 16, 128, 32)       /* powers of 2 */ \
    X(COEFFS, "coeffs", 6, 98304, 128) /* <= 6 cube^2 */ \
    X(RANK, "rank", 1, 512, 0)                           \
    X(BASIS_COEFFS, "basis-coeffs", 1, 98304, 0)         \
    X(PHASE_TERMS, "phase-terms", 1, 9, 0) /* 1, 4, 9 */ \
    X(SINGLE_POINTS, "single-points", 1, 1024, 16)       \
    X(WALKS, "walks", 16, 1048576, 0)

enum prt_bake_setting {
#define X(name, word, low, high, standard) PRT_BAKE_##name,
    PRT_BAKE_LIMITS(X)
#undef X
};
enum {
#define X(name, word, low, high, standard)                         \
    PRT_BAKE_##name##_MIN = (low), PRT_BAKE_##name##_MAX = (high), \
    PRT_BAKE_##name##_DEFAULT = (standard),
    PRT_BAKE_LIMITS(X)
#undef X
};
#define PRT_BAKE_ERROR_MIN 1e-4
#define PRT_BAKE_ERROR_MAX 0.5
#define PRT_BAKE_ERROR_DEFAULT 0.01

/* Whether the value is one; 0, the default, is. Else the reason, which begins with the word and
 * the value. Thread-safe. */
bool prt_bake_setting_ok(enum prt_bake_setting setting, uint64_t value, char reason[128]);
bool prt_bake_error_ok(double max_error, char reason[128]);

#ifdef __cplusplus
}
#endif
#endif
