// SPDX-License-Identifier: MIT
// OpenImageIO behind extern "C", built as libprt_oiio.so, and OpenEXR's own reader for
// luminance-chroma files, which OpenImageIO refuses.
#include "oiio_abi.h"

#include <ImfIO.h>
#include <ImfRgbaFile.h>
#include <ImfThreading.h>
#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <vector>

namespace
{

int fail(prt_oiio_image *image, const std::string &reason)
{
    std::snprintf(image->error, sizeof image->error, "%s",
                  reason.empty() ? "not an image of a known format" : reason.c_str());
    return -1;
}

class Memory : public OPENEXR_IMF_NAMESPACE::IStream
{
  public:
    Memory(const void *bytes, size_t n)
        : IStream("memory"), bytes_(static_cast<const char *>(bytes)), n_(n)
    {
    }
    bool read(char *to, int count) override
    {
        if (count < 0 || size_t(count) > n_ - at_)
            throw std::runtime_error("the file ends too early");
        std::memcpy(to, bytes_ + at_, size_t(count));
        at_ += size_t(count);
        return at_ < n_;
    }
    uint64_t tellg() override
    {
        return at_;
    }
    void seekg(uint64_t to) override
    {
        at_ = to < n_ ? size_t(to) : n_;
    }

  private:
    const char *bytes_;
    size_t n_, at_ = 0;
};

// Luminance-chroma images come out as RGB.
int decode_chroma(const void *bytes, size_t n, prt_oiio_size_fn allow, void *user,
                  prt_oiio_image *image)
{
    using namespace OPENEXR_IMF_NAMESPACE;
    setGlobalThreadCount(0);
    Memory memory(bytes, n);
    RgbaInputFile file(memory);
    const auto box = file.dataWindow();
    const int64_t w = int64_t(box.max.x) - box.min.x + 1,
                  h = int64_t(box.max.y) - box.min.y + 1;
    if (w <= 0 || h <= 0 || allow(user, uint64_t(w), uint64_t(h)))
        return fail(image, "the image is above the size limit");
    std::vector<Rgba> line(static_cast<size_t>(w));
    image->rgb = static_cast<float *>(std::malloc(size_t(w * h) * 3 * sizeof(float)));
    if (!image->rgb) return fail(image, "no memory");
    for (int64_t y = 0; y < h; y++) {
        const int at = int(box.min.y + y);
        file.setFrameBuffer(line.data() - box.min.x, 1, 0);
        file.readPixels(at);
        for (int64_t x = 0; x < w; x++) {
            float *p = image->rgb + (y * w + x) * 3;
            p[0] = line[size_t(x)].r;
            p[1] = line[size_t(x)].g;
            p[2] = line[size_t(x)].b;
        }
    }
    image->width = uint32_t(w);
    image->height = uint32_t(h);
    return 0;
}

int decode(const char *name, const void *bytes, size_t n, prt_oiio_size_fn allow, void *user,
           prt_oiio_image *image)
{
    OIIO::attribute("threads", 1);
    OIIO::attribute("exr_threads", -1);
    OIIO::attribute("limits:channels", 1024);
    OIIO::Filesystem::IOMemReader memory(const_cast<void *>(bytes), n);
    OIIO::ImageSpec config;
    void *proxy = &memory; // the EXR reader takes the proxy from here, the others from open()
    config.attribute("oiio:ioproxy", OIIO::TypeDesc::PTR, &proxy);
    config.attribute("oiio:UnassociatedAlpha", 1);
    auto input = OIIO::ImageInput::open(name, &config, &memory);
    if (!input) return fail(image, OIIO::geterror());
    const OIIO::ImageSpec spec = input->spec();
    if (spec.width <= 0 || spec.height <= 0 || spec.depth > 1 || spec.nchannels < 1)
        return fail(image, "not a flat image (depth or channel count)");
    if (spec.deep) return fail(image, "deep images are not supported; flatten it first");
    if (allow(user, uint64_t(spec.width), uint64_t(spec.height)))
        return fail(image, "the image is above the size limit");
    int first = 0;
    for (int c = 0; c + 2 < spec.nchannels; c++)
        if (spec.channelnames[c] == "R" && spec.channelnames[c + 1] == "G") first = c;
    const int count = spec.nchannels >= first + 3 ? 3 : 1;
    const size_t pixels = size_t(spec.width) * size_t(spec.height);
    float *rgb = static_cast<float *>(std::calloc(pixels * 3, sizeof(float)));
    if (!rgb) return fail(image, "no memory");
    if (!input->read_image(0, 0, first, first + count, OIIO::TypeDesc::FLOAT, rgb,
                           sizeof(float) * 3)) {
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
prt_oiio_decode(const char *name, const void *bytes, size_t n, int is_chroma,
                prt_oiio_size_fn allow, void *user, prt_oiio_image *image)
{
    std::memset(image, 0, sizeof *image);
    try {
        if (is_chroma) return decode_chroma(bytes, n, allow, user, image);
        return decode(name, bytes, n, allow, user, image);
    } catch (const std::exception &e) {
        return fail(image, e.what());
    } catch (...) {
        return fail(image, "unknown exception");
    }
}
