// SPDX-License-Identifier: MIT
// The table of the API: paths and methods, and how each becomes a message of the protocol.
// net/route_answers.c turns the answers into HTTP.
#include "net/routes.h"

#include "message_text.h"
#include "net/page_files.h"
#include "relight.pb-c.h"

#include <cjson/cJSON.h>
#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

// ---- parameters into fields

// A parameter and its field. `set` NULL: the field takes the text as it is.
struct field {
    const char *parameter, *path;
    int (*set)(ProtobufCMessage *message, const char *path, const char *text,
               char error[MESSAGE_TEXT_ERROR]);
};

static bool refuse_parameter(struct http_problem *problem, const char *parameter,
                             const char *why)
{
    http_refuse(problem, 400, "out_of_range", "%s: %s", parameter, why);
    snprintf(problem->parameter, sizeof problem->parameter, "%s", parameter);
    return false;
}

static bool set_fields(struct exchange *x, const struct field *field, size_t n,
                       struct http_problem *problem)
{
    for (size_t i = 0; i < n; i++) {
        char error[MESSAGE_TEXT_ERROR];
        const char *text = http_parameter(&x->head, field[i].parameter);
        if (!text) continue;
        int failed = field[i].set ? field[i].set(x->message, field[i].path, text, error)
                                  : message_set(x->message, field[i].path, text, error);
        if (failed) return refuse_parameter(problem, field[i].parameter, error);
    }
    return true;
}

static bool new_message(struct exchange *x, const ProtobufCMessageDescriptor *descriptor,
                        struct http_problem *problem)
{
    char error[MESSAGE_TEXT_ERROR];
    x->message = message_new(descriptor);
    if (x->message &&
        (!x->id[0] || !protobuf_c_message_descriptor_get_field_by_name(descriptor, "model") ||
         !message_set(x->message, "model", x->id, error)))
        return true;
    http_refuse(problem, 503, "no_memory", "not enough memory");
    return false;
}

// "X,Y,Z" into x, y and z of a Vec3.
static int set_vec3(ProtobufCMessage *message, const char *path, const char *text,
                    char error[MESSAGE_TEXT_ERROR])
{
    static const char *const axis[] = {"x", "y", "z"};
    char copy[120], inner[80], *at = copy;
    if (strlen(text) >= sizeof copy) text = "";
    snprintf(copy, sizeof copy, "%s", text);
    for (int i = 0; i < 3; i++) {
        char *word = strsep(&at, ",");
        snprintf(inner, sizeof inner, "%s.%s", path, axis[i]);
        if (!word || message_set(message, inner, word, error)) {
            snprintf(error, MESSAGE_TEXT_ERROR, "expected three numbers X,Y,Z");
            return -1;
        }
    }
    if (!at) return 0;
    snprintf(error, MESSAGE_TEXT_ERROR, "expected three numbers X,Y,Z");
    return -1;
}

// EYE:TARGET[:UP[:FOVY]]
static int set_camera(ProtobufCMessage *message, const char *path, const char *text,
                      char error[MESSAGE_TEXT_ERROR])
{
    static const char *const part[] = {"eye", "target", "up"};
    char copy[400], inner[80], *at = copy;
    int n = 0, failed = strlen(text) >= sizeof copy;
    snprintf(copy, sizeof copy, "%s", failed ? "" : text);
    for (char *word; !failed && (word = strsep(&at, ":")); n++) {
        snprintf(inner, sizeof inner, "%s.%s", path, n < 3 ? part[n] : "fovy_deg");
        if (n > 3) failed = 1;
        else if (n == 3) failed = message_set(message, inner, word, error);
        else if (*word || n < 2) failed = set_vec3(message, inner, word, error);
    }
    if (!failed && n >= 2) return 0;
    snprintf(error, MESSAGE_TEXT_ERROR, "expected EYE:TARGET:UP:FOVY (x,y,z:x,y,z:x,y,z:deg)");
    return -1;
}

