// SPDX-License-Identifier: MIT
// A light of a dim sky with a lamp above and to the right, for tests of bakes.
#ifndef TESTS_PHYSICS_LAMP_LIGHT_H
#define TESTS_PHYSICS_LAMP_LIGHT_H

#include "prt/light.h"

// 6 x 16 x 16 texels, which the caller ends with prt_cube_finish.
static inline void lamp_light(struct prt_cube *out)
{
    assert_int_equal(prt_cube_init(out, 16), PRT_OK);
    for (uint32_t i = 0; i < 6 * 256; i++) {
        float d[3];
        prt_cube_direction(i / 256, (2 * (i % 16) + 1) / 16.0 - 1,
                           (2 * (i / 16 % 16) + 1) / 16.0 - 1, d);
        const bool lamp = d[0] * 0.5f + d[1] * 0.7f + d[2] * 0.5f > 0.93f;
        for (uint32_t c = 0; c < 3; c++)
            out->texel[3 * i + c] = 0.3f + 0.2f * d[1] + (lamp ? 20 - 3.0f * (float)c : 0);
    }
}

#endif
