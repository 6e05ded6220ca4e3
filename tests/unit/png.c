// SPDX-License-Identifier: MIT
// Pictures as PNG, read byte by byte.
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>
#include <zlib.h>

#include "prt/picture.h"

static struct prt_context quiet;

// The data of a PNG's chunk, n bytes.
static const uint8_t *chunk_of(const struct prt_blob *png, const char *name, size_t *n)
{
    const uint8_t *p = png->bytes;
    for (size_t at = 8; at + 12 <= png->size; at += *n + 12) {
        *n = (size_t)p[at] << 24 | (size_t)p[at + 1] << 16 | (size_t)p[at + 2] << 8 | p[at + 3];
        if (!memcmp(p + at + 4, name, 4)) return p + at + 8;
    }
    fail_msg("no %s", name);
    return NULL;
}

// Alpha 0 is stored as 0, and 1 or more as the largest number of a channel, in 8 and 16 bits.
// Colours are stored without their alpha.
static void transparent_png(void **state)
{
    enum { N = 6 };
    static const float linear[3] = {0.4f, 0.1f, 0.7f};
    static const double srgb[3] = {0.6652, 0.3492, 0.8543};
    float rgb[3 * N], alpha[N] = {0, 0.02f, 0.25f, 0.5f, 1, 2};
    for (int i = 0; i < 3 * N; i++) rgb[i] = linear[i % 3] * fminf(alpha[i / 3], 1);
    struct prt_image image = {N, 1, rgb, alpha};
    const struct prt_picture_format *png = prt_picture_format("a.PNG");
    for (int fine = 0; fine < 2; fine++) {
        const struct prt_picture_options o = {.tone = PRT_TONE_NONE, .fine = fine};
        struct prt_blob blob;
        uint8_t row[1 + 8 * N];
        size_t n;
        uLongf size = sizeof row;
        assert_int_equal(prt_picture_encode(&quiet, png, &image, &o, &blob), PRT_OK);
        assert_int_equal(chunk_of(&blob, "IHDR", &n)[8], fine ? 16 : 8);
        const uint8_t *data = chunk_of(&blob, "IDAT", &n);
        assert_int_equal(uncompress(row, &size, data, n), Z_OK);
        const int wide = fine ? 2 : 1, pixel = 4 * wide, filter = row[0];
        assert_int_equal(size, 1 + N * pixel);
        assert_true(filter <= 1); // filter none, or sub
        for (int i = pixel; filter == 1 && i < N * pixel; i++)
            row[1 + i] = (uint8_t)(row[1 + i] + row[1 + i - pixel]);
        const int most = fine ? 65535 : 255, unit = fine ? 257 : 1;
        const int want[N] = {0, 5 * unit, 64 * unit, 128 * unit, most, most};
        for (int i = 0; i < N; i++) {
            const uint8_t *p = row + 1 + i * pixel;
            int c[4];
            for (int k = 0; k < 4; k++) c[k] = fine ? p[2 * k] << 8 | p[2 * k + 1] : p[k];
            assert_int_equal(c[3], want[i]);
            // Where nothing is seen there is no colour.
            for (int k = 0; k < 3 && i && i < 5; k++)
                assert_true(abs(c[k] - (int)(srgb[k] * most)) <= unit);
        }
        prt_free(blob.bytes);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(transparent_png)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
