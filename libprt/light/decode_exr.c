/* SPDX-License-Identifier: MIT */
/* Reader of OpenEXR through OpenEXRCore: scanline and tiled parts, RGB and grey channels,
 * layers, data windows; chunk by chunk into float planes. libprt_oiio.so reads the files that
 * OpenEXRCore 3.1 does not support (DWA) or decodes wrongly (subsampled chroma in B44). */
#include "light_private.h"

#include <math.h>
#include <openexr.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

enum { N_PLANE = 3, MAX_CHANNEL = 1024 };
enum colour { COLOUR_NONE, COLOUR_RGB, COLOUR_CHROMA, COLOUR_GREY };

struct plane {
    int channel;  /* index in the file's list, -1: absent, reads as 0 */
    float *value; /* [height][width] of the data window */
};

struct exr {
    const struct prt_context *ctx;
    const char *name;
    const uint8_t *bytes;
    size_t size;
    exr_context_t file;
    int part;
    exr_attr_box2i_t data, display;
    int32_t width, height; /* of the data window */
    enum colour colour;
    struct plane plane[N_PLANE];
    float *scratch; /* one chunk of one channel */
    size_t scratch_count;
    char why[256];
};

bool prt_is_exr(const uint8_t *bytes, size_t n)
{
    return n >= 4 && bytes[0] == 0x76 && bytes[1] == 0x2f && bytes[2] == 0x31 && bytes[3] == 1;
}

static int64_t read_bytes(exr_const_context_t file, void *user, void *buffer, uint64_t size,
                          uint64_t offset, exr_stream_error_func_ptr_t error)
{
    const struct exr *x = user;
    if (offset >= x->size) return 0;
    const uint64_t left = x->size - offset;
    const uint64_t n = size < left ? size : left;
    memcpy(buffer, x->bytes + offset, n);
    return (int64_t)n;
}

static int64_t file_size(exr_const_context_t file, void *user)
{
    return (int64_t)((const struct exr *)user)->size;
}

static void keep_message(exr_const_context_t file, exr_result_t code, const char *message)
{
    void *user = NULL;
    if (!file || exr_get_user_data(file, &user) != EXR_ERR_SUCCESS || !user) return;
    struct exr *x = user;
    if (!x->why[0]) snprintf(x->why, sizeof x->why, "%s", message);
}

static int fail_exr(const struct exr *x, exr_result_t code)
{
    return prt_fail(x->ctx, code == EXR_ERR_OUT_OF_MEMORY ? PRT_NOMEM : PRT_FORMAT, "%s: %s",
                    x->name, x->why[0] ? x->why : exr_get_default_error_message(code));
}

/* ---- the choice of channels ---- */

static int find(const exr_attr_chlist_t *list, const char *prefix, size_t n_prefix,
                const char *leaf)
{
    for (int i = 0; i < list->num_channels; i++) {
        const char *s = list->entries[i].name.str;
        if (strlen(s) == n_prefix + strlen(leaf) && !strncmp(s, prefix, n_prefix) &&
            !strcasecmp(s + n_prefix, leaf))
            return i;
    }
    return -1;
}

static bool choose_layer(struct exr *x, const exr_attr_chlist_t *list, const char *prefix,
                         size_t n_prefix)
{
    static const struct {
        enum colour colour;
        const char *leaf[N_PLANE];
    } sets[] = {{COLOUR_RGB, {"R", "G", "B"}},
                {COLOUR_RGB, {"red", "green", "blue"}},
                {COLOUR_CHROMA, {"Y", "RY", "BY"}}};
    for (size_t s = 0; s < sizeof sets / sizeof *sets; s++) {
        int found = 0;
        for (int i = 0; i < N_PLANE; i++) {
            x->plane[i].channel = find(list, prefix, n_prefix, sets[s].leaf[i]);
            found += x->plane[i].channel >= 0;
        }
        x->colour = sets[s].colour;
        if (found == N_PLANE || (found == 2 && x->colour == COLOUR_RGB)) return true;
    }
    static const char *const grey[] = {"Y", "R",         "red",  "G",   "B",
                                       "L", "luminance", "gray", "grey"};
    for (size_t s = 0; s < sizeof grey / sizeof *grey; s++) {
        const int channel = find(list, prefix, n_prefix, grey[s]);
        if (channel < 0) continue;
        x->colour = COLOUR_GREY;
        for (int i = 0; i < N_PLANE; i++) x->plane[i].channel = i ? -1 : channel;
        if (s > 0)
            prt_log(x->ctx, PRT_LOG_WARNING, "%s: has only channel %s; it is read as grey",
                    x->name, list->entries[channel].name.str);
        return true;
    }
    return false;
}

