/* SPDX-License-Identifier: MIT */
/* Parser of Radiance .hdr: RGBE and XYZE, new and old run lengths, flat, every orientation,
 * EXPOSURE. It is the project's own because OpenImageIO ignores EXPOSURE and refuses XYZE. */
#include "light_private.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct reader {
    const struct prt_context *ctx;
    const char *name;
    const uint8_t *at, *end;
};

struct header {
    double scale; /* 1 / product of EXPOSURE lines */
    bool xyz;
    bool x_major; /* scanlines run along y */
    bool flip_x, flip_y;
    uint32_t width, height;
};

bool prt_is_hdr(const uint8_t *bytes, size_t n)
{
    return n >= 2 && bytes[0] == '#' && bytes[1] == '?';
}

/* Next header line without its newline, cut at size - 1; false at the end of the bytes. */
static bool next_line(struct reader *r, char *line, size_t size)
{
    size_t n = 0;
    if (r->at >= r->end) return false;
    while (r->at < r->end && *r->at != '\n') {
        if (n + 1 < size) line[n++] = (char)*r->at;
        r->at++;
    }
    if (r->at >= r->end) return false;
    r->at++;
    if (n && line[n - 1] == '\r') n--;
    line[n] = 0;
    return true;
}

static int read_variable(struct reader *r, const char *line, struct header *h)
{
    if (!strncmp(line, "FORMAT=", 7)) {
        h->xyz = !strcmp(line + 7, "32-bit_rle_xyze");
        if (!h->xyz && strcmp(line + 7, "32-bit_rle_rgbe"))
            return prt_fail(r->ctx, PRT_FORMAT, "%s: unknown format \"%.40s\"", r->name,
                            line + 7);
    } else if (!strncmp(line, "EXPOSURE=", 9)) {
        char *end;
        const double e = strtod(line + 9, &end);
        if (end == line + 9 || !(e > 1e-20 && e < 1e20))
            return prt_fail(r->ctx, PRT_FORMAT,
                            "%s: EXPOSURE must be a positive number, not "
                            "\"%.40s\"",
                            r->name, line + 9);
        h->scale /= e;
    }
    return PRT_OK;
}

/* "-Y 512 +X 1024" or one of the seven other orders and signs; the first axis is the slow one.
 */
static int read_resolution(struct reader *r, const char *line, struct header *h)
{
    char sign[2], axis[2];
    long size[2];
    if (sscanf(line, "%c%c %9ld %c%c %9ld", &sign[0], &axis[0], &size[0], &sign[1], &axis[1],
               &size[1]) != 6 ||
        !((axis[0] == 'Y' && axis[1] == 'X') || (axis[0] == 'X' && axis[1] == 'Y')))
        return prt_fail(r->ctx, PRT_FORMAT, "%s: no valid resolution line (\"%.40s\")", r->name,
                        line);
    for (int i = 0; i < 2; i++) {
        if ((sign[i] != '+' && sign[i] != '-') || size[i] <= 0)
            return prt_fail(r->ctx, PRT_FORMAT, "%s: no valid resolution line (\"%.40s\")",
                            r->name, line);
        if (size[i] > PRT_IMAGE_MAX)
            return prt_fail(r->ctx, PRT_LIMIT,
                            "%s: a side of %ld pixels is above the limit of %d", r->name,
                            size[i], PRT_IMAGE_MAX);
        if (axis[i] == 'X') {
            h->width = (uint32_t)size[i];
            h->flip_x = sign[i] == '-';
        } else {
            h->height = (uint32_t)size[i];
            h->flip_y = sign[i] == '+'; /* +Y counts upwards */
        }
    }
    h->x_major = axis[0] == 'X';
    return PRT_OK;
}

static int read_header(struct reader *r, struct header *h)
{
    char line[512];
    memset(h, 0, sizeof *h);
    h->scale = 1;
    bool ended = false;
    const size_t n = (size_t)(r->end - r->at);
    if (!(n > 10 && !memcmp(r->at, "#?RADIANCE", 10)) &&
        !(n > 6 && !memcmp(r->at, "#?RGBE", 6)))
        prt_log(r->ctx, PRT_LOG_WARNING,
                "%s: begins with neither #?RADIANCE nor #?RGBE; it is "
                "read as Radiance all the same",
                r->name);
    while (!ended && next_line(r, line, sizeof line)) {
        ended = line[0] == 0;
        int err = read_variable(r, line, h);
        if (err) return err;
    }
    if (!ended || !next_line(r, line, sizeof line))
        return prt_fail(r->ctx, PRT_FORMAT, "%s: the header has no empty line at its end",
                        r->name);
    return read_resolution(r, line, h);
}

static int fail_truncated(const struct reader *r)
{
    return prt_fail(r->ctx, PRT_FORMAT, "%s: the file ends in the middle of the pixels",
                    r->name);
}

