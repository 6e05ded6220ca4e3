// SPDX-License-Identifier: MIT
// Views of an open file in one of its variants (prt/variant.h).
#include "render/evaluation.h"
#include "net/errors.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void variant_keep_error(void *user, enum prt_log_level level, const char *line)
{
    snprintf(user, 300, "%s", line);
}

static void destroy(void *value)
{
    struct variant_view *view = value;
    prt_variant_destroy(view->variant);
    cache_release(view->file);
    free(view);
}

static struct variant_view *create(const struct model *model, const struct render_spec *spec,
                                   struct cache_entry *file, int *code, char error[300])
{
    const struct prt_context ctx = {.log = variant_keep_error, .log_user = error};
    const struct prt_transport *t = prt_file_transport(file->value);
    struct variant_view *view = calloc(1, sizeof *view);
    int status = PRT_NOMEM;
    snprintf(error, 300, "not enough memory");
    if (view)
        status = prt_variant_create(&ctx, model->name, &t->mesh, &t->media,
                                    prt_transport_variants(t), spec->variant, &view->variant);
    if (!status) {
        cache_hold(view->file = file);
        return view;
    }
    free(view);
    *code = error_of_status(status);
    return NULL;
}

// Made on the loop's thread: it reads blocks and media, not vertices.
struct cache_entry *variant_get(struct model *model, const struct render_spec *spec,
                                struct cache_entry *file, int *code, char error[300])
{
    char key[sizeof model->key + VARIANT_NAME + 40];
    bool fresh;
    snprintf(key, sizeof key, "%s/variant/%llx/%s", model->key,
             (unsigned long long)prt_file_hash(file->value), spec->variant);
    struct cache_entry *entry = cache_find(model->server->cache, key);
    if (entry) return entry;
    struct variant_view *view = create(model, spec, file, code, error);
    if (!view) return NULL;
    entry = cache_get(model->server->cache, key, &fresh);
    if (!fresh) { // no memory
        destroy(view);
        return entry;
    }
    entry->holds_file = true;
    cache_fill(entry, view,
               sizeof *view + sizeof *view->variant +
                   view->variant->mesh.n_block * (sizeof(struct prt_block) + 12),
               destroy);
    return entry;
}
