// SPDX-License-Identifier: MIT
#include "messages.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "relight.pb-c.h"

#define COUNT(list) (sizeof(list) / sizeof *(list))

void bytes_add(struct bytes *out, const void *bytes, size_t n)
{
    if (out->n + n > out->room) {
        out->room = 2 * (out->n + n);
        out->at = realloc(out->at, out->room);
        if (!out->at) abort();
    }
    if (n) memcpy(out->at + out->n, bytes, n);
    out->n += n;
}

// ---- pieces

// Lengths, counts and numbers at which somebody may have erred.
uint32_t rnd_odd(struct rnd *r)
{
    static const uint32_t odd[] = {0,     1,          2,          3,         7,    16,
                                   63,    64,         255,        256,       4096, 65535,
                                   65536, 0x7fffffff, 0x80000000, 0xffffffff};
    return RND_PICK(r, odd);
}

static float odd_real(struct rnd *r)
{
    static const float odd[] = {0, -1, 1, 1e-30f, 1e30f, -1e9f, 170, 45};
    uint32_t bits = (uint32_t)rnd_bits(r);
    float x;
    if (rnd_chance(r, 2)) return RND_PICK(r, odd);
    memcpy(&x, &bits, 4); // NaN and infinity among them
    return x;
}

// Good mostly, so that requests get past their checks.
static float real(struct rnd *r, float low, float high)
{
    return rnd_chance(r, 20) ? odd_real(r) : low + (high - low) * (float)rnd(r, 1000) / 999;
}

static Relight__Vec3 *vec3(struct rnd *r, Relight__Vec3 *v, float low, float high)
{
    relight__vec3__init(v);
    v->x = real(r, low, high);
    v->y = real(r, low, high);
    v->z = real(r, low, high);
    return v;
}

// Names of a few forms; those that a worker parses (a profile, an escaped letter, long text)
// differ each time, so that none is found in the cache.
static char *material(struct rnd *r, char text[4096])
{
    double a = 0.2 + rnd(r, 1000000) * 1e-6;
    int n = 0;
    switch (rnd(r, 9)) {
    case 0:
        return strcpy(text, "");
    case 1:
        return strcpy(text, rnd_chance(r, 2) ? "marble" : "skin1");
    case 2:
        return strcpy(text, rnd_chance(r, 2) ? "no such material" : "{\"sigma_a\":[1,");
    case 3:
        snprintf(text, 4096,
                 "{\"sigma_s_prime\":[%g,1,2],\"sigma_a\":[0.01,0.02,0.03],\"eta\":1.3}", a);
        return text;
    case 4:
        snprintf(text, 4096,
                 "{\"profile\":\"burley\",\"albedo\":[%g,0.8,0.7],\"mean_free_path\":[1,2,3]}",
                 a);
        return text;
    case 5:
        snprintf(text, 4096,
                 "{\"profile\":\"multipole\",\"layers\":[{\"thickness\":0.5,\"sigma_s_prime\":"
                 "[%g,1,2],\"sigma_a\":[0.1,0.2,0.3]},{\"sigma_s_prime\":[2,2,2],\"sigma_a\":"
                 "[0.1,0.1,0.1]}],\"eta\":1.4}",
                 a);
        return text;
    case 6:
        snprintf(text, 4096, "{\"profile\":\"no such\",\"albedo\":%g}", a);
        return text;
    default: // cheap to parse and yet a worker's
        n = snprintf(
            text, 4096,
            "{\"sigma_s_prime\":[%g,1,2],\"sigma_a\":[0.01,0.02,0.03],\"\\u0065ta\":1.3", a);
        if (rnd_chance(r, 2)) memset(text + n, ' ', 2100), n += 2100;
        return strcpy(text + n, "}"), text;
    }
}

enum { OBJECTS = 3 };
struct object_materials {
    Relight__ObjectMaterial entry[OBJECTS], *at[OBJECTS];
    char text[OBJECTS][4096];
};

