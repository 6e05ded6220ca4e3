// SPDX-License-Identifier: MIT
// Strokes of a room over the picture of a pin: the points of the surface through the camera.
#include "picture_compare.h"
#include "room.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

struct projection {
    double eye[3], right[3], up[3], forward[3], scale; // scale: pixels at distance 1
    uint32_t width, height;
    uint8_t *rgb;
};

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const double a[3], const double b[3], double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

static bool normalise(double v[3])
{
    double size = sqrt(dot(v, v));
    for (int i = 0; i < 3 && size > 0; i++) v[i] /= size;
    return size > 0;
}

static bool set_projection(struct projection *p, const struct relight_image *image,
                           uint8_t *rgb)
{
    const struct relight_camera *c = &image->camera;
    double up[3];
    *p = (struct projection){.width = image->width, .height = image->height, .rgb = rgb};
    bool has_up = c->up[0] != 0 || c->up[1] != 0 || c->up[2] != 0;
    for (int i = 0; i < 3; i++) {
        p->eye[i] = c->eye[i];
        p->forward[i] = (double)c->target[i] - c->eye[i];
        up[i] = has_up ? c->up[i] : i == 1;
    }
    if (!normalise(p->forward) || !(c->fovy_deg > 0)) return false;
    cross(p->forward, up, p->right);
    if (!normalise(p->right)) return false;
    cross(p->right, p->forward, p->up);
    p->scale = image->height / (2 * tan(c->fovy_deg * M_PI / 360));
    return true;
}

// Pixels of a point, the top row first; false: behind the eye.
static bool project(const struct projection *p, const cJSON *point, double out[2])
{
    const cJSON *at = list_of(point, "position");
    double d[3] = {number_of(at, "x") - p->eye[0], number_of(at, "y") - p->eye[1],
                   number_of(at, "z") - p->eye[2]};
    double depth = dot(d, p->forward);
    if (!at || !(depth > 0)) return false;
    out[0] = p->width / 2. + dot(d, p->right) / depth * p->scale;
    out[1] = p->height / 2. - dot(d, p->up) / depth * p->scale;
    return fabs(out[0]) < 1e5 && fabs(out[1]) < 1e5;
}

static void dab(struct projection *p, double x, double y, double radius, uint32_t color)
{
    for (double j = floor(y - radius); j <= y + radius; j++)
        for (double i = floor(x - radius); i <= x + radius; i++) {
            if (i < 0 || j < 0 || i >= p->width || j >= p->height) continue;
            if (hypot(i + .5 - x, j + .5 - y) > radius + .25) continue;
            uint8_t *at = p->rgb + 3 * ((size_t)j * p->width + (size_t)i);
            at[0] = (uint8_t)(color >> 16);
            at[1] = (uint8_t)(color >> 8);
            at[2] = (uint8_t)color;
        }
}

static void draw_stroke(struct projection *p, const cJSON *line)
{
    const cJSON *point;
    double from[2], to[2], radius = fmax(.5, fmin(32, number_of(line, "width") / 2));
    uint32_t color = (uint32_t)number_of(line, "color");
    bool has_from = false;
    cJSON_ArrayForEach(point, list_of(line, "points"))
    {
        if (!project(p, point, to)) {
            has_from = false;
            continue;
        }
        if (!has_from) memcpy(from, to, sizeof from);
        double steps = fmin(1e5, ceil(hypot(to[0] - from[0], to[1] - from[1]) / .5) + 1);
        for (double i = 0; i <= steps; i++)
            dab(p, from[0] + (to[0] - from[0]) * i / steps,
                from[1] + (to[1] - from[1]) * i / steps, radius, color);
        memcpy(from, to, sizeof from);
        has_from = true;
    }
}

static bool is_of(const cJSON *stroke, double pin)
{
    return number_of(list_of(stroke, "line"), "pin") == pin;
}

static int write_drawn(struct room_call *c, const cJSON *strokes, double pin,
                       const struct relight_image *image, const char *path)
{
    struct projection p;
    const cJSON *stroke;
    size_t n = 3 * (size_t)image->width * image->height;
    if (image->n_byte < n) return report_usage(c->options, "the daemon's picture is too short");
    uint8_t *rgb = malloc(n + 1);
    void *png = NULL;
    if (rgb) memcpy(rgb, image->data, n);
    if (rgb && set_projection(&p, image, rgb))
        cJSON_ArrayForEach(stroke, strokes) if (is_of(stroke, pin))
            draw_stroke(&p, list_of(stroke, "line"));
    if (rgb) png = encode_png(rgb, image->width, image->height, &n);
    int status = png ? write_file(c->options, path, png, n)
                     : report_usage(c->options, "not enough memory");
    free(png);
    free(rgb);
    return status;
}

int room_write_strokes(struct room_call *c, const cJSON *state, double pin, const char *path)
{
    const cJSON *strokes = list_of(state, "strokes"), *stroke;
    struct relight_room_view view = {.pin = (uint64_t)pin, .format = RELIGHT_IMAGE_RGB8};
    struct relight_image image;
    bool any = false;
    cJSON_ArrayForEach(stroke, strokes) any |= is_of(stroke, pin);
    if (!any) return EXIT_DONE;
    if (relight_room_picture(c->client, c->room, &view, &image, &c->error))
        return room_failed(c);
    int status = write_drawn(c, strokes, pin, &image, path);
    relight_image_finish(&image);
    return status;
}