static int set_size(ProtobufCMessage *message, const char *path, const char *text,
                    char error[MESSAGE_TEXT_ERROR])
{
    char width[16], height[80], *cross = strpbrk(text, "xX");
    if (cross && cross > text && cross - text < 8) {
        snprintf(width, sizeof width, "%.*s", (int)(cross - text), text);
        snprintf(height, sizeof height, "%s%sheight", path, *path ? "." : "");
        if (!message_set(message, height, cross + 1, error)) {
            snprintf(height, sizeof height, "%s%swidth", path, *path ? "." : "");
            if (!message_set(message, height, width, error) && atoi(width) > 0 &&
                atoi(cross + 1) > 0)
                return 0;
        }
    }
    snprintf(error, MESSAGE_TEXT_ERROR, "expected WIDTHxHEIGHT in pixels, as 800x600");
    return -1;
}

// The hash of an upload stands for env:HASH, another word for name:WORD.
static int set_env(ProtobufCMessage *message, const char *path, const char *text,
                   char error[MESSAGE_TEXT_ERROR])
{
    char named[300];
    bool whole = strchr(text, ':') || !strcmp(text, "constant");
    snprintf(named, sizeof named, "%s%.250s",
             whole                      ? ""
             : relight_hash_valid(text) ? "env:"
                                        : "name:",
             text);
    return message_set(message, path, named, error);
}

// Of a room's items, which are counted from 1: 0 would draw its scene.
static int set_item(ProtobufCMessage *message, const char *path, const char *text,
                    char error[MESSAGE_TEXT_ERROR])
{
    if (message_set(message, path, text, error)) return -1;
    if (strtoull(text, NULL, 10)) return 0;
    snprintf(error, MESSAGE_TEXT_ERROR, "expected a number from 1 on");
    return -1;
}

// "R,G,B" is a plain background, "transparent" none.
static int set_background(ProtobufCMessage *message, const char *path, const char *text,
                          char error[MESSAGE_TEXT_ERROR])
{
    if (!strcmp(text, "transparent"))
        return message_set(message, "picture.transparent", "yes", error);
    return set_vec3(message, path, text, error) ||
           message_set(message, "picture.plain_background", "yes", error);
}

static int set_image_format(ProtobufCMessage *message, const char *path, const char *text,
                            char error[MESSAGE_TEXT_ERROR])
{
    return message_set(message, path, strcasecmp(text, "jpg") ? text : "jpeg", error);
}

// "material.OBJECT=TEXT", any number of them, as entries of `field`, a list of ObjectMaterial
// in the message itself or in `part` of it.
static bool set_materials(struct exchange *x, const char *part, const char *field,
                          struct http_problem *problem)
{
    static const char prefix[] = "material.";
    const size_t skip = sizeof prefix - 1;
    char error[MESSAGE_TEXT_ERROR];
    bool good = true;
    for (unsigned i = 0; good && i < x->head.n_parameter; i++) {
        struct http_parameter *p = &x->head.parameter[i];
        if (strncmp(p->name, prefix, skip) != 0) continue;
        p->used = true;
        cJSON *root = cJSON_CreateObject();
        cJSON *holder = part ? cJSON_AddObjectToObject(root, part) : root;
        cJSON *entry = cJSON_CreateObject();
        cJSON_AddItemToArray(cJSON_AddArrayToObject(holder, field), entry);
        cJSON_AddStringToObject(entry, "object", p->name + skip);
        cJSON_AddStringToObject(entry, "material", p->value);
        if (message_from_json(x->message, root, error))
            good = refuse_parameter(problem, p->name, error);
        cJSON_Delete(root);
    }
    return good;
}

// ---- operations

