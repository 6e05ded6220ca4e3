// SPDX-License-Identifier: MIT
// The exchange that proto/vectors shows: hello, an upload, a load with progress, colours of an
// inline light, a picture, a view, an error, a payload in two frames.
#include "proto_vectors.h"
#include "any_fields.h"

#include <ctype.h>
#include <stdio.h>
#include <string.h>

enum { LAST = RELIGHT_FRAME_LAST, MORE = RELIGHT_FRAME_MORE, ANSWER = RELIGHT_TYPE_ANSWER };
static uint8_t colors[2 * 64], blob[100], parts[256];
static float cube[6 * 16 * 16 * 3];
static const char hash[] = "bce0aff19cf5aa6a7469a30d61d04e4376e4bbf6381052ee9e7f33925c954d52";

// Parts that several requests have.
static Relight__Light light, second, *lights[] = {&light, &second};
static Relight__Picture picture;
static Relight__LoadRequest load;
static Relight__ImageAnswer image;
static const float moved[2][2][3] = {{{1, 2, 3}, {-1, 0.5f, 0}}, {{0, 1, 0}, {1, 0, 0}}};

static unsigned add(struct vector *out, unsigned n, const char *name, const char *note,
                    uint16_t type, uint8_t flags, uint64_t id, const ProtobufCMessage *message,
                    const void *payload, uint64_t size)
{
    out[n] = (struct vector){name,
                             note,
                             {.type = type, .flags = flags, .id = id, .payload_size = size},
                             message,
                             payload};
    return n + 1;
}

unsigned vector_add(struct vector *out, unsigned n, const char *name, const char *note,
                    uint16_t type, uint8_t flags, uint64_t id, const ProtobufCMessage *message,
                    const void *payload, uint64_t size)
{
    return add(out, n, name, note, type, flags, id, message, payload, size);
}

unsigned vector_exchange(struct vector *out, unsigned n, const char *name, uint16_t type,
                         uint64_t id, const char *request_note, const ProtobufCMessage *request,
                         const char *answer_note, const ProtobufCMessage *answer)
{
    static char names[MAX_VECTOR][32];
    snprintf(names[n], sizeof names[n], "%s_answer", name);
    n = add(out, n, name, request_note, type, LAST, id, request, NULL, 0);
    return add(out, n, names[n - 1], answer_note, type | ANSWER, LAST, id, answer, NULL, 0);
}

