// SPDX-License-Identifier: MIT
// The media of SOURCE's objects: --material by object, the file's own materials, baked media.
#include "tool.h"

#include <stdio.h>
#include <string.h>

// The entries of --material and what they refer to.
struct given {
    struct prt_material material[PRT_MEDIA_MAX];
    char name[PRT_MEDIA_MAX][128]; // longer names are cut, and no object has one
    struct prt_media_entry entry[PRT_MEDIA_MAX];
    unsigned n;
};

static int read_given(struct tool *tool, struct given *g)
{
    const struct options *o = &tool->opt;
    for (g->n = 0; g->n < o->n_material; g->n++) {
        const char *text = o->material[g->n];
        const size_t n = prt_media_name_length(text);
        int status =
            material_named(tool, "material", text + (n ? n + 1 : 0), &g->material[g->n]);
        if (status) return status;
        snprintf(g->name[g->n], sizeof g->name[0], "%.*s", n < 127 ? (int)n : 127, text);
        g->entry[g->n] = (struct prt_media_entry){g->name[g->n], &g->material[g->n]};
    }
    return EXIT_DONE;
}

// Whether a translucent block has no medium; *some: another has one.
static bool any_missing(const struct prt_mesh *mesh,
                        const struct prt_material *const of_block[], bool *some)
{
    bool missing = false;
    *some = false;
    for (uint32_t i = 0; i < mesh->n_block; i++) {
        if (!mesh->surface[mesh->block[i].surface].translucent) continue;
        missing |= !of_block[i];
        *some |= of_block[i] != NULL;
    }
    return missing;
}

static int fill_rest(struct tool *tool, const struct source *source,
                     const struct prt_material *fallback, const struct prt_material *of_block[])
{
    const struct prt_mesh *mesh = source->mesh;
    bool some, missing = any_missing(mesh, of_block, &some);
    if (missing && !fallback && !some)
        return usage_error(
            &tool->opt, "%s is a model whose own materials give no medium: it needs --material",
            source->path);
    for (uint32_t i = 0; i < mesh->n_block; i++)
        if (!of_block[i]) of_block[i] = fallback;
    return EXIT_DONE;
}

// A map that does not fit is wrong usage.
static int media_exit(const struct tool *tool, int status)
{
    return status == PRT_ARG ? EXIT_USAGE : tool_exit(tool, status);
}

int source_media(struct tool *tool, struct source *source, const struct prt_material *fallback)
{
    struct prt_mesh *mesh = source->loaded;
    struct given *given = prt_alloc(1, sizeof *given);
    struct prt_material *own = prt_alloc(mesh->n_surface, sizeof *own);
    const struct prt_material **of_block = prt_calloc(mesh->n_block, sizeof *of_block);
    int status = given && own && of_block
                     ? read_given(tool, given)
                     : tool_exit(tool, prt_fail(&tool->ctx, PRT_NOMEM, "no memory"));
    if (!status)
        status = media_exit(
            tool, prt_media_assign(&tool->ctx, mesh, given->n, given->entry, of_block));
    if (!status) {
        prt_media_own(&tool->ctx, mesh, own, of_block);
        status = fill_rest(tool, source, fallback, of_block);
    }
    if (!status) status = media_exit(tool, prt_media_divide(&tool->ctx, mesh, of_block));
    if (!status)
        status = media_exit(tool, prt_media_create(&tool->ctx, mesh, of_block, &source->made));
    if (!status) {
        source->media = *source->made;
        source->media_given = given->n > 0;
    }
    prt_free(given);
    prt_free(own);
    prt_free(of_block);
    return status;
}

int source_media_edit(struct tool *tool, struct source *source)
{
    struct given *given = prt_alloc(1, sizeof *given);
    int status = given ? read_given(tool, given)
                       : tool_exit(tool, prt_fail(&tool->ctx, PRT_NOMEM, "no memory"));
    if (!status)
        status = media_exit(tool, prt_media_edit(&tool->ctx, source->mesh, &source->media,
                                                 given->n, given->entry, &source->made));
    if (!status) {
        source->media = *source->made;
        source->media_given = true;
    }
    prt_free(given);
    return status;
}