static const struct field shade_fields[] = {
    {"env", "lights.env", set_env},         {"rotate", "lights.rotate_deg", NULL},
    {"gain", "lights.gain", set_vec3},      {"engine", "shade.engine", NULL},
    {"term", "shade.term", NULL},           {"material", "shade.material", NULL},
    {"variant", "shade.variant", NULL},     {"eye", "shade.eye", set_vec3},
    {"max_error", "shade.max_error", NULL}, {"budget_ms", "shade.budget_ms", NULL},
};
static const struct field picture_fields[] = {
    {"size", "picture", set_size},
    {"camera", "picture.camera", set_camera},
    {"format", "picture.format", set_image_format},
    {"quality", "picture.quality", NULL},
    {"tone", "picture.tone", NULL},
    {"exposure", "picture.exposure_ev", NULL},
    {"background", "picture.background", set_background},
    {"samples", "picture.samples", NULL},
    {"no_specular", "picture.no_specular", NULL},
    {"floor", "picture.floor", NULL},
    {"albedo_map", "shade.albedo_map", NULL},
    {"normal_map", "shade.normal_map", NULL},
    {"bump_map", "shade.bump_map", NULL},
    {"bump_mm", "shade.bump_mm", NULL},
};
static const struct field load_fields[] = {
    {"name", "name", NULL},
    {"path", "path", NULL},
    {"size_mm", "size_mm", NULL},
    {"mm_per_unit", "mm_per_unit", NULL},
    {"material", "material", NULL},
    {"variant", "variant", NULL},
    {"up_z", "up_z", NULL},
    {"flip_v", "flip_v", NULL},
    {"preview", "preview", NULL},
    {"no_draft", "no_draft", NULL},
    {"pin", "pin", NULL},
    {"opaque", "opaque", NULL},
    {"transport", "bake.transport", NULL},
    {"storage", "bake.storage", NULL},
    {"scattering", "bake.scattering", NULL},
    {"walks", "bake.walks", NULL},
    {"samples", "bake.samples", NULL},
    {"cube", "bake.cube", NULL},
    {"coeffs", "bake.coeffs", NULL},
    {"rank", "bake.rank", NULL},
    {"phase_terms", "bake.phase_terms", NULL},
    {"single_points", "bake.single_points", NULL},
    {"no_single", "bake.no_single", NULL},
    {"exit_planes", "bake.exit_planes", NULL},
    {"any_eta", "bake.any_eta", NULL},
    {"max_error", "bake.max_error", NULL},
    {"seed", "bake.seed", NULL},
    {"env", "bake.env", set_env},
    {"rotate", "bake.rotate_deg", NULL},
};
#define N(list) (sizeof(list) / sizeof *(list))

// A light comes once: by its name, as the body, or in a JSON body. A polynomial bake needs
// none.
static bool one_light(struct exchange *x, struct http_problem *problem)
{
    const char *env = http_parameter(&x->head, "env");
    if (!x->head.has_body || !env) return true;
    return refuse_parameter(problem, "env", "the light is given twice, here and as the body");
}

// The body's light takes rotate and gain of the query.
static void add_light(struct exchange *x)
{
    char error[MESSAGE_TEXT_ERROR];
    set_env(x->message, "lights.env", x->blob, error);
}

static const char *text_in(const cJSON *json, const char *key)
{
    const char *text = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(json, key));
    return text ? text : "";
}

bool route_body_agrees(struct exchange *x, const cJSON *body, struct http_problem *problem)
{
    static const char *const of_lights[] = {"rotate", "gain"};
    const cJSON *picture = cJSON_GetObjectItemCaseSensitive(body, "picture");
    const char *model = text_in(body, "model"), *format = text_in(picture, "format");
    const char *ending = strcasecmp(x->ending, "jpg") ? x->ending : "jpeg";
    if (x->id[0] && *model && strcmp(model, x->id))
        return refuse_parameter(problem, "model", "the path names another one");
    for (int i = 0; i < 2 && cJSON_GetObjectItemCaseSensitive(body, "lights"); i++)
        if (http_parameter(&x->head, of_lights[i]))
            return refuse_parameter(problem, of_lights[i],
                                    "the lights are in the body: it goes there, too");
    if (*format && strncasecmp(format, ending, strlen(ending))) // exr_float is an .exr
        return refuse_parameter(problem, "picture.format", "the path ends in another one");
    return true;
}