static Relight__ObjectMaterial **object_materials(struct rnd *r, struct object_materials *o)
{
    static char *const names[] = {"", "Cube", "made up", "C", "a=b", "\xc3\xa4"};
    for (unsigned i = 0; i < OBJECTS; i++) {
        o->at[i] = &o->entry[i];
        relight__object_material__init(o->at[i]);
        o->entry[i].object = RND_PICK(r, names);
        o->entry[i].material = material(r, o->text[i]);
    }
    return o->at;
}

struct shade {
    Relight__Shade shade;
    Relight__Vec3 eye;
    char material[4096], map[65];
    struct object_materials objects;
};

static Relight__Shade *shade(struct world *world, struct shade *s)
{
    struct rnd *r = world->rnd;
    relight__shade__init(&s->shade);
    s->shade.engine = (Relight__Engine)rnd(r, 10);
    if (rnd_chance(r, 2)) s->shade.engine = RELIGHT__ENGINE__ENGINE_DEFAULT;
    if (s->shade.engine == RELIGHT__ENGINE__ENGINE_REFERENCE && !rnd_chance(r, 20))
        s->shade.engine = RELIGHT__ENGINE__ENGINE_SPLAT; // traced: seconds
    s->shade.term = (Relight__Term)(rnd_chance(r, 3) ? rnd(r, 5) : 0);
    s->shade.material = material(r, s->material);
    if (rnd_chance(r, 6)) {
        s->shade.materials = object_materials(r, &s->objects);
        s->shade.n_materials = 1 + rnd(r, OBJECTS);
    }
    if (rnd_chance(r, 3)) s->shade.eye = vec3(r, &s->eye, -20, 20);
    if (rnd_chance(r, 10)) s->shade.max_error = real(r, 0, 1);
    if (rnd_chance(r, 4)) s->shade.budget_ms = rnd(r, 50);
    if (rnd_chance(r, 12)) {
        memcpy(s->map, world->blob[rnd(r, WORLD_BLOBS)].hash, 65);
        char **map[] = {&s->shade.albedo_map, &s->shade.normal_map, &s->shade.bump_map};
        *map[rnd(r, 3)] = s->map;
    }
    return &s->shade;
}

enum { MAX_LIGHTS = 18, CUBE = 16, CUBE_FLOATS = 18 * CUBE * CUBE };

struct lights {
    Relight__Light light[MAX_LIGHTS], *at[MAX_LIGHTS];
    Relight__Vec3 gain[MAX_LIGHTS];
    char env[MAX_LIGHTS][128];
    size_t n, payload_bytes;
    float *payload;
};

char *message_environment(struct world *world, char text[128])
{
    struct rnd *r = world->rnd;
    static const char *const plain[] = {"constant",       "constant:1,2,3", "constant:-1,0,0",
                                        "constant:1,2,3", "env:",           "../x"};
    if (rnd_chance(r, 2)) return strcpy(text, RND_PICK(r, plain));
    snprintf(text, 128, "env:%s", world->blob[rnd_chance(r, 4) ? rnd(r, WORLD_BLOBS) : 1].hash);
    return text;
}

static void lights(struct world *world, struct lights *l)
{
    struct rnd *r = world->rnd;
    unsigned n = rnd_chance(r, 20) ? rnd(r, MAX_LIGHTS + 1) : 1 + rnd(r, 2), cubes = 0;
    l->n = n;
    for (unsigned i = 0; i < n; i++) {
        Relight__Light *light = l->at[i] = &l->light[i];
        relight__light__init(light);
        if (rnd_chance(r, 5)) {
            light->cube_n = rnd_chance(r, 20) ? rnd_odd(r) : CUBE;
            cubes += light->cube_n == CUBE;
        }
        if (!light->cube_n || rnd_chance(r, 50))
            light->env = message_environment(world, l->env[i]);
        if (rnd_chance(r, 2)) light->rotate_deg = real(r, -360, 360);
        if (rnd_chance(r, 3)) light->gain = vec3(r, &l->gain[i], 0, 2);
    }
    l->payload_bytes = cubes * CUBE_FLOATS * sizeof(float);
    l->payload = cubes ? malloc(l->payload_bytes) : NULL;
    for (size_t i = 0; i < cubes * (size_t)CUBE_FLOATS; i++)
        l->payload[i] = i % 997 ? 0.5f : real(r, 0, 3);
    if (cubes && rnd_chance(r, 20)) l->payload_bytes -= 4;
}

