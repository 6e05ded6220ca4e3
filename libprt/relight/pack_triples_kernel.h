/* SPDX-License-Identifier: MIT */
/* Packing of triples, as plain loops over 16 lanes; included by pack_triples.c once for each
 * instruction set, in its region of base/isa.h. */

static float PRT_KERNEL(largest)(const float *x, size_t n)
{
    float lane[16] = {0};
    for (size_t k = 0; k < n; k += 16)
        for (size_t i = 0; i < (n - k < 16 ? n - k : 16); i++) {
            const float a = fabsf(x[k + i]);
            lane[i] = a > lane[i] ? a : lane[i]; // NaN is passed over
        }
    for (int i = 1; i < 16; i++) lane[0] = lane[i] > lane[0] ? lane[i] : lane[0];
    return lane[0];
}

// 32 triples; lane i has the triples 2 i and 2 i + 1. Of their largest number the mantissa is
// 256 to 511, unless it is below 1.
static void PRT_KERNEL(pack)(const float number[6][16], uint32_t out[2][16])
{
    float steps[16];
    int32_t exponent[16];
    for (int i = 0; i < 16; i++) {
        float most = 0;
        for (int j = 0; j < 6; j++) {
            const float x = fabsf(number[j][i]);
            most = x > most ? x : most; // NaN is passed over
        }
        most = most < 0x1p14f ? most : 0x1p14f;
        int32_t bits, e;
        memcpy(&bits, &most, 4);
        e = (bits >> 23) - 126; // most < 2^e
        e = e > 0 ? e : 0;
        float at[1];
        bits = (e - 9 + 127) << 23;
        memcpy(at, &bits, 4);
        e += (most >= 511.5f * *at) & (e < 15); // not to 512
        exponent[i] = e;
        bits = (9 - e + 127) << 23;
        memcpy(&steps[i], &bits, 4);
    }
    for (int t = 0; t < 2; t++)
        for (int i = 0; i < 16; i++) {
            uint32_t word = (uint32_t)(exponent[i] >> 2 * t & 3) << 30;
            for (int c = 0; c < 3; c++) {
                float m = number[3 * t + c][i] * steps[i];
                m = m > -511 ? m : -511; // NaN becomes it
                m = m < 511 ? m : 511;
                m += 0x1.8p23f; // the last bits are those of the nearest integer
                uint32_t bits;
                memcpy(&bits, &m, 4);
                word |= (bits & 1023) << 10 * c;
            }
            out[t][i] = word;
        }
}

static const struct pack_loops PRT_KERNEL(pack_loops) = {PRT_KERNEL(largest), PRT_KERNEL(pack)};
