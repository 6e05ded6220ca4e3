// SPDX-License-Identifier: MIT
// Frames: light and camera of each, drawing, tiling, files.
#include "preview.h"

#include "../cli/picture_compare.h"
#include "video.h"

#include <cjson/cJSON.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// State that frames share. While the light turns, the visibility buffer and the background are
// reused (shading turns the background); while the camera turns, reflections and colours are.
struct drawing {
    struct scene *scene;
    struct planes planes;
    struct prt_visibility *visibility;
    struct prt_cube background; /* unturned, of background_of */
    const struct sky *background_of;
    double rotate_deg;
    struct prt_specular *specular;
    struct prt_image canvas; /* a sheet's */
    struct video *video;
    uint8_t *rgb;             /* of a film's frame; of both pictures of a difference */
    uint32_t attempt;         /* index of the --try */
    struct prt_camera camera; /* of frame 0 */
};

static double rotation(const struct options *o, uint32_t frame)
{
    return o->rotate_deg + (o->turn_light ? 360.0 * frame / o->n_frame : 0);
}

// The camera of a frame: it moves about the axis +y through its target.
static struct prt_camera frame_camera(const struct drawing *d, uint32_t frame)
{
    const struct options *o = d->scene->options;
    struct prt_camera c = d->camera;
    if (o->turn_light) return c;
    double a = 2 * M_PI * frame / o->n_frame, x = c.eye[0] - c.target[0],
           z = c.eye[2] - c.target[2];
    c.eye[0] = c.target[0] + (float)(cos(a) * x + sin(a) * z);
    c.eye[2] = c.target[2] + (float)(cos(a) * z - sin(a) * x);
    double ux = c.up[0], uz = c.up[2];
    c.up[0] = (float)(cos(a) * ux + sin(a) * uz);
    c.up[2] = (float)(cos(a) * uz - sin(a) * ux);
    return c;
}

static void drop_specular(struct drawing *d)
{
    if (d->specular) prt_specular_destroy(d->specular);
    d->specular = NULL;
}

static int set_background(struct drawing *d, const struct sky *sky)
{
    if (d->background_of == sky) return EXIT_DONE;
    uint32_t n = prt_env_full_cube(sky->env);
    prt_cube_finish(&d->background);
    d->background = (struct prt_cube){0};
    d->background_of = NULL;
    if (prt_env_to_cube(&d->scene->ctx, sky->env, n < 512 ? n : 512, 0, &d->background))
        return EXIT_FAILED;
    d->background_of = sky;
    return EXIT_DONE;
}

static int set_light(struct drawing *d, const struct sky *sky, double rotate_deg)
{
    const struct options *o = d->scene->options;
    const struct prt_context *ctx = &d->scene->ctx;
    struct prt_cube mirror = {0};
    drop_specular(d);
    d->rotate_deg = rotate_deg;
    if (!sky->env) {
        prt_cube_finish(&d->background);
        d->background = (struct prt_cube){0};
        d->background_of = NULL;
        return EXIT_DONE;
    }
    if (!o->plain && set_background(d, sky)) return EXIT_FAILED;
    if (o->no_specular) return EXIT_DONE;
    uint32_t n = prt_env_full_cube(sky->env);
    int status = prt_env_to_cube(ctx, sky->env, n < 256 ? n : 256, rotate_deg, &mirror);
    if (!status) status = prt_specular_create(ctx, &mirror, &d->specular);
    prt_cube_finish(&mirror);
    return status ? EXIT_FAILED : EXIT_DONE;
}

static int set_camera(struct drawing *d, uint32_t frame)
{
    const struct options *o = d->scene->options;
    struct prt_camera camera = frame_camera(d, frame);
    if (d->visibility) prt_visibility_destroy(d->visibility);
    d->visibility = NULL;
    struct prt_raster raster = {o->width, o->height, o->samples, PRT_RASTER_AUTO};
    return prt_visibility_create(&d->scene->ctx, &d->scene->mesh, &camera, &raster,
                                 &d->visibility)
               ? EXIT_FAILED
               : EXIT_DONE;
}

static int shade(struct drawing *d, struct prt_image *out)
{
    const struct options *o = d->scene->options;
    struct prt_shade s = {.n_plane = d->planes.n,
                          .planes = d->planes.value,
                          .media = *d->scene->media,
                          .fresnel = true,
                          .transparent = o->transparent,
                          .specular = d->specular};
    if (!o->plain && d->background.texel) s.background = &d->background;
    s.background_rotate_deg = (float)d->rotate_deg;
    memcpy(s.background_rgb, o->background, sizeof s.background_rgb);
    return prt_shade_image(&d->scene->ctx, d->visibility, &d->scene->mesh, &s, out)
               ? EXIT_FAILED
               : EXIT_DONE;
}

