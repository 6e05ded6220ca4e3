// SPDX-License-Identifier: MIT
// Checks that need the open model: whether its bake, or the image-space engines, can answer a
// request, and which of the two does.
#include "render/walk.h"

#include <stdio.h>

static bool has_maps(const struct render_spec *s)
{
    return s->map[0][0] || s->map[1][0] || s->map[2][0];
}

bool render_uses_screen(const struct render *r)
{
    struct model *m = r->model;
    const bool ready = model_answering(m)->state == RELIGHT__MODEL_STATE__MODEL_READY;
    if (!r->spec.picture) return false;
    if (!r->spec.engine && has_maps(&r->spec)) return true; // baked transport has no maps
    if (r->spec.engine) return r->spec.engine >= RELIGHT__ENGINE__ENGINE_SPLAT;
    return render_pose(r) ||
           (!ready && m->mesh != MESH_NONE &&
            !(m->state == RELIGHT__MODEL_STATE__MODEL_FAILED && m->mesh == MESH_FAILED));
}

bool render_light_is_baked(const struct render *r)
{
    return !r->screen && render_transport(r)->engine == PRT_TRANSPORT_POLYNOMIAL &&
           r->spec.term != RELIGHT__TERM__TERM_IRRADIANCE;
}

static int check_screen(const struct render *r, char error[300])
{
    const struct render_spec *s = &r->spec;
    if (has_maps(s) && !render_shape(r)->mesh.uv) {
        snprintf(error, 300, "%.100s has no texture coordinates, which maps need",
                 r->model->name);
        return RELIGHT__ERROR_CODE__ERROR_MISMATCH;
    }
    if (s->term != RELIGHT__TERM__TERM_TOTAL && s->term != RELIGHT__TERM__TERM_MULTIPLE) {
        snprintf(error, 300, "image-space engines compute terms total and multiple, not %s",
                 s->term == RELIGHT__TERM__TERM_SINGLE ? "single" : "irradiance");
        return RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED;
    }
    if (!s->n_light) {
        bool later = !s->engine && r->model->state == RELIGHT__MODEL_STATE__MODEL_BAKING;
        snprintf(error, 300, "lights is 0, allowed range 1 to %d%s", RENDER_MAX_LIGHTS,
                 later ? ": until the bake, which may contain one, is ready" : "");
        return later ? RELIGHT__ERROR_CODE__ERROR_NOT_READY
                     : RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
    }
    return 0;
}

static int check_engine(const struct render *r, bool traced, char error[300])
{
    static const char *const names[] = {"the default", "reference", "wavelet",
                                        "polynomial",  "joint",     "splat",
                                        "tangent",     "texture",   "hybrid"};
    int asked = r->spec.engine,
        baked = RELIGHT__ENGINE__ENGINE_WAVELET + (int)render_transport(r)->engine;
    if (traced && asked > RELIGHT__ENGINE__ENGINE_REFERENCE) {
        snprintf(error, 300, "term irradiance is traced by engine reference, not %s",
                 names[asked]);
        return RELIGHT__ERROR_CODE__ERROR_MISMATCH;
    }
    if (traced || !asked || asked == baked) return 0;
    snprintf(error, 300, "%.100s was baked for engine %s, not %s", r->model->name, names[baked],
             names[asked]);
    return asked == RELIGHT__ENGINE__ENGINE_WAVELET ||
                   asked == RELIGHT__ENGINE__ENGINE_POLYNOMIAL ||
                   asked == RELIGHT__ENGINE__ENGINE_JOINT
               ? RELIGHT__ERROR_CODE__ERROR_MISMATCH
               : RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED;
}

int check_factored(const struct model *model, const struct prt_transport *t, char error[300])
{
    for (uint32_t i = 0; i < t->n_tensor; i++) {
        if (t->tensor[i].storage == PRT_STORAGE_FACTORED) continue;
        snprintf(
            error, 300,
            "%.100s has no coefficients: its transport is %s, not factored: take colours in "
            "another format, or bake it as wavelet or joint transport with factored storage",
            model->name, t->tensor[i].storage == PRT_STORAGE_SPARSE ? "sparse" : "polynomial");
        return RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED;
    }
    return 0;
}

