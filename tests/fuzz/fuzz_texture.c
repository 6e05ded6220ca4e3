// SPDX-License-Identifier: MIT
// Images of models from hostile bytes: any result but a crash, a leak or a hang will do; what
// is accepted has a valid mip chain.
#include "prt/texture.h"

#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n);

static void quiet(void *user, enum prt_log_level level, const char *line)
{
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n)
{
    struct prt_context ctx;
    struct prt_texture_image image;
    uint32_t width, height;
    uint8_t *texel;
    prt_context_init(&ctx);
    ctx.log = quiet;
    if (prt_texture_decode(&ctx, "fuzz", bytes, n, 4 << 20, &width, &height, &texel)) return 0;
    prt_texture_finish_levels(width, height, n % PRT_TEXTURE_N_KIND, texel, &image);
    if (!prt_texture_image_valid(&image, 4 << 20)) abort();
    prt_free(texel);
    return 0;
}
