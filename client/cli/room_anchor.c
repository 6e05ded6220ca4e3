// SPDX-License-Identifier: MIT
// relight room anchors: where the pins lie on the model that the room shows now. On a model of
// the pin's mesh it is the same triangle, also where its vertices moved; on another one the
// nearest point of its surface, if there is one near enough.
#include "room.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

// Of the diagonal of the model's bounding box: farther away is another place.
static const double most_distance = .01;

struct anchor {
    bool placed, same_mesh;
    struct room_point point; // its distance: from where the pin was, in diagonals
};

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

double room_bounds(const struct relight_geometry *g, double low[3], double high[3])
{
    for (int k = 0; k < 3; k++) {
        low[k] = INFINITY;
        high[k] = -INFINITY;
    }
    for (uint32_t i = 0; i < g->n_vertex; i++)
        for (int k = 0; k < 3; k++) {
            low[k] = fmin(low[k], g->position[i][k]);
            high[k] = fmax(high[k], g->position[i][k]);
        }
    double d[3];
    for (int k = 0; k < 3; k++) d[k] = high[k] - low[k];
    return sqrt(dot(d, d));
}

// The point of a triangle that is nearest to p: its weights of the second and third corner.
// Ericson, Real-Time Collision Detection, 5.1.5: regions of corners, edges and the face.
static void nearest_in_triangle(const double p[3], const double a[3], const double b[3],
                                const double c[3], double w[2])
{
    double ab[3], ac[3], ap[3], bp[3], cp[3];
    for (int k = 0; k < 3; k++) {
        ab[k] = b[k] - a[k];
        ac[k] = c[k] - a[k];
        ap[k] = p[k] - a[k];
        bp[k] = p[k] - b[k];
        cp[k] = p[k] - c[k];
    }
    double d1 = dot(ab, ap), d2 = dot(ac, ap), d3 = dot(ab, bp), d4 = dot(ac, bp);
    double d5 = dot(ab, cp), d6 = dot(ac, cp);
    double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
    double sum = va + vb + vc;
    w[0] = w[1] = 0;
    if (d1 <= 0 && d2 <= 0) return;
    if (d3 >= 0 && d4 <= d3) {
        w[0] = 1;
    } else if (d6 >= 0 && d5 <= d6) {
        w[1] = 1;
    } else if (vc <= 0 && d1 >= 0 && d3 <= 0) {
        w[0] = d1 / (d1 - d3);
    } else if (vb <= 0 && d2 >= 0 && d6 <= 0) {
        w[1] = d2 / (d2 - d6);
    } else if (va <= 0) {
        w[1] = (d4 - d3) / (d4 - d3 + d5 - d6);
        w[0] = 1 - w[1];
    } else if (sum > 0) {
        w[0] = vb / sum;
        w[1] = vc / sum;
    }
}

static void point_of(const struct relight_geometry *g, uint32_t triangle, const double w[2],
                     double out[3])
{
    const uint32_t *c = g->triangle[triangle];
    for (int k = 0; k < 3; k++)
        out[k] = (1 - w[0] - w[1]) * g->position[c[0]][k] + w[0] * g->position[c[1]][k] +
                 w[1] * g->position[c[2]][k];
}

static double distance(const double a[3], const double b[3])
{
    double d[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
    return sqrt(dot(d, d));
}

static uint32_t object_of(const struct relight_geometry *g, uint32_t triangle)
{
    for (size_t i = 0; i < g->n_block; i++) {
        const struct relight_block *b = &g->block[i];
        if (triangle >= b->triangle_begin && triangle - b->triangle_begin < b->n_triangle)
            return b->object;
    }
    return 0;
}

void room_point_fill(const struct relight_geometry *g, struct room_point *point)
{
    point_of(g, point->triangle, point->weight, point->position);
    point->object = object_of(g, point->triangle);
}

void room_nearest(const struct relight_geometry *g, const double p[3], struct room_point *out)
{
    double best = INFINITY;
    for (uint32_t t = 0; t < g->n_triangle; t++) {
        double corner[3][3], w[2], at[3];
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++) corner[i][k] = g->position[g->triangle[t][i]][k];
        nearest_in_triangle(p, corner[0], corner[1], corner[2], w);
        point_of(g, t, w, at);
        double d = distance(p, at);
        if (!(d < best)) continue;
        best = d;
        out->triangle = t;
        memcpy(out->weight, w, sizeof w);
        memcpy(out->position, at, sizeof at);
    }
    out->distance = best;
    out->object = object_of(g, out->triangle);
}

