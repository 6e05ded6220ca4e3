/* SPDX-License-Identifier: MIT */
/* Detects the image format by its first bytes and calls its parser. Runs in the isolated child
 * only. */
#include "light_private.h"

#include <math.h>
#include <string.h>
#include <strings.h>

float prt_srgb_to_linear(float v)
{
    return v <= 0.04045f ? v / 12.92f : powf((v + 0.055f) / 1.055f, 2.4f);
}

int prt_decode_own(const struct prt_context *ctx, const char *name, const void *bytes, size_t n,
                   struct prt_decoded *out)
{
    int err;
    out->hint = PRT_HINT_NONE;
    out->is_chroma = false;
    out->image = (struct prt_image){0};
    if (n < 4)
        return prt_fail(ctx, PRT_FORMAT, "%s: the file has %zu bytes; an image has at least 4",
                        name, n);
    if (prt_is_hdr(bytes, n)) return prt_decode_hdr(ctx, name, bytes, n, &out->image);
    const char *dot = strrchr(name, '.');
    if (dot && !strcasecmp(dot, ".hdr"))
        return prt_fail(ctx, PRT_FORMAT, "%s: not a Radiance file: it does not begin with #?",
                        name);
    err = PRT_UNSUPPORTED;
    if (prt_is_exr(bytes, n)) err = prt_decode_exr(ctx, name, bytes, n, out);
    else if (prt_is_ktx(bytes, n)) err = prt_decode_ktx(ctx, name, bytes, n, out);
    else if (prt_is_dds(bytes, n)) err = prt_decode_dds(ctx, name, bytes, n, out);
    else if (!memcmp(bytes, "\x89PNG", 4))
        err = prt_decode_png(ctx, name, bytes, n, &out->image);
    else if (!memcmp(bytes, "\xff\xd8\xff", 3))
        err = prt_decode_jpeg(ctx, name, bytes, n, &out->image);
    return err;
}

int prt_decode(const struct prt_context *ctx, const char *name, const void *bytes, size_t n,
               struct prt_decoded *out)
{
    const int err = prt_decode_own(ctx, name, bytes, n, out);
    if (err != PRT_UNSUPPORTED) return err;
    return prt_decode_oiio(ctx, name, bytes, n, out->is_chroma, &out->image);
}