static bool prepare_image(struct exchange *x, struct http_problem *problem)
{
    char error[MESSAGE_TEXT_ERROR];
    if (!one_light(x, problem) ||
        !new_message(x, &relight__image_request__descriptor, problem) ||
        !set_fields(x, shade_fields, N(shade_fields), problem) ||
        !set_materials(x, "shade", "materials", problem) ||
        !set_fields(x, picture_fields, N(picture_fields), problem))
        return false;
    // image.png: the ending says the format.
    if (x->ending[0] && set_image_format(x->message, "picture.format", x->ending, error)) {
        http_refuse(problem, 404, "not_found", "image.%s: %s", x->ending, error);
        return false;
    }
    snprintf(x->file_name, sizeof x->file_name, "light");
    return true;
}

static bool prepare_colors(struct exchange *x, struct http_problem *problem)
{
    static const char *const words[] = {"f32", "f16", "rgb9e5", "srgb8", "csv", "npy"};
    char error[MESSAGE_TEXT_ERROR];
    const char *format = http_parameter(&x->head, "format");
    const char *exposure = http_parameter(&x->head, "exposure");
    if (!format) format = x->ending[0] ? x->ending : "f32";
    if (!one_light(x, problem) ||
        !new_message(x, &relight__colors_request__descriptor, problem) ||
        !set_fields(x, shade_fields, N(shade_fields), problem) ||
        !set_materials(x, "shade", "materials", problem))
        return false;
    x->format = -1;
    for (int i = 0; i < COLORS_N_FORMAT; i++)
        if (!strcasecmp(words[i], format)) x->format = i;
    if (x->format < 0)
        return refuse_parameter(problem, "format",
                                "expected one of f32 f16 rgb9e5 srgb8 csv npy");
    if (x->format < COLORS_CSV) message_set(x->message, "format", format, error);
    if (exposure && message_set(x->message, "exposure_ev", exposure, error))
        return refuse_parameter(problem, "exposure", error);
    snprintf(x->file_name, sizeof x->file_name, "light");
    return true;
}

static bool prepare_environment(struct exchange *x, struct http_problem *problem)
{
    static const struct field fields[] = {{"width", "thumbnail", NULL}};
    char error[MESSAGE_TEXT_ERROR];
    if (!new_message(x, &relight__env_request__descriptor, problem)) return false;
    if (!set_env(x->message, "env", x->id, error) &&
        !message_set(x->message, "thumbnail", "256", error))
        return set_fields(x, fields, 1, problem);
    http_refuse(problem, 400, "bad_request", "%s", error);
    return false;
}

static bool prepare_load(struct exchange *x, struct http_problem *problem)
{
    const char *name = http_parameter(&x->head, "name");
    const char *path = http_parameter(&x->head, "path");
    if (!new_message(x, &relight__load_request__descriptor, problem)) return false;
    if (path && x->head.has_body)
        return refuse_parameter(problem, "path",
                                "the model is given twice, here and as the body");
    if (!path && !x->head.has_body)
        return refuse_parameter(problem, "path",
                                "no model: send its file as the body, or name "
                                "a file of the models folder");
    bool file = x->head.has_body && strncasecmp(x->head.content_type, "application/json", 16);
    if (file && (!name || !*name || strlen(name) >= sizeof x->file_name))
        return refuse_parameter(problem, "name",
                                "the file's name is needed, with its ending: name=bunny.glb");
    if (file) snprintf(x->file_name, sizeof x->file_name, "%s", name);
    return set_fields(x, load_fields, N(load_fields), problem) &&
           set_materials(x, NULL, "materials", problem);
}

static void add_model_file(struct exchange *x)
{
    char error[MESSAGE_TEXT_ERROR];
    message_set(x->message, "files.name", x->file_name, error);
    message_set(x->message, "files.blob", x->blob, error);
}

static bool prepare_list(struct exchange *x, struct http_problem *problem)
{
    static const struct field fields[] = {{"after", "after", NULL}, {"limit", "limit", NULL}};
    char error[MESSAGE_TEXT_ERROR];
    return new_message(x, &relight__list_request__descriptor, problem) &&
           !message_set(x->message, "files", "yes", error) &&
           !message_set(x->message, "environments", "yes", error) &&
           set_fields(x, fields, 2, problem);
}

