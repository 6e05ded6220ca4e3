// SPDX-License-Identifier: MIT
#include "core/image_format.h"

#include "relight.pb-c.h"

#include <stddef.h>

static const struct image_format formats[] = {
    [RELIGHT__IMAGE_FORMAT__IMAGE_JPEG] = {"image/jpeg", ".jpg"},
    [RELIGHT__IMAGE_FORMAT__IMAGE_PNG] = {"image/png", ".png"},
    [RELIGHT__IMAGE_FORMAT__IMAGE_EXR] = {"image/x-exr", ".exr"},
    [RELIGHT__IMAGE_FORMAT__IMAGE_EXR_FLOAT] = {"image/x-exr", ".exr", .full_float = true},
    [RELIGHT__IMAGE_FORMAT__IMAGE_PNG16] = {"image/png", ".png", .fine = true},
    [RELIGHT__IMAGE_FORMAT__IMAGE_RGB8] = {"application/octet-stream"},
    [RELIGHT__IMAGE_FORMAT__IMAGE_F16] = {"application/octet-stream"},
};

const struct image_format *image_format_of(unsigned format)
{
    return format < sizeof formats / sizeof *formats && formats[format].media_type
               ? &formats[format]
               : NULL;
}
