// SPDX-License-Identifier: MIT
// Views: fields that change alone, lights that go, acknowledgements without an answer, the
// window in bytes, equal frames, deadlines and rate of frames.
#include "frames.h"

#include <math.h>

enum { F32_BYTES = OCTAHEDRON_VERTICES * 12 };

static const char milk[] =
    "{\"sigma_s_prime\":[2,2,3],\"sigma_a\":[0.01,0.02,0.05],\"eta\":1.3}";
static struct daemon d;
static struct relight_client *client;
static char model[ID_SIZE]; // joint: any material
static struct frames *f;
static uint64_t last_id = 100;

// One daemon and one bake for all tests, a connection for each.
static int group_begin(void **state)
{
    setenv("MALLOC_PERTURB_", "165", 1);
    daemon_folder(&d);
    daemon_start(&d, NULL);
    client = client_open(d.address);
    struct relight_load load = small_bake(0, 200);
    load.material = NULL;
    bake_octahedron(client, &d, "joint.obj", &load, model);
    return 0;
}

static int group_end(void **state)
{
    relight_close(client);
    int status = daemon_end(&d);
    daemon_remove(&d);
    return status;
}

static int begin(void **state)
{
    f = frames_open(&d);
    return 0;
}

static int end(void **state)
{
    if (f) frames_close(f);
    f = NULL;
    return 0;
}

// A state with its parts, in one place.
struct put {
    Relight__ViewState state;
    Relight__Light light, *lights[1];
    Relight__Vec3 gain;
    Relight__Shade shade;
    Relight__ViewOptions options;
    Relight__Picture picture;
    Relight__Camera camera;
    Relight__Vec3 eye, target, up;
};

static void put_init(struct put *p)
{
    relight__view_state__init(&p->state);
    relight__light__init(&p->light);
    relight__vec3__init(&p->gain);
    relight__shade__init(&p->shade);
    relight__view_options__init(&p->options);
    p->lights[0] = &p->light;
    p->state.lights = p->lights;
}

static uint64_t open_view(struct put *p)
{
    Relight__ViewOpenRequest m = RELIGHT__VIEW_OPEN_REQUEST__INIT;
    m.model = model;
    m.colors = !p->state.picture;
    m.state = &p->state;
    frames_add(f, RELIGHT_TYPE_VIEW_OPEN, ++last_id, &m.base, NULL, 0);
    frames_send(f);
    return last_id;
}

static uint64_t set_shown(uint64_t view, uint64_t sequence, uint64_t shown, struct put *p,
                          char **fields, size_t n)
{
    Relight__ViewSetRequest m = RELIGHT__VIEW_SET_REQUEST__INIT;
    m.view = view;
    m.sequence = sequence;
    m.shown = shown;
    m.state = &p->state;
    p->state.fields = fields;
    p->state.n_fields = n;
    frames_add(f, RELIGHT_TYPE_VIEW_SET, ++last_id, &m.base, NULL, 0);
    frames_send(f);
    return last_id;
}

static uint64_t set(uint64_t view, uint64_t sequence, struct put *p, char **fields, size_t n)
{
    return set_shown(view, sequence, 0, p, fields, n);
}

static int code_of(uint64_t id)
{
    return frames_wait(f, id).code;
}

static void acknowledge(uint64_t view, uint64_t shown)
{
    Relight__ViewAck m = RELIGHT__VIEW_ACK__INIT;
    m.view = view;
    m.shown = shown;
    frames_add(f, RELIGHT_TYPE_VIEW_ACK, 0, &m.base, NULL, 0);
    frames_send(f);
}

struct seen {
    uint64_t frame, sequence, hash, n;
    bool equal;
    int code;
    float value[OCTAHEDRON_VERTICES * 3];
};

