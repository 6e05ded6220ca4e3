// SPDX-License-Identifier: MIT
// Cameras: the text of --camera, the default view, and the frame that rays are computed from.
#include "internal.h"

#include <math.h>
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

void prt_camera_frame(const struct prt_mesh *mesh, float aspect, struct prt_camera *out)
{
    const double elevation = 15 * M_PI / 180, margin = 0.9, fovy = 36;
    double scale = mesh->mm_per_unit > 0 ? mesh->mm_per_unit : 1;
    double tan_y = tan(fovy * M_PI / 360) * margin, tan_x = tan_y * (aspect > 0 ? aspect : 1);
    double back[3] = {0, sin(elevation), cos(elevation)};
    double up[3] = {0, cos(elevation), -sin(elevation)};
    bool any = false;
    for (uint32_t b = 0; b < mesh->n_block; b++)
        any |= mesh->surface[mesh->block[b].surface].translucent != 0;
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
    double centre[3], distance = 0;
    for (int i = 0; i < 3; i++) centre[i] = hi[i] >= lo[i] ? (lo[i] + hi[i]) / 2 : 0;
    // the nearest distance at which every vertex lies inside both fields of view
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        const struct prt_block *k = &mesh->block[b];
        if (!block_counts(mesh, k, any)) continue;
        for (uint32_t v = k->vertex_begin; v < k->vertex_begin + k->n_vertex; v++) {
            double p[3];
            for (int i = 0; i < 3; i++) p[i] = mesh->position[v][i] - centre[i];
            double z = dot3(p, back), d = z + fabs(dot3(p, up)) / tan_y;
            distance = fmax(distance, fmax(d, z + fabs(p[0]) / tan_x));
        }
    }
    if (!(distance > 0)) distance = 1;
    *out = (struct prt_camera){.up = {0, 1, 0}, .fovy_deg = (float)fovy, .automatic = true};
    for (int i = 0; i < 3; i++) {
        out->target[i] = (float)(centre[i] / scale);
        out->eye[i] = (float)((centre[i] + distance * back[i]) / scale);
    }
}