/* Flat pixels and old runs: (1,1,1,n) repeats the last pixel n << 8k times. */
static int read_old_scanline(struct reader *r, uint32_t n, uint8_t (*line)[4])
{
    unsigned shift = 0;
    for (uint32_t i = 0; i < n;) {
        if (r->end - r->at < 4) return fail_truncated(r);
        const uint8_t *p = r->at;
        r->at += 4;
        if (p[0] != 1 || p[1] != 1 || p[2] != 1) {
            memcpy(line[i++], p, 4);
            shift = 0;
            continue;
        }
        uint64_t run = shift < 32 ? (uint64_t)p[3] << shift : (uint64_t)n + 1;
        if (i == 0 || run > n - i)
            return prt_fail(r->ctx, PRT_FORMAT, "%s: a run is longer than its scanline",
                            r->name);
        for (; run; run--, i++) memcpy(line[i], line[i - 1], 4);
        shift += 8;
    }
    return PRT_OK;
}

static int read_scanline(struct reader *r, uint32_t n, uint8_t (*line)[4])
{
    const bool new_style = n >= 8 && n <= 32767 && r->end - r->at >= 4 && r->at[0] == 2 &&
                           r->at[1] == 2 && !(r->at[2] & 0x80);
    if (!new_style) return read_old_scanline(r, n, line);
    const uint32_t stored = (uint32_t)r->at[2] << 8 | r->at[3];
    if (stored != n)
        return prt_fail(r->ctx, PRT_FORMAT, "%s: a scanline of %u pixels in an image of %u",
                        r->name, stored, n);
    r->at += 4;
    for (int c = 0; c < 4; c++)
        for (uint32_t i = 0; i < n;) {
            if (r->end - r->at < 2) return fail_truncated(r);
            uint32_t count = *r->at++;
            const bool run = count > 128;
            count = run ? count - 128 : count;
            if (count == 0 || count > n - i)
                return prt_fail(r->ctx, PRT_FORMAT, "%s: a run is longer than its scanline",
                                r->name);
            if (!run && (size_t)(r->end - r->at) < count) return fail_truncated(r);
            for (uint32_t k = 0; k < count; k++) line[i + k][c] = run ? r->at[0] : r->at[k];
            r->at += run ? 1 : count;
            i += count;
        }
    return PRT_OK;
}

/* CIE XYZ, D65 white, to linear Rec. 709. */
static void xyz_to_rgb(float *p)
{
    const float x = p[0], y = p[1], z = p[2];
    p[0] = 3.2404542f * x - 1.5371385f * y - 0.4985314f * z;
    p[1] = -0.9692660f * x + 1.8760108f * y + 0.0415560f * z;
    p[2] = 0.0556434f * x - 0.2040259f * y + 1.0572252f * z;
}

static void store_scanline(const struct header *h, uint32_t slow, const uint8_t (*line)[4],
                           const float *scale, struct prt_image *out)
{
    const uint32_t n = h->x_major ? h->height : h->width;
    for (uint32_t fast = 0; fast < n; fast++) {
        uint32_t x = h->x_major ? slow : fast, y = h->x_major ? fast : slow;
        x = h->flip_x ? h->width - 1 - x : x;
        y = h->flip_y ? h->height - 1 - y : y;
        float *p = out->rgb + ((size_t)y * h->width + x) * 3;
        for (int c = 0; c < 3; c++) p[c] = (float)line[fast][c] * scale[line[fast][3]];
        if (h->xyz) {
            xyz_to_rgb(p);
            for (int c = 0; c < 3; c++) /* out of gamut by rounding */
                p[c] = p[c] > 0 ? p[c] : 0;
        }
    }
}

int prt_decode_hdr(const struct prt_context *ctx, const char *name, const uint8_t *bytes,
                   size_t n, struct prt_image *out)
{
    struct reader r = {ctx, name, bytes, bytes + n};
    struct header h;
    int err = read_header(&r, &h);
    if (err) return err;
    const uint32_t n_slow = h.x_major ? h.width : h.height;
    const uint32_t n_fast = h.x_major ? h.height : h.width;
    /* a scanline takes at least 4 bytes */
    if ((uint64_t)n_slow > (uint64_t)(r.end - r.at) / 4 + 1) return fail_truncated(&r);
    float scale[256];
    scale[0] = 0;
    for (int e = 1; e < 256; e++) scale[e] = (float)(ldexp(1.0, e - 136) * h.scale);
    uint8_t(*line)[4] = prt_alloc(n_fast, 4);
    err = line ? prt_image_reserve(ctx, name, h.width, h.height, out) : PRT_NOMEM;
    for (uint32_t i = 0; !err && i < n_slow; i++) {
        err = read_scanline(&r, n_fast, line);
        if (!err) store_scanline(&h, i, (const uint8_t(*)[4])line, scale, out);
    }
    prt_free(line);
    if (err) prt_image_finish(out);
    return err;
}