struct picture {
    Relight__Picture picture;
    Relight__Camera camera;
    Relight__Vec3 vector[4];
};

static Relight__Picture *picture(struct rnd *r, struct picture *p)
{
    relight__picture__init(&p->picture);
    relight__camera__init(&p->camera);
    p->picture.width = rnd_chance(r, 50) ? rnd_odd(r) : 1 + rnd(r, 24);
    p->picture.height = 1 + rnd(r, 24);
    p->picture.format = (Relight__ImageFormat)rnd(r, 7);
    p->picture.quality = rnd_chance(r, 4) ? rnd(r, 120) : 0;
    p->picture.tone = (Relight__Tone)rnd(r, 4);
    p->picture.exposure_ev = real(r, -4, 4);
    p->picture.plain_background = rnd_chance(r, 2);
    if (rnd_chance(r, 4)) p->picture.background = vec3(r, &p->vector[3], 0, 1);
    p->picture.samples = rnd_chance(r, 8) ? rnd_odd(r) : 1u << rnd(r, 4);
    p->picture.no_specular = rnd_chance(r, 2);
    p->picture.transparent = rnd_chance(r, 4);
    if (rnd_chance(r, 3)) {
        p->picture.camera = &p->camera;
        p->camera.eye = vec3(r, &p->vector[0], -20, 20);
        p->camera.target = vec3(r, &p->vector[1], -2, 2);
        if (rnd_chance(r, 3)) p->camera.up = vec3(r, &p->vector[2], -1, 1);
        p->camera.fovy_deg = real(r, 0, 169);
    }
    return &p->picture;
}

// ---- frames

void message_emit(struct world *world, uint16_t type, uint64_t id,
                  const ProtobufCMessage *message, const void *payload, size_t n,
                  struct bytes *out)
{
    struct rnd *r = world->rnd;
    struct relight_frame frame = {
        .flags = 0, .type = type, .id = id, .payload_size = payload ? n : 0};
    uint8_t *head;
    size_t size;
    if (rnd_chance(r, 12)) frame.deadline_ms = 1 + rnd(r, 20);
    if (relight_frame_pack(&frame, message, 0, 0, &head, &size)) abort();
    bytes_add(out, head, size);
    if (payload) bytes_add(out, payload, n);
    free(head);
}

void message_hello(struct world *world, uint64_t id, bool good, struct bytes *out)
{
    static const uint64_t payload[] = {0, 0, 0, 0, 0, 4096, 4096, 65536, 1ull << 40, 100};
    struct rnd *r = world->rnd;
    Relight__HelloRequest in = RELIGHT__HELLO_REQUEST__INIT;
    in.client = "fuzz";
    in.version_min = !good && rnd_chance(r, 40) ? 2 : 0;
    in.version_max = !good && rnd_chance(r, 40) ? rnd_odd(r) : 1;
    in.max_payload = good ? 0 : RND_PICK(r, payload);
    EMIT(HELLO, in);
}

void message_cancel_job(struct world *world, uint64_t id, const char *job, struct bytes *out)
{
    Relight__CancelJobRequest in = RELIGHT__CANCEL_JOB_REQUEST__INIT;
    in.job = (char *)job;
    for (unsigned i = 0; i < world->n_job; i++)
        if (!strcmp(world->job[i], job)) world->cancelled[i] = true;
    EMIT(CANCEL_JOB, in);
}

