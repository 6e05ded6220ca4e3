// SPDX-License-Identifier: MIT
// The cameras of a glTF file. A damaged one is left out, with a warning, and fails no model.
#include "gltf.h"

#include <cjson/cJSON.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

static void read_camera(const cJSON *item, struct gltf_camera *out)
{
    const cJSON *name = cJSON_GetObjectItemCaseSensitive(item, "name");
    const cJSON *view = cJSON_GetObjectItemCaseSensitive(item, "perspective");
    const cJSON *angle = cJSON_GetObjectItemCaseSensitive(view, "yfov"); // radians
    if (cJSON_IsString(name)) snprintf(out->name, sizeof out->name, "%s", name->valuestring);
    double degrees = cJSON_IsNumber(angle) ? angle->valuedouble * 180 / M_PI : 0;
    out->fovy_deg = degrees > 0 && degrees < 170 ? degrees : 0;
}

int prt_gltf_cameras(struct gltf *g, const char *json, size_t n)
{
    cJSON *list = cJSON_ParseWithLengthOpts(json, n, NULL, 0);
    int count = cJSON_IsArray(list) ? cJSON_GetArraySize(list) : 0;
    const cJSON *item;
    size_t i = 0;
    g->n_camera = 0;
    if (count) g->camera = prt_gltf_own(g, (size_t)count * sizeof *g->camera);
    if (count && g->camera) cJSON_ArrayForEach(item, list) read_camera(item, &g->camera[i++]);
    g->n_camera = i;
    cJSON_Delete(list);
    return count && !g->camera ? prt_gltf_no_memory(g) : PRT_OK;
}

void prt_gltf_add_camera(struct gltf *g, const struct prt_gltf_node *node, const double *m)
{
    if (node->camera < 0 || (uint64_t)node->camera >= g->n_camera) return;
    const struct gltf_camera *c = &g->camera[node->camera];
    const char *name = node->name[0] ? node->name : c->name[0] ? c->name : "camera";
    const double forward[3] = {-m[8], -m[9], -m[10]}; // a camera looks along -z
    if (c->fovy_deg > 0) {
        prt_draft_camera(g->d, name, m + 12, forward, m + 4, c->fovy_deg);
        return;
    }
    prt_log(g->d->ctx, PRT_LOG_WARNING,
            "%s: camera \"%.60s\" is left out: it is orthographic, or has no angle of view "
            "below 170 degrees",
            g->d->name, name);
}
