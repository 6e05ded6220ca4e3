/* SPDX-License-Identifier: MIT */
/* Values by a tone curve's table. Included by tone.c once for each instruction set, in its
 * region of base/isa.h: the indices are computed as vectors. */

/* Where the table has n values, n <= TOGETHER. */
static void PRT_KERNEL(find_entries)(float scale, const float *in, int n,
                                     int32_t index[TOGETHER])
{
    const float lo = 0x1p-14f, hi = 0x1.fffffep11f;
    const int32_t base = (127 + OCTAVE_LO) << STEP_BITS;
    for (int k = 0; k < n; k++) {
        /* a comparison with NaN is false, so that NaN becomes lo, which is black */
        float x = in[k] * scale;
        x = x > lo ? x : lo;
        x = x < hi ? x : hi;
        int32_t b;
        memcpy(&b, &x, 4);
        index[k] = (b >> SHIFT) - base;
    }
}

/* n <= TOGETHER values, eight in one store: a quarter faster than one by one. */
static void PRT_KERNEL(look_up)(const uint8_t *curve_table, const int32_t index[TOGETHER],
                                int n, uint8_t *out)
{
    int k = 0;
    for (; k + 8 <= n; k += 8) {
        uint8_t eight[8];
        for (int i = 0; i < 8; i++) eight[i] = curve_table[index[k + i]];
        memcpy(out + k, eight, sizeof eight);
    }
    for (; k < n; k++) out[k] = curve_table[index[k]];
}

static void PRT_KERNEL(tone_values)(const struct tone_curve *tone, const float *in, size_t n,
                                    uint8_t *out)
{
    for (size_t i = 0; i < n; i += TOGETHER) {
        int32_t index[TOGETHER];
        const int m = n - i < TOGETHER ? (int)(n - i) : TOGETHER;
        PRT_KERNEL(find_entries)(tone->scale, in + i, m, index);
        PRT_KERNEL(look_up)(tone->table, index, m, out + i);
    }
}