static bool prepare_info(struct exchange *x, struct http_problem *problem)
{
    return new_message(x, &relight__info_request__descriptor, problem);
}

static bool prepare_unload(struct exchange *x, struct http_problem *problem)
{
    static const struct field fields[] = {{"forget", "forget", NULL}, {"force", "force", NULL}};
    return new_message(x, &relight__unload_request__descriptor, problem) &&
           set_fields(x, fields, 2, problem);
}

static bool prepare_watch(struct exchange *x, struct http_problem *problem)
{
    char error[MESSAGE_TEXT_ERROR];
    return new_message(x, &relight__watch_request__descriptor, problem) &&
           !message_set(x->message, "job", x->id, error);
}

static bool prepare_cancel(struct exchange *x, struct http_problem *problem)
{
    char error[MESSAGE_TEXT_ERROR];
    return new_message(x, &relight__cancel_job_request__descriptor, problem) &&
           !message_set(x->message, "job", x->id, error);
}

// ---- review rooms

static bool prepare_rooms(struct exchange *x, struct http_problem *problem)
{
    return new_message(x, &relight__room_list_request__descriptor, problem);
}

static bool prepare_room(struct exchange *x, struct http_problem *problem)
{
    char error[MESSAGE_TEXT_ERROR];
    return new_message(x, &relight__room_get_request__descriptor, problem) &&
           !message_set(x->message, "room", x->id, error);
}

static bool prepare_room_events(struct exchange *x, struct http_problem *problem)
{
    static const struct field fields[] = {{"after", "after", NULL}};
    char error[MESSAGE_TEXT_ERROR];
    return prepare_room(x, problem) && !message_set(x->message, "events", "yes", error) &&
           set_fields(x, fields, 1, problem);
}

static bool prepare_room_image(struct exchange *x, struct http_problem *problem)
{
    static const struct field fields[] = {{"pin", "pin", set_item},
                                          {"decision", "decision", set_item},
                                          {"revision", "revision", set_item},
                                          {"size", "", set_size}};
    char error[MESSAGE_TEXT_ERROR];
    if (!new_message(x, &relight__room_picture_request__descriptor, problem) ||
        message_set(x->message, "room", x->id, error))
        return false;
    if (strcasecmp(x->ending, "png") && strcasecmp(x->ending, "exr")) {
        http_refuse(problem, 404, "not_found", "image.%s: a room's pictures are png or exr",
                    x->ending);
        return false;
    }
    const char *format = strcasecmp(x->ending, "png") ? x->ending : "png16";
    return !message_set(x->message, "format", format, error) &&
           set_fields(x, fields, 4, problem);
}

// ---- uploads

static bool whole_number(struct exchange *x, const char *name, uint64_t *out,
                         struct http_problem *problem)
{
    const char *text = http_parameter(&x->head, name);
    if (!text) return true;
    if (!*text || strspn(text, "0123456789") != strlen(text) || strlen(text) > 15)
        return refuse_parameter(problem, name, "expected a number of bytes");
    *out = strtoull(text, NULL, 10);
    return true;
}

// PUT /v1/blobs/HASH, POST /v1/blobs, and the question GET /v1/blobs/HASH.
static bool prepare_blob(struct exchange *x, struct http_problem *problem)
{
    char error[MESSAGE_TEXT_ERROR];
    const char *name = http_parameter(&x->head, "name");
    bool asks = !strcmp(x->head.method, "GET") || !strcmp(x->head.method, "HEAD");
    if (name && strlen(name) < sizeof x->file_name)
        snprintf(x->file_name, sizeof x->file_name, "%s", name);
    if (x->id[0] && !relight_hash_valid(x->id)) {
        http_refuse(problem, 404, "not_found",
                    "the name of a blob is its SHA-256, 64 "
                    "lower-case hex digits");
        return false;
    }
    if (!asks && !x->head.has_body) {
        http_refuse(problem, 400, "bad_request", "the body is empty");
        return false;
    }
    if ((x->id[0] && !whole_number(x, "size", &x->blob_size, problem)) ||
        (x->id[0] && !asks && !whole_number(x, "offset", &x->blob_offset, problem)) ||
        !new_message(x, &relight__put_blob_request__descriptor, problem))
        return false;
    memcpy(x->blob, x->id, x->id[0] ? 65 : 1);
    // A question about a blob that is there needs no size; one about an upload does.
    const char *size = x->id[0] ? http_parameter(&x->head, "size") : NULL;
    return !message_set(x->message, "hash", x->id, error) &&
           !message_set(x->message, "size", size ? size : "1", error);
}