// Three vertices in two clusters: vertices 2 and 0 with one row, vertex 1 with two.
static unsigned add_coefficients(struct vector *out, unsigned n)
{
    static Relight__FactorsRequest ask;
    static Relight__FactorsAnswer factors;
    static Relight__FactorTensor tensor, *tensors[] = {&tensor};
    static union {
        uint32_t words[64];
        int16_t u[128];
    } sections = {{2, 1, 1, 2, [16] = 2, 0, 1}};
    relight__factors_request__init(&ask);
    relight__factors_answer__init(&factors);
    relight__factor_tensor__init(&tensor);
    ask.model = "3f9ad2c1";
    n = add(out, n, "factors", "C: FACTORS", 27, LAST, 20, &ask.base, NULL, 0);
    sections.u[64] = 1 << 14, sections.u[66] = -(1 << 13);
    sections.u[96] = 1 << 12, sections.u[97] = 1 << 11;
    tensor.term = RELIGHT__TERM__TERM_MULTIPLE;
    tensor.n_cluster = 2;
    tensor.order_offset = 64;
    tensor.u_offset = 128;
    tensor.u_bytes = 128;
    factors.factors = UINT64_C(0x1122334455667788);
    factors.n_vertex = 3;
    factors.n_tensors = 1;
    factors.tensors = tensors;
    n = add(out, n, "factors_answer",
            "S: FACTORS, U/2^-20: 16384 -8192 of vertices 2 and 0, (4096 2048) of vertex 1",
            27 | ANSWER, LAST, 20, &factors.base, &sections, sizeof sections);

    static Relight__ColorsRequest request;
    static Relight__Light even, *all[] = {&even};
    static Relight__ColorsAnswer answer;
    static Relight__Coefficients coefficients;
    static Relight__CoefficientLayer layer, *layers[] = {&layer};
    static Relight__Outgoing outgoing, *outgoings[] = {&outgoing};
    static float scale = 2;
    static const uint16_t rows[9] = {0x3c00, 0x3800, 0x3400, 0x4000, 0, 0, 0, 0x4400, 0};
    relight__colors_request__init(&request);
    relight__light__init(&even);
    relight__colors_answer__init(&answer);
    relight__coefficients__init(&coefficients);
    relight__coefficient_layer__init(&layer);
    relight__outgoing__init(&outgoing);
    even.env = "constant";
    request.model = "3f9ad2c1";
    request.n_lights = 1;
    request.lights = all;
    request.format = RELIGHT__COLOR_FORMAT__COLOR_COEFFICIENTS;
    n = add(out, n, "coefficients_request", "C: COLORS, coefficients", 12, LAST, 21,
            &request.base, NULL, 0);
    layer.n_phase = 1;
    layer.n_row = 3;
    layer.n_scales = 1;
    layer.scales = &scale;
    outgoing.eta = 1.3f;
    outgoing.roughness = 0.25f;
    outgoing.mean = 0.5f;
    outgoing.divisor = 1;
    outgoing.view_slope = 0.5f;
    coefficients.factors = factors.factors;
    coefficients.n_layers = 1;
    coefficients.layers = layers;
    coefficients.n_outgoing = 1;
    coefficients.outgoing = outgoings;
    answer.n_vertex = 3;
    answer.n_plane = 1;
    answer.plane_bytes = sizeof rows;
    answer.format = RELIGHT__COLOR_FORMAT__COLOR_COEFFICIENTS;
    answer.generation = 1;
    answer.coefficients = &coefficients;
    n = add(out, n, "coefficients_answer",
            "S: COLORS: halves (1 .5 .25)(2 0 0)(0 4 0) times 2; M of vertex 2 is "
            "(2 1 .5)/64, of vertex 1 (4 0 0)/256 + (0 8 0)/512, colours half of that",
            12 | ANSWER, LAST, 21, &answer.base, rows, sizeof rows);
    // steps of 2^-7 (exponent 2) and 2^-5 (exponent 4)
    static const uint32_t packed[4] = {2u << 30 | 32 << 20 | 64 << 10 | 128, 1024u - 256,
                                       128 << 10, 1u << 30};
    static Relight__ColorsAnswer rounded;
    rounded = answer;
    rounded.plane_bytes = sizeof packed;
    rounded.format = RELIGHT__COLOR_FORMAT__COLOR_COEFFICIENTS_PACKED;
    return add(out, n, "coefficients_packed_answer",
               "S: COLORS: the same packed, but -2 in place of 2", 12 | ANSWER, LAST, 21,
               &rounded.base, packed, sizeof packed);
}

static unsigned add_hello(struct vector *out, unsigned n)
{
    static Relight__HelloRequest hello;
    relight__hello_request__init(&hello);
    hello.client = "vector 1.0";
    hello.version_min = hello.version_max = 1;
    n = add(out, n, "hello_request", "C: HELLO", 1, LAST, 1, &hello.base, NULL, 0);

    static Relight__HelloAnswer welcome;
    static char *presets[] = {"marble", "skin1"};
    relight__hello_answer__init(&welcome);
    welcome.server = "relightd 0.1.0";
    welcome.version = 1;
    welcome.max_payload = 1 << 24;
    welcome.max_header = 1 << 16;
    welcome.max_in_flight = 64;
    welcome.max_blob = UINT64_C(1) << 32;
    welcome.presets = presets;
    welcome.n_presets = 2;
    welcome.chunk = 1 << 20;
    static char *features[] = {"events", "goaway"};
    welcome.run = "09f3c2d1a5b60718";
    welcome.features = features;
    welcome.n_features = 2;
    welcome.max_lights = 16;
    welcome.max_side = 4096;
    welcome.max_ping = 1 << 16;
    welcome.max_window = 256;
    welcome.max_answer_header = 1 << 24;
    welcome.handshake_ms = 5000;
    welcome.frame_time_ms = 30000;
    welcome.write_time_ms = 10000;
    welcome.idle_ms = 600000;
    welcome.deadline_ms = 120000;
    n = add(out, n, "hello_answer", "S: HELLO", 1 | ANSWER, LAST, 1, &welcome.base, NULL, 0);

    static Relight__PingRequest ping;
    relight__ping_request__init(&ping);
    n = add(out, n, "ping_request", "C: PING, no header bytes, 4 payload bytes", 2, LAST, 2,
            &ping.base, blob, 4);
    return n;
}

