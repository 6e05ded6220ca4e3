// SPDX-License-Identifier: MIT
// The approved material as project JSON, as glTF (KHR_materials_volume with the draft of
// KHR_materials_volume_scatter) and as MaterialX (standard_surface).
#include "room.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// The newest approval that no rejection follows; else NULL.
static const cJSON *approval(const cJSON *state)
{
    const cJSON *d, *found = NULL;
    cJSON_ArrayForEach(d, list_of(state, "decisions")) found =
        cJSON_IsTrue(list_of(d, "approve")) ? d : NULL;
    return found;
}

// malloc()ed; NULL where there is none.
static char *text_copy(const cJSON *material)
{
    if (cJSON_IsObject(material)) return cJSON_PrintUnformatted(material);
    return cJSON_IsString(material) ? strdup(material->valuestring) : NULL;
}

// The material's text of the approved revision, malloc()ed; the model's own where it has none.
static char *material_text(struct room_call *c, const cJSON *scene)
{
    const cJSON *material = list_of(scene, "material");
    struct relight_model model;
    if (cJSON_IsObject(material) || cJSON_IsString(material)) return text_copy(material);
    if (relight_info(c->client, text_of(scene, "model"), &model, &c->error)) return NULL;
    char *text = strdup(model.material ? model.material : "");
    relight_model_finish(&model);
    return text;
}

static void add_color(cJSON *to, const char *field, const float x[3])
{
    cJSON *list = cJSON_AddArrayToObject(to, field);
    char text[32];
    for (int k = 0; k < 3; k++) {
        snprintf(text, sizeof text, "%.9g", (double)x[k]);
        cJSON_AddItemToArray(list, cJSON_CreateRaw(text));
    }
}

// Light attenuates by `color` over `distance` metres; the distance is the shortest free path.
static cJSON *gltf(const struct relight_medium *m)
{
    cJSON *root = cJSON_CreateObject(), *asset = cJSON_AddObjectToObject(root, "asset");
    cJSON *used = cJSON_AddArrayToObject(root, "extensionsUsed");
    cJSON *material = cJSON_CreateObject(), *extensions;
    float most = fmaxf(m->sigma_t[0], fmaxf(m->sigma_t[1], m->sigma_t[2])), color[3];
    static const char *const names[] = {"KHR_materials_transmission", "KHR_materials_ior",
                                        "KHR_materials_volume", "KHR_materials_volume_scatter"};
    cJSON_AddStringToObject(asset, "version", "2.0");
    cJSON_AddStringToObject(asset, "generator", "relight");
    for (int i = 0; i < 4; i++) cJSON_AddItemToArray(used, cJSON_CreateString(names[i]));
    cJSON_AddItemToArray(cJSON_AddArrayToObject(root, "materials"), material);
    cJSON_AddStringToObject(material, "name", "approved");
    add_float(cJSON_AddObjectToObject(material, "pbrMetallicRoughness"), "roughnessFactor",
              m->roughness);
    extensions = cJSON_AddObjectToObject(material, "extensions");
    for (int k = 0; k < 3; k++) color[k] = expf(-m->sigma_t[k] / most);
    add_float(cJSON_AddObjectToObject(extensions, names[0]), "transmissionFactor", 1);
    add_float(cJSON_AddObjectToObject(extensions, names[1]), "ior", m->eta);
    cJSON *volume = cJSON_AddObjectToObject(extensions, names[2]);
    add_float(volume, "thicknessFactor", 1);
    add_float(volume, "attenuationDistance", 1e-3f / most);
    add_color(volume, "attenuationColor", color);
    cJSON *scatter = cJSON_AddObjectToObject(extensions, names[3]);
    add_color(scatter, "multiscatterColor", m->reflectance);
    add_float(scatter, "scatterAnisotropy", m->g[1]);
    return root;
}

