// SPDX-License-Identifier: MIT
// Images over a model's uv for `prt image` by image-space engines: tints, normals, heights.
#include "maps.h"

#include <math.h>
#include <string.h>
#include <strings.h>

bool maps_asked(const struct options *o)
{
    return o->albedo_map || o->normal_map || o->bump_map;
}

// Whether a file's numbers are stored as they are meant; others were decoded as sRGB colours.
static bool is_linear(const char *path)
{
    static const char *const ending[] = {".exr", ".hdr", ".pfm", ".pic"};
    const char *dot = strrchr(path, '.');
    for (size_t k = 0; dot && k < sizeof ending / sizeof *ending; k++)
        if (!strcasecmp(dot, ending[k])) return true;
    return false;
}

static float as_stored(float v)
{
    return v <= 0.0031308f ? 12.92f * v : 1.055f * powf(v, 1 / 2.4f) - 0.055f;
}

// Normals and heights are numbers, not colours.
static void undo_srgb(const char *path, struct prt_image *image)
{
    if (is_linear(path)) return;
    for (size_t i = 0; i < (size_t)image->width * image->height * 3; i++)
        image->rgb[i] = as_stored(image->rgb[i]);
}

static int load_one(struct tool *tool, const char *path, struct prt_image *image,
                    struct prt_screen_map *map)
{
    int status = prt_image_load(&tool->ctx, path, image);
    if (status) return tool_exit(tool, status);
    *map = (struct prt_screen_map){image->width, image->height, (const float(*)[3])image->rgb};
    return EXIT_DONE;
}

int maps_load(struct tool *tool, const struct prt_mesh *mesh, const struct prt_material *material,
              struct maps *out, struct prt_screen_options *screen)
{
    const struct options *o = &tool->opt;
    int status = EXIT_DONE;
    memset(out, 0, sizeof *out);
    if (!maps_asked(o)) return EXIT_DONE;
    if (!mesh->uv)
        return tool_exit(tool, prt_fail(&tool->ctx, PRT_ARG,
                                        "%s has no texture coordinates for a map to lie on",
                                        o->input[0]));
    if (o->albedo_map) {
        if ((status = load_one(tool, o->albedo_map, &out->image[0], &out->map[0]))) return status;
        float(*rgb)[3] = (float(*)[3])out->image[0].rgb;
        status = prt_screen_albedo_factors(&tool->ctx, material,
                                           (size_t)out->map[0].width * out->map[0].height,
                                           (const float(*)[3])rgb, rgb);
        if (status) return tool_exit(tool, status);
        screen->sigma_a_map = &out->map[0];
    }
    if (o->normal_map) {
        if ((status = load_one(tool, o->normal_map, &out->image[1], &out->map[1]))) return status;
        undo_srgb(o->normal_map, &out->image[1]);
        screen->normal_map = &out->map[1];
    }
    if (o->bump_map) {
        if ((status = load_one(tool, o->bump_map, &out->image[2], &out->map[2]))) return status;
        undo_srgb(o->bump_map, &out->image[2]);
        float height = o->bump_mm > 0 ? (float)o->bump_mm : 0.5f;
        size_t n = (size_t)out->map[2].width * out->map[2].height * 3;
        for (size_t i = 0; i < n; i++) out->image[2].rgb[i] *= height;
        screen->bump_map = &out->map[2];
    }
    return EXIT_DONE;
}

void maps_finish(struct maps *maps)
{
    for (int k = 0; k < 3; k++) prt_image_finish(&maps->image[k]);
}