static int check_coefficients(const struct render *r, char error[300])
{
    if (r->spec.term == RELIGHT__TERM__TERM_IRRADIANCE) {
        snprintf(error, 300, "irradiance is traced, not baked: it has no coefficients");
        return RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED;
    }
    if (r->spec.has_eye) {
        snprintf(error, 300, "coefficients hold for every eye: leave shade.eye out");
        return RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST;
    }
    return check_factored(r->model, render_transport(r), error);
}

static int check_baked(const struct render *r, char error[300])
{
    const struct prt_transport *t = render_transport(r);
    const struct render_spec *s = &r->spec;
    bool traced = s->term == RELIGHT__TERM__TERM_IRRADIANCE;
    if (has_maps(s)) {
        snprintf(error, 300, "maps are for pictures by image-space engines");
        return RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED;
    }
    if (r->bakes && s->term == RELIGHT__TERM__TERM_SINGLE &&
        !(r->model->facts.error_single > 0)) {
        snprintf(error, 300, "%.100s still bakes, and its draft has no single scattering",
                 r->model->name);
        return RELIGHT__ERROR_CODE__ERROR_NOT_READY;
    }
    int code = check_engine(r, traced, error);
    if (!code && is_coefficients(s)) code = check_coefficients(r, error);
    if (code) return code;
    if (!traced && t->engine == PRT_TRANSPORT_POLYNOMIAL && s->n_light) {
        snprintf(error, 300, "%.100s was baked with its light: send no lights", r->model->name);
        return RELIGHT__ERROR_CODE__ERROR_MISMATCH;
    }
    if ((traced || t->engine != PRT_TRANSPORT_POLYNOMIAL) && !s->n_light) {
        snprintf(error, 300, "lights is 0, allowed range 1 to %d", RENDER_MAX_LIGHTS);
        return RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
    }
    if (!traced && (s->has_material || s->objects) && t->engine == PRT_TRANSPORT_WAVELET) {
        snprintf(
            error, 300,
            "%.100s was baked with its material (wavelet transport), which cannot change; for "
            "others, bake it with transport joint or polynomial",
            r->model->name);
        return RELIGHT__ERROR_CODE__ERROR_MISMATCH;
    }
    if (s->max_error > 0 && bake_error(r) > s->max_error) {
        snprintf(error, 300, "the %s's measured error %.3g is above max_error %.3g%s",
                 r->bakes ? "draft" : "bake", (double)bake_error(r), (double)s->max_error,
                 r->bakes ? ": wait for the bake" : "");
        return RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
    }
    return 0;
}

int check_request(const struct render *r, char error[300])
{
    if (r->spec.picture && r->spec.floor && !r->spec.n_light) {
        snprintf(error, 300,
                 "picture.floor: the shadow is of lights, and the request has none");
        return RELIGHT__ERROR_CODE__ERROR_MISMATCH;
    }
    return r->screen ? check_screen(r, error) : check_baked(r, error);
}

int check_media(const struct render *r, char error[300])
{
    const uint32_t n = render_media(r)->n;
    if (!r->spec.map[0][0] || n == 1) return 0;
    snprintf(error, 300,
             "shade.albedo_map changes one medium, and the model has %u: give all objects one "
             "material",
             n);
    return RELIGHT__ERROR_CODE__ERROR_MISMATCH;
}

int check_error_bound(const struct render *r, char error[300])
{
    double bound = (double)r->result.error_bound, most = (double)r->spec.max_error;
    if (!(most > 0) || bound <= most || !(r->screen || r->media.entry)) return 0;
    snprintf(error, 300,
             r->screen ? "the preview's expected error %.3g is above max_error %.3g"
                       : "the error bound %.3g of this material is above max_error %.3g",
             bound, most);
    return RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
}
