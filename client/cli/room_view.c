// SPDX-License-Identifier: MIT
// A view of another program on the model of the room: the point that its middle shows, and the
// camera that shows the same.
#include "room.h"

#include <math.h>
#include <string.h>

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const double a[3], const double b[3], double out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
}

// Intersection of a ray with a triangle, from either side (Moeller and Trumbore 1997). Returns
// the distance along the ray, or INFINITY where the two do not meet. w gets the barycentric
// coordinates of the second and the third corner.
static double meet(const double eye[3], const double direction[3], const double corner[3][3],
                   double w[2])
{
    double ab[3], ac[3], from[3], p[3], q[3];
    for (int k = 0; k < 3; k++) {
        ab[k] = corner[1][k] - corner[0][k];
        ac[k] = corner[2][k] - corner[0][k];
        from[k] = eye[k] - corner[0][k];
    }
    cross(direction, ac, p);
    double volume = dot(ab, p);
    if (!(fabs(volume) > 0)) return INFINITY;
    cross(from, ab, q);
    w[0] = dot(from, p) / volume;
    w[1] = dot(direction, q) / volume;
    double t = dot(ac, q) / volume;
    return w[0] >= 0 && w[1] >= 0 && w[0] + w[1] <= 1 && t > 0 ? t : INFINITY;
}

static double first_hit(const struct relight_geometry *g, const double eye[3],
                        const double direction[3], struct room_point *out)
{
    double nearest = INFINITY;
    for (uint32_t t = 0; t < g->n_triangle; t++) {
        double corner[3][3], w[2];
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++) corner[i][k] = g->position[g->triangle[t][i]][k];
        double at = meet(eye, direction, corner, w);
        if (!(at < nearest)) continue;
        nearest = at;
        out->triangle = t;
        memcpy(out->weight, w, sizeof w);
    }
    if (nearest < INFINITY) room_point_fill(g, out);
    return nearest;
}

// The ray passes the model by: the surface that is nearest to where it comes nearest to the
// model's middle.
static double pass_by(const struct relight_geometry *g, const double eye[3],
                      const double direction[3], const double middle[3], struct room_point *out)
{
    double to[3], p[3];
    for (int k = 0; k < 3; k++) to[k] = middle[k] - eye[k];
    double t = fmax(0, dot(to, direction));
    for (int k = 0; k < 3; k++) p[k] = eye[k] + t * direction[k];
    room_nearest(g, p, out);
    return t;
}

// The view's own up, unless it points along the view.
static void choose_up(const struct bcf_view *view, float out[3])
{
    double side[3];
    cross(view->direction, view->up, side);
    bool good =
        sqrt(dot(side, side)) > 1e-3 * sqrt(dot(view->up, view->up)) && dot(side, side) > 0;
    bool steep = fabs(view->direction[1]) > .99;
    for (int k = 0; k < 3; k++)
        out[k] = good ? (float)view->up[k] : k == (steep ? 2 : 1) ? 1 : 0;
}

// Daemons have no orthogonal camera: a long lens from far away shows nearly the same.
static const double lens_deg = 10;

bool room_look(const struct relight_geometry *g, const struct bcf_view *view,
               struct room_point *at, struct relight_camera *camera)
{
    double low[3], high[3], middle[3], eye[3];
    double size = room_bounds(g, low, high),
           units = 1e3 / (g->mm_per_unit > 0 ? g->mm_per_unit : 1);
    *camera = (struct relight_camera){.set = true, .fovy_deg = (float)view->fovy_deg};
    if (!g->n_triangle) return false;
    for (int k = 0; k < 3; k++) {
        middle[k] = (low[k] + high[k]) / 2;
        eye[k] = view->eye[k] * units;
    }
    double t = first_hit(g, eye, view->direction, at);
    if (!(t < INFINITY)) t = pass_by(g, eye, view->direction, middle, at);
    double back = 0;
    if (view->height > 0) {
        double half = lens_deg / 2 * acos(-1) / 180;
        back = view->height * units / 2 / tan(half) - t;
        camera->fovy_deg = (float)lens_deg;
    }
    t = fmax(t, 1e-3 * size); // an eye on the surface looks along the view, too
    for (int k = 0; k < 3; k++) {
        camera->eye[k] = (float)(eye[k] - back * view->direction[k]);
        camera->target[k] = (float)(eye[k] + t * view->direction[k]);
    }
    choose_up(view, camera->up);
    return memcmp(camera->eye, camera->target, sizeof camera->eye) != 0;
}