static unsigned add_upload(struct vector *out, unsigned n)
{
    static Relight__PutBlobRequest ask, put;
    relight__put_blob_request__init(&ask);
    ask.hash = (char *)(uintptr_t)hash;
    ask.size = sizeof blob;
    ask.name = "sky.hdr";
    put = ask;
    n = add(out, n, "put_blob_ask", "C: PUT_BLOB, is it there?", 4, LAST, 3, &ask.base, NULL,
            0);
    static Relight__PutBlobAnswer missing, there;
    relight__put_blob_answer__init(&missing);
    there = missing;
    n = add(out, n, "put_blob_missing", "S: PUT_BLOB, no (an empty header)", 4 | ANSWER, LAST,
            3, &missing.base, NULL, 0);
    n = add(out, n, "put_blob_chunk", "C: PUT_BLOB, all 100 bytes: 0,1,2,...", 4, LAST, 4,
            &put.base, blob, sizeof blob);
    there.complete = 1;
    there.received = sizeof blob;
    n = add(out, n, "put_blob_complete", "S: PUT_BLOB, complete", 4 | ANSWER, LAST, 4,
            &there.base, NULL, 0);
    return n;
}

static unsigned add_load(struct vector *out, unsigned n)
{
    static Relight__FileRef file, *files[] = {&file};
    static Relight__BakeSettings bake;
    relight__load_request__init(&load);
    relight__file_ref__init(&file);
    relight__bake_settings__init(&bake);
    file.name = "bunny.obj";
    file.blob = (char *)(uintptr_t)hash;
    load.n_files = 1;
    load.files = files;
    load.size_mm = 50;
    load.material = "marble";
    bake.transport = RELIGHT__TRANSPORT__TRANSPORT_WAVELET;
    bake.samples = 150000;
    load.bake = &bake;
    n = add(out, n, "load_request", "C: LOAD", 6, LAST, 5, &load.base, NULL, 0);
    static Relight__LoadAnswer loaded;
    relight__load_answer__init(&loaded);
    loaded.model = "3f9ad2c1";
    loaded.state = RELIGHT__MODEL_STATE__MODEL_BAKING;
    loaded.job = "12";
    n = add(out, n, "load_answer", "S: LOAD", 6 | ANSWER, LAST, 5, &loaded.base, NULL, 0);

    static Relight__WatchRequest watch;
    static Relight__Progress half, done;
    relight__watch_request__init(&watch);
    watch.job = "12";
    n = add(out, n, "watch_request", "C: WATCH", 7, LAST, 6, &watch.base, NULL, 0);
    relight__progress__init(&half);
    half.job = "12";
    half.model = "3f9ad2c1";
    half.state = RELIGHT__JOB_STATE__JOB_RUNNING;
    half.stage = "irradiance";
    half.fraction = 0.5f;
    half.eta_s = 60;
    half.elapsed_s = 60;
    n = add(out, n, "watch_progress", "S: WATCH, half done: LAST is not set", 7 | ANSWER, 0, 6,
            &half.base, NULL, 0);
    done = half;
    done.state = RELIGHT__JOB_STATE__JOB_DONE;
    done.fraction = 1;
    done.eta_s = 0;
    done.elapsed_s = 120;
    n = add(out, n, "watch_done", "S: WATCH, done: LAST", 7 | ANSWER, LAST, 6, &done.base, NULL,
            0);
    return n;
}