// The next frame of the view; false when none comes in time.
static bool next_frame(uint64_t view, struct seen *out, int ms)
{
    struct frames_answer a;
    ProtobufCMessage *m = NULL;
    for (;;) {
        if (!frames_next(f, &a, ms, &m)) return false;
        assert_false(a.closed);
        if (a.type == RELIGHT_TYPE_ERROR) fail_msg("%d %s", a.code, a.text);
        if (a.id == view) break;
        protobuf_c_message_free_unpacked(m, NULL);
    }
    Relight__ViewFrame *frame = (Relight__ViewFrame *)m;
    *out = (struct seen){.frame = frame->frame,
                         .sequence = frame->sequence,
                         .hash = frame->hash,
                         .equal = frame->equal,
                         .n = a.payload,
                         .code = frame->error ? (int)frame->error->code : 0};
    if (a.payload == F32_BYTES) memcpy(out->value, f->decoder.frame.payload, F32_BYTES);
    protobuf_c_message_free_unpacked(m, NULL);
    return true;
}

static struct seen frame_of(uint64_t view, uint64_t sequence)
{
    struct seen seen;
    do {
        if (!next_frame(view, &seen, 20000)) fail_msg("no frame of state %d", (int)sequence);
        acknowledge(view, seen.frame);
    } while (seen.sequence < sequence);
    return seen;
}

// What COLORS answers.
static void expect_colors(const struct seen *seen, const char *env, float gain,
                          const char *material, enum relight_term term)
{
    struct relight_light light = {.env = env, .gain = {gain, gain, gain}};
    struct relight_colors_request request = {
        .model = model, .n_light = 1, .lights = &light, .sum = true};
    struct relight_colors colors;
    struct relight_error error;
    request.shade.material = material;
    request.shade.term = term;
    OK(relight_colors(client, &request, &colors, &error));
    const float *want = colors.data;
    assert_int_equal(seen->n, F32_BYTES);
    for (int i = 0; i < OCTAHEDRON_VERTICES * 3; i++)
        if (!(fabsf(seen->value[i] - want[i]) <= 1e-4f * (1 + want[i])))
            fail_msg("value %d: %g, COLORS answers %g", i, (double)seen->value[i],
                     (double)want[i]);
    relight_colors_finish(&colors);
}

static void fields_change_alone(void **state)
{
    struct put p;
    put_init(&p);
    p.state.n_lights = 1;
    p.light.env = "constant:1,2,3";
    p.state.shade = &p.shade;
    p.shade.material = (char *)milk;
    uint64_t view = open_view(&p);
    struct seen seen = frame_of(view, 0);
    expect_colors(&seen, "constant:1,2,3", 1, milk, RELIGHT_TERM_TOTAL);

    put_init(&p);
    p.state.shade = &p.shade;
    p.shade.term = RELIGHT__TERM__TERM_MULTIPLE; // the material stays
    set(view, 1, &p, (char *[]){"shade.term"}, 1);
    seen = frame_of(view, 1);
    expect_colors(&seen, "constant:1,2,3", 1, milk, RELIGHT_TERM_MULTIPLE);

    put_init(&p); // the environment stays
    p.state.n_lights = 1;
    p.gain.x = p.gain.y = p.gain.z = 2;
    p.light.gain = &p.gain;
    set(view, 2, &p, (char *[]){"lights.gain"}, 1);
    seen = frame_of(view, 2);
    expect_colors(&seen, "constant:1,2,3", 2, milk, RELIGHT_TERM_MULTIPLE);

    put_init(&p); // the material goes back to the model's, the term stays
    set(view, 3, &p, (char *[]){"shade.material"}, 1);
    seen = frame_of(view, 3);
    expect_colors(&seen, "constant:1,2,3", 2, NULL, RELIGHT_TERM_MULTIPLE);

    put_init(&p);
    p.state.options = &p.options;
    p.options.color_format = RELIGHT__COLOR_FORMAT__COLOR_RGB9E5;
    set(view, 4, &p, (char *[]){"options.color_format"}, 1);
    assert_int_equal(frame_of(view, 4).n, OCTAHEDRON_VERTICES * 4);
    set(view, 5, &p, (char *[]){"shade", "options"}, 2); // all of shade, all of options
    seen = frame_of(view, 5);
    assert_int_equal(seen.n, OCTAHEDRON_VERTICES * 4);

    // Lights can go: this bake needs one.
    put_init(&p);
    set(view, 6, &p, (char *[]){"lights"}, 1);
    assert_int_equal(frame_of(view, 6).code, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE);
    p.state.n_lights = 1;
    p.light.env = "constant";
    p.state.options = &p.options;
    set(view, 7, &p, NULL, 0);
    seen = frame_of(view, 7);
    assert_int_equal(seen.code, 0);
}

