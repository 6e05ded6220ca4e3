// SPDX-License-Identifier: MIT
// .prt files with a header that a forger made consistent: what opens must relight, on every
// instruction set, without touching anything outside the file.
#include <stdlib.h>
#include <string.h>
#define XXH_INLINE_ALL
#include <xxhash.h>

#include "format.h"
#include "prt/radial.h"
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

// Media in the basis of a tensor of walks: a material or an error, never another address.
static void apply_medium(struct prt_context *ctx, const struct prt_transport *t)
{
    const struct prt_material medium = {
        .sigma_s_prime = {0.3f, 1, 8}, .sigma_a = {0, 0.02f, 0.7f}, .eta = 1.3f};
    const struct prt_media media = prt_media_one(&medium);
    struct prt_cube light;
    double error;
    (void)prt_answer_material_error(ctx, t, &media, PRT_ANSWER_MULTIPLE, &error);
    if (prt_cube_init(&light, t->cube)) return;
    const struct prt_query query = {
        .term = PRT_ANSWER_MULTIPLE, .light = &light, .media = media};
    float(*color)[3] = prt_calloc(t->mesh.n_vertex, sizeof *color);
    if (color) (void)prt_answer_colors(ctx, t, &query, color);
    prt_free(color);
    prt_cube_finish(&light);
}

static bool is_of_walks(const struct prt_transport *t)
{
    bool any = false;
    for (uint32_t i = 0; i < t->n_tensor; i++)
        any |= t->tensor[i].n_knot && t->tensor[i].basis_kind == PRT_RADIAL_WALK;
    return any && t->n_tensor == 1 && t->cube <= 64;
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
        if (is_of_walks(t)) apply_medium(&ctx, t);
        prt_file_close(file);
    }
    free(h);
    return 0;
}