static unsigned add_colors(struct vector *out, unsigned n)
{
    static Relight__ColorsRequest ask_colors;
    static Relight__Vec3 gain;
    static Relight__Shade shade;
    static char env[80];
    relight__colors_request__init(&ask_colors);
    relight__light__init(&light);
    relight__light__init(&second);
    relight__vec3__init(&gain);
    relight__shade__init(&shade);
    gain.x = 1, gain.y = 0.5f, gain.z = 0.25f;
    strcpy(env, "env:");
    strcat(env, hash);
    light.env = env;
    light.rotate_deg = 90;
    light.gain = &gain;
    second.cube_n = 16;
    ask_colors.model = "3f9ad2c1";
    ask_colors.n_lights = 2;
    ask_colors.lights = lights;
    shade.term = RELIGHT__TERM__TERM_MULTIPLE;
    ask_colors.shade = &shade;
    ask_colors.format = RELIGHT__COLOR_FORMAT__COLOR_RGB9E5;
    n = add(out, n, "colors_request",
            "C: COLORS, deadline 500 ms, an image and a cube of 16: texel "
            "float i is (i mod 7) / 4",
            12, LAST, 7, &ask_colors.base, cube, sizeof cube);
    out[n - 1].frame.deadline_ms = 500;
    out[n - 1].payload = (const uint8_t *)cube;
    static Relight__ColorsAnswer answer;
    static Relight__Cost cost;
    relight__colors_answer__init(&answer);
    relight__cost__init(&cost);
    answer.n_vertex = 3;
    answer.n_plane = 2;
    answer.plane_bytes = 64;
    answer.format = RELIGHT__COLOR_FORMAT__COLOR_RGB9E5;
    cost.relight_ms = 0.25f;
    cost.total_ms = 0.5f;
    cost.error_bound = 0.0078125f;
    cost.engine = RELIGHT__ENGINE__ENGINE_WAVELET;
    answer.cost = &cost;
    // (1, 0.5, 0.25), (0, 0, 0), (65408, 0, 1/65536 is lost): exponent is shared.
    static const uint8_t rgb9e5[12] = {0x00, 0x01, 0x01, 0x81, 0,    0,
                                       0,    0,    0xff, 0x01, 0x00, 0xf8};
    memcpy(colors, rgb9e5, sizeof rgb9e5);
    memcpy(colors + 64, rgb9e5, sizeof rgb9e5);
    n = add(out, n, "colors_answer",
            "S: COLORS, 2 planes of 3 vertices: (1,.5,.25) (0,0,0) "
            "(65408,0,0)",
            12 | ANSWER, LAST, 7, &answer.base, colors, sizeof colors);
    return n;
}

static unsigned add_cancel(struct vector *out, unsigned n)
{
    static Relight__CancelRequest cancel;
    relight__cancel_request__init(&cancel);
    cancel.id = 8;
    n = add(out, n, "cancel_request", "C: CANCEL of request 8", 9, LAST, 9, &cancel.base, NULL,
            0);
    static Relight__Error error;
    relight__error__init(&error);
    error.code = RELIGHT__ERROR_CODE__ERROR_CANCELLED;
    error.text = "request 8 was cancelled";
    n = add(out, n, "error", "S: ERROR for request 8", RELIGHT_TYPE_ERROR, LAST, 8, &error.base,
            NULL, 0);
    return n;
}

