// SPDX-License-Identifier: MIT
// Radiance RGBE files, without run-length encoding.
#include "prt/light.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

// Radiance RGBE, flat: a shared exponent, mantissas rounded to nearest. Mantissas below 128 on
// all three channels never occur, so no pixel can be taken for a run-length mark.
static void rgbe_encode(const float rgb[3], unsigned char out[4])
{
    float top = fmaxf(rgb[0], fmaxf(rgb[1], rgb[2]));
    int exponent = 0;
    memset(out, 0, 4);
    if (!(top > 1e-36f)) return;
    frexpf(top, &exponent);
    if (roundf(ldexpf(top, 8 - exponent)) > 255) exponent++;
    if (exponent > 127) exponent = 127;
    for (int c = 0; c < 3; c++) {
        float mantissa = roundf(ldexpf(fmaxf(rgb[c], 0), 8 - exponent));
        out[c] = (unsigned char)fminf(mantissa, 255);
    }
    out[3] = (unsigned char)(exponent + 128);
}

int prt_encode_hdr(const struct prt_context *ctx, const struct prt_image *image,
                   struct prt_blob *out)
{
    size_t n = (size_t)image->width * image->height, used;
    unsigned char *file = prt_alloc(n + 32, 4);
    if (!file) return prt_fail(ctx, PRT_NOMEM, "no memory for a Radiance picture");
    used = (size_t)snprintf((char *)file, 128,
                            "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %u +X %u\n",
                            image->height, image->width);
    for (size_t i = 0; i < n; i++) rgbe_encode(image->rgb + 3 * i, file + used + 4 * i);
    *out = (struct prt_blob){file, used + 4 * n};
    return PRT_OK;
}
