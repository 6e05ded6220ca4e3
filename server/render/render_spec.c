// SPDX-License-Identifier: MIT
// From a request's messages to a checked render_spec. Every refusal names the parameter, its
// range and its unit.
#include "render/shared/materials.h"
#include "render/evaluation.h"
#include "render/shared/poses.h"
#include "net/request.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define RANGE(value, low, high, unit, ...) \
    return range_refuse(error, 300, (double)(value), low, high, unit, __VA_ARGS__)
#define REFUSE(code, ...) \
    return (snprintf(error, 300, __VA_ARGS__), RELIGHT__ERROR_CODE__ERROR_##code)

void render_spec_init(struct render_spec *spec)
{
    *spec = (struct render_spec){.width = 800, .height = 600, .samples = 4, .quality = 90};
}

void render_spec_finish(struct render_spec *spec)
{
    held_bytes_release(spec->texels);
    pose_release(spec->pose);
    media_map_release(spec->objects);
    spec->texels = NULL;
    spec->pose = NULL;
    spec->objects = NULL;
}

void render_spec_copy(const struct render_spec *from, struct render_spec *to)
{
    *to = *from;
    if (to->texels) held_bytes_hold(to->texels);
    if (to->pose) to->pose->refs++;
    if (to->objects) to->objects->refs++;
}

struct render_spec render_spec_plain(const struct render_spec *spec)
{
    struct render_spec plain = *spec;
    plain.texels = NULL;
    plain.pose = NULL;
    plain.objects = NULL;
    return plain;
}

int render_spec_pose(struct render_spec *spec, const struct model *model, const char *name,
                     char error[300])
{
    int code = 0;
    struct pose *pose = NULL;
    if (name[0] && !(pose = poses_find(model->server->poses, model, name, &code, error)))
        return code;
    pose_release(spec->pose);
    spec->pose = pose;
    return 0;
}

const float *render_texels(const struct render_spec *spec, const struct render_light *light)
{
    return (const float *)spec->texels->bytes + light->texel;
}

// Whether the protocol's enum has the value: protobuf passes unknown ones on.
static bool is_value(const ProtobufCEnumDescriptor *descriptor, int value)
{
    return protobuf_c_enum_descriptor_get_value(descriptor, value) != NULL;
}

static bool vec3(const Relight__Vec3 *v, float out[3])
{
    if (!v) return false;
    out[0] = v->x;
    out[1] = v->y;
    out[2] = v->z;
    return true;
}

// NULL, or the first component outside the range.
static const float *outside(const float v[3], float low, float high)
{
    for (int i = 0; i < 3; i++)
        if (!(v[i] >= low && v[i] <= high)) return v + i;
    return NULL;
}

static int parse_rotation(struct render_light *out, const Relight__Light *in, unsigned index,
                          char error[300])
{
    if (!(fabsf(in->rotate_deg) <= 1e6f))
        RANGE(in->rotate_deg, -1e6, 1e6, "degrees", "lights[%u].rotate_deg", index);
    out->rotate_deg = fmod(in->rotate_deg, 360);
    if (out->rotate_deg < 0) out->rotate_deg += 360;
    return 0;
}

static int parse_gain(struct render_light *out, const Relight__Light *in, unsigned index,
                      char error[300])
{
    for (int c = 0; c < 3; c++) out->gain[c] = 1;
    vec3(in->gain, out->gain);
    const float *bad = outside(out->gain, 0, 1e6f);
    if (bad) RANGE(*bad, 0, 1e6, "", "lights[%u].gain", index);
    return 0;
}

static int parse_light(struct render_light *out, const Relight__Light *in, unsigned index,
                       const struct request *request, char error[300])
{
    *out = (struct render_light){.cube_n = in->cube_n};
    if (!in->cube_n == !in->env[0])
        REFUSE(BAD_REQUEST, "lights[%u]: expected exactly one of env and cube_n", index);
    if (in->cube_n && (in->cube_n < 16 || in->cube_n > 128 || in->cube_n & (in->cube_n - 1)))
        REFUSE(OUT_OF_RANGE,
               "lights[%u].cube_n is %u, allowed range 16 to 128: 16, 32, 64 or 128", index,
               in->cube_n);
    int code = parse_rotation(out, in, index, error);
    if (!code) code = parse_gain(out, in, index, error);
    if (code) return code;
    return in->env[0] ? env_of_request(request, in->env, out->env, error) : 0;
}

static void set_keys(struct render_light *light, const char *source)
{
    snprintf(light->key, sizeof light->key, "%s@%.9g*%.9g,%.9g,%.9g", source, light->rotate_deg,
             (double)light->gain[0], (double)light->gain[1], (double)light->gain[2]);
    snprintf(light->still_key, sizeof light->still_key, "%s@0*%.9g,%.9g,%.9g", source,
             (double)light->gain[0], (double)light->gain[1], (double)light->gain[2]);
}

size_t render_first_bad_texel(const float *texels, size_t n)
{
    size_t i = 0;
    while (i < n && texels[i] >= 0 && texels[i] <= 1e9f) i++;
    return i;
}

void render_light_name(struct render_light *light, const float *texels, const char *hash)
{
    char source[104], hex[65];
    struct relight_sha256 sha;
    size_t bytes = (size_t)72 * light->cube_n * light->cube_n;
    // A cryptographic hash: clients share cache entries by it, and none may construct a
    // collision.
    if (light->cube_n && hash[0]) {
        snprintf(source, sizeof source, "texels:%u:%s+%zu", light->cube_n, hash, light->texel);
    } else if (light->cube_n) {
        relight_sha256_init(&sha);
        relight_sha256_add(&sha, texels + light->texel, bytes);
        relight_sha256_hex(&sha, hex);
        snprintf(source, sizeof source, "texels:%u:%s", light->cube_n, hex);
    } else {
        snprintf(source, sizeof source, "%s", light->env);
    }
    set_keys(light, source);
}

int render_spec_turn(struct render_spec *spec, size_t n, Relight__Light *const *lights,
                     bool rotate, bool gain, char error[300])
{
    struct render_light next[RENDER_MAX_LIGHTS];
    if (n != spec->n_light)
        REFUSE(BAD_REQUEST, "%zu lights are to be turned or scaled, and the view has %u", n,
               spec->n_light);
    for (unsigned i = 0; i < n; i++) {
        char source[96];
        next[i] = spec->light[i];
        snprintf(source, sizeof source, "%.*s", (int)strcspn(next[i].key, "@"), next[i].key);
        int code = rotate ? parse_rotation(&next[i], lights[i], i, error) : 0;
        if (!code && gain) code = parse_gain(&next[i], lights[i], i, error);
        if (code) return code;
        set_keys(&next[i], source);
    }
    memcpy(spec->light, next, n * sizeof *next);
    return 0;
}

int render_spec_lights(struct render_spec *spec, size_t n, Relight__Light *const *lights,
                       struct request *request, char error[300])
{
    if (n > RENDER_MAX_LIGHTS) RANGE(n, 1, RENDER_MAX_LIGHTS, "", "lights");
    struct render_light parsed[RENDER_MAX_LIGHTS];
    size_t floats = 0;
    for (unsigned i = 0; i < n; i++) {
        int code = parse_light(&parsed[i], lights[i], i, request, error);
        if (code) return code;
        parsed[i].texel = floats;
        floats += (size_t)18 * parsed[i].cube_n * parsed[i].cube_n;
    }
    if (request->payload_size != floats * sizeof(float))
        REFUSE(BAD_REQUEST, "the payload has %zu bytes, and the lights' cubes need %zu",
               request->payload_size, floats * sizeof(float));
    const float *texels = (const float *)request->payload;
    const char *hash = request->payload_hash;
    size_t bad = hash[0] ? request->payload_bad - 1 : render_first_bad_texel(texels, floats);
    if (bad < floats) RANGE(texels[bad], 0, 1e9, "", "texels[%zu]", bad);
    struct held_bytes *held = request_take_payload(request);
    if (floats && !held) REFUSE(NO_MEMORY, "not enough memory");
    held_bytes_release(spec->texels);
    spec->texels = held;
    spec->n_light = (unsigned)n;
    for (unsigned i = 0; i < n; i++) spec->light[i] = parsed[i];
    for (unsigned i = 0; i < n; i++) render_light_name(&spec->light[i], texels, hash);
    return 0;
}

static int parse_maps(struct render_spec *spec, const Relight__Shade *shade, char error[300])
{
    const char *const map[3] = {shade->albedo_map, shade->normal_map, shade->bump_map};
    static const char *const name[3] = {"albedo_map", "normal_map", "bump_map"};
    for (int k = 0; k < 3; k++) {
        if (map[k][0] && !relight_hash_valid(map[k]))
            REFUSE(BAD_REQUEST, "shade.%s %.70s: not the SHA-256 of an upload", name[k],
                   map[k]);
        snprintf(spec->map[k], sizeof spec->map[k], "%s", map[k]);
    }
    if (!(shade->bump_mm >= 0 && shade->bump_mm <= 1e4f))
        RANGE(shade->bump_mm, 0, 1e4, "mm", "shade.bump_mm");
    spec->bump_mm = shade->bump_mm;
    return 0;
}

static int parse_material(struct render_spec *spec, struct request *request, const char *text,
                          char error[300])
{
    bool preset;
    spec->has_material = text[0] != 0;
    spec->material_key[0] = 0;
    if (!spec->has_material) return 0;
    if (material_of_request(request, text, &spec->material, &preset, error))
        return RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
    material_key(&spec->material, spec->material_key);
    return 0;
}

static int parse_entry(struct request *request, const Relight__ObjectMaterial *in, size_t index,
                       struct media_map *map, char error[300])
{
    char own[300];
    bool preset;
    if (!in->object[0] || !in->material[0])
        REFUSE(BAD_REQUEST, "shade.materials[%zu]: object or material is missing", index);
    if (material_of_request(request, in->material, &map->entry[index].material, &preset, own))
        REFUSE(OUT_OF_RANGE, "material of \"%.63s\": %.200s", in->object, own);
    snprintf(map->entry[index].object, sizeof map->entry[0].object, "%s", in->object);
    return 0;
}

static int parse_objects(struct render_spec *spec, struct request *request, size_t n,
                         Relight__ObjectMaterial *const *in, char error[300])
{
    int code = 0;
    if (n > PRT_MEDIA_MAX) RANGE(n, 0, PRT_MEDIA_MAX, "", "shade.materials");
    struct media_map *map = n ? media_map_create((unsigned)n) : NULL;
    if (n && !map) REFUSE(NO_MEMORY, "not enough memory");
    for (size_t i = 0; i < n && !code; i++) code = parse_entry(request, in[i], i, map, error);
    if (code) {
        media_map_release(map);
        return code;
    }
    if (map) media_map_set_key(map);
    media_map_release(spec->objects);
    spec->objects = map;
    return 0;
}

int render_spec_shade(struct render_spec *spec, struct request *request,
                      const Relight__Shade *shade, char error[300])
{
    if (!shade) return 0;
    if (!is_value(&relight__engine__descriptor, (int)shade->engine))
        REFUSE(UNSUPPORTED, "engine %u is unknown", shade->engine);
    if (!is_value(&relight__term__descriptor, (int)shade->term))
        REFUSE(UNSUPPORTED, "term %u is unknown", shade->term);
    if (strlen(shade->variant) >= sizeof spec->variant)
        REFUSE(OUT_OF_RANGE, "shade.variant: the name has more than 63 bytes");
    snprintf(spec->variant, sizeof spec->variant, "%s", shade->variant);
    spec->engine = shade->engine;
    spec->term = shade->term;
    int code = parse_material(spec, request, shade->material, error);
    if (!code) code = parse_objects(spec, request, shade->n_materials, shade->materials, error);
    materials_used(request);
    if (code) return code;
    spec->has_eye = vec3(shade->eye, spec->eye);
    const float *bad = spec->has_eye ? outside(spec->eye, -1e9f, 1e9f) : NULL;
    if (bad) RANGE(*bad, -1e9, 1e9, "", "shade.eye");
    if (!(shade->max_error >= 0 && shade->max_error <= 1e9f))
        RANGE(shade->max_error, 0, 1e9, "", "shade.max_error");
    spec->max_error = shade->max_error;
    spec->budget_ms = shade->budget_ms;
    return parse_maps(spec, shade, error);
}

int render_spec_colors(struct render_spec *spec, int format, float exposure_ev,
                       uint32_t most_rank, bool phases, bool exits, char error[300])
{
    if (!is_value(&relight__color_format__descriptor, format))
        REFUSE(UNSUPPORTED, "format %d is unknown", format);
    if (!(fabsf(exposure_ev) <= 40)) RANGE(exposure_ev, -40, 40, "stops", "exposure_ev");
    spec->format = format;
    spec->exposure_ev = exposure_ev;
    spec->most_rank = most_rank;
    spec->phases = phases;
    spec->exits = exits;
    return 0;
}

// A camera that the model places: one of its own, or an orbit.
static int parse_named_camera(struct render_spec *spec, const Relight__Camera *camera,
                              char error[300])
{
    const Relight__Orbit *o = camera->orbit;
    if (camera->eye || camera->target || (camera->name[0] && o))
        REFUSE(BAD_REQUEST, "camera: set eye and target, or name, or orbit");
    if (strlen(camera->name) >= sizeof spec->camera_name)
        REFUSE(OUT_OF_RANGE, "camera.name has more than 63 bytes");
    snprintf(spec->camera_name, sizeof spec->camera_name, "%s", camera->name);
    spec->has_orbit = o != NULL;
    if (!o) return 0;
    spec->orbit =
        (struct prt_orbit){o->azimuth_deg, o->elevation_deg, o->zoom == 0 ? 1 : o->zoom};
    if (!prt_orbit_ok(&spec->orbit))
        REFUSE(OUT_OF_RANGE,
               "camera.orbit: the azimuth is in [-1e6, 1e6] degrees, the elevation in [-90, "
               "90] degrees, the zoom in [0.1, 100]");
    return 0;
}

static int parse_camera(struct render_spec *spec, const Relight__Camera *camera,
                        char error[300])
{
    static const float up[3] = {0, 1, 0};
    spec->has_camera = camera != NULL;
    spec->camera_name[0] = 0;
    spec->has_orbit = false;
    if (!camera) return 0;
    if (camera->name[0] || camera->orbit) return parse_named_camera(spec, camera, error);
    memcpy(spec->camera_up, up, sizeof up);
    vec3(camera->up, spec->camera_up);
    if (!vec3(camera->eye, spec->camera_eye) || !vec3(camera->target, spec->camera_target))
        REFUSE(BAD_REQUEST, "camera: eye or target is missing");
    const float *const point[3] = {spec->camera_eye, spec->camera_target, spec->camera_up};
    static const char *const name[3] = {"eye", "target", "up"};
    for (int i = 0; i < 3; i++) {
        const float *bad = outside(point[i], -1e9f, 1e9f);
        if (bad) RANGE(*bad, -1e9, 1e9, "", "picture.camera.%s", name[i]);
    }
    spec->fovy_deg = camera->fovy_deg;
    if (!(spec->fovy_deg >= 0 && spec->fovy_deg < 170))
        REFUSE(OUT_OF_RANGE,
               "picture.camera.fovy_deg is %g, allowed range 0 to 170 (excluded) degrees",
               (double)spec->fovy_deg);
    float look[3], u[3], cross = 0;
    for (int i = 0; i < 3; i++) look[i] = spec->camera_target[i] - spec->camera_eye[i];
    memcpy(u, spec->camera_up, sizeof u);
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        cross += fabsf(look[j] * u[k] - look[k] * u[j]);
    }
    if (!(cross > 0)) REFUSE(OUT_OF_RANGE, "camera: eye, target and up lie on one line");
    return 0;
}