void message_upload(struct world *world, uint64_t id, unsigned b, struct bytes *out)
{
    struct rnd *r = world->rnd;
    const struct blob *blob = &world->blob[b];
    Relight__PutBlobRequest in = RELIGHT__PUT_BLOB_REQUEST__INIT;
    char hash[65];
    memcpy(hash, blob->hash, 65);
    in.hash = hash;
    in.size = blob->n;
    in.name = (char *)blob->name;
    size_t from = 0, n = blob->n;
    if (rnd_chance(r, 3)) { // a chunk
        from = rnd_chance(r, 2) ? 0 : blob->n / 2;
        n = rnd_chance(r, 2) ? blob->n / 2 : rnd(r, (uint32_t)(blob->n - from + 1));
        in.offset = from;
    }
    if (rnd_chance(r, 12)) hash[rnd(r, 64)] = RND_PICK(r, ((const char[]){'0', 'f', 'G', '/'}));
    if (rnd_chance(r, 20)) in.size = rnd_bits(r) >> rnd(r, 64);
    if (rnd_chance(r, 20)) in.offset = rnd_bits(r) >> rnd(r, 64);
    if (n > blob->n - from) n = blob->n - from;
    message_emit(world, RELIGHT_TYPE_PUT_BLOB, id, &in.base, n ? blob->bytes + from : NULL, n,
                 out);
}

void message_load(struct world *world, uint64_t id, enum load_kind kind, struct bytes *out)
{
    struct rnd *r = world->rnd;
    bool preview = kind == LOAD_PREVIEW, plain = kind >= LOAD_NEW_BAKE;
    Relight__LoadRequest in = RELIGHT__LOAD_REQUEST__INIT;
    Relight__FileRef file[2] = {RELIGHT__FILE_REF__INIT, RELIGHT__FILE_REF__INIT};
    Relight__FileRef *files[2] = {&file[0], &file[1]};
    Relight__BakeSettings bake = RELIGHT__BAKE_SETTINGS__INIT;
    char text[4096], env[128];
    static char *const opaque[] = {"made up", "Cube", ""};
    file[0].name = "tiny.glb";
    file[0].blob = world->blob[!plain && rnd_chance(r, 30) ? rnd(r, WORLD_BLOBS) : 0].hash;
    file[1].name = RND_PICK(r, ((char *[]){"tiny.bin", "a/b", "../x", "tiny.glb", "a"}));
    file[1].blob = world->blob[rnd(r, WORLD_BLOBS)].hash;
    in.files = files;
    in.n_files = !plain && rnd_chance(r, 20) ? rnd(r, 3) : 1;
    if (!plain && rnd_chance(r, 40)) in.path = "../etc/passwd";
    if (rnd_chance(r, 3)) in.name = RND_PICK(r, ((char *[]){"tiny", "Zwölf", "a b", ""}));
    in.size_mm = 10;
    if (!plain && rnd_chance(r, 30)) in.mm_per_unit = real(r, 0, 2);
    in.material = !plain && rnd_chance(r, 3) ? material(r, text) : "marble";
    if (!preview || rnd_chance(r, 4)) {
        in.bake = &bake;
        bool other = kind != LOAD_SAME_BAKE;
        bake.seed = !plain && rnd_chance(r, 3) ? rnd(r, 4) : (world->last_seed += other);
        if (!plain && rnd_chance(r, 8)) bake.transport = (Relight__Transport)rnd(r, 5);
        if (!plain && rnd_chance(r, 12)) bake.cube = rnd_odd(r);
        if (!plain && rnd_chance(r, 12)) bake.env = message_environment(world, env);
    }
    struct object_materials objects;
    if (!plain && rnd_chance(r, 6)) {
        in.materials = object_materials(r, &objects);
        in.n_materials = 1 + rnd(r, OBJECTS);
    }
    if (rnd_chance(r, 10)) in.opaque = (char **)opaque, in.n_opaque = 1 + rnd(r, 3);
    in.pin = rnd_chance(r, 10);
    in.preview = preview;
    EMIT(LOAD, in);
}

