// SPDX-License-Identifier: MIT
// Other programs' materials from hostile text: MaterialX, Principled JSON, pbrt. A medium that
// is found is in range.
#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "prt/medium.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n);

static void quiet(void *user, enum prt_log_level level, const char *line)
{
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n)
{
    struct prt_import *item;
    const struct prt_import *chosen;
    unsigned count;
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = quiet;
    char *text = malloc(n + 1);
    if (!text) return 0;
    memcpy(text, bytes, n);
    text[n] = 0;
    if (!prt_material_import(&ctx, "fuzz", text, n, 0, &item, &count)) {
        assert(count > 0);
        for (unsigned i = 0; i < count; i++) {
            assert(memchr(item[i].name, 0, sizeof item[i].name));
            if (item[i].has_medium) assert(!prt_material_check(&ctx, &item[i].material));
            else assert(item[i].why_not[0]);
        }
        (void)prt_import_choose(&ctx, "fuzz", item, count, NULL, &chosen);
        prt_free(item);
    }
    free(text);
    return 0;
}
