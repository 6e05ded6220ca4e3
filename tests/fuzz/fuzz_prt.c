// SPDX-License-Identifier: MIT
// .prt files with a header that a forger made consistent: what opens must relight, on every
// instruction set, without touching anything outside the file.
#include <stdlib.h>
#include <string.h>
#define XXH_INLINE_ALL
#include <xxhash.h>

#include "format.h"
#include "prt/relight.h"

static void quiet(void *user, enum prt_log_level level, const char *line)
{
}

static void relight(struct prt_context *ctx, const struct prt_tensor *t, uint32_t cube)
{
    struct prt_light light = {cube, prt_calloc(24ull * cube * cube, 4)};
    const struct prt_light *lights[3] = {&light, &light, &light};
    bool free_material = t->coupling == PRT_COUPLE_FULL || t->storage == PRT_STORAGE_RADIAL;
    float *coef = free_material ? prt_calloc(3ull * t->n_radial, 4) : NULL;
    float *color = prt_alloc(9ull * t->n_phase * t->n_vertex, 4);
    static const unsigned masks[] = {PRT_CPU_C, PRT_CPU_AVX2, ~0u};
    for (int i = 0; i < 3; i++) {
        ctx->cpu = prt_cpu_detect() & masks[i];
        if (color && light.coef) prt_relight(ctx, t, 3, lights, coef, false, color);
    }
    prt_free(light.coef);
    prt_free(coef);
    prt_free(color);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n);

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n)
{
    struct prt_context ctx;
    struct prt_file *file;
    struct format_header *h = malloc(n ? n : 1);
    prt_context_init(&ctx);
    ctx.log = quiet;
    if (n) memcpy(h, bytes, n);
    uint64_t sealed = n < sizeof *h ? 0 : sizeof *h + format_padded(32ull * h->n_section);
    if (sealed && sealed <= n) {
        h->file_bytes = n;
        h->hash = 0;
        h->hash = XXH3_64bits(h, sealed);
    }
    if (!prt_file_open_memory(&ctx, "fuzz", h, n, PRT_FILE_CHECK_HEADERS, &file)) {
        const struct prt_transport *t = prt_file_transport(file);
        for (uint32_t i = 0; i < t->n_tensor && t->cube <= 64; i++)
            relight(&ctx, &t->tensor[i], t->cube);
        prt_file_close(file);
    }
    free(h);
    return 0;
}