/* Plain names first, then the first layer that has colours. */
static bool choose_channels(struct exr *x, const exr_attr_chlist_t *list)
{
    if (list->num_channels > MAX_CHANNEL) return false;
    if (choose_layer(x, list, "", 0)) return true;
    for (int i = 0; i < list->num_channels; i++) {
        const char *s = list->entries[i].name.str, *dot = strrchr(s, '.');
        if (dot && choose_layer(x, list, s, (size_t)(dot + 1 - s))) {
            prt_log(x->ctx, PRT_LOG_NOTE, "%s: the colours are those of layer %.*s", x->name,
                    (int)(dot - s), s);
            return true;
        }
    }
    return false;
}

/* First flat part with colours. */
static int choose_part(struct exr *x)
{
    int count = 0;
    bool deep = false;
    exr_result_t code = exr_get_count(x->file, &count);
    if (code != EXR_ERR_SUCCESS) return fail_exr(x, code);
    for (x->part = 0; x->part < count; x->part++) {
        exr_storage_t storage;
        const exr_attr_chlist_t *list = NULL;
        if (exr_get_storage(x->file, x->part, &storage) != EXR_ERR_SUCCESS ||
            exr_get_channels(x->file, x->part, &list) != EXR_ERR_SUCCESS || !list)
            continue;
        if (storage != EXR_STORAGE_SCANLINE && storage != EXR_STORAGE_TILED) {
            deep = true;
            continue;
        }
        if (choose_channels(x, list)) return PRT_OK;
    }
    if (deep)
        return prt_fail(x->ctx, PRT_FORMAT,
                        "%s: deep images are not supported; flatten it first", x->name);
    return prt_fail(x->ctx, PRT_FORMAT, "%s: has no channels R, G, B or Y", x->name);
}

static int read_windows(struct exr *x)
{
    exr_result_t code = exr_get_data_window(x->file, x->part, &x->data);
    if (code == EXR_ERR_SUCCESS) code = exr_get_display_window(x->file, x->part, &x->display);
    if (code != EXR_ERR_SUCCESS) return fail_exr(x, code);
    const int64_t w = (int64_t)x->data.max.x - x->data.min.x + 1;
    const int64_t h = (int64_t)x->data.max.y - x->data.min.y + 1;
    if (w <= 0 || h <= 0)
        return prt_fail(x->ctx, PRT_FORMAT, "%s: the data window is empty", x->name);
    if (w > PRT_IMAGE_MAX || h > PRT_IMAGE_MAX || (uint64_t)(w * h) > PRT_IMAGE_MAX_PIXELS)
        return prt_fail(x->ctx, PRT_LIMIT,
                        "%s: %lld x %lld pixels are above the limit of %d a "
                        "side",
                        x->name, (long long)w, (long long)h, PRT_IMAGE_MAX);
    x->width = (int32_t)w;
    x->height = (int32_t)h;
    return PRT_OK;
}

/* A chunk takes at least 8 bytes: refuses a file that declares more chunks than it can hold,
 * before memory is allocated for them. */
static int check_plausible(struct exr *x)
{
    int32_t chunks = 0;
    exr_result_t code = exr_get_chunk_count(x->file, x->part, &chunks);
    if (code != EXR_ERR_SUCCESS) return fail_exr(x, code);
    if ((uint64_t)chunks * 8 > x->size)
        return prt_fail(x->ctx, PRT_FORMAT,
                        "%s: the header declares %d chunks, too many for %zu bytes", x->name,
                        chunks, x->size);
    return PRT_OK;
}

