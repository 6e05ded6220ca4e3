/* SPDX-License-Identifier: MIT */
/* Declarations that frame.c and decoder.c share. */
#ifndef RELIGHT_FRAME_PRIVATE_H
#define RELIGHT_FRAME_PRIVATE_H

#include "frame.h"

/* Reads and checks the fixed part; header and payload pointers are left NULL. 0 or a fault. */
int relight_frame_get_fixed(const uint8_t *bytes, const struct relight_frame_limits *limits,
                            struct relight_frame *out);
int relight_frame_check_padding(const uint8_t *bytes, size_t begin, size_t end);

#endif
