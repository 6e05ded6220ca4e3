// SPDX-License-Identifier: MIT
// Levels of a filtered environment brought to one size.
#include "cube.h"

#include <pthread.h>
#include <string.h>

enum { SIDE = SPECULAR_SIDE, TEXELS = 6 * SIDE * SIDE };

typedef float v4 __attribute__((vector_size(16), aligned(16)));

// Where texel i of the large cube lies in a smaller, bordered one: four texels and their
// weights. They depend on the sizes alone: computed once for each size.
struct place {
    uint32_t at[4];
    float weight[4];
};
static struct place places[2][TEXELS]; // of sides 16 and 8
static pthread_once_t once = PTHREAD_ONCE_INIT;

static void make_places(void)
{
    for (int size = 0; size < 2; size++) {
        const uint32_t n = size ? 8 : 16, m = n + 2;
        for (uint32_t i = 0; i < TEXELS; i++) {
            uint32_t face = i / (SIDE * SIDE);
            float x = ((float)(i % SIDE) + 0.5f) / SIDE * (float)n + 0.5f;
            float y = ((float)(i / SIDE % SIDE) + 0.5f) / SIDE * (float)n + 0.5f;
            uint32_t x0 = (uint32_t)x, y0 = (uint32_t)y, at = ((face * m + y0) * m + x0) * 4;
            float fx = x - (float)x0, fy = y - (float)y0;
            places[size][i] =
                (struct place){{at, at + 4, at + 4 * m, at + 4 * m + 4},
                               {(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy}};
        }
    }
}

// The level at the large cube's texels, without its border.
static void enlarge(const struct border_cube *level, struct border_cube *out)
{
    const struct place *place = level->n == SIDE ? NULL : places[level->n == 8];
    for (uint32_t i = 0; i < TEXELS; i++) {
        const uint32_t face = i / (SIDE * SIDE), y = i / SIDE % SIDE, x = i % SIDE;
        v4 *to = (v4 *)border_texel(out, face, x, y), value;
        if (!place) {
            value = *(const v4 *)border_texel(level, face, x, y);
        } else {
            const struct place *p = &place[i];
            value = p->weight[0] * *(const v4 *)(level->texel + p->at[0]);
            for (int k = 1; k < 4; k++)
                value += p->weight[k] * *(const v4 *)(level->texel + p->at[k]);
        }
        *to = value;
    }
}

bool prt_specular_stack(struct prt_specular *s)
{
    pthread_once(&once, make_places);
    s->stack = (struct border_cube){
        SIDE, prt_calloc((size_t)SPECULAR_LEVELS * SPECULAR_LEVEL_FLOATS, sizeof(float))};
    for (unsigned k = 0; s->stack.texel && k < SPECULAR_LEVELS; k++) {
        struct border_cube own = {SIDE, s->stack.texel + (size_t)k * SPECULAR_LEVEL_FLOATS};
        enlarge(&s->level[k], &own);
        prt_border_cube_seal(&own);
    }
    return s->stack.texel != NULL;
}