static void states_that_are_refused(void **state)
{
    enum {
        BAD = RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
        RANGE = RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE
    };
    struct put p;
    put_init(&p);
    p.state.n_lights = 1;
    p.light.env = "constant:1,2,3";
    uint64_t view = open_view(&p);
    struct seen before = frame_of(view, 0);
    char *many[65];
    for (int i = 0; i < 65; i++) many[i] = "shade";
    assert_int_equal(code_of(set(view, 1, &p, (char *[]){"shade.colour"}, 1)), BAD);
    assert_int_equal(code_of(set(view, 1, &p, (char *[]){"picture.camera.eye"}, 1)), BAD);
    assert_int_equal(code_of(set(view, 1, &p, (char *[]){""}, 1)), BAD);
    assert_int_equal(code_of(set(view, 1, &p, many, 65)), RANGE);
    p.state.n_lights = 0; // the view has one
    assert_int_equal(code_of(set(view, 1, &p, (char *[]){"lights.gain"}, 1)), BAD);
    p.state.n_lights = 1;
    p.light.rotate_deg = 1e9f;
    assert_int_equal(code_of(set(view, 1, &p, (char *[]){"lights.rotate_deg"}, 1)), RANGE);
    p.state.options = &p.options;
    p.options.window = 257;
    assert_int_equal(code_of(set(view, 1, &p, (char *[]){"options"}, 1)), RANGE);
    p.options.window = 0;
    p.options.color_format = 77;
    assert_int_equal(code_of(set(view, 1, &p, (char *[]){"options"}, 1)),
                     RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED);
    // Texels beside fields that do not name the lights.
    static const float texels[72 * 16 * 16 / 4];
    Relight__ViewSetRequest m = RELIGHT__VIEW_SET_REQUEST__INIT;
    put_init(&p);
    m.view = view;
    m.state = &p.state;
    p.state.fields = (char *[]){"shade.engine"};
    p.state.n_fields = 1;
    frames_add(f, RELIGHT_TYPE_VIEW_SET, ++last_id, &m.base, texels, sizeof texels);
    frames_send(f);
    assert_int_equal(code_of(last_id), BAD);
    // None of them changed anything.
    put_init(&p);
    set(view, 2, &p, NULL, 0);
    struct seen after = frame_of(view, 2);
    assert_memory_equal(before.value, after.value, sizeof after.value);
    assert_int_equal(before.hash, after.hash);
}

// A picture of 32 x 32 pixels in this format, with the background left out or not.
static void put_picture(struct put *p, Relight__ImageFormat format, bool transparent)
{
    put_init(p);
    relight__picture__init(&p->picture);
    p->state.picture = &p->picture;
    p->picture.width = p->picture.height = 32;
    p->picture.format = format;
    p->picture.transparent = transparent;
}

// Alpha needs a format that has it: what counts is the state that follows from the fields, not
// the values beside them.
static void alpha_by_name(void **state)
{
    const int no = RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED;
    const Relight__ImageFormat jpeg = RELIGHT__IMAGE_FORMAT__IMAGE_JPEG,
                               png = RELIGHT__IMAGE_FORMAT__IMAGE_PNG;
    char *const transparent = "picture.transparent", *const format = "picture.format";
    struct put p;
    put_picture(&p, png, true);
    p.state.n_lights = 1;
    p.light.env = "constant:1,2,3";
    uint64_t straight = open_view(&p);
    const struct seen want = frame_of(straight, 0);
    p.picture.transparent = false;
    uint64_t view = open_view(&p);
    const struct seen opaque = frame_of(view, 0);
    assert_true(want.hash && opaque.hash && want.hash != opaque.hash);
    // The view has a format with alpha.
    put_picture(&p, jpeg, true);
    assert_int_equal(code_of(set(view, 1, &p, (char *[]){transparent}, 1)), 0);
    assert_int_equal(frame_of(view, 1).hash, want.hash);
    // And has none afterwards.
    assert_int_equal(code_of(set(straight, 1, &p, (char *[]){format, transparent}, 2)), no);
    p.picture.transparent = false;
    assert_int_equal(code_of(set(straight, 1, &p, (char *[]){format}, 1)), no);
    set(straight, 1, &p, (char *[]){"options"}, 1); // nothing of it was taken
    assert_int_equal(frame_of(straight, 1).hash, want.hash);
    assert_int_equal(code_of(set(view, 2, &p, (char *[]){format, transparent}, 2)), 0);
    assert_int_equal(frame_of(view, 2).code, 0);
    p.picture.transparent = true;
    assert_int_equal(code_of(set(view, 3, &p, (char *[]){transparent}, 1)), no);
    assert_int_equal(code_of(set(view, 3, &p, NULL, 0)), no);
}

