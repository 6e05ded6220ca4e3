// SPDX-License-Identifier: MIT
// Images over a model's uv for `prt image` by image-space engines: tints, normals, heights.
#include "maps.h"

#include <string.h>

bool maps_given(const struct options *o)
{
    return o->albedo_map || o->normal_map || o->bump_map;
}

static int load_one(struct tool *tool, enum prt_screen_map_kind kind, const char *path,
                    const struct prt_material *material, float height_mm,
                    struct prt_screen_map *map)
{
    struct prt_image image = {0};
    int status = prt_image_load(&tool->ctx, path, &image);
    if (!status)
        status = prt_screen_map_make(&tool->ctx, kind, &image, prt_screen_map_linear(path), 0,
                                     material, height_mm, map);
    prt_image_finish(&image);
    return tool_exit(tool, status);
}

int maps_load(struct tool *tool, const struct prt_mesh *mesh, const struct prt_media *media,
              struct maps *out, struct prt_screen_options *screen)
{
    const struct options *o = &tool->opt;
    const char *const path[3] = {o->albedo_map, o->normal_map, o->bump_map};
    const struct prt_screen_map **use[3] = {&screen->sigma_a_map, &screen->normal_map,
                                            &screen->bump_map};
    memset(out, 0, sizeof *out);
    if (!maps_given(o)) return EXIT_DONE;
    if (!mesh->uv)
        return tool_exit(tool, prt_fail(&tool->ctx, PRT_ARG,
                                        "%s has no texture coordinates, which a map needs",
                                        o->input[0]));
    if (o->albedo_map && media->n > 1)
        return usage_error(o,
                           "--albedo-map changes one medium, and %s has %u: give all objects "
                           "one --material",
                           o->input[0], media->n);
    for (int k = 0; k < 3; k++) {
        if (!path[k]) continue;
        int status = load_one(tool, (enum prt_screen_map_kind)k, path[k], media->medium,
                              (float)o->bump_mm, &out->map[k]);
        if (status) return status;
        *use[k] = &out->map[k];
    }
    screen->maps_checked = true;
    return EXIT_DONE;
}

void maps_finish(struct maps *maps)
{
    for (int k = 0; k < 3; k++) prt_screen_map_finish(&maps->map[k]);
}
