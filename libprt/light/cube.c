/* SPDX-License-Identifier: MIT */
/* Geometry of cubemaps: face axes, look-ups, exact solid angles. */
#include "prt/light.h"

#include <math.h>
#include <string.h>

void prt_image_finish(struct prt_image *image)
{
    if (!image) return;
    prt_free(image->rgb);
    prt_free(image->alpha);
    memset(image, 0, sizeof *image);
}

int prt_cube_init(struct prt_cube *cube, uint32_t n)
{
    cube->n = 0;
    cube->texel = NULL;
    if (n < 1 || n > PRT_CUBE_MAX)
        return prt_fail(NULL, PRT_ARG, "cube size %u, allowed range 1 to %d", n, PRT_CUBE_MAX);
    cube->texel = prt_calloc((size_t)6 * n * n * 3, sizeof(float));
    if (!cube->texel)
        return prt_fail(NULL, PRT_NOMEM, "no memory for a cube of 6 x %u x %u", n, n);
    cube->n = n;
    return PRT_OK;
}

void prt_cube_finish(struct prt_cube *cube)
{
    if (!cube) return;
    prt_free(cube->texel);
    cube->texel = NULL;
    cube->n = 0;
}

void prt_cube_direction(unsigned face, double s, double t, float dir[3])
{
    const double d[6][3] = {{1, -t, -s}, {-1, -t, s}, {s, 1, t},
                            {s, -1, -t}, {s, -t, 1},  {-s, -t, -1}};
    const double scale = 1.0 / sqrt(1.0 + s * s + t * t);
    for (int i = 0; i < 3; i++) dir[i] = (float)(d[face][i] * scale);
}

void prt_cube_lookup(const float dir[3], unsigned *face, float *s, float *t)
{
    const float x = dir[0], y = dir[1], z = dir[2];
    const float ax = fabsf(x), ay = fabsf(y), az = fabsf(z);
    float a, b, major;
    if (ax >= ay && ax >= az) {
        *face = x < 0;
        a = x < 0 ? z : -z;
        b = -y;
        major = ax;
    } else if (ay >= az) {
        *face = y < 0 ? 3 : 2;
        a = x;
        b = y < 0 ? -z : z;
        major = ay;
    } else {
        *face = z < 0 ? 5 : 4;
        a = z < 0 ? -x : x;
        b = -y;
        major = az;
    }
    *s = major > 0 ? a / major : 0;
    *t = major > 0 ? b / major : 0;
}

/* Solid angle of the rectangle [0,s] x [0,t] on the plane at distance 1. */
static double corner(double s, double t)
{
    return atan2(s * t, sqrt(s * s + t * t + 1.0));
}

double prt_cube_solid_angle(uint32_t n, uint32_t x, uint32_t y)
{
    const double s0 = 2.0 * x / n - 1.0, s1 = 2.0 * (x + 1.0) / n - 1.0;
    const double t0 = 2.0 * y / n - 1.0, t1 = 2.0 * (y + 1.0) / n - 1.0;
    return corner(s1, t1) - corner(s0, t1) - corner(s1, t0) + corner(s0, t0);
}

void prt_cube_solid_angles(uint32_t n, float *out)
{
    /* eightfold symmetry: compute a quadrant's triangle, mirror it */
    const uint32_t half = (n + 1) / 2;
    for (uint32_t y = 0; y < half; y++)
        for (uint32_t x = 0; x <= y; x++) {
            const float w = (float)prt_cube_solid_angle(n, x, y);
            const uint32_t mx = n - 1 - x, my = n - 1 - y;
            out[(size_t)y * n + x] = out[(size_t)x * n + y] = w;
            out[(size_t)y * n + mx] = out[(size_t)x * n + my] = w;
            out[(size_t)my * n + x] = out[(size_t)mx * n + y] = w;
            out[(size_t)my * n + mx] = out[(size_t)mx * n + my] = w;
        }
}
