// SPDX-License-Identifier: MIT
// Converts plain structs to messages and back; checks messages of the daemon before their use.
#include "internal.h"

#include <math.h>
#include <stdio.h>

// The public enums have the numbers of relight.proto.
_Static_assert((int)RELIGHT_ENGINE_HYBRID == RELIGHT__ENGINE__ENGINE_HYBRID, "engine");
_Static_assert((int)RELIGHT_TERM_SINGLE == RELIGHT__TERM__TERM_SINGLE, "term");
_Static_assert((int)RELIGHT_COLOR_COEFFICIENTS_PACKED ==
                   RELIGHT__COLOR_FORMAT__COLOR_COEFFICIENTS_PACKED,
               "colour format");
#define X(name, number, ending) \
    _Static_assert(number == RELIGHT__IMAGE_FORMAT__IMAGE_##name, "image format");
RELIGHT_IMAGE_FORMAT_LIST(X)
#undef X
_Static_assert((int)RELIGHT_TONE_NONE == RELIGHT__TONE__TONE_NONE, "tone");
_Static_assert((int)RELIGHT_MODEL_FAILED == RELIGHT__MODEL_STATE__MODEL_FAILED, "model state");
_Static_assert((int)RELIGHT_JOB_CANCELLED == RELIGHT__JOB_STATE__JOB_CANCELLED, "job state");
_Static_assert((int)RELIGHT_E_JOB_FAILED == RELIGHT__ERROR_CODE__ERROR_JOB_FAILED, "codes");
_Static_assert((int)RELIGHT_TRANSPORT_JOINT == RELIGHT__TRANSPORT__TRANSPORT_JOINT,
               "transport");
_Static_assert((int)RELIGHT_STORAGE_SPARSE == RELIGHT__STORAGE__STORAGE_SPARSE, "storage");

struct owner *relight_owner(struct answer *answer)
{
    struct owner *owner = calloc(1, sizeof *owner);
    if (!owner) relight_answer_free(answer);
    else owner->answer = answer;
    return owner;
}

void *relight_owner_alloc(struct owner *owner, size_t n, size_t size)
{
    if (owner->n_extra == sizeof owner->extra / sizeof *owner->extra) return NULL;
    void *p = calloc(n ? n : 1, size);
    if (p) owner->extra[owner->n_extra++] = p;
    return p;
}

void relight_owner_free(struct owner *owner)
{
    if (!owner) return;
    relight_answer_free(owner->answer);
    for (unsigned i = 0; i < owner->n_extra; i++) free(owner->extra[i]);
    free(owner);
}

static Relight__Vec3 vec3(const float v[3])
{
    Relight__Vec3 m = RELIGHT__VEC3__INIT;
    m.x = v[0], m.y = v[1], m.z = v[2];
    return m;
}

int relight_put_turns(struct request_parts *parts, size_t n, const struct relight_light *lights,
                      struct relight_error *error)
{
    parts->n_cube = 0;
    if (n > RELIGHT_MAX_LIGHT)
        return relight_fail(error, RELIGHT_E_ARGUMENT, "", "%zu lights, at most %d a request",
                            n, RELIGHT_MAX_LIGHT);
    for (size_t i = 0; i < n; i++) {
        const struct relight_light *in = lights + i;
        Relight__Light *m = parts->light + i;
        relight__light__init(m);
        parts->lights[i] = m;
        m->rotate_deg = in->rotate_deg;
        if (in->gain[0] != 0 || in->gain[1] != 0 || in->gain[2] != 0) {
            parts->gain[i] = vec3(in->gain);
            m->gain = parts->gain + i;
        }
    }
    return 0;
}

int relight_put_lights(struct request_parts *parts, size_t n,
                       const struct relight_light *lights, struct relight_error *error)
{
    int status = relight_put_turns(parts, n, lights, error);
    for (size_t i = 0; !status && i < n; i++) {
        const struct relight_light *in = lights + i;
        Relight__Light *m = parts->light + i;
        if (!in->cube_n == !in->env)
            return relight_fail(error, RELIGHT_E_ARGUMENT, "",
                                "light %zu needs either an environment or a cube", i);
        if (in->cube_n) {
            if (in->cube_n < 16 || in->cube_n > 128 || in->cube_n & (in->cube_n - 1) ||
                !in->cube)
                return relight_fail(error, RELIGHT_E_ARGUMENT, "",
                                    "light %zu: cube of %u, allowed are 16, 32, 64, 128", i,
                                    in->cube_n);
            m->cube_n = in->cube_n;
            parts->cube[parts->n_cube++] = (struct iovec){
                (void *)(uintptr_t)in->cube, sizeof(float) * 18 * in->cube_n * in->cube_n};
        } else {
            m->env = relight_text(in->env);
        }
    }
    return status;
}

int relight_put_materials(size_t n, const struct relight_object_material *in,
                          Relight__ObjectMaterial message[RELIGHT_MAX_MATERIAL],
                          Relight__ObjectMaterial *list[RELIGHT_MAX_MATERIAL],
                          struct relight_error *error)
{
    if (n > RELIGHT_MAX_MATERIAL)
        return relight_fail(error, RELIGHT_E_ARGUMENT, "",
                            "%zu materials by object, at most %d a request", n,
                            RELIGHT_MAX_MATERIAL);
    for (size_t i = 0; i < n; i++) {
        relight__object_material__init(list[i] = message + i);
        message[i].object = relight_text(in[i].object);
        message[i].material = relight_text(in[i].material);
    }
    return 0;
}

int relight_put_shade(struct request_parts *parts, const struct relight_shade *shade,
                      struct relight_error *error)
{
    Relight__Shade *m = &parts->shade;
    relight__shade__init(m);
    int status = relight_put_materials(shade->n_material, shade->materials, parts->material,
                                       parts->materials, error);
    if (status) return status;
    m->n_materials = shade->n_material;
    m->materials = parts->materials;
    m->engine = (Relight__Engine)shade->engine;
    m->term = (Relight__Term)shade->term;
    m->material = relight_text(shade->material);
    m->max_error = shade->max_error;
    m->budget_ms = shade->budget_ms;
    m->albedo_map = relight_text(shade->albedo_map);
    m->normal_map = relight_text(shade->normal_map);
    m->bump_map = relight_text(shade->bump_map);
    m->bump_mm = shade->bump_mm;
    m->variant = relight_text(shade->variant);
    if (shade->has_eye) {
        parts->shade_eye = vec3(shade->eye);
        m->eye = &parts->shade_eye;
    }
    return 0;
}

void relight_put_picture(struct request_parts *parts, const struct relight_picture *picture)
{
    Relight__Picture *m = &parts->picture;
    const struct relight_camera *camera = &picture->camera;
    relight__picture__init(m);
    m->width = picture->width;
    m->height = picture->height;
    m->format = (Relight__ImageFormat)picture->format;
    m->quality = picture->quality;
    m->tone = (Relight__Tone)picture->tone;
    m->exposure_ev = picture->exposure_ev;
    m->samples = picture->samples;
    m->no_specular = picture->no_specular;
    m->transparent = picture->transparent;
    m->floor = picture->floor;
    if (picture->plain_background) {
        m->plain_background = 1;
        parts->background = vec3(picture->background);
        m->background = &parts->background;
    }
    if (!camera->set) return;
    relight__camera__init(&parts->camera);
    m->camera = &parts->camera;
    parts->camera.name = relight_text(camera->name);
    if (camera->has_orbit) {
        relight__orbit__init(&parts->orbit);
        parts->orbit.azimuth_deg = camera->azimuth_deg;
        parts->orbit.elevation_deg = camera->elevation_deg;
        parts->orbit.zoom = camera->zoom;
        parts->camera.orbit = &parts->orbit;
    }
    if (camera->has_orbit || camera->name[0]) return;
    parts->eye = vec3(camera->eye);
    parts->target = vec3(camera->target);
    parts->camera.eye = &parts->eye;
    parts->camera.target = &parts->target;
    parts->camera.fovy_deg = camera->fovy_deg;
    if (camera->up[0] != 0 || camera->up[1] != 0 || camera->up[2] != 0) {
        parts->up = vec3(camera->up);
        parts->camera.up = &parts->up;
    }
}

void relight_get_cost(const Relight__Cost *m, struct relight_cost *out)
{
    *out = (struct relight_cost){.note = ""};
    if (!m) return;
    *out = (struct relight_cost){.queue_ms = m->queue_ms,
                                 .light_ms = m->light_ms,
                                 .relight_ms = m->relight_ms,
                                 .raster_ms = m->raster_ms,
                                 .shade_ms = m->shade_ms,
                                 .encode_ms = m->encode_ms,
                                 .total_ms = m->total_ms,
                                 .shared = m->shared,
                                 .error_bound = m->error_bound,
                                 .engine = (enum relight_engine)m->engine,
                                 .note = m->note,
                                 .samples = m->samples,
                                 .frames = m->frames,
                                 .converged = m->converged,
                                 .reduced = m->reduced,
                                 .draft = m->draft,
                                 .bake_fraction = m->bake_fraction};
}

unsigned relight_color_bytes(unsigned format)
{
    switch ((int)format) {
    case RELIGHT_COLOR_F32:
        return 12;
    case RELIGHT_COLOR_F16:
        return 6;
    case RELIGHT_COLOR_RGB9E5:
    case RELIGHT_COLOR_SRGB8:
        return 4;
    default:
        return 0;
    }
}

int relight_get_colors(const Relight__ColorsAnswer *m, const uint8_t *payload,
                       uint64_t payload_size, struct relight_colors *out,
                       struct relight_error *error)
{
    const uint32_t n = m->n_coarse ? m->n_coarse : m->n_vertex;
    const uint64_t each = (uint64_t)n * relight_color_bytes(m->format);
    uint64_t need = each;
    uint64_t last; // where the last plane starts
    const bool rows = relight_is_coefficients((int)m->format);
    if (rows) need = m->plane_bytes;
    const bool parted = m->n_part > 0 && !rows;
    if ((!rows && !relight_color_bytes(m->format)) || !m->n_plane ||
        (parted && __builtin_mul_overflow(each, (uint64_t)m->n_part, &need)) ||
        m->plane_bytes < need || (parted && !m->n_outgoing) || m->n_exit > m->n_part ||
        m->n_coarse > m->n_vertex || (rows && m->n_coarse) ||
        (m->n_plane > 1 && m->plane_bytes % RELIGHT_FRAME_ALIGN) ||
        __builtin_mul_overflow(m->plane_bytes, (uint64_t)m->n_plane - 1, &last) ||
        last > payload_size || payload_size - last < need)
        return relight_fail(
            error, RELIGHT_E_PROTOCOL, "",
            "colours answer: %u planes of %u vertices do not fit its %llu bytes", m->n_plane,
            m->n_vertex, (unsigned long long)payload_size);
    *out = (struct relight_colors){.n_vertex = m->n_vertex,
                                   .n_plane = m->n_plane,
                                   .n_part = parted ? m->n_part : 0,
                                   .n_exit = parted ? m->n_exit : 0,
                                   .n_coarse = m->n_coarse,
                                   .coarse_order = m->coarse_order,
                                   .plane_bytes = m->plane_bytes,
                                   .format = (enum relight_color_format)m->format,
                                   .generation = m->generation,
                                   .data = payload};
    relight_get_cost(m->cost, &out->cost);
    if (parted) {
        out->n_outgoing = m->n_outgoing;
        out->outgoings = m->outgoing;
    }
    if (rows && !relight_get_coefficients(m, out))
        return relight_fail(error, RELIGHT_E_PROTOCOL, "",
                            "colours answer: its coefficients contradict each other");
    return 0;
}

static void get_vec3(const Relight__Vec3 *m, float out[3])
{
    out[0] = m ? m->x : 0;
    out[1] = m ? m->y : 0;
    out[2] = m ? m->z : 0;
}

int relight_get_image(const Relight__ImageAnswer *m, const uint8_t *payload,
                      uint64_t payload_size, struct relight_image *out,
                      struct relight_error *error)
{
    uint64_t pixels = (uint64_t)m->width * m->height, need = 1;
    if (m->format == RELIGHT__IMAGE_FORMAT__IMAGE_RGB8) need = pixels * 3;
    if (m->format == RELIGHT__IMAGE_FORMAT__IMAGE_F16) need = pixels * 6;
    if (!pixels || m->width > 65535 || m->height > 65535 || payload_size < need)
        return relight_fail(error, RELIGHT_E_PROTOCOL, "",
                            "image answer: %u x %u pixels in %llu bytes", m->width, m->height,
                            (unsigned long long)payload_size);
    *out = (struct relight_image){.width = m->width,
                                  .height = m->height,
                                  .format = (enum relight_image_format)m->format,
                                  .generation = m->generation,
                                  .n_byte = payload_size,
                                  .data = payload,
                                  .mesh_hash = m->drawn ? m->drawn->mesh_hash : "",
                                  .bake_hash = m->drawn ? m->drawn->bake_hash : ""};
    if (m->camera) {
        out->camera.set = true;
        get_vec3(m->camera->eye, out->camera.eye);
        get_vec3(m->camera->target, out->camera.target);
        get_vec3(m->camera->up, out->camera.up);
        out->camera.fovy_deg = m->camera->fovy_deg;
    }
    relight_get_cost(m->cost, &out->cost);
    return 0;
}

int relight_get_blocks(struct owner *owner, size_t n, Relight__Block **blocks,
                       const struct relight_block **out)
{
    struct relight_block *block = relight_owner_alloc(owner, n, sizeof *block);
    if (!block) return -1;
    for (size_t i = 0; i < n; i++) {
        const Relight__Block *m = blocks[i];
        block[i] = (struct relight_block){.object = m->object,
                                          .surface = m->surface,
                                          .translucent = m->translucent,
                                          .vertex_begin = m->vertex_begin,
                                          .n_vertex = m->n_vertex,
                                          .triangle_begin = m->triangle_begin,
                                          .n_triangle = m->n_triangle};
        block[i].has_gain = m->gain != NULL;
        if (m->gain) get_vec3(m->gain, block[i].gain);
        get_vec3(m->base_color, block[i].base_color);
        block[i].surface_index = m->surface_index;
        block[i].medium = m->medium;
        block[i].node = m->node;
    }
    *out = block;
    return 0;
}

int relight_orbit_parse(const char *text, struct relight_camera *out,
                        struct relight_error *error)
{
    struct relight_camera c = {.set = true, .has_orbit = true, .zoom = 1};
    int two = 0, three = 0;
    int n =
        sscanf(text, "%f,%f%n,%f%n", &c.azimuth_deg, &c.elevation_deg, &two, &c.zoom, &three);
    bool read = (n == 2 && two && !text[two]) || (n == 3 && three && !text[three]);
    if (!read || !(fabsf(c.azimuth_deg) <= 1e6f) || !(fabsf(c.elevation_deg) <= 90) ||
        !(c.zoom >= 0.1f && c.zoom <= 100))
        return relight_fail(
            error, RELIGHT_E_ARGUMENT, "",
            "orbit '%s': expected AZIMUTH,ELEVATION[,ZOOM], as 30,15 or 30,15,2; "
            "the elevation is in [-90, 90] degrees, the zoom in [0.1, 100]",
            text);
    *out = c;
    return 0;
}

int relight_camera_parse(const char *text, struct relight_camera *out,
                         struct relight_error *error)
{
    struct relight_camera camera = {.set = true};
    float *triple[3] = {camera.eye, camera.target, camera.up};
    const char *at = text;
    if (*text && !strpbrk(text, ":,") && strlen(text) < sizeof camera.name) {
        snprintf(camera.name, sizeof camera.name, "%s", text);
        *out = camera;
        return 0;
    }
    for (int i = 0; i < 4; i++) {
        float v[3];
        int used = 0;
        if (sscanf(at, "%f,%f,%f%n", v, v + 1, v + 2, &used) == 3 && used && i < 3)
            memcpy(triple[i], v, sizeof v);
        else if (i >= 2 && sscanf(at, "%f%n", v, &used) == 1 && used && v[0] > 0 && v[0] < 170)
            camera.fovy_deg = v[0];
        else break;
        for (int k = 0; k < (camera.fovy_deg > 0 ? 1 : 3); k++)
            if (!isfinite(v[k])) goto bad;
        at += used;
        if (!*at && i >= 1) {
            *out = camera;
            return 0;
        }
        if (*at++ != ':' || camera.fovy_deg > 0) break;
    }
bad:
    return relight_fail(
        error, RELIGHT_E_ARGUMENT, "",
        "camera '%s': expected EYE:TARGET[:UP][:FOVY] as x,y,z:x,y,z:x,y,z:deg, "
        "0 < FOVY < 170, or the name of one of the model's cameras",
        text);
}
