// SPDX-License-Identifier: MIT
// Internal to the texture room.
#ifndef PRT_TEXTURE_INTERNAL_H
#define PRT_TEXTURE_INTERNAL_H

#include "prt/texture.h"

// [256] linear values of sRGB bytes.
const float *prt_texture_linear(void);

#endif