// ---- the table

// "/" is there without a page, too: it says how to get one.
static const struct route page_route = {"GET", "/",  BODY_NONE, 0,   page_file,
                                        NULL,  NULL, true,      true};
static const struct route routes[] = {
    {"GET", "/healthz", BODY_NONE, 0, page_health, NULL, NULL, true},
    {"GET", "/readyz", BODY_NONE, 0, page_ready, NULL, NULL, true},
    {"GET", "/metrics", BODY_NONE, 0, page_metrics, NULL, NULL, false},
    {"GET", "/v1/openapi.json", BODY_NONE, 0, page_openapi, NULL, NULL, true},
    {"GET", "/v1/models", BODY_NONE, RELIGHT_TYPE_LIST, prepare_list, NULL, answer_json, false},
    {"POST", "/v1/models", BODY_FILE_OR_JSON, RELIGHT_TYPE_LOAD, prepare_load, add_model_file,
     answer_load, false},
    {"GET", "/v1/models/*/image.*", BODY_NONE, RELIGHT_TYPE_IMAGE, prepare_image, NULL,
     answer_image, false, false, true},
    {"POST", "/v1/models/*/image.*", BODY_FILE_OR_JSON, RELIGHT_TYPE_IMAGE, prepare_image,
     add_light, answer_image, false},
    {"GET", "/v1/models/*/image", BODY_NONE, RELIGHT_TYPE_IMAGE, prepare_image, NULL,
     answer_image, false, false, true},
    {"POST", "/v1/models/*/image", BODY_FILE_OR_JSON, RELIGHT_TYPE_IMAGE, prepare_image,
     add_light, answer_image, false},
    {"GET", "/v1/models/*/colors.*", BODY_NONE, RELIGHT_TYPE_COLORS, prepare_colors, NULL,
     answer_colors, false},
    {"POST", "/v1/models/*/colors.*", BODY_FILE_OR_JSON, RELIGHT_TYPE_COLORS, prepare_colors,
     add_light, answer_colors, false},
    {"GET", "/v1/models/*/colors", BODY_NONE, RELIGHT_TYPE_COLORS, prepare_colors, NULL,
     answer_colors, false},
    {"POST", "/v1/models/*/colors", BODY_FILE_OR_JSON, RELIGHT_TYPE_COLORS, prepare_colors,
     add_light, answer_colors, false},
    {"GET", "/v1/environments/*/image.jpg", BODY_NONE, RELIGHT_TYPE_ENV, prepare_environment,
     NULL, answer_environment, false, false, true},
    {"GET", "/v1/models/*", BODY_NONE, RELIGHT_TYPE_INFO, prepare_info, NULL, answer_json,
     false},
    {"DELETE", "/v1/models/*", BODY_NONE, RELIGHT_TYPE_UNLOAD, prepare_unload, NULL,
     answer_json, false},
    {"GET", "/v1/rooms", BODY_NONE, RELIGHT_TYPE_ROOM_LIST, prepare_rooms, NULL, answer_json,
     false},
    {"GET", "/v1/rooms/*/image.*", BODY_NONE, RELIGHT_TYPE_ROOM_PICTURE, prepare_room_image,
     NULL, answer_image, false},
    {"GET", "/v1/rooms/*/events", BODY_NONE, RELIGHT_TYPE_ROOM_GET, prepare_room_events, NULL,
     answer_room, false},
    {"GET", "/v1/rooms/*", BODY_NONE, RELIGHT_TYPE_ROOM_GET, prepare_room, NULL, answer_room,
     false},
    {"GET", "/v1/jobs/*/events", BODY_NONE, RELIGHT_TYPE_WATCH, prepare_watch, NULL,
     answer_events, false},
    {"GET", "/v1/jobs/*", BODY_NONE, RELIGHT_TYPE_WATCH, prepare_watch, NULL, answer_json,
     false},
    {"DELETE", "/v1/jobs/*", BODY_NONE, RELIGHT_TYPE_CANCEL_JOB, prepare_cancel, NULL,
     answer_json, false},
    {"POST", "/v1/blobs", BODY_FILE, RELIGHT_TYPE_PUT_BLOB, prepare_blob, NULL, answer_blob,
     false},
    {"PUT", "/v1/blobs/*", BODY_FILE, RELIGHT_TYPE_PUT_BLOB, prepare_blob, NULL, answer_blob,
     false},
    {"GET", "/v1/blobs/*", BODY_NONE, RELIGHT_TYPE_PUT_BLOB, prepare_blob, NULL, answer_blob,
     false},
};