static unsigned add_view(struct vector *out, unsigned n)
{
    static Relight__ViewOpenRequest open;
    static Relight__ViewState state;
    relight__view_open_request__init(&open);
    relight__view_state__init(&state);
    relight__picture__init(&picture);
    picture.width = 640;
    picture.height = 360;
    state.picture = &picture;
    state.n_lights = 1;
    state.lights = lights;
    open.model = "3f9ad2c1";
    open.state = &state;
    n = add(out, n, "view_open", "C: VIEW_OPEN", 14, LAST, 10, &open.base, NULL, 0);
    static Relight__ViewSetRequest set;
    static Relight__ViewState material;
    static Relight__Shade skin;
    relight__view_set_request__init(&set);
    relight__view_state__init(&material);
    relight__shade__init(&skin);
    skin.material = "skin1";
    material.shade = &skin;
    set.view = 10;
    set.sequence = 1;
    set.state = &material;
    n = add(out, n, "view_set", "C: VIEW_SET, another material", 15, LAST, 11, &set.base, NULL,
            0);
    static Relight__ViewFrame frame;
    relight__view_frame__init(&frame);
    relight__image_answer__init(&image);
    image.width = 640;
    image.height = 360;
    frame.frame = 1;
    frame.sequence = 1;
    frame.image = &image;
    n = add(out, n, "view_frame_more",
            "S: ViewFrame, first 256 payload bytes: 255,254,...: MORE", 14 | ANSWER, MORE, 10,
            &frame.base, parts, sizeof parts);
    n = add(out, n, "view_frame_rest",
            "S: the other 100 payload bytes of that frame: no header", 14 | ANSWER, 0, 10, NULL,
            blob, sizeof blob);
    return n;
}

static unsigned add_preview(struct vector *out, unsigned n)
{
    static Relight__LoadRequest instant;
    static Relight__LoadAnswer seen;
    instant = load;
    instant.preview = 1;
    instant.bake = NULL;
    n = add(out, n, "load_preview", "C: LOAD without a bake", 6, LAST, 12, &instant.base, NULL,
            0);
    relight__load_answer__init(&seen);
    seen.model = "3f9ad2c1";
    seen.state = RELIGHT__MODEL_STATE__MODEL_PREVIEW;
    n = add(out, n, "load_preview_answer", "S: LOAD, no job", 6 | ANSWER, LAST, 12, &seen.base,
            NULL, 0);
    static Relight__ImageRequest ask_image;
    static Relight__Shade hurry;
    relight__image_request__init(&ask_image);
    relight__shade__init(&hurry);
    hurry.engine = RELIGHT__ENGINE__ENGINE_SPLAT;
    hurry.budget_ms = 40;
    ask_image.model = "3f9ad2c1";
    ask_image.n_lights = 1;
    ask_image.lights = lights;
    ask_image.shade = &hurry;
    ask_image.picture = &picture;
    n = add(out, n, "image_request", "C: IMAGE by splats in 40 ms", 13, LAST, 13,
            &ask_image.base, NULL, 0);
    static Relight__ImageAnswer drawn;
    static Relight__Cost spent;
    relight__cost__init(&spent);
    spent.relight_ms = 30;
    spent.total_ms = 38.5f;
    spent.error_bound = 0.03125f;
    spent.engine = RELIGHT__ENGINE__ENGINE_SPLAT;
    spent.note = "preview: the bake is at 40 %";
    spent.samples = 165;
    spent.frames = 1;
    drawn = image;
    drawn.generation = 1;
    drawn.cost = &spent;
    n = add(out, n, "image_answer", "S: IMAGE, 256 payload bytes in place of a picture's",
            13 | ANSWER, LAST, 13, &drawn.base, parts, sizeof parts);
    return n;
}

static unsigned add_materials(struct vector *out, unsigned n)
{
    static Relight__ColorsRequest ask_parts;
    static Relight__Shade two_media;
    static Relight__ObjectMaterial wax, *by_object[] = {&wax};
    relight__colors_request__init(&ask_parts);
    relight__shade__init(&two_media);
    relight__object_material__init(&wax);
    wax.object = "wax";
    wax.material = "marble";
    two_media.material = "ketchup";
    two_media.n_materials = 1;
    two_media.materials = by_object;
    ask_parts.model = "3f9ad2c1";
    ask_parts.n_lights = 1;
    ask_parts.lights = lights;
    ask_parts.shade = &two_media;
    n = add(out, n, "colors_materials",
            "C: COLORS, wax is marble and all other objects are ketchup", 12, LAST, 22,
            &ask_parts.base, NULL, 0);
    return n;
}