// A view with a window of one whose second state waits for the acknowledgement of its frame.
static uint64_t open_waiting_view(struct put *p)
{
    struct seen seen;
    put_init(p);
    p->state.n_lights = 1;
    p->light.env = "constant:1,2,3";
    p->state.options = &p->options;
    p->options.window = 1;
    uint64_t view = open_view(p);
    assert_true(next_frame(view, &seen, 20000));
    p->light.env = "constant:3,2,1";
    set(view, 1, p, NULL, 0);
    assert_false(next_frame(view, &seen, 300));
    return view;
}

static void acknowledged_without_an_answer(void **state)
{
    struct put p;
    struct seen seen;
    uint64_t view = open_waiting_view(&p);
    // Those that name no frame of this view change nothing, and nothing is answered.
    acknowledge(view + 1, 1);
    acknowledge(0, UINT64_MAX);
    Relight__ViewAck m = RELIGHT__VIEW_ACK__INIT;
    frames_add(f, RELIGHT_TYPE_VIEW_ACK, 7, &m.base, NULL, 0);
    frames_add_raw(f, RELIGHT_TYPE_VIEW_ACK, 0, "\xff\xff\xff", 3);
    Relight__PingRequest ping = RELIGHT__PING_REQUEST__INIT;
    frames_add(f, RELIGHT_TYPE_PING, 9, &ping.base, NULL, 0);
    frames_send(f);
    struct frames_answer a;
    assert_true(frames_next(f, &a, 20000, NULL));
    assert_int_equal(a.id, 9);
    acknowledge(view, 1);
    assert_true(next_frame(view, &seen, 20000));
    assert_int_equal(seen.sequence, 1);
    assert_int_equal(seen.frame, 2);
    // More than were sent counts as all that were sent.
    set(view, 2, &p, NULL, 0);
    acknowledge(view, UINT64_MAX);
    assert_true(next_frame(view, &seen, 20000));
    set(view, 3, &p, NULL, 0);
    assert_false(next_frame(view, &seen, 300));
}

