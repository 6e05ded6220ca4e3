// SPDX-License-Identifier: MIT
// prt env: converts environments between lat-long and cube layouts, turns and resizes them, and
// prints their power.
#include "tool.h"

#include <cjson/cJSON.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void latlong_power(const struct prt_image *image, double power[3])
{
    memset(power, 0, 3 * sizeof *power);
    for (uint32_t y = 0; y < image->height; y++) {
        // Exact solid angle of a pixel: the band's share of the sphere.
        double above = cos(M_PI * y / image->height),
               below = cos(M_PI * (y + 1) / image->height);
        double omega = 2 * M_PI * (above - below) / image->width;
        const float *row = image->rgb + (size_t)y * image->width * 3;
        for (size_t x = 0; x < image->width; x++)
            for (int c = 0; c < 3; c++) power[c] += omega * (double)row[3 * x + (size_t)c];
    }
}

void cube_power(const struct prt_cube *cube, double power[3])
{
    size_t n = cube->n;
    memset(power, 0, 3 * sizeof *power);
    for (uint32_t y = 0; y < n; y++)
        for (uint32_t x = 0; x < n; x++) {
            double omega = prt_cube_solid_angle(cube->n, x, y);
            for (size_t face = 0; face < 6; face++)
                for (size_t c = 0; c < 3; c++)
                    power[c] += omega * (double)cube->texel[((face * n + y) * n + x) * 3 + c];
        }
}

void env_power(const struct prt_env *env, double power[3])
{
    if (env->kind == PRT_ENV_LATLONG) latlong_power(&env->latlong, power);
    else cube_power(&env->cube, power);
}

// Positions of the six camera views in a layout, in widths of a face; some are turned by 180
// degrees.
struct layout {
    const char *name;
    unsigned columns, rows;
    struct {
        unsigned char x, y, turned;
    } place[6]; // +X -X +Y -Y +Z -Z
};
static const struct layout layouts[] = {
    {"envmap", 1, 6, {{0, 0, 0}, {0, 1, 0}, {0, 2, 0}, {0, 3, 0}, {0, 4, 0}, {0, 5, 0}}},
    {"vstrip", 1, 6, {{0, 0, 0}, {0, 1, 0}, {0, 2, 0}, {0, 3, 0}, {0, 4, 0}, {0, 5, 0}}},
    {"hstrip", 6, 1, {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {3, 0, 0}, {4, 0, 0}, {5, 0, 0}}},
    {"hcross", 4, 3, {{2, 1, 0}, {0, 1, 0}, {1, 0, 0}, {1, 2, 0}, {3, 1, 0}, {1, 1, 0}}},
    {"vcross", 3, 4, {{2, 1, 0}, {0, 1, 0}, {1, 0, 0}, {1, 2, 0}, {1, 3, 1}, {1, 1, 0}}},
};

// Unmirrored camera views of the faces: forward, right, up.
static const float views[6][3][3] = {
    {{1, 0, 0}, {0, 0, 1}, {0, 1, 0}},  {{-1, 0, 0}, {0, 0, -1}, {0, 1, 0}},
    {{0, 1, 0}, {1, 0, 0}, {0, 0, 1}},  {{0, -1, 0}, {1, 0, 0}, {0, 0, -1}},
    {{0, 0, 1}, {-1, 0, 0}, {0, 1, 0}}, {{0, 0, -1}, {1, 0, 0}, {0, 1, 0}},
};

// The texel of `cube` at a pixel of a view: a permutation without filtering.
static const float *view_texel(const struct prt_cube *cube, unsigned view, uint32_t x,
                               uint32_t y)
{
    float n = (float)cube->n, s = 2 * ((float)x + 0.5f) / n - 1,
          t = 2 * ((float)y + 0.5f) / n - 1;
    float dir[3], fs, ft;
    unsigned face;
    for (int i = 0; i < 3; i++)
        dir[i] = views[view][0][i] + s * views[view][1][i] - t * views[view][2][i];
    prt_cube_lookup(dir, &face, &fs, &ft);
    size_t px = (size_t)fminf(fmaxf((fs + 1) * 0.5f * n, 0), n - 1);
    size_t py = (size_t)fminf(fmaxf((ft + 1) * 0.5f * n, 0), n - 1);
    return cube->texel + ((face * (size_t)cube->n + py) * cube->n + px) * 3;
}