static int reserve_planes(struct exr *x)
{
    uint64_t chunk_bytes = 0;
    for (int i = 0; i < N_PLANE; i++) {
        struct plane *p = &x->plane[i];
        if (p->channel < 0) continue;
        p->value = prt_calloc((size_t)x->width * (size_t)x->height, sizeof(float));
        if (!p->value)
            return prt_fail(x->ctx, PRT_NOMEM, "%s: no memory for %d x %d pixels", x->name,
                            x->width, x->height);
    }
    exr_result_t code = exr_get_chunk_unpacked_size(x->file, x->part, &chunk_bytes);
    if (code != EXR_ERR_SUCCESS) return fail_exr(x, code);
    const uint64_t limit =
        x->ctx && x->ctx->memory_limit ? x->ctx->memory_limit : UINT64_C(8) << 30;
    if (chunk_bytes > limit / 8)
        return prt_fail(x->ctx, PRT_LIMIT,
                        "%s: chunks of %llu bytes are above the limit of %llu", x->name,
                        (unsigned long long)chunk_bytes, (unsigned long long)(limit / 8));
    return PRT_OK;
}

/* ---- chunks ---- */

static int which_plane(const struct exr *x, int channel)
{
    for (int i = 0; i < N_PLANE; i++)
        if (x->plane[i].channel == channel) return i;
    return -1;
}

/* Decodes every channel to scratch memory, then copies the chosen channels to their planes. */
static int decode_chunk(struct exr *x, exr_decode_pipeline_t *pipe, int32_t left, int32_t top,
                        const exr_attr_chlist_t *list)
{
    size_t need = 0;
    for (int c = 0; c < pipe->channel_count; c++)
        need += (size_t)pipe->channels[c].width * (size_t)pipe->channels[c].height;
    if (need > x->scratch_count) {
        prt_free(x->scratch);
        x->scratch = prt_alloc(need, sizeof(float));
        x->scratch_count = x->scratch ? need : 0;
        if (!x->scratch)
            return prt_fail(x->ctx, PRT_NOMEM, "%s: no memory for a chunk", x->name);
    }
    float *at = x->scratch;
    for (int c = 0; c < pipe->channel_count; c++) {
        exr_coding_channel_info_t *info = &pipe->channels[c];
        info->decode_to_ptr = (uint8_t *)at;
        info->user_bytes_per_element = sizeof(float);
        info->user_data_type = EXR_PIXEL_FLOAT;
        info->user_pixel_stride = sizeof(float);
        info->user_line_stride = info->width * (int32_t)sizeof(float);
        if (info->data_type == EXR_PIXEL_UINT && which_plane(x, c) < 0)
            info->user_data_type = EXR_PIXEL_UINT;
        at += (size_t)info->width * (size_t)info->height;
    }
    exr_result_t code = exr_decoding_choose_default_routines(x->file, x->part, pipe);
    if (code == EXR_ERR_SUCCESS) code = exr_decoding_run(x->file, x->part, pipe);
    if (code != EXR_ERR_SUCCESS) return fail_exr(x, code);
    at = x->scratch;
    for (int c = 0; c < pipe->channel_count; c++) {
        const exr_coding_channel_info_t *info = &pipe->channels[c];
        const int i = which_plane(x, c);
        if (i >= 0) {
            struct plane *p = &x->plane[i];
            const int32_t room = x->width - left, n = info->width < room ? info->width : room;
            for (int32_t r = 0; n > 0 && r < info->height && top + r < x->height; r++)
                memcpy(p->value + (size_t)(top + r) * x->width + left,
                       at + (size_t)r * info->width, (size_t)n * sizeof(float));
        }
        at += (size_t)info->width * (size_t)info->height;
    }
    return PRT_OK;
}

