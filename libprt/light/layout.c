/* SPDX-License-Identifier: MIT */
/* Layouts in which an image holds an environment: detection, and copying into an environment.
 */
#include "light_private.h"

#include <math.h>
#include <string.h>

/* Copies the n x n picture named `face` whose top left pixel is (x0,y0) into the cube;
 * half_turn undoes the vertical cross's back face. */
static void put_view(const struct prt_image *src, uint32_t x0, uint32_t y0, bool half_turn,
                     enum prt_faces faces, unsigned face, struct prt_cube *cube)
{
    const uint32_t n = cube->n;
    const struct prt_face_place place = prt_face_place(faces, face);
    const bool flip_x = place.flip_x != half_turn;
    const bool flip_y = place.flip_y != half_turn;
    face = place.face;
    for (uint32_t y = 0; y < n; y++)
        for (uint32_t x = 0; x < n; x++) {
            const uint32_t sx = x0 + (flip_x ? n - 1 - x : x);
            const uint32_t sy = y0 + (flip_y ? n - 1 - y : y);
            memcpy(cube->texel + (((size_t)face * n + y) * n + x) * 3,
                   src->rgb + ((size_t)sy * src->width + sx) * 3, 3 * sizeof(float));
        }
}

/* Column and row of each face's cell, in cells. */
static const unsigned char hcross[6][2] = {{2, 1}, {0, 1}, {1, 0}, {1, 2}, {3, 1}, {1, 1}};
static const unsigned char vcross[6][2] = {{2, 1}, {0, 1}, {1, 0}, {1, 2}, {1, 3}, {1, 1}};
static const unsigned char row[6][2] = {{0, 0}, {1, 0}, {2, 0}, {3, 0}, {4, 0}, {5, 0}};
static const unsigned char column[6][2] = {{0, 0}, {0, 1}, {0, 2}, {0, 3}, {0, 4}, {0, 5}};

static int start_cube(const struct prt_context *ctx, const char *name, uint32_t n,
                      struct prt_env *env)
{
    if (n > PRT_CUBE_MAX)
        return prt_fail(ctx, PRT_LIMIT, "%s: cube faces of %u x %u are above the limit of %d",
                        name, n, n, PRT_CUBE_MAX);
    env->kind = PRT_ENV_CUBE;
    return prt_cube_init(&env->cube, n);
}

/* The layout's cell of each named picture. In a cross the front, -Z of camera views and +Z of
 * the others, is in the middle. */
static int cut_as(const struct prt_image *im, const unsigned char cell[6][2],
                  enum prt_faces faces, struct prt_cube *cube)
{
    const uint32_t n = cube->n;
    const bool cross = cell == hcross || cell == vcross;
    for (unsigned face = 0; face < 6; face++) {
        const bool swap = cross && face >= 4 && faces != PRT_FACES_CAMERA;
        const unsigned at = swap ? 9 - face : face;
        put_view(im, cell[at][0] * n, cell[at][1] * n, cell == vcross && at == 4, faces, face,
                 cube);
    }
    return PRT_OK;
}

/* A cross is folded the same way by all; a strip is read as the edges fit. */
static int cut_cells(const struct prt_context *ctx, const char *name,
                     const struct prt_image *im, const unsigned char cell[6][2], uint32_t n,
                     enum prt_faces faces, struct prt_env *env)
{
    int err = start_cube(ctx, name, n, env);
    const bool guess = faces == PRT_FACES_GUESS, cross = cell == hcross || cell == vcross;
    if (err) return err;
    if (!guess) return cut_as(im, cell, faces, &env->cube);
    cut_as(im, cell, PRT_FACES_CAMERA, &env->cube);
    if (cross || prt_faces_by_edges(&env->cube) == PRT_FACES_CAMERA) return PRT_OK;
    prt_log(ctx, PRT_LOG_NOTE,
            "%s: its edges fit as in three.js, and it is read so; --faces gl mirrors it, "
            "--faces d3d or --rotate 180 turns it",
            name);
    return cut_as(im, cell, PRT_FACES_THREE, &env->cube);
}

static int use_latlong(struct prt_decoded *in, struct prt_env *env)
{
    env->kind = PRT_ENV_LATLONG;
    env->latlong = in->image;
    in->image = (struct prt_image){0};
    return PRT_OK;
}

/* OpenEXR's lat-long has +Z at its centre: the image turned by half a circle (METHODS §2). */
static int use_exr_latlong(const struct prt_context *ctx, const char *name,
                           struct prt_decoded *in, struct prt_env *env)
{
    struct prt_image *im = &in->image;
    const uint32_t w = im->width, half = w / 2;
    float *line = prt_alloc((size_t)w * 3, sizeof *line);
    if (!line) return prt_fail(ctx, PRT_NOMEM, "%s: no memory", name);
    for (uint32_t y = 0; y < im->height; y++) {
        float *p = im->rgb + (size_t)y * w * 3;
        memcpy(line, p + (size_t)half * 3, (size_t)(w - half) * 3 * sizeof *line);
        memcpy(line + (size_t)(w - half) * 3, p, (size_t)half * 3 * sizeof *line);
        memcpy(p, line, (size_t)w * 3 * sizeof *line);
    }
    prt_free(line);
    return use_latlong(in, env);
}