static int lay_out(const struct prt_context *ctx, const struct prt_cube *cube,
                   const struct layout *layout, struct prt_image *out)
{
    uint32_t n = cube->n, width = n * layout->columns, height = n * layout->rows;
    out->alpha = NULL;
    out->rgb = prt_calloc((size_t)width * height, 3 * sizeof *out->rgb);
    if (!out->rgb) return prt_fail(ctx, PRT_NOMEM, "no memory for %ux%u pixels", width, height);
    out->width = width;
    out->height = height;
    for (unsigned view = 0; view < 6; view++) {
        bool turned = layout->place[view].turned;
        for (uint32_t y = 0; y < n; y++)
            for (uint32_t x = 0; x < n; x++) {
                uint32_t px = layout->place[view].x * n + (turned ? n - 1 - x : x);
                uint32_t py = layout->place[view].y * n + (turned ? n - 1 - y : y);
                memcpy(out->rgb + ((size_t)py * width + px) * 3, view_texel(cube, view, x, y),
                       3 * sizeof(float));
            }
    }
    return PRT_OK;
}

static int report(const struct tool *tool, const char *layout, const struct prt_image *image,
                  const double before[3], const double after[3])
{
    double ratio = (after[0] + after[1] + after[2]) / (before[0] + before[1] + before[2]);
    if (tool->opt.json) {
        cJSON *root = cJSON_CreateObject();
        cJSON_AddStringToObject(root, "out", tool->opt.out);
        cJSON_AddStringToObject(root, "layout", layout);
        cJSON_AddNumberToObject(root, "width", image->width);
        cJSON_AddNumberToObject(root, "height", image->height);
        cJSON_AddItemToObject(root, "power_before", cJSON_CreateDoubleArray(before, 3));
        cJSON_AddItemToObject(root, "power_after", cJSON_CreateDoubleArray(after, 3));
        char *text = cJSON_PrintUnformatted(root);
        puts(text ? text : "{}");
        free(text);
        cJSON_Delete(root);
    } else if (!tool->opt.quiet) {
        printf("power before %.6g %.6g %.6g\n", before[0], before[1], before[2]);
        printf("power after  %.6g %.6g %.6g  (%+.4f %%)\n", after[0], after[1], after[2],
               isfinite(ratio) ? 100 * (ratio - 1) : 0.0);
    }
    return EXIT_DONE;
}

static enum prt_tone tone_of(const char *word)
{
    if (word && !strcmp(word, "filmic")) return PRT_TONE_FILMIC;
    if (word && !strcmp(word, "reinhard")) return PRT_TONE_REINHARD;
    return PRT_TONE_NONE; // an environment is data: only encode it
}

static bool is_exr(const char *path)
{
    return prt_picture_format(path) == prt_picture_format(".exr");
}

static int write_picture(const struct tool *tool, const struct prt_image *image, bool envmap)
{
    const struct options *o = &tool->opt;
    struct prt_picture_options options = {.tone = tone_of(o->tone),
                                          .exposure_ev = (float)o->exposure_ev,
                                          .quality = o->quality ? (int)o->quality : 92,
                                          .full_float = o->full_float};
    if (envmap) return prt_write_exr(&tool->ctx, o->out, image, o->full_float, true);
    if (!prt_picture_format(o->out)->linear)
        prt_log(&tool->ctx, PRT_LOG_WARNING, "%s: 8 bits clip radiance above 1", o->out);
    return output_image(&tool->ctx, o->out, image, &options);
}