static int next_chunk(struct exr *x, exr_decode_pipeline_t *pipe, const exr_chunk_info_t *info,
                      bool *started, int32_t left, int32_t top, const exr_attr_chlist_t *list)
{
    exr_result_t code = *started ? exr_decoding_update(x->file, x->part, info, pipe)
                                 : exr_decoding_initialize(x->file, x->part, info, pipe);
    *started = *started || code == EXR_ERR_SUCCESS;
    if (code != EXR_ERR_SUCCESS) return fail_exr(x, code);
    return decode_chunk(x, pipe, left, top, list);
}

static int read_scanlines(struct exr *x, exr_decode_pipeline_t *pipe, bool *started,
                          const exr_attr_chlist_t *list)
{
    int32_t step = 0;
    exr_result_t code = exr_get_scanlines_per_chunk(x->file, x->part, &step);
    if (code != EXR_ERR_SUCCESS || step < 1) return fail_exr(x, code);
    for (int32_t y = 0; y < x->height; y += step) {
        exr_chunk_info_t info;
        code = exr_read_scanline_chunk_info(x->file, x->part, x->data.min.y + y, &info);
        if (code != EXR_ERR_SUCCESS) return fail_exr(x, code);
        int err = next_chunk(x, pipe, &info, started, 0, y, list);
        if (err) return err;
    }
    return PRT_OK;
}

static int read_tiles(struct exr *x, exr_decode_pipeline_t *pipe, bool *started,
                      const exr_attr_chlist_t *list)
{
    int32_t tw = 0, th = 0;
    exr_result_t code = exr_get_tile_sizes(x->file, x->part, 0, 0, &tw, &th);
    if (code != EXR_ERR_SUCCESS || tw < 1 || th < 1) return fail_exr(x, code);
    for (int32_t y = 0; y * (int64_t)th < x->height; y++)
        for (int32_t tile = 0; tile * (int64_t)tw < x->width; tile++) {
            exr_chunk_info_t info;
            code = exr_read_tile_chunk_info(x->file, x->part, tile, y, 0, 0, &info);
            if (code != EXR_ERR_SUCCESS) return fail_exr(x, code);
            int err = next_chunk(x, pipe, &info, started, tile * tw, y * th, list);
            if (err) return err;
        }
    return PRT_OK;
}

static int read_pixels(struct exr *x)
{
    exr_decode_pipeline_t pipe = EXR_DECODE_PIPELINE_INITIALIZER;
    exr_storage_t storage = EXR_STORAGE_SCANLINE;
    const exr_attr_chlist_t *list = NULL;
    bool started = false;
    exr_get_storage(x->file, x->part, &storage);
    exr_get_channels(x->file, x->part, &list);
    int err = storage == EXR_STORAGE_TILED ? read_tiles(x, &pipe, &started, list)
                                           : read_scanlines(x, &pipe, &started, list);
    if (started) exr_decoding_destroy(x->file, &pipe);
    return err;
}

/* ---- the image ---- */

/* The image is the display window; pixels outside the data window are black. It is the data
 * window for environments (envmap attribute), for display windows that are empty, above the
 * limit or apart from the data window, and for data windows of the display window's size. */
static int compose(struct exr *x, bool envmap, struct prt_image *out)
{
    exr_attr_box2i_t box = x->display;
    int64_t w = (int64_t)box.max.x - box.min.x + 1, h = (int64_t)box.max.y - box.min.y + 1;
    const bool overlap = box.min.x <= x->data.max.x && box.max.x >= x->data.min.x &&
                         box.min.y <= x->data.max.y && box.max.y >= x->data.min.y;
    const bool shifted = w == x->width && h == x->height;
    if (envmap || shifted || w <= 0 || h <= 0 || w > PRT_IMAGE_MAX || h > PRT_IMAGE_MAX ||
        !overlap) {
        box = x->data;
        w = x->width;
        h = x->height;
    }
    int err = prt_image_reserve(x->ctx, x->name, (uint64_t)w, (uint64_t)h, out);
    if (err) return err;
    /* columns [first,last) and rows [top,bottom) of the image are inside the data window */
    const int64_t off_x = (int64_t)x->data.min.x - box.min.x;
    const int64_t off_y = (int64_t)x->data.min.y - box.min.y;
    const int64_t first = off_x > 0 ? off_x : 0, top = off_y > 0 ? off_y : 0;
    const int64_t last = off_x + x->width < w ? off_x + x->width : w;
    const int64_t bottom = off_y + x->height < h ? off_y + x->height : h;
    memset(out->rgb, 0, (size_t)w * (size_t)h * 3 * sizeof(float));
    for (int i = 0; i < N_PLANE; i++) {
        const float *value = x->plane[x->colour == COLOUR_GREY ? 0 : i].value;
        for (int64_t y = top; value && y < bottom; y++) {
            const float *src = value + (y - off_y) * x->width - off_x;
            float *dst = out->rgb + (size_t)y * (size_t)w * 3 + i;
            for (int64_t k = first; k < last; k++) dst[k * 3] = src[k];
        }
    }
    if (first > 0 || top > 0 || last < w || bottom < h)
        prt_log(x->ctx, PRT_LOG_WARNING,
                "%s: the data window is smaller than the image; the rest "
                "is black",
                x->name);
    return PRT_OK;
}