static bool ends_with(const char *text, size_t n, const char *end)
{
    size_t m = strlen(end);
    return n > m && !strncmp(text + n - m, end, m);
}

// Whether the path has the pattern; *n_id and *ending are then what it leaves open.
static bool matches(const char *pattern, const char *path, size_t *n_id, const char **ending)
{
    const char *star = strchr(pattern, '*');
    size_t before = star ? (size_t)(star - pattern) : 0, n = strlen(path);
    char tail[24];
    *n_id = 0;
    *ending = "";
    if (!star) return !strcmp(pattern, path);
    if (strncmp(pattern, path, before)) return false;
    snprintf(tail, sizeof tail, "%s", star + 1);
    if (ends_with(tail, strlen(tail), ".*")) {
        const char *dot = strrchr(path, '.');
        if (!dot || strchr(dot, '/') || !dot[1] || strlen(dot + 1) > 15) return false;
        *ending = dot + 1;
        n = (size_t)(dot - path);
        tail[strlen(tail) - 2] = 0;
    }
    if (n <= before + strlen(tail) || strncmp(path + n - strlen(tail), tail, strlen(tail)))
        return false;
    *n_id = n - before - strlen(tail);
    return *n_id < EXCHANGE_ID;
}

bool route_is_signable(const char *path)
{
    const char *ending;
    size_t n;
    for (size_t i = 0; i < N(routes); i++)
        if (routes[i].signable && matches(routes[i].pattern, path, &n, &ending)) return true;
    return false;
}

const struct route *route_find(struct exchange *x, struct http_problem *problem)
{
    char allow[60] = "";
    const char *method = strcmp(x->head.method, "HEAD") ? x->head.method : "GET", *ending;
    const char *first = NULL;
    size_t n;
    if (!strcmp(method, "GET") && (!strcmp(x->head.path, "/") || page_files_find(x->head.path)))
        return &page_route;
    for (size_t i = 0; i < N(routes); i++) {
        const struct route *r = &routes[i];
        if (!matches(r->pattern, x->head.path, &n, &ending)) continue;
        if (first && strcmp(first, r->pattern)) break; // a more general pattern
        first = r->pattern;
        if (!strcmp(r->method, method)) {
            const char *star = strchr(r->pattern, '*');
            if (star)
                snprintf(x->id, sizeof x->id, "%.*s", (int)n,
                         x->head.path + (star - r->pattern));
            snprintf(x->ending, sizeof x->ending, "%s", ending);
            return r;
        }
        snprintf(allow + strlen(allow), sizeof allow - strlen(allow), "%s%s%s",
                 allow[0] ? ", " : "", r->method, strcmp(r->method, "GET") ? "" : ", HEAD");
    }
    if (allow[0]) {
        exchange_field(x, "allow:", "%s", allow);
        http_refuse(problem, 405, "unsupported", "%s is not one of %s", x->head.method, allow);
    } else {
        http_refuse(problem, 404, "not_found", "there is nothing at this path");
        snprintf(problem->hint, sizeof problem->hint, "/v1/openapi.json lists the paths");
    }
    return NULL;
}