static int use_gl_cube(const struct prt_context *ctx, const char *name,
                       const struct prt_image *im, enum prt_faces faces, struct prt_env *env)
{
    int err = start_cube(ctx, name, im->width, env);
    if (!err && faces != PRT_FACES_GUESS) return cut_as(im, column, faces, &env->cube);
    if (!err)
        memcpy(env->cube.texel, im->rgb, (size_t)im->width * im->height * 3 * sizeof(float));
    return err;
}

int prt_env_from_image(const struct prt_context *ctx, const char *name, struct prt_decoded *in,
                       enum prt_faces faces, struct prt_env *env)
{
    const struct prt_image *im = &in->image;
    const uint64_t w = im->width, h = im->height;
    const int64_t off = (int64_t)w - 2 * (int64_t)h;
    /* 2:1 up to an odd width or one border line */
    const bool is_latlong = off >= -2 && off <= 2;

    if ((in->hint == PRT_HINT_EXR_CUBE || in->hint == PRT_HINT_GL_CUBE) && h != 6 * w)
        return prt_fail(ctx, PRT_FORMAT,
                        "%s: a cube's six faces in a strip are n x 6n pixels, not %llu x %llu",
                        name, (unsigned long long)w, (unsigned long long)h);
    if (in->hint == PRT_HINT_GL_CUBE) return use_gl_cube(ctx, name, im, faces, env);
    if (in->hint == PRT_HINT_EXR_LATLONG && is_latlong)
        return use_exr_latlong(ctx, name, in, env);
    if (is_latlong) return use_latlong(in, env);
    if (in->hint == PRT_HINT_EXR_CUBE && faces == PRT_FACES_GUESS) faces = PRT_FACES_CAMERA;
    if (h == 6 * w) return cut_cells(ctx, name, im, column, im->width, faces, env);
    if (w == 6 * h) return cut_cells(ctx, name, im, row, im->height, faces, env);
    if (w * 3 == h * 4 && w % 4 == 0)
        return cut_cells(ctx, name, im, hcross, im->width / 4, faces, env);
    if (w * 4 == h * 3 && w % 3 == 0)
        return cut_cells(ctx, name, im, vcross, im->width / 3, faces, env);
    return prt_fail(
        ctx, PRT_FORMAT,
        "%s: %llu x %llu pixels are not an environment: expected a "
        "lat-long (2:1), a cross (4:3 or 3:4) or six faces in a strip (6:1 or 1:6)%s",
        name, (unsigned long long)w, (unsigned long long)h,
        w == h ? "; light probes (angular maps) must be converted to lat-long" : "");
}

static void fill_faces(const struct prt_decoded *image, enum prt_faces faces,
                       struct prt_cube *cube)
{
    for (unsigned face = 0; face < 6; face++)
        put_view(&image[face].image, 0, 0, false, faces, face, cube);
}

int prt_env_from_faces(const struct prt_context *ctx, const char *name,
                       const struct prt_decoded *image, enum prt_faces faces, bool axis_names,
                       struct prt_env *env)
{
    const uint32_t n = image[0].image.width;
    for (unsigned face = 0; face < 6; face++) {
        const struct prt_image *im = &image[face].image;
        if (im->width != n || im->height != n)
            return prt_fail(ctx, PRT_FORMAT,
                            "%s: faces must be square and of one size, face %u "
                            "is %u x %u, the first %u wide",
                            name, face, im->width, im->height, n);
    }
    const bool guess = faces == PRT_FACES_GUESS;
    int err = start_cube(ctx, name, n, env);
    if (err) return err;
    fill_faces(image, guess ? PRT_FACES_CAMERA : faces, &env->cube);
    if (!guess) return PRT_OK;
    const bool camera = prt_faces_by_edges(&env->cube) == PRT_FACES_CAMERA;
    if (!camera) fill_faces(image, PRT_FACES_THREE, &env->cube);
    prt_log(ctx, PRT_LOG_NOTE, "%s: six faces named by %s, read %s", name,
            axis_names ? "axis" : "side",
            camera
                ? "as camera views with -Z in front, as their edges fit; mirrored or turned? "
                  "--faces gl, three or d3d"
                : "as in three.js, as their edges fit; mirrored? --faces gl; turned? --faces "
                  "d3d, or --rotate");
    return PRT_OK;
}
