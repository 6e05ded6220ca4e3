// SPDX-License-Identifier: MIT
// Checks of a LOAD before anything is done for it.
#include "ops/load.h"

#include "prt/bake_limits.h"
#include "prt/media.h"
#include "render/render.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

bool load_safe_name(const char *name)
{
    if (!name[0] || name[0] == '/' || name[0] == '.' || strlen(name) > 200) return false;
    for (const char *p = name; *p; p++)
        if ((unsigned char)*p < 32 || *p == 127 || *p == '\\' ||
            (p[0] == '/' && (p[1] == '.' || p[1] == '/')))
            return false;
    return true;
}

static bool bad_real(float x, float low, float high)
{
    return !(x >= low && x <= high); // catches NaN
}

static const char *bad_range(char reason[128], float x, double low, double high,
                             const char *unit, const char *parameter)
{
    range_refuse(reason, 128, (double)x, low, high, unit, "%s", parameter);
    return reason;
}

// NULL when the numbers make sense, else which one does not.
const char *load_bad_setting(const Relight__LoadRequest *r, char reason[128])
{
    const Relight__BakeSettings *b = r->bake;
    if (r->size_mm != 0 && bad_real(r->size_mm, 1e-3f, 1e6f))
        return bad_range(reason, r->size_mm, 1e-3, 1e6, "mm", "size_mm");
    if (r->mm_per_unit != 0 && bad_real(r->mm_per_unit, 1e-9f, 1e9f))
        return bad_range(reason, r->mm_per_unit, 1e-9, 1e9, "mm", "mm_per_unit");
    if (r->size_mm != 0 && r->mm_per_unit != 0)
        return "size_mm and mm_per_unit are both given: one scale is wanted";
    if (strlen(r->variant) > 63) return "variant: the name has more than 63 bytes";
    if (r->n_opaque > MAX_OPAQUE)
        return bad_range(reason, (float)r->n_opaque, 0, MAX_OPAQUE, "", "opaque");
    if (!b) return NULL;
    if (!protobuf_c_enum_descriptor_get_value(&relight__transport__descriptor,
                                              (int)b->transport))
        return "transport is unknown";
    if (!protobuf_c_enum_descriptor_get_value(&relight__storage__descriptor, (int)b->storage))
        return "storage is unknown";
    if (!protobuf_c_enum_descriptor_get_value(&relight__scattering__descriptor,
                                              (int)b->scattering))
        return "scattering is unknown";
    const bool walk = b->scattering == RELIGHT__SCATTERING__SCATTERING_WALK;
    if (b->walks && !walk) return "walks are for scattering walk";
    // The library's bounds and its words.
    if (!prt_bake_setting_ok(PRT_BAKE_CUBE, b->cube, reason) ||
        !prt_bake_setting_ok(PRT_BAKE_PHASE_TERMS, b->phase_terms, reason) ||
        !prt_bake_setting_ok(PRT_BAKE_SAMPLES, b->samples, reason) ||
        !prt_bake_setting_ok(PRT_BAKE_RANK, b->rank, reason) ||
        !prt_bake_setting_ok(PRT_BAKE_COEFFS, b->coeffs, reason) ||
        !prt_bake_setting_ok(PRT_BAKE_SINGLE_POINTS, b->single_points, reason) ||
        !prt_bake_setting_ok(PRT_BAKE_WALKS, b->walks, reason) ||
        !prt_bake_error_ok((double)b->max_error, reason))
        return reason;
    if (bad_real(b->rotate_deg, -1e6f, 1e6f))
        return bad_range(reason, b->rotate_deg, -1e6, 1e6, "degrees", "bake.rotate_deg");
    return NULL;
}

static bool refuse(struct load *load, int code, const char *text)
{
    request_fail(load->request, code, "%s", text);
    return false;
}

static bool refuse_object(struct load *load, const char *object, const char *why)
{
    request_fail(load->request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                 "material of \"%.63s\": %s", object, why);
    return false;
}

// Whether --material can name the object, and no other entry does.
static bool check_object(struct load *load, const char *object)
{
    const size_t n = strlen(object);
    if (object[strcspn(object, "={/")])
        return refuse_object(load, object, "the name of an object has no '=', '{' or '/' here");
    for (unsigned i = 0; i < load->n_material; i++) {
        const char *other = load->material[i].arg;
        const size_t m = prt_media_name_length(other);
        if (m == n && !strncmp(other, object, n))
            return refuse_object(load, object, "another entry gives it a material, too");
    }
    return true;
}

