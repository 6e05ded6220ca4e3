/* SPDX-License-Identifier: MIT */
/* EXT_texture_shared_exponent: 9 bits of mantissa, exponent bias 15. Selects on bits, without
 * branches or calls, so that the compiler vectorises the loop. Included by colors.c once for
 * each instruction set. */
static void PRT_KERNEL(rgb9e5)(const float *restrict rgb, size_t n, uint32_t *restrict out)
{
    const float top = 65408,
                low = 0x1p-16f; /* the largest value; exponent 0 below the latter */
    for (size_t i = 0; i < n; i++) {
        float r = rgb[3 * i], g = rgb[3 * i + 1], b = rgb[3 * i + 2];
        r = r > 0 ? r : 0; /* NaN, too, becomes 0 */
        g = g > 0 ? g : 0;
        b = b > 0 ? b : 0;
        r = r < top ? r : top;
        g = g < top ? g : top;
        b = b < top ? b : top;
        float high = r > g ? r : g;
        high = high > b ? high : b;
        high = high > low ? high : low;
        int32_t bits, scale_bits;
        float scale;
        memcpy(&bits, &high, 4);
        /* a mantissa that would round up to 512 takes the next exponent */
        const int32_t e = ((bits + (1 << 14)) >> 23) - 127;
        scale_bits = (127 + 8 - e) << 23;
        memcpy(&scale, &scale_bits, 4);
        const int32_t r9 = (int32_t)(r * scale + 0.5f), g9 = (int32_t)(g * scale + 0.5f),
                      b9 = (int32_t)(b * scale + 0.5f);
        out[i] = (uint32_t)(e + 16) << 27 | (uint32_t)(b9 << 18 | g9 << 9 | r9);
    }
}
