// SPDX-License-Identifier: MIT
// Fields of a view's state by their names in relight.proto.
#include "render/evaluation.h"

#include <stdio.h>
#include <string.h>

// Each row is one member of struct render_spec; some fields of a message have several.
#define ROW(name, member)                                                                     \
    {                                                                                         \
        name, offsetof(struct render_spec, member), sizeof(((struct render_spec *)0)->member) \
    }
static const struct {
    const char *name;
    size_t offset, size;
} rows[] = {
    ROW("shade.engine", engine),
    ROW("shade.term", term),
    ROW("shade.material", has_material),
    ROW("shade.material", material),
    ROW("shade.material", material_key),
    ROW("shade.eye", has_eye),
    ROW("shade.eye", eye),
    ROW("shade.max_error", max_error),
    ROW("shade.budget_ms", budget_ms),
    ROW("shade.albedo_map", map[0]),
    ROW("shade.normal_map", map[1]),
    ROW("shade.bump_map", map[2]),
    ROW("shade.bump_mm", bump_mm),
    ROW("shade.variant", variant),
    ROW("picture.width", width),
    ROW("picture.height", height),
    ROW("picture.camera", has_camera),
    ROW("picture.camera", camera_name),
    ROW("picture.camera", has_orbit),
    ROW("picture.camera", orbit),
    ROW("picture.camera", camera_eye),
    ROW("picture.camera", camera_target),
    ROW("picture.camera", camera_up),
    ROW("picture.camera", fovy_deg),
    ROW("picture.format", image_format),
    ROW("picture.quality", quality),
    ROW("picture.tone", tone),
    ROW("picture.exposure_ev", picture_ev),
    ROW("picture.plain_background", plain_background),
    ROW("picture.background", background),
    ROW("picture.samples", samples),
    ROW("picture.no_specular", no_specular),
    ROW("picture.transparent", transparent),
    ROW("picture.floor", floor),
};
static const char *const others[] = {"shade.materials",
                                     "lights",
                                     "lights.rotate_deg",
                                     "lights.gain",
                                     "shade",
                                     "picture",
                                     "options",
                                     "options.max_fps",
                                     "options.window",
                                     "options.window_bytes",
                                     "options.color_format",
                                     "options.color_exposure_ev",
                                     "options.frame_deadline_ms",
                                     "options.most_rank",
                                     "options.phases",
                                     "options.exits",
                                     "options.coarse",
                                     "options.skip_equal",
                                     "pose"};

bool render_fields_name(size_t n, char *const *fields, const char *field)
{
    size_t part = strcspn(field, ".");
    for (size_t i = 0; i < n; i++)
        if (!strcmp(fields[i], field) ||
            (strlen(fields[i]) == part && !strncmp(fields[i], field, part)))
            return true;
    return false;
}

static bool is_known(const char *field)
{
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        if (!strcmp(rows[i].name, field)) return true;
    for (size_t i = 0; i < sizeof others / sizeof *others; i++)
        if (!strcmp(others[i], field)) return true;
    return false;
}

int render_spec_copy_fields(struct render_spec *spec, const struct render_spec *values,
                            size_t n, char *const *fields, char error[300])
{
    for (size_t i = 0; i < n; i++)
        if (!is_known(fields[i])) {
            snprintf(error, 300, "state.fields: \"%.60s\" is not a field of a view's state",
                     fields[i]);
            return RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST;
        }
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        if (render_fields_name(n, fields, rows[i].name))
            memcpy((char *)spec + rows[i].offset, (const char *)values + rows[i].offset,
                   rows[i].size);
    if (render_fields_name(n, fields, "shade.materials")) {
        media_map_release(spec->objects);
        spec->objects = values->objects;
        if (spec->objects) spec->objects->refs++;
    }
    return 0;
}
