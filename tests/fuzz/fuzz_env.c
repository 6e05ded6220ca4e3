// SPDX-License-Identifier: MIT
// Environments: our own .hdr, .dds and .ktx parsers run in this process, other formats as they
// always do, in a child. Whatever loads must resample to finite, non-negative texels.
#include "light/light_private.h"

#include <assert.h>
#include <math.h>

static void quiet(void *user, enum prt_log_level level, const char *line)
{
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n);

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n)
{
    struct prt_context ctx;
    struct prt_decoded in = {0};
    struct prt_env *env = NULL;
    struct prt_cube cube;
    prt_context_init(&ctx);
    ctx.log = quiet;
    ctx.memory_limit = 64 << 20;
    if (prt_is_hdr(bytes, n) || prt_is_dds(bytes, n) || prt_is_ktx(bytes, n)) {
        if (!prt_decode(&ctx, "fuzz", bytes, n, &in)) prt_image_finish(&in.image);
    } else if (prt_is_exr(bytes, n) && !prt_env_load_memory(&ctx, "fuzz", bytes, n, &env)) {
        assert(!prt_env_to_cube(&ctx, env, 8, 30, &cube));
        for (int i = 0; i < 6 * 8 * 8 * 3; i++)
            assert(cube.texel[i] >= 0 && isfinite(cube.texel[i]));
        prt_cube_finish(&cube);
        prt_env_destroy(env);
    }
    return 0;
}
