/* SPDX-License-Identifier: MIT */
/* Geometry shared by the resamplers between lat-long images and cubemaps.
 *
 * The sphere is cut into thin wedges of azimuth at every column edge of the lat-long image and
 * of the cube's side faces, so that a wedge is inside one column of either. Along a wedge's
 * central meridian both images are piecewise constant in z = sin(latitude), and dz dphi is
 * solid angle: power moves between cells by exact 1-D overlap in z. Meridians do not bound the
 * cells of +Y and -Y; there the wedges are made thin (several wedges a corner
 * texel). Each cell's sum is divided by the solid angle it received, so a constant stays
 * constant, and one factor a channel, within about 1e-4 of 1, makes the total power exact. */
#ifndef PRT_LIGHT_RESAMPLE_H
#define PRT_LIGHT_RESAMPLE_H

#include "light_private.h"

#include <math.h>

#define PI 3.14159265358979323846
enum { N_QUADRANT = 4 };

/* The side faces and the azimuth phi of their centres (direction (sin phi, ., -cos phi)); in
 * each, s = -tan(beta) with beta = phi - centre. */
static const struct quadrant {
    unsigned face;
    double phi;
} quadrants[N_QUADRANT] = {{5, 0}, {0, PI / 2}, {4, PI}, {1, -PI / 2}};

/* Walks the cells of a cube's cap along one azimuth outwards from the pole. */
struct cap_walk {
    int x, y, dx, dy;
    double rho, next_x, next_y, step_x, step_y, end;
};

static inline __attribute__((always_inline)) void cap_walk_start(struct cap_walk *w, uint32_t n,
                                                                 double s, double t)
{
    const double half = 0.5 * n, centre_low = (double)(n / 2);
    const bool odd = n & 1;
    const double as = fabs(s) > 1e-12 ? fabs(s) : 1e-12, at = fabs(t) > 1e-12 ? fabs(t) : 1e-12;
    w->dx = s >= 0 ? 1 : -1;
    w->dy = t >= 0 ? 1 : -1;
    w->x = (int)centre_low - (!odd && s < 0);
    w->y = (int)centre_low - (!odd && t < 0);
    w->step_x = 1.0 / (as * half);
    w->step_y = 1.0 / (at * half);
    w->next_x = (odd ? 0.5 : 1.0) * w->step_x;
    w->next_y = (odd ? 0.5 : 1.0) * w->step_y;
    w->rho = 0;
    w->end = 1.0 / (as > at ? as : at);
}

/* Leaves the current cell: returns its outer radius and moves on; the last one is w->end. */
static inline __attribute__((always_inline)) double cap_walk_next(struct cap_walk *w,
                                                                  bool *last)
{
    double out;
    if (w->next_x < w->next_y) {
        out = w->next_x;
        w->next_x += w->step_x;
        w->x += w->dx;
    } else {
        out = w->next_y;
        w->next_y += w->step_y;
        w->y += w->dy;
    }
    *last = out >= w->end * (1 - 1e-9);
    return *last ? w->end : out;
}

/* Wedges that each of n_wedge intervals of azimuth is cut into, so that about `rays_per_texel`
 * wedges cross a corner texel of a cap. */
unsigned prt_resample_cap_rays(double n_wedge, uint32_t n, double rays_per_texel);
/* [height+1] z of the row edges of a lat-long image, 1 to -1; NULL without memory. The caller
 * prt_free()s. */
double *prt_resample_row_edges(uint32_t height);

/* The lat-long a cube environment is turned from: 8 n x 4 n, so 2 pixels a texel. It lies in
 * the environment's cache, made once, or without one in `temporary`, which the caller finishes.
 */
int prt_env_turned_source(const struct prt_context *ctx, const struct prt_env *env,
                          struct prt_image *temporary, const struct prt_image **out);
/* The lat-long `src`, turned counter-clockwise about +y by `turn` [rad], into `out` of n texels
 * a side. PRT_OK, PRT_NOMEM, or the pool's status. */
int prt_resample_latlong_to_cube(const struct prt_context *ctx, const struct prt_image *src,
                                 uint32_t n, double turn, struct prt_cube *out);
/* The cube `src` into `out` of n texels a side, turned counter-clockwise about +y by
 * `quarters` times 90 degrees, exactly. PRT_OK or PRT_NOMEM. */
int prt_resample_cube_to_cube(const struct prt_cube *src, uint32_t n, unsigned quarters,
                              struct prt_cube *out);

#endif