// A lat-long image that keeps its size and is not turned keeps its pixels.
static bool is_copy(const struct options *o, const struct prt_env *env,
                    const struct layout *layout, uint32_t width, uint32_t height)
{
    return !layout && env->kind == PRT_ENV_LATLONG && !(fabs(o->rotate_deg) > 0) &&
           width == env->latlong.width && height == env->latlong.height;
}

// Every other conversion passes through a cube, which is the light that the engines use.
static int convert(const struct tool *tool, const struct prt_env *env,
                   const struct layout *layout, struct prt_image *out, double after[3])
{
    const struct options *o = &tool->opt;
    struct prt_cube cube = {0};
    uint32_t full = prt_env_full_cube(env), width = o->width ? o->width : 4 * full;
    uint32_t height = o->height ? o->height : (width + 1) / 2;
    if (is_copy(o, env, layout, width, height)) {
        size_t n_value = (size_t)width * height * 3;
        *out = (struct prt_image){width, height, prt_alloc(n_value, sizeof(float))};
        if (!out->rgb) return prt_fail(&tool->ctx, PRT_NOMEM, "no memory for the image");
        memcpy(out->rgb, env->latlong.rgb, n_value * sizeof(float));
        latlong_power(out, after);
        return PRT_OK;
    }
    uint32_t n = layout ? (o->width ? o->width : full) : full;
    int status = prt_env_to_cube(&tool->ctx, env, n, o->rotate_deg, &cube);
    if (!status && layout) {
        cube_power(&cube, after);
        status = lay_out(&tool->ctx, &cube, layout, out);
    } else if (!status) {
        status = prt_cube_to_latlong(&tool->ctx, &cube, width, height, out);
        if (!status) latlong_power(out, after);
    }
    prt_cube_finish(&cube);
    return status;
}

static int check_usage(const struct options *o)
{
    if (!o->out) return usage_error(o, "-o OUT is missing");
    if (!prt_picture_format(o->out)) return picture_path_error(o, "environments");
    if (o->layout && !strcmp(o->layout, "envmap") && !is_exr(o->out))
        return usage_error(o,
                           "--layout envmap is an attribute of OpenEXR files: give -o OUT.exr");
    return EXIT_DONE;
}

int run_env(struct tool *tool)
{
    const struct options *o = &tool->opt;
    struct prt_env *env = NULL;
    struct prt_image image = {0};
    const struct layout *layout = NULL;
    double before[3], after[3];
    int status = check_usage(o);
    if (status || (status = check_writable(tool, o->out))) return status;
    status = tool_env_load(tool, o->input[0], &env);
    if (status) return tool_exit(tool, status == PRT_ARG ? PRT_FORMAT : status);
    bool exr = is_exr(o->out);
    // --size WxH means a lat-long result, for any input.
    const char *name = o->layout                                ? o->layout
                       : o->height || env->kind == PRT_ENV_CUBE ? "latlong"
                       : exr                                    ? "envmap"
                                                                : "vcross";
    for (size_t i = 0; i < sizeof layouts / sizeof *layouts; i++)
        if (!strcmp(layouts[i].name, name)) layout = &layouts[i];
    if (layout && (o->width > PRT_CUBE_MAX || (o->width && o->width < PRT_CUBE_MIN) ||
                   (o->height && o->height != o->width)))
        status = usage_error(o, "--size of a cube: expected its side N in [%d, %d]",
                             PRT_CUBE_MIN, PRT_CUBE_MAX);
    if (!status) {
        env_power(env, before);
        int result = convert(tool, env, layout, &image, after);
        if (!result) result = write_picture(tool, &image, !strcmp(name, "envmap"));
        status = tool_exit(tool, result);
    }
    if (!status) status = report(tool, name, &image, before, after);
    prt_image_finish(&image);
    prt_env_destroy(env);
    return status;
}
