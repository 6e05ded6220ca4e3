// SPDX-License-Identifier: MIT
// Owns the only C++ of this room: OpenImageIO behind extern "C", built as libprt_oiio.so.
#include "oiio_abi.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <vector>

namespace {

int fail(prt_oiio_image *image, const std::string &why)
{
    std::snprintf(image->error, sizeof image->error, "%s",
                  why.empty() ? "not an image of a known format" : why.c_str());
    return -1;
}

int decode(const char *name, const void *bytes, size_t n, prt_oiio_size_fn allow, void *user,
           prt_oiio_image *image)
{
    OIIO::attribute("threads", 1);
    OIIO::attribute("exr_threads", -1);
    OIIO::attribute("limits:channels", 1024);
    OIIO::Filesystem::IOMemReader memory(const_cast<void *>(bytes), n);
    OIIO::ImageSpec config;
    config.attribute("oiio:UnassociatedAlpha", 1);
    auto input = OIIO::ImageInput::open(name, &config, &memory);
    if (!input)
        return fail(image, OIIO::geterror());
    const OIIO::ImageSpec spec = input->spec();
    if (spec.width <= 0 || spec.height <= 0 || spec.depth > 1 || spec.nchannels < 1)
        return fail(image, "no flat image");
    if (spec.deep)
        return fail(image, "deep images are not supported, flatten it first");
    if (allow(user, uint64_t(spec.width), uint64_t(spec.height)))
        return fail(image, "the image is above the size limit");
    int first = 0;
    for (int c = 0; c + 2 < spec.nchannels; c++)
        if (spec.channelnames[c] == "R" && spec.channelnames[c + 1] == "G")
            first = c;
    const int count = spec.nchannels >= first + 3 ? 3 : 1;
    const size_t pixels = size_t(spec.width) * size_t(spec.height);
    float *rgb = static_cast<float *>(std::calloc(pixels * 3, sizeof(float)));
    if (!rgb)
        return fail(image, "no memory");
    if (!input->read_image(0, 0, first, first + count, OIIO::TypeDesc::FLOAT,
                           rgb, sizeof(float) * 3)) {
        std::free(rgb);
        return fail(image, input->geterror());
    }
    for (size_t i = 0; count == 1 && i < pixels; i++)
        rgb[i * 3 + 1] = rgb[i * 3 + 2] = rgb[i * 3];
    image->width = uint32_t(spec.width);
    image->height = uint32_t(spec.height);
    image->rgb = rgb;
    image->is_srgb = !spec.format.is_floating_point();
    input->close();
    return 0;
}

} // namespace

extern "C" __attribute__((visibility("default"))) int
prt_oiio_decode(const char *name, const void *bytes, size_t n, prt_oiio_size_fn allow, void *user,
                prt_oiio_image *image)
{
    std::memset(image, 0, sizeof *image);
    try {
        return decode(name, bytes, n, allow, user, image);
    } catch (const std::exception &e) {
        return fail(image, e.what());
    } catch (...) {
        return fail(image, "unknown exception");
    }
}