int render_spec_picture(struct render_spec *spec, const struct server *server,
                        const Relight__Picture *p, char error[300])
{
    spec->picture = true;
    if (!p) return 0;
    uint32_t side = server->options.max_side;
    spec->width = p->width ? p->width : 800;
    spec->height = p->height ? p->height : 600;
    if (spec->width > side) RANGE(spec->width, 1, side, "pixels", "picture.width");
    if (spec->height > side) RANGE(spec->height, 1, side, "pixels", "picture.height");
    if (!image_format_known(p->format))
        REFUSE(UNSUPPORTED, "picture.format %u is unknown", p->format);
    if (!is_value(&relight__tone__descriptor, (int)p->tone))
        REFUSE(UNSUPPORTED, "picture.tone %u is unknown", p->tone);
    if (p->quality > 100) RANGE(p->quality, 1, 100, "", "picture.quality");
    if (!(fabsf(p->exposure_ev) <= 40))
        RANGE(p->exposure_ev, -40, 40, "stops", "picture.exposure_ev");
    spec->image_format = p->format;
    spec->tone = p->tone;
    spec->quality = p->quality ? p->quality : 90;
    spec->picture_ev = p->exposure_ev;
    spec->plain_background = p->plain_background;
    spec->no_specular = p->no_specular;
    spec->transparent = p->transparent;
    spec->floor = p->floor;
    spec->samples = p->samples ? p->samples : 4;
    if (spec->samples > 8 || spec->samples & (spec->samples - 1))
        REFUSE(OUT_OF_RANGE, "picture.samples is %u, allowed range 1 to 8: 1, 2, 4 or 8",
               spec->samples);
    memset(spec->background, 0, sizeof spec->background);
    vec3(p->background, spec->background);
    const float *bad = outside(spec->background, 0, 1e6f);
    if (bad) RANGE(*bad, 0, 1e6, "", "picture.background");
    return parse_camera(spec, p->camera, error);
}

int render_spec_alpha(const struct render_spec *spec, char error[300])
{
    if (spec->transparent && !image_format_alpha((unsigned)spec->image_format))
        REFUSE(UNSUPPORTED, "picture.transparent needs a format with alpha: PNG or EXR");
    return 0;
}