static void print_json(cJSON *json)
{
    char *text = cJSON_PrintUnformatted(json);
    if (text) puts(text);
    free(text);
    cJSON_Delete(json);
}

void print_written(const struct options *o, const char *path, uint32_t width, uint32_t height)
{
    if (!o->json) {
        printf("%s: %u x %u\n", path, width, height);
        return;
    }
    cJSON *json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, "file", path);
    cJSON_AddNumberToObject(json, "width", width);
    cJSON_AddNumberToObject(json, "height", height);
    print_json(json);
}

static int save(struct scene *scene, const char *path, const struct prt_image *image)
{
    const struct options *o = scene->options;
    const struct prt_picture_options options = {
        .tone = o->tone, .exposure_ev = o->exposure_ev, .quality = o->quality};
    struct prt_blob blob;
    if (prt_picture_encode(&scene->ctx, prt_picture_format(path), image, &options, &blob))
        return EXIT_FAILED;
    int status = prt_write_file(&scene->ctx, path, blob.bytes, blob.size);
    prt_free(blob.bytes);
    if (status) return EXIT_FAILED;
    print_written(o, path, image->width, image->height);
    return EXIT_DONE;
}

// FILE.png, FILE-COLUMN.png or FILE-ENV-COLUMN.png
static void file_name(const struct options *o, size_t env, uint32_t frame, char *out, size_t n)
{
    const char *dot = strrchr(o->output, '.');
    int stem = (int)(dot - o->output);
    if (o->n_env == 1 && options_columns(o) == 1) snprintf(out, n, "%s", o->output);
    else if (o->n_env == 1) snprintf(out, n, "%.*s-%03u%s", stem, o->output, frame, dot);
    else snprintf(out, n, "%.*s-%zu-%03u%s", stem, o->output, env, frame, dot);
}

// One picture as it is displayed, into the film, or beside the other of a difference.
static int keep_displayed(struct drawing *d, size_t index, const struct prt_image *image)
{
    const struct options *o = d->scene->options;
    uint8_t *to = d->rgb + (d->video ? 0 : index * 3 * image->width * image->height);
    if (prt_tone_map(&d->scene->ctx, image, o->tone, o->exposure_ev, to)) return EXIT_FAILED;
    if (!d->video || video_add(d->video, to)) return EXIT_DONE;
    return EXIT_FAILED; // video_close says so
}

static int keep(struct drawing *d, size_t env, uint32_t frame, const struct prt_image *image)
{
    const struct options *o = d->scene->options;
    const uint32_t column = o->n_try ? d->attempt : frame;
    if (o->difference || d->video) return keep_displayed(d, env + column, image);
    if (!o->sheet) {
        char path[4096];
        file_name(o, env, column, path, sizeof path);
        return save(d->scene, path, image);
    }
    size_t x = (size_t)column * (o->width + o->gap), y = env * (o->height + o->gap);
    for (size_t row = 0; row < o->height; row++) {
        size_t to = (y + row) * d->canvas.width + x, from = row * o->width;
        memcpy(d->canvas.rgb + 3 * to, image->rgb + 3 * from, 12 * (size_t)o->width);
        if (image->alpha)
            memcpy(d->canvas.alpha + to, image->alpha + from, 4 * (size_t)o->width);
    }
    return EXIT_DONE;
}

static int make_canvas(struct drawing *d)
{
    const struct options *o = d->scene->options;
    uint64_t w = (uint64_t)options_columns(o) * (o->width + o->gap) - o->gap;
    uint64_t h = o->n_env * (uint64_t)(o->height + o->gap) - o->gap;
    if (w > 32768 || h > 32768 || w * h > 1u << 28) {
        fprintf(stderr,
                "relight-preview: a sheet of %llu x %llu pixels is too large: at most 32768 a "
                "side and 2^28 in all\n",
                (unsigned long long)w, (unsigned long long)h);
        return EXIT_USAGE;
    }
    d->canvas = (struct prt_image){(uint32_t)w, (uint32_t)h, prt_calloc((size_t)(w * h), 12)};
    if (o->transparent) d->canvas.alpha = prt_calloc((size_t)(w * h), 4);
    return d->canvas.rgb && (d->canvas.alpha || !o->transparent) ? EXIT_DONE : EXIT_FAILED;
}

