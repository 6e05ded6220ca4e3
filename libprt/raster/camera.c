// SPDX-License-Identifier: MIT
// Cameras: the texts of --camera and --orbit, framing, the file's own cameras, and the frame
// that rays are computed from.
#include "internal.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static double dot3(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross3(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static bool normalise3(double v[3])
{
    double l = sqrt(dot3(v, v));
    if (!(l > 1e-30) || !isfinite(l)) return false;
    for (int i = 0; i < 3; i++) v[i] /= l;
    return true;
}

// Three comma-separated numbers up to ':' or the end; advances *text past them.
static bool parse_triple(const char **text, float out[3])
{
    const char *p = *text;
    for (int i = 0; i < 3; i++) {
        char *end;
        out[i] = strtof(p, &end);
        if (end == p || !isfinite(out[i])) return false;
        if (i < 2 && *end != ',') return false;
        p = i < 2 ? end + 1 : end;
    }
    *text = p;
    return *p == 0 || *p == ':';
}

int prt_camera_parse(const struct prt_context *ctx, const char *text, struct prt_camera *out)
{
    struct prt_camera c = {.up = {0, 1, 0}, .fovy_deg = 36};
    if (!strcmp(text, "auto")) {
        c.automatic = true;
        *out = c;
        return PRT_OK;
    }
    static const char *const part[] = {"EYE", "TARGET", "UP"};
    float *where[] = {c.eye, c.target, c.up};
    const char *p = text;
    for (int i = 0; i < 3; i++) {
        if (!parse_triple(&p, where[i]))
            return prt_fail(ctx, PRT_ARG,
                            "camera '%s': %s must be three finite numbers x,y,z "
                            "(EYE:TARGET[:UP[:FOVY]])",
                            text, part[i]);
        if (!*p && i == 0)
            return prt_fail(ctx, PRT_ARG,
                            "camera '%s': TARGET is missing (EYE:TARGET[:UP[:FOVY]])", text);
        if (!*p) break;
        p++;
    }
    if (*p) {
        char *end;
        c.fovy_deg = strtof(p, &end);
        if (end == p || *end)
            return prt_fail(ctx, PRT_ARG,
                            "camera '%s': FOVY must be one number of degrees in (0,170)", text);
    }
    struct camera_frame frame;
    int status = prt_camera_frame_init(ctx, &c, 1, 1, 1, &frame);
    if (status) return status;
    *out = c;
    return PRT_OK;
}

int prt_camera_frame_init(const struct prt_context *ctx, const struct prt_camera *camera,
                          double mm_per_unit, uint32_t width, uint32_t height,
                          struct camera_frame *out)
{
    struct camera_frame f;
    double up[3];
    for (int i = 0; i < 3; i++) {
        f.eye[i] = camera->eye[i] * mm_per_unit;
        f.forward[i] = ((double)camera->target[i] - camera->eye[i]) * mm_per_unit;
        up[i] = camera->up[i];
        if (!isfinite(f.eye[i]) || !isfinite(f.forward[i]) || !isfinite(up[i]))
            return prt_fail(ctx, PRT_ARG, "camera: eye, target and up must be finite numbers");
    }
    if (!(camera->fovy_deg > 0 && camera->fovy_deg < 170))
        return prt_fail(ctx, PRT_ARG, "camera: field of view %g is outside (0,170) degrees",
                        (double)camera->fovy_deg);
    if (!normalise3(f.forward))
        return prt_fail(ctx, PRT_ARG, "camera: eye and target are the same point");
    bool parallel = !normalise3(up);
    if (!parallel) {
        cross3(f.forward, up, f.right);
        parallel = dot3(f.right, f.right) < 1e-10;
    }
    if (parallel) {
        // up is parallel to the view: replaced by -z, or by x when that is parallel too
        double other[3] = {0, 0, -1};
        if (fabs(f.forward[2]) > 0.9) other[0] = 1, other[2] = 0;
        prt_log(ctx, PRT_LOG_NOTE, "camera: up is parallel to the view; using %g,%g,%g",
                other[0], other[1], other[2]);
        cross3(f.forward, other, f.right);
    }
    normalise3(f.right);
    cross3(f.right, f.forward, f.up);
    f.tan_y = tan(camera->fovy_deg * (M_PI / 360));
    f.tan_x = f.tan_y * width / height;
    for (int i = 0; i < 3; i++) {
        f.right[i] *= f.tan_x;
        f.up[i] *= f.tan_y;
    }
    *out = f;
    return PRT_OK;
}