void message_update_vertices(struct world *world, uint64_t id, uint64_t other,
                             struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__UpdateVerticesRequest in = RELIGHT__UPDATE_VERTICES_REQUEST__INIT;
    float vertex[MODEL_VERTICES * 6];
    in.model = (char *)world_any_model(world);
    in.first = rnd_chance(r, 16) ? rnd_odd(r) : rnd(r, MODEL_VERTICES);
    in.n = rnd(r, MODEL_VERTICES - in.first % MODEL_VERTICES + 1);
    in.has_normals = rnd_chance(r, 2);
    in.own_units = rnd_chance(r, 2);
    if (rnd_chance(r, 3)) in.if_generation = rnd(r, 4);
    size_t n = in.n * (in.has_normals ? 24u : 12u);
    for (size_t i = 0; i < n / 4; i++) vertex[i] = i % 40 ? (float)rnd(r, 10) : real(r, -4, 4);
    if (rnd_chance(r, 20)) in.n = rnd_odd(r);
    message_emit(world, RELIGHT_TYPE_UPDATE_VERTICES, id, &in.base, vertex, n, out);
}

void message_put_pose(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__PutPoseRequest in = RELIGHT__PUT_POSE_REQUEST__INIT;
    float vertex[MODEL_VERTICES * 6];
    in.model = (char *)world_any_model(world);
    in.base_pose = world_any_pose(world);
    in.first = rnd_chance(r, 16) ? rnd_odd(r) : rnd(r, MODEL_VERTICES);
    in.n = rnd(r, MODEL_VERTICES - in.first % MODEL_VERTICES + 1);
    in.has_normals = rnd_chance(r, 2);
    in.own_units = rnd_chance(r, 2);
    size_t n = in.n * (in.has_normals ? 24u : 12u);
    for (size_t i = 0; i < n / 4; i++) vertex[i] = i % 40 ? (float)rnd(r, 10) : real(r, -4, 4);
    if (rnd_chance(r, 20)) in.n = rnd_odd(r);
    Relight__FileRef file = RELIGHT__FILE_REF__INIT, *files[2] = {&file, &file};
    if (rnd_chance(r, 5)) {
        in.animation = RND_PICK(r, ((char *[]){"walk", "", "\xc3\xa4", "a"}));
        in.time_s = real(r, -1, 3);
        in.up_z = rnd_chance(r, 2);
        file.name = RND_PICK(r, ((char *[]){"tiny.glb", "../x", "a/b.gltf"}));
        file.blob = world->blob[rnd(r, WORLD_BLOBS)].hash;
        in.files = files;
        in.n_files = rnd(r, 3);
        if (rnd_chance(r, 2)) in.n = 0, n = 0, in.base_pose = "";
    }
    message_emit(world, RELIGHT_TYPE_PUT_POSE, id, &in.base, vertex, n, out);
}

void message_colors(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__ColorsRequest in = RELIGHT__COLORS_REQUEST__INIT;
    struct lights l;
    struct shade s;
    lights(world, &l);
    in.model = (char *)world_any_model(world);
    in.lights = l.at;
    in.n_lights = l.n;
    in.sum = rnd_chance(r, 2);
    if (!rnd_chance(r, 3)) in.shade = shade(world, &s);
    in.format = (Relight__ColorFormat)rnd(r, 6);
    in.most_rank = rnd_chance(r, 3) ? (uint32_t)rnd_odd(r) : 0;
    in.phases = rnd_chance(r, 2);
    in.exits = rnd_chance(r, 2);
    in.pose = world_any_pose(world);
    message_emit(world, RELIGHT_TYPE_COLORS, id, &in.base, l.payload, l.payload_bytes, out);
    free(l.payload);
}

