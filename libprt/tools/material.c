// SPDX-License-Identifier: MIT
// prt material: media of other programs' materials, listed or written as JSON.
#include "tool.h"

#include <cjson/cJSON.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

// The materials of IN and the one that was chosen.
struct media {
    struct prt_import *item;
    unsigned n;
    char path[4096];
    const char *name; // after '#', or NULL
};

static int list_names(const struct tool *tool)
{
    const struct prt_material *m;
    cJSON *list = cJSON_CreateArray();
    for (unsigned i = 0; (m = prt_material_preset(i)); i++)
        cJSON_AddItemToArray(list, cJSON_CreateString(m->name));
    for (unsigned i = 0; (m = prt_material_named_medium(i)); i++)
        cJSON_AddItemToArray(list, cJSON_CreateString(m->name));
    const cJSON *name;
    char *text = tool->opt.json ? cJSON_PrintUnformatted(list) : NULL;
    if (text) puts(text);
    else cJSON_ArrayForEach(name, list) puts(name->valuestring);
    free(text);
    cJSON_Delete(list);
    return EXIT_DONE;
}

static bool is_model(const char *path)
{
    size_t n = strlen(path);
    return (n > 4 && !strcasecmp(path + n - 4, ".glb")) ||
           (n > 5 && !strcasecmp(path + n - 5, ".gltf"));
}

// A model's translucent materials.
static int read_model(struct tool *tool, struct media *out)
{
    struct prt_mesh *mesh;
    struct prt_mesh_options options = {.no_textures = true};
    double unit = tool->opt.mm_per_unit > 0 ? tool->opt.mm_per_unit : 1000;
    int status = prt_mesh_load(&tool->ctx, out->path, &options, &mesh);
    if (status) return tool_exit(tool, status);
    out->item = prt_calloc(mesh->n_surface, sizeof *out->item);
    for (uint32_t i = 0; out->item && i < mesh->n_surface; i++) {
        struct prt_import *item = &out->item[out->n++];
        const struct prt_surface *s = &mesh->surface[i];
        snprintf(item->name, sizeof item->name, "%s", s->name);
        snprintf(item->format, sizeof item->format, "glTF");
        bool given = mesh->volume && mesh->volume[i].kind && s->translucent;
        item->has_medium =
            given && prt_media_of_surface(&tool->ctx, mesh, i, unit, &item->material);
        snprintf(item->why_not, sizeof item->why_not, "%s",
                 given ? "it has no attenuation distance" : "it is opaque, or has no volume");
    }
    prt_mesh_destroy(mesh);
    return out->item ? EXIT_DONE
                     : tool_exit(tool, prt_fail(&tool->ctx, PRT_NOMEM, "no memory"));
}

static int read_named(struct tool *tool, struct media *out)
{
    out->item = prt_calloc(1, sizeof *out->item);
    if (!out->item) return tool_exit(tool, prt_fail(&tool->ctx, PRT_NOMEM, "no memory"));
    out->n = 1;
    int status = material_named(tool, NULL, tool->opt.input[0], &out->item->material);
    snprintf(out->item->name, sizeof out->item->name, "%s", out->item->material.name);
    snprintf(out->item->format, sizeof out->item->format, "prt");
    out->item->has_medium = !status;
    return status;
}

static int read_media(struct tool *tool, struct media *out)
{
    const char *in = tool->opt.input[0];
    const char *hash = access(in, F_OK) ? strrchr(in, '#') : NULL;
    snprintf(out->path, sizeof out->path, "%.*s", hash ? (int)(hash - in) : 4095, in);
    out->name = hash ? hash + 1 : NULL;
    if (!access(out->path, F_OK) && is_model(out->path)) return read_model(tool, out);
    if (!prt_material_is_foreign(in)) return read_named(tool, out);
    int status =
        prt_material_import_file(&tool->ctx, in, tool->opt.mm_per_unit, &out->item, &out->n);
    if (!status && out->name) out->name = out->item->name; // the beginning was a whole name
    return tool_exit(tool, status);
}

cJSON *describe_import(const struct prt_import *item)
{
    char text[PRT_MATERIAL_SUMMARY];
    cJSON *o = cJSON_CreateObject();
    cJSON_AddStringToObject(o, "name", item->name);
    cJSON_AddStringToObject(o, "format", item->format);
    if (!item->has_medium) cJSON_AddStringToObject(o, "no_medium", item->why_not);
    if (!item->has_medium) return o;
    prt_material_summary(&item->material, text, sizeof text);
    cJSON_AddItemToObject(o, "material", cJSON_Parse(text));
    return o;
}

static void print_media(const struct tool *tool, const struct media *media)
{
    cJSON *list = cJSON_CreateArray();
    for (unsigned i = 0; i < media->n; i++) {
        const struct prt_import *item = &media->item[i];
        cJSON *o = describe_import(item);
        char *medium = cJSON_PrintUnformatted(cJSON_GetObjectItem(o, "material"));
        cJSON_AddItemToArray(list, o);
        if (!tool->opt.json)
            printf("%s (%s): %s\n", item->name, item->format,
                   item->has_medium && medium ? medium : item->why_not);
        free(medium);
    }
    char *text = tool->opt.json ? cJSON_PrintUnformatted(list) : NULL;
    if (text) puts(text);
    free(text);
    cJSON_Delete(list);
}

static int write_one(struct tool *tool, const struct media *media)
{
    const struct prt_import *chosen;
    char text[PRT_MATERIAL_TEXT + 1];
    int status =
        prt_import_choose(&tool->ctx, media->path, media->item, media->n, media->name, &chosen);
    if (status) return tool_exit(tool, status == PRT_ARG ? PRT_FORMAT : status);
    int n = prt_material_print(&chosen->material, text, PRT_MATERIAL_TEXT);
    if (n < 0) return tool_exit(tool, n);
    text[n++] = '\n';
    return tool_exit(tool, prt_write_file(&tool->ctx, tool->opt.out, text, (size_t)n));
}

// Keeps the medium that IN#NAME means, for the list.
static int keep_named(struct tool *tool, struct media *media)
{
    const struct prt_import *chosen;
    if (!media->name) return EXIT_DONE;
    int status =
        prt_import_choose(&tool->ctx, media->path, media->item, media->n, media->name, &chosen);
    if (status) return tool_exit(tool, status == PRT_ARG ? PRT_FORMAT : status);
    media->item[0] = *chosen;
    media->n = 1;
    return EXIT_DONE;
}

int run_material(struct tool *tool)
{
    struct media media = {.n = 0};
    const char *in = tool->opt.input[0];
    if (!strcmp(in, "names") && access(in, F_OK)) return list_names(tool);
    int status = tool->opt.out ? check_writable(tool, tool->opt.out) : EXIT_DONE;
    if (!status) status = read_media(tool, &media);
    if (!status && tool->opt.out) status = write_one(tool, &media);
    else if (!status && !(status = keep_named(tool, &media))) print_media(tool, &media);
    prt_free(media.item);
    return status;
}