// The frame was received, whatever becomes of the state that came with its number.
static void acknowledged_by_a_refused_state(void **state)
{
    struct put p;
    struct seen seen;
    uint64_t view = open_waiting_view(&p);
    assert_int_equal(code_of(set_shown(view, 2, 1, &p, (char *[]){"shade.colour"}, 1)),
                     RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
    assert_true(next_frame(view, &seen, 20000));
    assert_int_equal(seen.frame, 2);
    assert_int_equal(seen.sequence, 1);
    expect_colors(&seen, "constant:3,2,1", 1, NULL, RELIGHT_TERM_TOTAL);
}

static void window_in_bytes(void **state)
{
    struct put p;
    put_init(&p);
    p.state.n_lights = 1;
    p.light.env = "constant:1,2,3";
    p.state.options = &p.options;
    p.options.window = 100;
    p.options.window_bytes = 2 * F32_BYTES + 1;
    uint64_t view = open_view(&p), sequence = 0;
    struct seen seen;
    for (int n = 1; n <= 3; n++) { // three frames are the first to take as much
        assert_true(next_frame(view, &seen, 20000));
        assert_int_equal(seen.frame, n);
        set(view, ++sequence, &p, NULL, 0);
    }
    assert_false(next_frame(view, &seen, 300));
    acknowledge(view, 1);
    assert_true(next_frame(view, &seen, 20000));
    set(view, ++sequence, &p, NULL, 0);
    assert_false(next_frame(view, &seen, 300));
    acknowledge(view, 4);
    assert_int_equal(frame_of(view, sequence).frame, 5);
    // The field alone: from here one frame is as much as the window takes.
    p.options.window_bytes = 1;
    set(view, ++sequence, &p, (char *[]){"options.window_bytes"}, 1);
    assert_true(next_frame(view, &seen, 20000));
    assert_int_equal(seen.frame, 6);
    set(view, ++sequence, &p, (char *[]){"lights"}, 1);
    assert_false(next_frame(view, &seen, 300));
}

static void equal_frames(void **state)
{
    struct put p;
    put_init(&p);
    p.state.n_lights = 1;
    p.light.env = "constant:1,2,3";
    p.state.options = &p.options;
    p.options.skip_equal = true;
    uint64_t view = open_view(&p);
    struct seen one = frame_of(view, 0);
    assert_true(one.hash && !one.equal);
    p.light.rotate_deg = 360;
    set(view, 1, &p, NULL, 0);
    struct seen same = frame_of(view, 1);
    assert_true(same.equal);
    assert_int_equal(same.hash, one.hash);
    assert_int_equal(same.n, 0);
    p.light.env = "constant:1,2,4";
    set(view, 2, &p, NULL, 0);
    struct seen other = frame_of(view, 2);
    assert_false(other.equal);
    assert_int_equal(other.n, F32_BYTES);
    assert_true(other.hash != one.hash);
    p.options.color_format = RELIGHT__COLOR_FORMAT__COLOR_F16; // encoded on a worker
    set(view, 3, &p, NULL, 0);
    other = frame_of(view, 3);
    assert_false(other.equal);
    set(view, 4, &p, NULL, 0);
    assert_true(frame_of(view, 4).equal);
    p.options.skip_equal = false;
    set(view, 5, &p, NULL, 0);
    same = frame_of(view, 5);
    assert_false(same.equal);
    assert_int_equal(same.n, OCTAHEDRON_VERTICES * 6);
    assert_int_equal(same.hash, other.hash);
    // The frame before is an error: none is equal to it.
    p.options.skip_equal = true;
    set(view, 6, &p, (char *[]){"options.skip_equal"}, 1);
    assert_true(frame_of(view, 6).equal);
    p.state.n_lights = 0;
    set(view, 7, &p, (char *[]){"lights"}, 1);
    assert_int_equal(frame_of(view, 7).code, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE);
    p.state.n_lights = 1;
    set(view, 8, &p, (char *[]){"lights"}, 1);
    same = frame_of(view, 8);
    assert_false(same.equal);
    assert_int_equal(same.n, OCTAHEDRON_VERTICES * 6);
    assert_int_equal(same.hash, other.hash);
}

// A view of a model without a bake tells so once for each state, tries again in silence, and
// draws the newest state by the bake.
static void a_bake_that_is_awaited(void **state)
{
    struct relight_load load = small_bake(9, 200);
    struct relight_loaded loaded;
    struct relight_error error;
    struct seen seen;
    struct put p;
    char joint[ID_SIZE];
    strcpy(joint, model);
    load.preview = true;
    OK(load_octahedron(client, &d, "awaited.obj", &load, &loaded, &error));
    strcpy(model, loaded.model);
    relight_loaded_finish(&loaded);
    put_init(&p);
    p.state.n_lights = 1;
    p.light.env = "constant:1,2,3";
    uint64_t view = open_view(&p);
    strcpy(model, joint);
    assert_int_equal(frame_of(view, 0).code, RELIGHT__ERROR_CODE__ERROR_NOT_READY);
    assert_false(next_frame(view, &seen, 900)); // it tries every 250 ms
    p.light.env = "constant:3,2,1";
    set(view, 1, &p, NULL, 0);
    assert_int_equal(frame_of(view, 1).code, RELIGHT__ERROR_CODE__ERROR_NOT_READY);
    assert_false(next_frame(view, &seen, 600));
    load.preview = false;
    bake_octahedron(client, &d, "awaited.obj", &load, joint);
    seen = frame_of(view, 1);
    assert_int_equal(seen.code, 0);
    assert_int_equal(seen.frame, 3);
    assert_int_equal(seen.n, F32_BYTES);
}

// A picture of 32 x 32 pixels from there, in a view of its own where `view` is 0.
static struct seen look(uint64_t *view, uint64_t sequence, float eye, float target, float up,
                        float fovy)
{
    struct put p;
    put_init(&p);
    relight__picture__init(&p.picture);
    relight__camera__init(&p.camera);
    relight__vec3__init(&p.eye);
    relight__vec3__init(&p.target);
    relight__vec3__init(&p.up);
    p.state.picture = &p.picture;
    p.picture.width = p.picture.height = 32;
    p.picture.format = RELIGHT__IMAGE_FORMAT__IMAGE_PNG;
    p.picture.camera = &p.camera;
    p.camera.eye = &p.eye;
    p.camera.target = &p.target;
    p.camera.up = &p.up;
    p.camera.fovy_deg = fovy;
    p.eye.x = eye, p.eye.z = 4;
    p.target.y = target;
    p.up.x = up, p.up.y = 1;
    if (*view) {
        set(*view, sequence, &p, (char *[]){"picture.camera"}, 1);
    } else {
        p.state.n_lights = 1;
        p.light.env = "constant:1,2,3";
        *view = open_view(&p);
    }
    return frame_of(*view, sequence);
}

// The field of the camera is all of it: pictures are those of views that began with it.
static void a_camera_is_replaced_whole(void **state)
{
    static const float to[][4] = {
        {1, 0, 0, 40}, {1, .5f, 0, 40}, {1, .5f, .5f, 40}, {1, .5f, .5f, 60}};
    uint64_t view = 0;
    struct seen before = look(&view, 0, 0, 0, 0, 40);
    for (uint64_t i = 0; i < 4; i++) {
        uint64_t fresh = 0;
        struct seen one = look(&view, i + 1, to[i][0], to[i][1], to[i][2], to[i][3]);
        struct seen want = look(&fresh, 0, to[i][0], to[i][1], to[i][2], to[i][3]);
        assert_true(one.hash && one.hash != before.hash);
        assert_int_equal(one.hash, want.hash);
        before = one;
    }
}

// A picture of 32 x 32 pixels of an orbit, in a view of its own where `view` is 0.
static struct seen look_from(uint64_t *view, uint64_t sequence, float azimuth, float zoom)
{
    Relight__Orbit orbit = RELIGHT__ORBIT__INIT;
    struct put p;
    put_init(&p);
    relight__picture__init(&p.picture);
    relight__camera__init(&p.camera);
    p.state.picture = &p.picture;
    p.picture.width = p.picture.height = 32;
    p.picture.format = RELIGHT__IMAGE_FORMAT__IMAGE_PNG;
    p.picture.camera = &p.camera;
    p.camera.orbit = &orbit;
    orbit.azimuth_deg = azimuth;
    orbit.elevation_deg = 10;
    orbit.zoom = zoom;
    if (*view) {
        set(*view, sequence, &p, (char *[]){"picture.camera"}, 1);
    } else {
        p.state.n_lights = 1;
        p.light.env = "constant:1,2,3";
        *view = open_view(&p);
    }
    return frame_of(*view, sequence);
}

// So it is with a camera that the daemon places, and between the two kinds.
static void an_orbit_is_replaced_whole(void **state)
{
    uint64_t view = 0, orbits = 0, fixed = 0;
    struct seen before = look_from(&view, 0, 0, 1);
    const struct seen side = look_from(&orbits, 0, 20, 1), near = look_from(&orbits, 1, 20, 2),
                      placed = look(&fixed, 0, 1, 0, 0, 40);
    struct seen one = look_from(&view, 1, 20, 1);
    assert_int_equal(one.hash, side.hash);
    assert_true(one.hash && one.hash != before.hash);
    one = look_from(&view, 2, 20, 2);
    assert_int_equal(one.code, 0);
    assert_int_equal(one.hash, near.hash);
    assert_true(one.hash != side.hash);
    one = look(&view, 3, 1, 0, 0, 40);
    assert_int_equal(one.code, 0);
    assert_int_equal(one.hash, placed.hash);
    one = look_from(&view, 4, 20, 1);
    assert_int_equal(one.code, 0);
    assert_int_equal(one.hash, side.hash);
    uint64_t fresh = 0;
    assert_int_equal(look_from(&fresh, 0, 20, 2).hash, near.hash);
}

// Tracing irradiance under a new light takes far longer than a millisecond.
static void a_frame_has_its_deadline(void **state)
{
    struct put p;
    put_init(&p);
    p.state.n_lights = 1;
    p.light.env = "constant:1,2,3";
    p.state.options = &p.options;
    p.state.shade = &p.shade;
    p.options.frame_deadline_ms = 1;
    p.shade.term = RELIGHT__TERM__TERM_IRRADIANCE;
    uint64_t view = open_view(&p);
    struct seen seen = frame_of(view, 0);
    assert_int_equal(seen.code, RELIGHT__ERROR_CODE__ERROR_DEADLINE);
    put_init(&p); // without a deadline
    set(view, 1, &p, (char *[]){"options.frame_deadline_ms"}, 1);
    seen = frame_of(view, 1);
    assert_int_equal(seen.code, 0);
    assert_int_equal(seen.frame, 2);
    set(view, 2, &p, (char *[]){"shade.term"}, 1);
    seen = frame_of(view, 2);
    assert_int_equal(seen.code, 0);
    assert_int_equal(seen.frame, 3);
}

static double seconds_now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

// A view sends at most max_fps frames a second, however often its state changes, and then the
// newest state.
static void rate_of_a_client(void **state)
{
    enum { FPS = 4, STATES = 60 };
    struct put p;
    struct seen seen;
    uint64_t n = 0, sequence = 0;
    put_init(&p);
    p.state.n_lights = 1;
    p.light.env = "constant";
    p.light.gain = &p.gain;
    p.state.options = &p.options;
    p.options.max_fps = FPS;
    p.gain.x = p.gain.y = p.gain.z = 1;
    uint64_t view = open_view(&p);
    seen = frame_of(view, 0);
    double start = seconds_now();
    while (sequence < STATES) {
        p.gain.x = 1 + (float)++sequence;
        set(view, sequence, &p, NULL, 0);
        if (!next_frame(view, &seen, 20)) continue;
        acknowledge(view, seen.frame);
        n++;
    }
    double seconds = seconds_now() - start;
    print_message("%d frames in %.2f s\n", (int)n, seconds);
    assert_true((double)n <= seconds * FPS + 1);
    if (seen.sequence < STATES) seen = frame_of(view, STATES); // else the loop had it
    assert_int_equal(seen.sequence, STATES);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(fields_change_alone, begin, end),
        cmocka_unit_test_setup_teardown(states_that_are_refused, begin, end),
        cmocka_unit_test_setup_teardown(acknowledged_without_an_answer, begin, end),
        cmocka_unit_test_setup_teardown(alpha_by_name, begin, end),
        cmocka_unit_test_setup_teardown(acknowledged_by_a_refused_state, begin, end),
        cmocka_unit_test_setup_teardown(window_in_bytes, begin, end),
        cmocka_unit_test_setup_teardown(equal_frames, begin, end),
        cmocka_unit_test_setup_teardown(a_bake_that_is_awaited, begin, end),
        cmocka_unit_test_setup_teardown(a_camera_is_replaced_whole, begin, end),
        cmocka_unit_test_setup_teardown(an_orbit_is_replaced_whole, begin, end),
        cmocka_unit_test_setup_teardown(a_frame_has_its_deadline, begin, end),
        cmocka_unit_test_setup_teardown(rate_of_a_client, begin, end),
    };
    return cmocka_run_group_tests(tests, group_begin, group_end);
}