void message_image(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__ImageRequest in = RELIGHT__IMAGE_REQUEST__INIT;
    struct lights l;
    struct shade s;
    struct picture p;
    lights(world, &l);
    in.model = (char *)world_any_model(world);
    in.lights = l.at;
    in.n_lights = l.n;
    if (!rnd_chance(r, 3)) in.shade = shade(world, &s);
    in.picture = picture(r, &p);
    in.pose = world_any_pose(world);
    message_emit(world, RELIGHT_TYPE_IMAGE, id, &in.base, l.payload, l.payload_bytes, out);
    free(l.payload);
}

struct state {
    Relight__ViewState state;
    Relight__ViewOptions options;
    char *fields[6];
    struct lights lights;
    struct shade shade;
    struct picture picture;
};

static char *const field_names[] = {
    "lights",          "lights.rotate_deg", "lights.gain",     "shade",
    "shade.material",  "shade.eye",         "picture",         "picture.camera",
    "picture.width",   "options",           "options.window",  "options.skip_equal",
    "shade.max_error", "no such field",     "options.max_fps", "pose"};

static Relight__ViewState *view_state(struct world *world, struct state *s)
{
    struct rnd *r = world->rnd;
    relight__view_state__init(&s->state);
    s->lights.n = s->lights.payload_bytes = 0;
    s->lights.payload = NULL;
    if (!rnd_chance(r, 4)) lights(world, &s->lights);
    s->state.lights = s->lights.at;
    s->state.n_lights = s->lights.n;
    if (!rnd_chance(r, 3)) s->state.shade = shade(world, &s->shade);
    // Without one a view is 800x600 pixels.
    if (!rnd_chance(r, 40)) s->state.picture = picture(r, &s->picture);
    if (rnd_chance(r, 2)) {
        relight__view_options__init(&s->options);
        s->options.color_format = (Relight__ColorFormat)rnd(r, 6);
        s->options.most_rank = rnd_chance(r, 3) ? (uint32_t)rnd_odd(r) : 0;
        s->options.phases = rnd_chance(r, 2);
        s->options.exits = rnd_chance(r, 2);
        s->options.coarse = rnd_chance(r, 2);
        s->options.max_fps = rnd_chance(r, 3) ? rnd(r, 1000) : 0;
        s->options.window = rnd_chance(r, 3) ? rnd(r, rnd_chance(r, 9) ? 300 : 8) : 0;
        s->options.window_bytes = rnd_chance(r, 3) ? rnd(r, 3000) : 0;
        s->options.frame_deadline_ms = rnd_chance(r, 3) ? rnd(r, 20) : 0;
        s->options.skip_equal = rnd_chance(r, 2);
        s->state.options = &s->options;
    }
    s->state.pose = world_any_pose(world);
    s->state.fields = s->fields;
    s->state.n_fields = rnd_chance(r, 2) ? rnd(r, 7) : 0;
    for (size_t i = 0; i < s->state.n_fields; i++) s->fields[i] = RND_PICK(r, field_names);
    return &s->state;
}

void message_view_open(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__ViewOpenRequest in = RELIGHT__VIEW_OPEN_REQUEST__INIT;
    struct state s;
    in.state = view_state(world, &s);
    in.model = (char *)world_any_model(world);
    in.colors = rnd_chance(r, 2);
    message_emit(world, RELIGHT_TYPE_VIEW_OPEN, id, &in.base, s.lights.payload,
                 s.lights.payload_bytes, out);
    free(s.lights.payload);
}

void message_view_set(struct world *world, uint64_t id, uint64_t view, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__ViewSetRequest in = RELIGHT__VIEW_SET_REQUEST__INIT;
    struct state s = {0};
    in.view = view;
    in.sequence = rnd(r, 100);
    in.shown = rnd_chance(r, 2) ? rnd(r, 8) : rnd_bits(r) >> rnd(r, 64);
    if (!rnd_chance(r, 4)) in.state = view_state(world, &s);
    message_emit(world, RELIGHT_TYPE_VIEW_SET, id, &in.base, s.lights.payload,
                 s.lights.payload_bytes, out);
    free(s.lights.payload);
}