// subsurface_radius is in scene units; subsurface_scale makes them millimetres.
static char *materialx(const struct relight_medium *m)
{
    char *text = NULL;
    size_t n;
    FILE *out = open_memstream(&text, &n);
    if (!out) return NULL;
    fprintf(
        out,
        "<?xml version=\"1.0\"?>\n<materialx version=\"1.38\">\n"
        "  <standard_surface name=\"SR_approved\" type=\"surfaceshader\">\n"
        "    <input name=\"base\" type=\"float\" value=\"0\"/>\n"
        "    <input name=\"subsurface\" type=\"float\" value=\"1\"/>\n"
        "    <input name=\"subsurface_color\" type=\"color3\" value=\"%.9g, %.9g, %.9g\"/>\n"
        "    <input name=\"subsurface_radius\" type=\"color3\" value=\"%.9g, %.9g, %.9g\"/>\n"
        "    <input name=\"subsurface_scale\" type=\"float\" value=\"1\"/>\n"
        "    <input name=\"subsurface_anisotropy\" type=\"float\" value=\"%.9g\"/>\n"
        "    <input name=\"specular_IOR\" type=\"float\" value=\"%.9g\"/>\n"
        "    <input name=\"specular_roughness\" type=\"float\" value=\"%.9g\"/>\n"
        "  </standard_surface>\n"
        "  <surfacematerial name=\"approved\" type=\"material\">\n"
        "    <input name=\"surfaceshader\" type=\"surfaceshader\" nodename=\"SR_approved\"/>\n"
        "  </surfacematerial>\n</materialx>\n",
        (double)m->reflectance[0], (double)m->reflectance[1], (double)m->reflectance[2],
        (double)m->mean_free_path_mm[0], (double)m->mean_free_path_mm[1],
        (double)m->mean_free_path_mm[2], (double)m->g[1], (double)m->eta, (double)m->roughness);
    if (fclose(out)) return NULL;
    return text;
}

static int write_in(struct room_call *c, const char *name, char *text)
{
    char path[4096];
    snprintf(path, sizeof path, "%s/%s", c->options->output, name);
    int status = text ? write_file(c->options, path, text, strlen(text))
                      : report_usage(c->options, "not enough memory");
    free(text);
    return status;
}

// A material's text as name.json, name.gltf and name.mtlx; frees the text.
static int export_text(struct room_call *c, char *text, const char *name)
{
    struct relight_medium m;
    char file[100];
    int status = text ? relight_material(c->client, text, &m, &c->error) : -1;
    free(text);
    if (status) return room_failed(c);
    snprintf(file, sizeof file, "%s.json", name);
    status = write_in(c, file, strdup(m.json));
    if (m.profile && !c->options->json)
        fprintf(stderr,
                "relight: %s has a profile of its own: glTF and MaterialX hold the "
                "nearest medium\n",
                name);
    cJSON *json = gltf(&m);
    snprintf(file, sizeof file, "%s.gltf", name);
    if (!status) status = write_in(c, file, cJSON_Print(json));
    cJSON_Delete(json);
    snprintf(file, sizeof file, "%s.mtlx", name);
    if (!status) status = write_in(c, file, materialx(&m));
    relight_medium_finish(&m);
    return status;
}

// "material-OBJECT"; with "+" and its number where the object's name is none for a file: no
// other name has a "+".
static void name_of(char out[80], const char *object, int number)
{
    int n = snprintf(out, 80, "material-%.60s", object);
    bool plain = strlen(object) <= 60;
    for (char *at = out; *at; at++)
        if (!strchr("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_.", *at))
            *at = '_', plain = false;
    if (!plain) snprintf(out + n, 80 - (size_t)n, "+%d", number);
}

int export_material(struct room_call *c, const cJSON *state)
{
    const cJSON *decision = approval(state), *own;
    if (!decision) return EXIT_DONE;
    int at = (int)number_of(list_of(decision, "seen"), "revision"), number = 0;
    const cJSON *scene =
        list_of(cJSON_GetArrayItem(list_of(state, "revisions"), at - 1), "scene");
    c->error = (struct relight_error){0};
    char *text = material_text(c, scene);
    int status = !text && c->error.code ? room_left_out(c, "the approved material")
                                        : export_text(c, text, "material");
    cJSON_ArrayForEach(own, list_of(list_of(scene, "shade"), "materials"))
    {
        char name[80];
        name_of(name, text_of(own, "object"), ++number);
        if (!status) status = export_text(c, text_copy(list_of(own, "material")), name);
    }
    return status;
}
