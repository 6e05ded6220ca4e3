// SPDX-License-Identifier: MIT
// Materials from hostile text. What parses prints as text that parses to the same material.
#include <assert.h>
#include <math.h>
#include <string.h>

#include "prt/medium.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n);

static void quiet(void *user, enum prt_log_level level, const char *line)
{
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n)
{
    static char text[PRT_MATERIAL_TEXT], twice[PRT_MATERIAL_TEXT], short_text[1024];
    struct prt_material material, again;
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = quiet;
    if (prt_material_parse(&ctx, "fuzz", (const char *)bytes, n, &material)) return 0;
    assert(isfinite(material.eta) && isfinite(material.roughness));
    for (int c = 0; c < 3; c++)
        assert(material.sigma_a[c] >= 0 && isfinite(material.sigma_s_prime[c]));
    int length = prt_material_print(&material, text, sizeof text);
    assert(length > 0 && (size_t)length < sizeof text);
    assert(!prt_material_parse(&ctx, "printed", text, (size_t)length, &again));
    assert(prt_material_print(&again, twice, sizeof twice) == length);
    assert(!strcmp(text, twice));
    assert(prt_material_summary(&material, short_text, sizeof short_text) <= 512);
    return 0;
}