static bool add_material(struct load *load, const char *object, const char *text)
{
    struct load_material *own = &load->material[load->n_material];
    struct prt_material *material = malloc(sizeof *material);
    char *json = malloc(PRT_MATERIAL_TEXT), error[300] = "not enough memory";
    bool preset = false;
    int code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
    bool good = material && json;
    if (good && !(good = !material_of_request(load->request, text, material, &preset, error)))
        code = RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
    if (good) {
        if (preset) snprintf(json, PRT_MATERIAL_TEXT, "%s", material->name);
        else prt_material_print(material, json, PRT_MATERIAL_TEXT);
        if (!preset && !*object) snprintf(own->file, sizeof own->file, ".material.json");
        else if (!preset)
            snprintf(own->file, sizeof own->file, ".material-%u.json", load->n_material);
        own->text = strdup(json);
        if (asprintf(&own->arg, "%s%s%s", object, *object ? "=" : "",
                     preset ? material->name : own->file) < 0)
            own->arg = NULL;
        load->n_material++;
        good = own->text && own->arg;
    }
    free(material);
    free(json);
    return good || refuse(load, code, error);
}

// The materials; answers and returns false when one fails.
bool load_check_material(struct load *load)
{
    const Relight__LoadRequest *r = load_message(load);
    // As prt bake: where no transport is named either, a bake that leaves the material open.
    bool fixed = r->bake && r->bake->transport == RELIGHT__TRANSPORT__TRANSPORT_WAVELET;
    if (fixed && !r->material[0] && !r->n_materials)
        return refuse(load, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                      "material is missing: a preset's name or JSON text");
    if (r->n_materials > PRT_MEDIA_MAX)
        return refuse(load, RELIGHT__ERROR_CODE__ERROR_LIMIT, "more than 64 materials");
    if (r->material[0] && !add_material(load, "", r->material)) return false;
    for (size_t i = 0; i < r->n_materials; i++) {
        const Relight__ObjectMaterial *m = r->materials[i];
        if (!m->object[0] || !m->material[0])
            return refuse(load, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                          "materials: an object or a material is missing");
        if (!check_object(load, m->object) || !add_material(load, m->object, m->material))
            return false;
    }
    materials_used(load->request);
    return true;
}

// True when one name equals the other or is a folder above it: one folder cannot hold both.
static bool names_clash(const char *a, const char *b)
{
    size_t n = strlen(a), m = strlen(b), least = n < m ? n : m;
    return !strncmp(a, b, least) && (n == m || (n < m ? b : a)[least] == '/');
}

static bool check_file(struct load *load, size_t index)
{
    const Relight__FileRef *f = load_message(load)->files[index];
    if (!load_safe_name(f->name)) {
        load->request->hint = "name a file as its model does, without .. and a / in front";
        request_fail(load->request, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                     "files[%zu]: the name is not a plain relative path", index);
        return false;
    }
    if (!blobs_has(load->server->blobs, f->blob)) {
        request_fail(load->request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                     "%.100s: its blob was not uploaded", f->name);
        return false;
    }
    for (size_t i = 0; i < load->n_file; i++) {
        const struct load_file *other = &load->file[i];
        if (!strcmp(other->name, f->name) && !strcmp(other->hash, f->blob)) return true;
        if (!names_clash(other->name, f->name)) continue;
        request_fail(load->request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                     "files[%zu]: %.100s cannot be beside %.100s: one name for two things",
                     index, f->name, other->name);
        return false;
    }
    if (load_add_file(load, f->name, f->blob, NULL)) return true;
    request_fail(load->request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
    return false;
}

bool load_check_files(struct load *load)
{
    for (size_t i = 0; i < load_message(load)->n_files; i++)
        if (!check_file(load, i)) return false;
    load_hash_source(load);
    return true;
}

// Only an upload or words: any other text would be a path to the baker.
bool load_check_env(struct load *load)
{
    const Relight__LoadRequest *r = load_message(load);
    char error[300];
    if (!r->bake || !r->bake->env[0]) return true;
    int code = env_of_request(load->request, r->bake->env, load->env, error);
    if (!code && !strncmp(load->env, "env:", 4) &&
        !blobs_has(load->server->blobs, load->env + 4)) {
        code = RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
        request_fail(load->request, code, "bake.env: %.80s was not uploaded", r->bake->env);
    } else if (code == RELIGHT__ERROR_CODE__ERROR_NOT_FOUND) {
        request_fail(load->request, code,
                     "bake.env %.80s: this client uploaded no image of this name; LIST has the "
                     "names",
                     r->bake->env);
    } else if (code) {
        request_fail(load->request, code,
                     "bake.env %.60s: neither env:HASH nor constant[:R,G,B] with radiances in "
                     "[0, 1e6]",
                     r->bake->env);
    }
    return !code;
}