static bool is_subsampled(const struct exr *x)
{
    const exr_attr_chlist_t *list = NULL;
    exr_get_channels(x->file, x->part, &list);
    for (int i = 0; list && i < list->num_channels; i++)
        if (list->entries[i].x_sampling != 1 || list->entries[i].y_sampling != 1) return true;
    return false;
}

static int decode_file(struct exr *x, struct prt_decoded *out)
{
    exr_compression_t compression;
    exr_envmap_t envmap;
    int err = choose_part(x);
    if (!err) err = read_windows(x);
    if (!err) err = check_plausible(x);
    if (err) return err;
    exr_result_t code = exr_get_compression(x->file, x->part, &compression);
    if (code != EXR_ERR_SUCCESS) return fail_exr(x, code);
    const bool has_envmap =
        exr_attr_get_envmap(x->file, x->part, "envmap", &envmap) == EXR_ERR_SUCCESS;
    out->hint = !has_envmap                 ? PRT_HINT_NONE
                : envmap == EXR_ENVMAP_CUBE ? PRT_HINT_EXR_CUBE
                                            : PRT_HINT_EXR_LATLONG;
    if ((unsigned)compression >= EXR_COMPRESSION_LAST_TYPE)
        return prt_fail(x->ctx, PRT_FORMAT, "%s: unknown compression %d", x->name,
                        (int)compression);
    out->is_chroma = x->colour == COLOUR_CHROMA || is_subsampled(x);
    if (compression == EXR_COMPRESSION_DWAA || compression == EXR_COMPRESSION_DWAB ||
        out->is_chroma)
        return PRT_UNSUPPORTED;
    err = prt_image_check(x->ctx, x->name, (uint64_t)x->width, (uint64_t)x->height);
    if (!err) err = reserve_planes(x);
    if (!err) err = read_pixels(x);
    if (!err) err = compose(x, has_envmap, &out->image);
    return err;
}

int prt_decode_exr(const struct prt_context *ctx, const char *name, const uint8_t *bytes,
                   size_t n, struct prt_decoded *out)
{
    struct exr x = {.ctx = ctx, .name = name, .bytes = bytes, .size = n};
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.user_data = &x;
    init.read_fn = read_bytes;
    init.size_fn = file_size;
    init.error_handler_fn = keep_message;
    init.max_image_width = init.max_image_height = PRT_IMAGE_MAX;
    init.max_tile_width = init.max_tile_height = 4096;
    exr_result_t code = exr_start_read(&x.file, "image", &init);
    if (code != EXR_ERR_SUCCESS) return fail_exr(&x, code);
    if (x.why[0]) /* a warning: the library replaced a bad value by its default */
        prt_log(ctx, PRT_LOG_WARNING, "%s: %s", name, x.why);
    x.why[0] = 0;
    int err = decode_file(&x, out);
    exr_finish(&x.file);
    for (int i = 0; i < N_PLANE; i++) prt_free(x.plane[i].value);
    prt_free(x.scratch);
    if (err) prt_image_finish(&out->image);
    return err;
}