static unsigned add_vertices(struct vector *out, unsigned n)
{
    static Relight__UpdateVerticesRequest update;
    static Relight__UpdateVerticesAnswer updated;
    relight__update_vertices_request__init(&update);
    relight__update_vertices_answer__init(&updated);
    update.model = "3f9ad2c1";
    update.first = 7;
    update.n = 2;
    update.has_normals = 1;
    n = add(out, n, "update_vertices",
            "C: UPDATE_VERTICES 7 and 8 to (1,2,3) (-1,.5,0) mm, normals "
            "+y +x",
            17, LAST, 14, &update.base, moved, sizeof moved);
    updated.generation = 2;
    n = add(out, n, "update_vertices_answer", "S: UPDATE_VERTICES", 17 | ANSWER, LAST, 14,
            &updated.base, NULL, 0);
    return n;
}

static unsigned add_view_fields(struct vector *out, unsigned n)
{
    static Relight__ViewSetRequest slide;
    static Relight__ViewState slid;
    static Relight__ViewAck ack;
    static char *slid_fields[] = {"lights.rotate_deg", "shade.material"};
    static Relight__Light turned, *turned_lights[] = {&turned};
    relight__view_set_request__init(&slide);
    relight__view_state__init(&slid);
    relight__light__init(&turned);
    relight__view_ack__init(&ack);
    turned.rotate_deg = 30;
    slid.n_lights = 1;
    slid.lights = turned_lights;
    slid.n_fields = 2;
    slid.fields = slid_fields;
    slide.view = 10;
    slide.sequence = 2;
    slide.state = &slid;
    n = add(out, n, "view_set_fields", "C: VIEW_SET, a light turned, the model's own material",
            15, LAST, 16, &slide.base, NULL, 0);
    ack.view = 10;
    ack.shown = 1;
    n = add(out, n, "view_ack", "C: VIEW_ACK of frame 1, one-way: id 0, no answer", 24, LAST, 0,
            &ack.base, NULL, 0);
    return n;
}

static unsigned add_pose(struct vector *out, unsigned n)
{
    static Relight__PutPoseRequest pose;
    static Relight__PutPoseAnswer posed;
    static Relight__GeometryRequest shape;
    relight__put_pose_request__init(&pose);
    relight__put_pose_answer__init(&posed);
    relight__geometry_request__init(&shape);
    pose.model = "3f9ad2c1";
    pose.first = 7;
    pose.n = 2;
    pose.has_normals = 1;
    n = add(out, n, "put_pose", "C: PUT_POSE, as UPDATE_VERTICES above", 26, LAST, 17,
            &pose.base, moved, sizeof moved);
    posed.pose = (char *)(uintptr_t)hash;
    posed.generation = UINT64_C(0x100000001);
    n = add(out, n, "put_pose_answer", "S: PUT_POSE", 26 | ANSWER, LAST, 17, &posed.base, NULL,
            0);
    static Relight__PutPoseRequest moment;
    static Relight__FileRef walker, *walkers[] = {&walker};
    relight__put_pose_request__init(&moment);
    relight__file_ref__init(&walker);
    walker.name = "walker.glb";
    walker.blob = (char *)(uintptr_t)hash;
    moment.model = "3f9ad2c1";
    moment.animation = "walk";
    moment.time_s = 0.5f;
    moment.n_files = 1;
    moment.files = walkers;
    n = add(out, n, "put_pose_animation", "C: PUT_POSE, half a second into an animation", 26,
            LAST, 23, &moment.base, NULL, 0);
    shape.model = "3f9ad2c1";
    shape.pose = (char *)(uintptr_t)hash;
    n = add(out, n, "geometry_of_pose", "C: GEOMETRY of that pose", 11, LAST, 18, &shape.base,
            NULL, 0);
    return n;
}

