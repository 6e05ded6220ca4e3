/* SPDX-License-Identifier: MIT */
/* Parser of DDS files that hold an uncompressed cubemap (RGBA16F, RGBA32F, 8-bit). It is the
 * project's own because OpenImageIO 2.4 refuses the float formats and rearranges the faces of
 * the others. OpenImageIO reads all other DDS files. */
#include "light_private.h"

#include <math.h>
#include <string.h>

enum { HEADER = 128, DX10_HEADER = 20, CUBE_ALL = 0xfe00, FOURCC_FLAG = 4, RGB_FLAG = 0x40 };

struct texture {
    uint32_t n, mips;
    size_t pixel_bytes, data_at;
    enum { HALF4, FLOAT4, BYTES } kind;
    uint32_t mask[3];
};

bool prt_is_dds(const uint8_t *bytes, size_t n)
{
    return n >= 4 && !memcmp(bytes, "DDS ", 4);
}

static uint32_t u32(const uint8_t *p)
{
    return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static float half_to_float(uint16_t h)
{
    const int e = h >> 10 & 31, m = h & 1023;
    const float sign = h & 0x8000 ? -1.0f : 1.0f;
    if (e == 31) return m ? NAN : sign * INFINITY;
    return sign * (e ? ldexpf((float)(m + 1024), e - 25) : ldexpf((float)m, -24));
}

static float channel(const uint8_t *p, const struct texture *t, int c)
{
    if (t->kind == HALF4) return half_to_float((uint16_t)(p[2 * c] | p[2 * c + 1] << 8));
    if (t->kind == FLOAT4) {
        const uint32_t bits = u32(p + 4 * c);
        float f;
        memcpy(&f, &bits, sizeof f);
        return f;
    }
    uint32_t v = 0;
    for (size_t i = 0; i < t->pixel_bytes; i++) v |= (uint32_t)p[i] << 8 * i;
    const uint32_t mask = t->mask[c];
    return mask ? prt_srgb_to_linear((float)(v & mask) / (float)mask) : 0;
}

/* Pixel format from the header (D3DFORMAT 113 RGBA16F, 116 RGBA32F) or from the DX10 extension
 * (DXGI_FORMAT 10 RGBA16F, 2 RGBA32F). PRT_UNSUPPORTED for other formats. */
static int read_format(const struct prt_context *ctx, const char *name, const uint8_t *bytes,
                       size_t n, struct texture *t)
{
    const uint32_t flags = u32(bytes + 80), fourcc = u32(bytes + 84), bits = u32(bytes + 88);
    t->data_at = HEADER;
    uint32_t format = fourcc;
    if ((flags & FOURCC_FLAG) && fourcc == 0x30315844) { /* "DX10" */
        if (n < HEADER + DX10_HEADER)
            return prt_fail(ctx, PRT_FORMAT, "%s: the file ends inside the DDS header", name);
        const uint32_t dxgi = u32(bytes + HEADER);
        t->data_at += DX10_HEADER;
        format = dxgi == 10 ? 113 : dxgi == 2 ? 116 : 0;
    }
    if ((flags & FOURCC_FLAG) && (format == 113 || format == 116)) {
        t->kind = format == 113 ? HALF4 : FLOAT4;
        t->pixel_bytes = format == 113 ? 8 : 16;
        return PRT_OK;
    }
    if (!(flags & FOURCC_FLAG) && (flags & RGB_FLAG) && (bits == 24 || bits == 32)) {
        t->kind = BYTES;
        t->pixel_bytes = bits / 8;
        for (int c = 0; c < 3; c++) t->mask[c] = u32(bytes + 92 + 4 * c);
        return PRT_OK;
    }
    return PRT_UNSUPPORTED;
}

int prt_decode_dds(const struct prt_context *ctx, const char *name, const uint8_t *bytes,
                   size_t n, struct prt_decoded *out)
{
    struct texture t = {0};
    if (n < HEADER || u32(bytes + 4) != 124)
        return prt_fail(ctx, PRT_FORMAT, "%s: the file ends inside the DDS header", name);
    const uint32_t caps = u32(bytes + 112), height = u32(bytes + 12), width = u32(bytes + 16);
    int err = read_format(ctx, name, bytes, n, &t);
    const bool dx10_cube = t.data_at > HEADER && (u32(bytes + HEADER + 8) & 4);
    if (!err && !(caps & 0x200) && !dx10_cube && t.kind == BYTES) return PRT_UNSUPPORTED;
    if (err) return err;
    if (!dx10_cube && (caps & CUBE_ALL) != CUBE_ALL)
        return prt_fail(ctx, PRT_FORMAT, "%s: not a cubemap with six faces", name);
    if (width != height || !width || width > PRT_CUBE_MAX)
        return prt_fail(ctx, PRT_FORMAT,
                        "%s: cube faces of %u x %u pixels; faces are squares of 1 to %d", name,
                        width, height, PRT_CUBE_MAX);
    uint32_t mips = u32(bytes + 8) & 0x20000 ? u32(bytes + 28) : 1;
    mips = mips ? mips : 1;
    if (mips > 12)
        return prt_fail(ctx, PRT_FORMAT, "%s: %u mip levels, at most 12", name, mips);
    size_t stride = 0; /* bytes of a face with its mip levels */
    for (uint32_t level = 0, side = width; level<mips; level++, side = side> 1 ? side / 2 : 1)
        stride += (size_t)side * side * t.pixel_bytes;
    const size_t n_face = (size_t)width * width;
    if (n - t.data_at < 5 * stride + n_face * t.pixel_bytes)
        return prt_fail(ctx, PRT_FORMAT, "%s: the file ends in the middle of the faces", name);
    err = prt_image_reserve(ctx, name, width, (uint64_t)width * 6, &out->image);
    for (unsigned face = 0; !err && face < 6; face++) {
        const uint8_t *src = bytes + t.data_at + face * stride;
        float *dst = out->image.rgb + face * n_face * 3;
        for (size_t i = 0; i < n_face; i++)
            for (int c = 0; c < 3; c++)
                dst[i * 3 + c] = channel(src + i * t.pixel_bytes, &t, c);
    }
    out->hint = PRT_HINT_GL_CUBE;
    return err;
}
