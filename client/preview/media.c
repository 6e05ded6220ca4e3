// SPDX-License-Identifier: MIT
// Media of the fetched model by object, with those of --material in their place.
#include "preview.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int fail(const char *text)
{
    fprintf(stderr, "relight-preview: %s\n", text);
    return EXIT_FAILED;
}

// The model's own media, as the daemon names them; to prt_free().
static int read_own(struct scene *scene, struct prt_media **out)
{
    const struct relight_geometry *g = &scene->geometry;
    uint8_t *of_object = prt_calloc(scene->mesh.n_object, 1);
    struct prt_material *medium = prt_calloc(g->n_medium, sizeof *medium);
    struct prt_media own = {(uint32_t)g->n_medium, medium, of_object};
    int status = of_object && medium ? EXIT_DONE : fail("not enough memory for the media");
    for (size_t i = 0; i < g->n_medium && !status; i++)
        if (prt_material_parse(&scene->ctx, "a material of the model", g->medium[i],
                               strlen(g->medium[i]), &medium[i]))
            status = EXIT_FAILED;
    for (size_t i = 0; i < g->n_block && !status; i++) {
        const struct relight_block *b = &g->block[i];
        if (b->translucent && b->medium >= own.n) status = fail("a block has no material");
        else if (b->translucent) of_object[b->object] = (uint8_t)b->medium;
    }
    if (!status && !(*out = prt_media_copy(&own, scene->mesh.n_object)))
        status = fail("not enough memory for the media");
    prt_free(of_object);
    prt_free(medium);
    return status;
}

// Reads --material into material[] and entry[], and as texts for the daemon.
static int read_given(struct scene *scene, unsigned n_given, const char *const *given,
                      struct prt_material *material, struct prt_media_entry *entry)
{
    for (unsigned i = 0; i < n_given; i++) {
        const size_t n = prt_media_name_length(given[i]);
        int status = prt_material_load(&scene->ctx, given[i] + (n ? n + 1 : 0), &material[i]);
        if (status) return status == PRT_ARG ? EXIT_USAGE : EXIT_FAILED;
        scene->text[i] = malloc(PRT_MATERIAL_TEXT);
        if (!scene->text[i]) return fail("not enough memory for the media");
        prt_material_print(&material[i], scene->text[i], PRT_MATERIAL_TEXT);
        snprintf(scene->object[i], sizeof scene->object[i], "%.*s", n < 127 ? (int)n : 127,
                 given[i]);
        entry[i] = (struct prt_media_entry){scene->object[i], &material[i]};
        if (n)
            scene->given[scene->shade.n_material++] =
                (struct relight_object_material){scene->object[i], scene->text[i]};
        else scene->shade.material = scene->text[i];
    }
    scene->shade.materials = scene->given;
    scene->shade.variant = scene->options->variant;
    return EXIT_DONE;
}

int scene_media(struct scene *scene, const char *more)
{
    const char *given[PRT_MEDIA_MAX + 1];
    unsigned n_given = scene->options->n_material;
    memcpy(given, scene->options->material, n_given * sizeof *given);
    if (more) given[n_given++] = more;
    scene_media_finish(scene);
    struct prt_media *own = NULL;
    struct prt_material *material = prt_alloc(PRT_MEDIA_MAX, sizeof *material);
    struct prt_media_entry entry[PRT_MEDIA_MAX];
    if (!scene->geometry.n_medium || scene->geometry.n_medium > PRT_MEDIA_MAX) {
        prt_free(material);
        return fail("the daemon names no materials of the model");
    }
    int status = material ? read_own(scene, &own) : fail("not enough memory for the media");
    if (!status) status = read_given(scene, n_given, given, material, entry);
    if (!status &&
        prt_media_edit(&scene->ctx, &scene->mesh, own, n_given, entry, &scene->media))
        status = EXIT_USAGE;
    for (uint32_t i = 0; !status && i < scene->media->n; i++)
        for (int c = 0; c < 3; c++) scene->anisotropic |= scene->media->medium[i].g[c] != 0;
    prt_free(material);
    prt_free(own);
    return status;
}

void scene_media_finish(struct scene *scene)
{
    prt_free(scene->media);
    for (unsigned i = 0; i < PRT_MEDIA_MAX; i++) free(scene->text[i]);
    scene->media = NULL;
    memset(scene->text, 0, sizeof scene->text);
    scene->shade = (struct relight_shade){0};
    scene->anisotropic = false;
}