// Whether the default camera frames this block: translucent ones, or all where none is.
static bool block_counts(const struct prt_mesh *mesh, const struct prt_block *block,
                         bool any_translucent)
{
    return !any_translucent || mesh->surface[block->surface].translucent;
}

// Middle of the framed vertices [mm].
static void frame_centre(const struct prt_mesh *mesh, bool any, double centre[3])
{
    double lo[3] = {1e300, 1e300, 1e300}, hi[3] = {-1e300, -1e300, -1e300};
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        const struct prt_block *k = &mesh->block[b];
        if (!block_counts(mesh, k, any)) continue;
        for (uint32_t v = k->vertex_begin; v < k->vertex_begin + k->n_vertex; v++) {
            for (int i = 0; i < 3; i++) {
                lo[i] = fmin(lo[i], mesh->position[v][i]);
                hi[i] = fmax(hi[i], mesh->position[v][i]);
            }
        }
    }
    for (int i = 0; i < 3; i++) centre[i] = hi[i] >= lo[i] ? (lo[i] + hi[i]) / 2 : 0;
}

// The axes of a view from azimuth and elevation [rad]: towards the eye, right and up.
struct view {
    double back[3], right[3], up[3];
};

static struct view view_from(double azimuth, double elevation)
{
    double sa = sin(azimuth), ca = cos(azimuth), se = sin(elevation), ce = cos(elevation);
    return (struct view){{sa * ce, se, ca * ce}, {ca, 0, -sa}, {-sa * se, ce, -ca * se}};
}

// The nearest distance [mm] at which every framed vertex lies inside both fields of view, whose
// half angles have these tangents.
static double frame_distance(const struct prt_mesh *mesh, bool any, const double centre[3],
                             const struct view *view, double tan_x, double tan_y)
{
    double distance = 0;
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        const struct prt_block *k = &mesh->block[b];
        if (!block_counts(mesh, k, any)) continue;
        for (uint32_t v = k->vertex_begin; v < k->vertex_begin + k->n_vertex; v++) {
            double p[3];
            for (int i = 0; i < 3; i++) p[i] = mesh->position[v][i] - centre[i];
            double z = dot3(p, view->back), d = z + fabs(dot3(p, view->up)) / tan_y;
            distance = fmax(distance, fmax(d, z + fabs(dot3(p, view->right)) / tan_x));
        }
    }
    return distance > 0 ? distance : 1;
}

void prt_camera_frame_from(const struct prt_mesh *mesh, float aspect,
                           const struct prt_orbit *orbit, struct prt_camera *out)
{
    const double margin = 0.9, fovy = 36, degree = M_PI / 180;
    double scale = mesh->mm_per_unit > 0 ? mesh->mm_per_unit : 1, centre[3];
    double tan_y = tan(fovy * degree / 2) * margin, tan_x = tan_y * (aspect > 0 ? aspect : 1);
    struct view view =
        view_from((double)orbit->azimuth_deg * degree, (double)orbit->elevation_deg * degree);
    bool any = false;
    for (uint32_t b = 0; b < mesh->n_block; b++)
        any |= mesh->surface[mesh->block[b].surface].translucent != 0;
    frame_centre(mesh, any, centre);
    double distance = frame_distance(mesh, any, centre, &view, tan_x, tan_y);
    // Zoom narrows the field of view: the eye never enters the model.
    double zoom = orbit->zoom > 0 ? (double)orbit->zoom : 1;
    double angle = zoom == 1 ? fovy : 2 * atan(tan(fovy * degree / 2) / zoom) / degree;
    *out = (struct prt_camera){.fovy_deg = (float)angle};
    for (int i = 0; i < 3; i++) {
        out->target[i] = (float)(centre[i] / scale);
        out->eye[i] = (float)((centre[i] + distance * view.back[i]) / scale);
        out->up[i] = (float)view.up[i];
    }
}