// One row: the frames of an environment. The colours of the next light are requested before
// this one is drawn, so that daemon and drawing overlap.
static int draw_row(struct drawing *d, size_t env)
{
    const struct options *o = d->scene->options;
    const struct sky *sky = d->scene->sky + env;
    struct colors_pending next = {0};
    int status = scene_colors_begin(d->scene, sky, rotation(o, 0), &next);
    for (uint32_t k = 0; !status && k < o->n_frame; k++) {
        struct prt_image image = {0};
        if (k == 0 || o->turn_light) {
            status = scene_colors_end(d->scene, &next, &d->planes);
            if (!status && o->turn_light && k + 1 < o->n_frame)
                status = scene_colors_begin(d->scene, sky, rotation(o, k + 1), &next);
        }
        if (!status && (k == 0 || o->turn_light)) status = set_light(d, sky, rotation(o, k));
        if (!status && (!d->visibility || (!o->turn_light && o->n_frame > 1)))
            status = set_camera(d, k);
        if (!status) status = shade(d, &image);
        if (!status) status = keep(d, env, k, &image);
        prt_image_finish(&image);
    }
    if (next.begun) scene_colors_end(d->scene, &next, &d->planes); // it is not needed
    return status;
}

// Memory of the pictures, or the film.
static int prepare_output(struct drawing *d)
{
    const struct options *o = d->scene->options;
    bool film = video_is_name(o->output);
    if (film || o->difference) {
        d->rgb = malloc((film ? 3 : 6) * (size_t)o->width * o->height);
        if (!d->rgb) return EXIT_FAILED;
    }
    if (film && !(d->video = video_open(o->output, o->width, o->height, o->fps)))
        return EXIT_FAILED;
    return o->sheet ? make_canvas(d) : EXIT_DONE;
}

// The map of CIEDE2000 of the second picture against the first.
static int save_difference(struct drawing *d)
{
    const struct options *o = d->scene->options;
    const size_t n = (size_t)o->width * o->height;
    struct picture_difference found;
    float *delta = malloc(n * sizeof *delta);
    uint32_t w, h;
    size_t bytes = 0;
    uint8_t *map = NULL;
    void *png = NULL;
    if (delta && picture_compare(d->rgb, d->rgb + 3 * n, n, delta, &found))
        map = compare_draw(COMPARE_DELTA, d->rgb, d->rgb + 3 * n, delta, o->width, o->height,
                           &w, &h);
    if (map) png = encode_png(map, w, h, &bytes);
    int status =
        png && !prt_write_file(&d->scene->ctx, o->output, png, bytes) ? EXIT_DONE : EXIT_FAILED;
    if (!status && o->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "file", o->output);
        cJSON_AddNumberToObject(json, "mean", found.mean);
        cJSON_AddNumberToObject(json, "p95", found.p95);
        cJSON_AddNumberToObject(json, "most", found.most);
        cJSON_AddNumberToObject(json, "noticeable", found.noticeable);
        print_json(json);
    } else if (!status)
        printf("%s: CIEDE2000 mean %.2f, 95 %% below %.2f, most %.2f; %.1f %% of the pixels "
               "differ by more than 1\n",
               o->output, found.mean, found.p95, found.most, 100 * found.noticeable);
    free(png);
    free(map);
    free(delta);
    return status;
}

static int finish_output(struct drawing *d, int status)
{
    const struct options *o = d->scene->options;
    if (d->video) {
        int closed = video_close(d->video);
        if (!status) status = closed;
        if (!status) print_written(o, o->output, o->width, o->height);
    }
    if (!status && o->sheet) status = save(d->scene, o->output, &d->canvas);
    if (!status && o->difference) status = save_difference(d);
    free(d->rgb);
    return status;
}

static int draw_rows(struct drawing *d)
{
    const struct options *o = d->scene->options;
    int status = EXIT_DONE;
    const uint32_t n = o->n_try ? o->n_try : 1;
    for (d->attempt = 0; !status && d->attempt < n; d->attempt++) {
        if (d->attempt) status = scene_media(d->scene, o->attempt[d->attempt]);
        for (size_t e = 0; !status && e < o->n_env; e++) status = draw_row(d, e);
    }
    return status;
}

int draw_all(struct scene *scene)
{
    const struct options *o = scene->options;
    struct drawing d = {.scene = scene, .camera = o->camera};
    float aspect = (float)o->width / (float)o->height;
    if (o->camera_name) d.camera = scene->named;
    else if (o->orbit.zoom > 0)
        prt_camera_frame_from(&scene->mesh, aspect, &o->orbit, &d.camera);
    else if (d.camera.automatic) prt_camera_frame(&scene->mesh, aspect, &d.camera);
    d.camera.automatic = false;
    int status = prepare_output(&d);
    if (!status) status = draw_rows(&d);
    status = finish_output(&d, status);
    drop_specular(&d);
    prt_cube_finish(&d.background);
    if (d.visibility) prt_visibility_destroy(d.visibility);
    prt_image_finish(&d.canvas);
    prt_free(d.planes.value);
    return status;
}
