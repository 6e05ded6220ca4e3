// SPDX-License-Identifier: MIT
// What an opened file tells about its model: sizes, errors, variants, hashes.
#include "store/model_files.h"

#include <cjson/cJSON.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// The worst of a term's lights in the bake's own measurement.
static float json_error(const char *errors, const char *term)
{
    cJSON *json = errors ? cJSON_Parse(errors) : NULL;
    const cJSON *worst =
        cJSON_GetObjectItemCaseSensitive(cJSON_GetObjectItemCaseSensitive(json, term), "worst");
    float x = cJSON_IsNumber(worst) ? (float)worst->valuedouble : 0;
    cJSON_Delete(json);
    return x;
}

// The file of a preview has a tensor, too, but nothing is in it.
static bool has_light(const struct prt_transport *t)
{
    for (uint32_t i = 0; i < t->n_tensor; i++)
        if (t->tensor[i].u_count || t->tensor[i].rows.n_row) return true;
    return false;
}

struct model_hashes model_hashes(const struct prt_file *file)
{
    struct model_hashes out = {0};
    const struct prt_transport *t = prt_file_transport(file);
    if (t->mesh_hash)
        snprintf(out.mesh, sizeof out.mesh, "%016llx", (unsigned long long)t->mesh_hash);
    if (has_light(t))
        snprintf(out.bake, sizeof out.bake, "%016llx", (unsigned long long)prt_file_hash(file));
    return out;
}

static void learn_variants(struct model *m, const struct prt_mesh *mesh)
{
    struct prt_mesh_variant *names = malloc((mesh->n_variant + 1) * sizeof *names);
    if (!names) return;
    if (mesh->n_variant) memcpy(names, mesh->variant, mesh->n_variant * sizeof *names);
    free(m->variant);
    m->variant = names;
    m->n_variant = mesh->n_variant;
}

void model_learn_mesh(struct model *m, const struct prt_file *file)
{
    const struct prt_mesh *mesh = &prt_file_transport(file)->mesh;
    struct model_facts *f = &m->facts;
    if (f->known) return;
    learn_variants(m, mesh);
    *f = (struct model_facts){.known = true,
                              .n_vertex = mesh->n_vertex,
                              .n_triangle = mesh->n_triangle,
                              .n_object = mesh->n_object,
                              .mm_per_unit = mesh->mm_per_unit};
    prt_mesh_bounds(mesh, f->file_box);
    memcpy(f->box, f->file_box, sizeof f->box);
}

static uint32_t exit_planes(const struct prt_transport *t)
{
    for (uint32_t i = 0; i < t->n_tensor; i++)
        if (t->tensor[i].term == PRT_TERM_VIEW) return t->tensor[i].n_phase;
    return 0;
}

void model_learn_facts(struct model *m, const struct prt_file *file)
{
    const struct prt_transport *t = prt_file_transport(file);
    struct model_facts *f = &m->facts;
    float box[2][3];
    if (f->baked && f->hash == prt_file_hash(file)) return; // it was open before
    memcpy(box, f->box, sizeof box);
    learn_variants(m, &t->mesh);
    *f = (struct model_facts){.known = true,
                              .baked = true,
                              .n_vertex = t->mesh.n_vertex,
                              .n_triangle = t->mesh.n_triangle,
                              .n_object = t->mesh.n_object,
                              .mm_per_unit = t->mesh.mm_per_unit,
                              .engine = t->engine,
                              .storage = t->n_tensor ? t->tensor[0].storage : 0,
                              .cube = t->cube,
                              .exit_planes = exit_planes(t),
                              .bytes = prt_file_bytes(file),
                              .hash = prt_file_hash(file),
                              .error_multiple = json_error(t->errors, "multiple"),
                              .error_single = json_error(t->errors, "single"),
                              .error_view = json_error(t->errors, "single_toward_eyes"),
                              .error_total = json_error(t->errors, "total")};
    prt_mesh_bounds(&t->mesh, f->file_box);
    memcpy(f->box, m->pose ? box : f->file_box, sizeof f->box);
}