void prt_camera_frame(const struct prt_mesh *mesh, float aspect, struct prt_camera *out)
{
    const struct prt_orbit orbit = {.elevation_deg = 15, .zoom = 1};
    prt_camera_frame_from(mesh, aspect, &orbit, out);
    out->up[0] = out->up[2] = 0;
    out->up[1] = 1;
    out->automatic = true;
}

bool prt_orbit_ok(const struct prt_orbit *orbit)
{
    return fabsf(orbit->azimuth_deg) <= 1e6f && fabsf(orbit->elevation_deg) <= 90 &&
           orbit->zoom >= 0.1f && orbit->zoom <= 100;
}

int prt_orbit_parse(const struct prt_context *ctx, const char *text, struct prt_orbit *out)
{
    struct prt_orbit o = {.zoom = 1};
    float *value[3] = {&o.azimuth_deg, &o.elevation_deg, &o.zoom};
    const char *p = text;
    int n = 0;
    while (n < 3) {
        char *end;
        *value[n] = strtof(p, &end);
        if (end == p || !isfinite(*value[n])) break;
        n++;
        p = end;
        if (*p != ',' || n == 3) break;
        p++;
    }
    if (*p || n < 2)
        return prt_fail(ctx, PRT_ARG,
                        "orbit '%s': expected AZIMUTH,ELEVATION[,ZOOM], as 30,15 or 30,15,2",
                        text);
    if (!prt_orbit_ok(&o))
        return prt_fail(ctx, PRT_ARG,
                        "orbit '%s': the elevation is in [-90, 90] degrees, the zoom in "
                        "[0.1, 100]",
                        text);
    *out = o;
    return PRT_OK;
}

int prt_camera_named(const struct prt_context *ctx, const struct prt_mesh *mesh,
                     const char *name, struct prt_camera *out)
{
    const char *list[PRT_MESH_MOST_CAMERAS];
    char remedy[256];
    if (!mesh->n_camera)
        return prt_fail(ctx, PRT_ARG,
                        "camera '%s': the model has no cameras of its own; give "
                        "EYE:TARGET[:UP[:FOVY]] or an orbit",
                        name);
    for (uint32_t i = 0; i < mesh->n_camera; i++) list[i] = mesh->camera[i].name;
    int found = prt_name_choose(name, list, mesh->n_camera, remedy, sizeof remedy);
    if (found < 0)
        return prt_fail(ctx, PRT_ARG, "camera '%s' is none of the model's %u (first: %s)%s%s",
                        name, mesh->n_camera, list[0], remedy[0] ? "; " : "", remedy);
    const struct prt_mesh_camera *c = &mesh->camera[found];
    *out = (struct prt_camera){.fovy_deg = c->fovy_deg};
    memcpy(out->eye, c->eye, sizeof out->eye);
    memcpy(out->target, c->target, sizeof out->target);
    memcpy(out->up, c->up, sizeof out->up);
    return PRT_OK;
}

void prt_camera_print(const struct prt_camera *c, char *text, size_t size)
{
    snprintf(text, size, "%.7g,%.7g,%.7g:%.7g,%.7g,%.7g:%.7g,%.7g,%.7g:%.7g", (double)c->eye[0],
             (double)c->eye[1], (double)c->eye[2], (double)c->target[0], (double)c->target[1],
             (double)c->target[2], (double)c->up[0], (double)c->up[1], (double)c->up[2],
             (double)c->fovy_deg);
}
