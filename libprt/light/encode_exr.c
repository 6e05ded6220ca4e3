/* SPDX-License-Identifier: MIT */
/* Writer of OpenEXR through OpenEXRCore, to memory: ZIP-compressed scanlines. */
#include "light_private.h"

#include <openexr.h>
#include <string.h>

struct sink {
    uint8_t *bytes;
    size_t size, room;
};

static int64_t write_bytes(exr_const_context_t file, void *user, const void *buffer, uint64_t n,
                           uint64_t offset, exr_stream_error_func_ptr_t error)
{
    struct sink *s = user;
    if (offset + n > s->room) {
        const size_t room = (size_t)(offset + n) * 2;
        uint8_t *grown = prt_calloc(room, 1);
        if (!grown) return -1;
        if (s->bytes) memcpy(grown, s->bytes, s->size);
        prt_free(s->bytes);
        s->bytes = grown;
        s->room = room;
    }
    memcpy(s->bytes + offset, buffer, n);
    s->size = offset + n > s->size ? (size_t)(offset + n) : s->size;
    return (int64_t)n;
}

static void ignore_message(exr_const_context_t file, exr_result_t code, const char *message)
{
}

static exr_result_t write_header(exr_context_t file, int *part, const struct prt_image *im,
                                 bool full_float, int envmap)
{
    static const char *const names[4] = {"A", "B", "G", "R"}; // in the format's order
    exr_result_t code = exr_add_part(file, "rgb", EXR_STORAGE_SCANLINE, part);
    if (code == EXR_ERR_SUCCESS)
        code = exr_initialize_required_attr_simple(file, *part, (int32_t)im->width,
                                                   (int32_t)im->height, EXR_COMPRESSION_ZIP);
    for (int c = im->alpha ? 0 : 1; code == EXR_ERR_SUCCESS && c < 4; c++)
        code = exr_add_channel(file, *part, names[c],
                               full_float ? EXR_PIXEL_FLOAT : EXR_PIXEL_HALF,
                               EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1);
    if (code == EXR_ERR_SUCCESS && envmap >= 0)
        code = exr_attr_set_envmap(file, *part, "envmap", (exr_envmap_t)envmap);
    if (code == EXR_ERR_SUCCESS) code = exr_write_header(file);
    return code;
}

static exr_result_t write_chunks(exr_context_t file, int part, const struct prt_image *im)
{
    exr_encode_pipeline_t pipe = EXR_ENCODE_PIPELINE_INITIALIZER;
    int32_t step = 0;
    exr_result_t code = exr_get_scanlines_per_chunk(file, part, &step);
    bool started = false;
    for (int32_t y = 0; code == EXR_ERR_SUCCESS && y < (int32_t)im->height; y += step) {
        exr_chunk_info_t info;
        code = exr_write_scanline_chunk_info(file, part, y, &info);
        if (code == EXR_ERR_SUCCESS)
            code = started ? exr_encoding_update(file, part, &info, &pipe)
                           : exr_encoding_initialize(file, part, &info, &pipe);
        if (code != EXR_ERR_SUCCESS) break;
        for (int c = 0; c < pipe.channel_count; c++) {
            exr_coding_channel_info_t *ch = &pipe.channels[c];
            const bool alpha = ch->channel_name[0] == 'A';
            const size_t n_value = alpha ? 1 : 3;
            const int from = ch->channel_name[0] == 'R'   ? 0
                             : ch->channel_name[0] == 'G' ? 1
                                                          : 2;
            const float *row = alpha ? im->alpha + (size_t)y * im->width
                                     : im->rgb + (size_t)y * im->width * 3 + from;
            ch->user_bytes_per_element = sizeof(float);
            ch->user_data_type = EXR_PIXEL_FLOAT;
            ch->user_pixel_stride = (int32_t)(n_value * sizeof(float));
            ch->user_line_stride = (int32_t)(im->width * n_value * sizeof(float));
            ch->encode_from_ptr = (const uint8_t *)row;
        }
        if (!started) code = exr_encoding_choose_default_routines(file, part, &pipe);
        started = true;
        if (code == EXR_ERR_SUCCESS) code = exr_encoding_run(file, part, &pipe);
    }
    if (started) exr_encoding_destroy(file, &pipe);
    return code;
}

static int encode(const struct prt_context *ctx, const struct prt_image *image, bool full_float,
                  int envmap, struct prt_blob *out)
{
    struct sink sink = {0};
    exr_context_t file = NULL;
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    int part = 0;
    memset(out, 0, sizeof *out);
    if (!image->rgb || !image->width || !image->height || image->width > PRT_IMAGE_MAX ||
        image->height > PRT_IMAGE_MAX)
        return prt_fail(ctx, PRT_ARG, "EXR of %u x %u: allowed are 1 to %d pixels a side",
                        image->width, image->height, PRT_IMAGE_MAX);
    const size_t count = (size_t)image->width * image->height * 3;
    struct prt_image copy = {image->width, image->height, NULL, image->alpha};
    if (!full_float) { /* the largest half, not infinity */
        copy.rgb = prt_alloc(count, sizeof(float));
        if (!copy.rgb) return prt_fail(ctx, PRT_NOMEM, "no memory for an EXR");
        for (size_t i = 0; i < count; i++) {
            const float v = image->rgb[i];
            copy.rgb[i] = v > 65504.0f ? 65504.0f : v < -65504.0f ? -65504.0f : v;
        }
        image = &copy;
    }
    init.user_data = &sink;
    init.write_fn = write_bytes;
    init.error_handler_fn = ignore_message;
    init.zip_level = 2; /* a tenth larger than the default level, three times as fast */
    exr_result_t code = exr_start_write(&file, "memory", EXR_WRITE_FILE_DIRECTLY, &init);
    if (code == EXR_ERR_SUCCESS) code = write_header(file, &part, image, full_float, envmap);
    if (code == EXR_ERR_SUCCESS) code = write_chunks(file, part, image);
    if (file) {
        const exr_result_t end = exr_finish(&file);
        code = code == EXR_ERR_SUCCESS ? end : code;
    }
    prt_free(copy.rgb);
    if (code != EXR_ERR_SUCCESS) {
        prt_free(sink.bytes);
        return prt_fail(ctx, PRT_INTERNAL, "cannot encode an EXR: %s",
                        exr_get_default_error_message(code));
    }
    out->bytes = sink.bytes;
    out->size = sink.size;
    return PRT_OK;
}

int prt_encode_exr(const struct prt_context *ctx, const struct prt_image *image,
                   bool full_float, struct prt_blob *out)
{
    return encode(ctx, image, full_float, -1, out);
}

int prt_write_exr(const struct prt_context *ctx, const char *path,
                  const struct prt_image *image, bool full_float, bool envmap_cube)
{
    struct prt_blob blob;
    if (envmap_cube && image->height != image->width * 6)
        return prt_fail(ctx, PRT_ARG, "%s: a cube EXR is n x 6n pixels, not %u x %u", path,
                        image->width, image->height);
    int err = encode(ctx, image, full_float, envmap_cube ? EXR_ENVMAP_CUBE : -1, &blob);
    if (!err) err = prt_write_file(ctx, path, blob.bytes, blob.size);
    prt_free(blob.bytes);
    return err;
}