static void read_position(const cJSON *at, double out[3])
{
    const cJSON *p = list_of(at, "position");
    out[0] = number_of(p, "x");
    out[1] = number_of(p, "y");
    out[2] = number_of(p, "z");
}

// A model that was baked anew is another model of the same mesh.
static bool same_mesh(const struct relight_geometry *g, const char *model, const cJSON *seen)
{
    const char *hash = text_of(seen, "mesh_hash");
    if (*hash && *g->mesh_hash) return !strcmp(hash, g->mesh_hash);
    return !strcmp(text_of(seen, "model"), model);
}

static struct anchor find_anchor(const struct relight_geometry *g, const char *model,
                                 double size, const cJSON *pin)
{
    const cJSON *at = list_of(pin, "at");
    struct anchor a = {.same_mesh = same_mesh(g, model, list_of(pin, "seen")),
                       .point.triangle = (uint32_t)number_of(at, "triangle")};
    double was[3];
    bool known = list_of(at, "position") != NULL;
    read_position(at, was);
    if (a.same_mesh && a.point.triangle < g->n_triangle) {
        a.point.weight[0] = number_of(at, "b1");
        a.point.weight[1] = number_of(at, "b2");
        room_point_fill(g, &a.point);
        a.point.distance = known ? distance(was, a.point.position) / size : 0;
        a.placed = true;
    } else if (known && g->n_triangle) {
        room_nearest(g, was, &a.point);
        a.point.distance /= size;
        a.placed = a.point.distance <= most_distance;
    } else {
        a.point.distance = INFINITY;
    }
    return a;
}

// ---- printing

static void print_anchor(double pin, const struct anchor *a)
{
    printf("pin %.0f  ", pin);
    if (!a->placed && isfinite(a->point.distance))
        printf(
            "cannot be placed: the nearest surface is %.2f %% of the model's size away, more "
            "than %g %%\n",
            100 * a->point.distance, 100 * most_distance);
    else if (!a->placed) printf("cannot be placed: its position was not kept\n");
    else if (!a->same_mesh)
        printf("on the nearest surface, %.3f %% of the model's size away: %u,%u,%.4f,%.4f\n",
               100 * a->point.distance, a->point.object, a->point.triangle, a->point.weight[0],
               a->point.weight[1]);
    else if (a->point.distance > 1e-6)
        printf("on its triangle, which moved by %.3f %% of the model's size\n",
               100 * a->point.distance);
    else printf("on its triangle, as it was\n");
}

cJSON *room_point_json(const struct room_point *p)
{
    static const char *const axis[] = {"x", "y", "z"};
    cJSON *at = cJSON_CreateObject();
    cJSON_AddNumberToObject(at, "object", p->object);
    cJSON_AddNumberToObject(at, "triangle", p->triangle);
    add_float(at, "b1", (float)p->weight[0]);
    add_float(at, "b2", (float)p->weight[1]);
    cJSON *position = cJSON_AddObjectToObject(at, "position");
    for (int k = 0; k < 3; k++) add_float(position, axis[k], (float)p->position[k]);
    return at;
}

static cJSON *anchor_json(double pin, const struct anchor *a)
{
    cJSON *json = cJSON_CreateObject();
    cJSON_AddNumberToObject(json, "pin", pin);
    cJSON_AddStringToObject(json, "state",
                            !a->placed                 ? "lost"
                            : !a->same_mesh            ? "placed"
                            : a->point.distance > 1e-6 ? "moved"
                                                       : "same");
    if (isfinite(a->point.distance))
        cJSON_AddNumberToObject(json, "distance", a->point.distance);
    if (a->placed) cJSON_AddItemToObject(json, "at", room_point_json(&a->point));
    return json;
}

int room_anchors(struct room_call *c)
{
    struct relight_geometry g;
    const cJSON *pin;
    cJSON *state = room_state(c);
    if (!state) return EXIT_FAILED;
    const char *model = text_of(list_of(state, "scene"), "model");
    int status = EXIT_DONE;
    if (!*model)
        status = report_usage(c->options, "the room's scene has no model: set it first");
    else if (relight_geometry(c->client, model, true, &g, &c->error)) status = room_failed(c);
    if (!status) {
        double low[3], high[3], size = room_bounds(&g, low, high);
        cJSON_ArrayForEach(pin, list_of(state, "pins"))
        {
            double number = number_of(list_of(pin, "stamp"), "sequence");
            struct anchor a = find_anchor(&g, model, size > 0 ? size : 1, pin);
            if (c->options->json) print_json(anchor_json(number, &a));
            else print_anchor(number, &a);
        }
        relight_geometry_finish(&g);
    }
    cJSON_Delete(state);
    return status;
}