static unsigned add_download(struct vector *out, unsigned n)
{
    static Relight__GetBlobRequest get;
    static Relight__GetBlobAnswer got;
    relight__get_blob_request__init(&get);
    relight__get_blob_answer__init(&got);
    get.hash = (char *)(uintptr_t)hash;
    get.offset = 90;
    n = add(out, n, "get_blob", "C: GET_BLOB from byte 90 on", 25, LAST, 19, &get.base, NULL,
            0);
    got.size = sizeof blob;
    got.name = "sky.hdr";
    n = add(out, n, "get_blob_answer", "S: GET_BLOB, the last ten bytes", 25 | ANSWER, LAST, 19,
            &got.base, blob + 90, 10);
    return n;
}

static unsigned add_endings(struct vector *out, unsigned n)
{
    static Relight__Error range;
    relight__error__init(&range);
    range.code = RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
    range.text = "sigma_a[0] is -1, allowed range 0 to 1000 mm^-1";
    range.parameter = "sigma_a[0]";
    range.has_range = 1;
    range.maximum = 1000;
    range.unit = "mm^-1";
    n = add(out, n, "error_range", "S: ERROR with a parameter and its range",
            RELIGHT_TYPE_ERROR, LAST, 7, &range.base, NULL, 0);
    static Relight__Goaway goaway;
    relight__goaway__init(&goaway);
    goaway.drain_ms = 10000;
    goaway.address = "tcp:192.0.2.7:7413";
    goaway.text = "the daemon is stopping";
    n = add(out, n, "goaway", "S: GOAWAY, unasked", RELIGHT_TYPE_GOAWAY, LAST, 0, &goaway.base,
            NULL, 0);
    return n;
}

static bool has_vector(const struct vector *out, unsigned n, uint16_t type)
{
    for (unsigned i = 0; i < n; i++)
        if (out[i].frame.type == type) return true;
    return false;
}

// Types that no function here describes: their request and answer with any fields. They live as
// long as the program.
static unsigned add_rest(struct vector *out, unsigned n)
{
    for (size_t i = 0; i < N_REQUEST_TYPE; i++) {
        const uint16_t type = request_types[i].type;
        struct rnd rnd;
        if (has_vector(out, n, type)) continue;
        rnd_seed(&rnd, type);
        const ProtobufCMessage *request = any_fields(&rnd, relight_type_message(type)),
                               *answer =
                                   request_types[i].answered
                                       ? any_fields(&rnd, relight_type_message(type | ANSWER))
                                       : NULL;
        char *name = strdup(relight_type_name(type));
        for (char *c = name; *c; c++) *c = (char)tolower(*c);
        if (answer)
            n = vector_exchange(out, n, name, type, 1000u + type, "C: any fields", request,
                                "S: any fields", answer);
        else n = add(out, n, name, "C: any fields, one-way", type, LAST, 0, request, NULL, 0);
    }
    return n;
}

unsigned vectors_make(struct vector out[MAX_VECTOR])
{
    for (unsigned i = 0; i < sizeof blob; i++) blob[i] = (uint8_t)i;
    for (unsigned i = 0; i < sizeof parts; i++) parts[i] = (uint8_t)(255 - i);
    for (unsigned i = 0; i < sizeof cube / sizeof *cube; i++) cube[i] = (float)(i % 7) * 0.25f;
    unsigned n = 0;
    n = add_hello(out, n);
    n = add_upload(out, n);
    n = add_load(out, n);
    n = add_colors(out, n);
    n = add_cancel(out, n);
    n = add_view(out, n);
    n = add_preview(out, n);
    n = add_materials(out, n);
    n = add_vertices(out, n);
    n = add_view_fields(out, n);
    n = add_pose(out, n);
    n = add_download(out, n);
    n = add_endings(out, n);
    n = vectors_add_access(out, n);
    n = add_coefficients(out, n);
    n = vectors_add_link(out, n);
    n = vectors_add_viewers(out, n);
    n = vectors_add_rooms(out, n);
    return add_rest(out, n);
}
