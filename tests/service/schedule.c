// SPDX-License-Identifier: MIT
// The order of work: shares of compute time, work that nobody waits for any more, and views
// that cannot keep their rate. Nothing here fails on time: shares are of thread-seconds.
#include "frames.h"

#include <arpa/inet.h>
#include <math.h>
#include <netinet/in.h>

static struct daemon d;
static char model[ID_SIZE];

static struct frames *open_tcp(void)
{
    struct frames *f = calloc(1, sizeof *f);
    struct relight_frame_limits limits = {1 << 24, UINT64_C(1) << 32, false};
    struct sockaddr_in a = {.sin_family = AF_INET};
    const char *colon = strrchr(d.tcp, ':');
    assert_non_null(f);
    assert_non_null(colon);
    relight_decoder_init(&f->decoder, &limits);
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    a.sin_port = htons((uint16_t)atoi(colon + 1));
    f->fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_int_equal(connect(f->fd, (struct sockaddr *)&a, sizeof a), 0);
    frames_add_hello(f, "modest");
    frames_send(f);
    assert_int_equal(frames_wait(f, 1).code, 0);
    return f;
}

// A picture that no other request shares: `turn` moves the eye.
static void add_picture(struct frames *f, uint64_t id, unsigned turn, uint32_t side,
                        Relight__Priority priority)
{
    Relight__ImageRequest m = RELIGHT__IMAGE_REQUEST__INIT;
    Relight__Light light = RELIGHT__LIGHT__INIT, *lights[] = {&light};
    Relight__Picture picture = RELIGHT__PICTURE__INIT;
    Relight__Camera camera = RELIGHT__CAMERA__INIT;
    Relight__Vec3 eye = RELIGHT__VEC3__INIT, target = RELIGHT__VEC3__INIT;
    light.env = "constant:1,1,1";
    eye.x = 4 * sinf((float)turn * 0.01f), eye.z = 4 * cosf((float)turn * 0.01f);
    eye.y = 0.5f;
    camera.eye = &eye, camera.target = &target;
    picture.camera = &camera;
    picture.width = picture.height = side;
    picture.format = RELIGHT__IMAGE_FORMAT__IMAGE_PNG;
    m.model = model;
    m.lights = lights, m.n_lights = 1;
    m.picture = &picture;
    m.priority = priority;
    frames_add(f, RELIGHT_TYPE_IMAGE, id, &m.base, NULL, 0);
}

// Of a name with labels, which follow it in braces, the sum.
static double metric_of(struct frames *f, const char *name)
{
    static uint64_t id = 1u << 30;
    Relight__StatsRequest in = RELIGHT__STATS_REQUEST__INIT;
    struct frames_answer a;
    ProtobufCMessage *m = NULL;
    const size_t n = strlen(name);
    double value = -1;
    frames_add(f, RELIGHT_TYPE_STATS, ++id, &in.base, NULL, 0);
    frames_send(f);
    do {
        if (m) protobuf_c_message_free_unpacked(m, NULL);
        m = NULL;
        assert_true(frames_next(f, &a, 60000, &m));
        assert_false(a.closed);
    } while (a.id != id);
    const Relight__StatsAnswer *stats = (const Relight__StatsAnswer *)m;
    for (size_t i = 0; i < stats->n_metrics; i++)
        if (!strncmp(stats->metrics[i]->name, name, n) &&
            (!stats->metrics[i]->name[n] || stats->metrics[i]->name[n] == '{'))
            value = fmax(value, 0) + stats->metrics[i]->value;
    protobuf_c_message_free_unpacked(m, NULL);
    return value;
}

enum { PICTURES = 100 };

// Orders slow pictures from this seed on and cancels them: how many were withdrawn, and the
// thread-seconds that the others took.
static double withdrawn_of_cancelled(struct frames *f, struct frames *watch, unsigned seed,
                                     double *seconds)
{
    Relight__CancelRequest cancel = RELIGHT__CANCEL_REQUEST__INIT;
    double withdrawn = metric_of(watch, "relightd_work_withdrawn_total");
    double before = metric_of(watch, "relightd_work_seconds_total");
    for (unsigned i = 0; i < PICTURES; i++)
        add_picture(f, seed + i, seed + i, 700, RELIGHT__PRIORITY__PRIORITY_DEFAULT);
    for (unsigned i = 0; i < PICTURES; i++) {
        cancel.id = seed + i;
        frames_add(f, RELIGHT_TYPE_CANCEL, 5000 + seed + i, &cancel.base, NULL, 0);
    }
    frames_send(f);
    assert_int_equal(frames_wait(f, 5000 + seed + PICTURES - 1).code, 0);
    while (metric_of(watch, "relightd_work_waiting") > 0) sleep_ms(20);
    sleep_ms(200);
    *seconds = metric_of(watch, "relightd_work_seconds_total") - before;
    return metric_of(watch, "relightd_work_withdrawn_total") - withdrawn;
}

// A hundred slow pictures are ordered and cancelled: few of them are ever computed, in the best
// turn.
static void test_cancelled_work_never_runs(void **state)
{
    struct frames *f = frames_open(&d), *watch = frames_open(&d);
    double before = metric_of(watch, "relightd_work_seconds_total");
    add_picture(f, 10, 9999, 700, RELIGHT__PRIORITY__PRIORITY_DEFAULT);
    frames_send(f);
    assert_int_equal(frames_wait(f, 10).code, 0);
    double one = metric_of(watch, "relightd_work_seconds_total") - before, gone = 0, all = 0;
    for (unsigned turn = 1; turn <= 5 && gone < .7 * PICTURES; turn++) {
        gone = withdrawn_of_cancelled(f, watch, 300 * turn, &all);
        print_message("one picture %.3f thread-s, %d cancelled ones %.3f; withdrawn %g\n", one,
                      PICTURES, all, gone);
    }
    assert_true(gone >= 0.7 * PICTURES);
    assert_true(all < 0.3 * PICTURES * one);
    frames_close(f);
    // So does a closed connection, and a deadline.
    f = frames_open(&d);
    double withdrawn = metric_of(watch, "relightd_work_withdrawn_total");
    for (uint64_t i = 0; i < PICTURES; i++)
        add_picture(f, 100 + i, 200 + (unsigned)i, 700, RELIGHT__PRIORITY__PRIORITY_BULK);
    frames_send(f);
    sleep_ms(50);
    frames_close(f);
    while (metric_of(watch, "relightd_work_waiting") > 0) sleep_ms(20);
    assert_true(metric_of(watch, "relightd_work_withdrawn_total") > withdrawn);
    frames_close(watch);
}

// Keeps so many pictures of a client on the way.
struct stream {
    struct frames *f;
    unsigned side, depth, open, done, turn;
    uint64_t id;
};

static void pump(struct stream *s, int ms)
{
    struct frames_answer a;
    while (s->open < s->depth) {
        add_picture(s->f, ++s->id, s->turn++, s->side, RELIGHT__PRIORITY__PRIORITY_DEFAULT);
        s->open++;
    }
    if (s->f->n) frames_send(s->f);
    while (frames_next(s->f, &a, ms, NULL)) {
        assert_false(a.closed);
        assert_int_equal(a.code, 0);
        s->open--;
        s->done++;
        ms = 0;
    }
}

// A request whose own work waits behind others' is cancelled: that work is withdrawn.
static void test_cancelled_order_is_withdrawn(void **state)
{
    struct frames *f = frames_open(&d), *other = frames_open(&d), *watch = frames_open(&d);
    Relight__GeometryRequest ask = RELIGHT__GEOMETRY_REQUEST__INIT;
    Relight__CancelRequest cancel = RELIGHT__CANCEL_REQUEST__INIT;
    for (unsigned i = 0; i < PICTURES; i++)
        add_picture(f, 1 + i, 20000 + i, 700, RELIGHT__PRIORITY__PRIORITY_DEFAULT);
    frames_send(f);
    while (metric_of(watch, "relightd_work_waiting") < 4) sleep_ms(2);
    double before = metric_of(watch, "relightd_work_withdrawn_total");
    ask.model = model;
    ask.coarse = true;
    cancel.id = 1;
    frames_add(other, RELIGHT_TYPE_GEOMETRY, 1, &ask.base, NULL, 0);
    frames_add(other, RELIGHT_TYPE_CANCEL, 2, &cancel.base, NULL, 0);
    frames_send(other);
    assert_int_equal(frames_wait(other, 2).code, 0);
    double withdrawn = metric_of(watch, "relightd_work_withdrawn_total") - before;
    assert_true(withdrawn == 1);
    frames_close(f);
    while (metric_of(watch, "relightd_work_waiting") > 0) sleep_ms(20);
    frames_close(other);
    frames_close(watch);
}

static unsigned count_in_log(const char *word)
{
    unsigned n = 0;
    char *text = read_text(d.log);
    for (const char *at = text; (at = strstr(at, word)); at++) n++;
    free(text);
    return n;
}

// A flat .hdr file of 2 MB whose pixels are of this brightness.
static void upload_sky(struct relight_client *client, unsigned bright, char env[80])
{
    enum { W = 1024, H = 512 };
    static char file[100 + 4 * W * H];
    struct relight_error error;
    size_t n =
        (size_t)sprintf(file, "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n", H, W);
    for (size_t i = 0; i < (size_t)W * H; i++) {
        const uint8_t pixel[4] = {(uint8_t)(100 + bright), 100, 100, 128};
        memcpy(file + n + 4 * i, pixel, 4);
    }
    memcpy(env, "env:", 4);
    OK(relight_upload(client, "sky.hdr", file, n + 4 * W * H, NULL, NULL, env + 4, NULL,
                      &error));
}

enum { IMAGES = 24, DECODERS = 4, TURNS = 5 };

// Asks for images that nobody has seen, cancels all, and then wants the last: how many were
// decoded?
static unsigned decoded_of_cancelled(struct relight_client *client, unsigned turn)
{
    char env[IMAGES][80];
    struct frames *f = frames_open(&d);
    Relight__CancelRequest cancel = RELIGHT__CANCEL_REQUEST__INIT;
    Relight__EnvRequest ask = RELIGHT__ENV_REQUEST__INIT;
    for (unsigned i = 0; i < IMAGES; i++) upload_sky(client, turn * IMAGES + i, env[i]);
    unsigned before = count_in_log("environment env=env:");
    for (uint64_t i = 0; i < IMAGES; i++) {
        ask.env = env[i];
        frames_add(f, RELIGHT_TYPE_ENV, 100 + i, &ask.base, NULL, 0);
    }
    for (uint64_t i = 0; i < IMAGES; i++) {
        cancel.id = 100 + i;
        frames_add(f, RELIGHT_TYPE_CANCEL, 1000 + i, &cancel.base, NULL, 0);
    }
    frames_send(f);
    assert_int_equal(frames_wait(f, 1000 + IMAGES - 1).code, 0);
    // One that is wanted is behind all that were queued.
    ask.env = env[IMAGES - 1];
    frames_add(f, RELIGHT_TYPE_ENV, 5000, &ask.base, NULL, 0);
    frames_send(f);
    assert_int_equal(frames_wait(f, 5000).code, 0);
    frames_close(f);
    return count_in_log("environment env=env:") - before;
}

// The decoders run four at a time: of the others nothing is decoded once nobody waits for it.
// A daemon that is stopped between a request and its cancellation decodes more: the best turn
// counts.
static void test_cancelled_images_are_not_decoded(void **state)
{
    struct relight_client *client = client_open(d.address);
    unsigned decoded = IMAGES;
    for (unsigned turn = 0; turn < TURNS && decoded > DECODERS + 1 + IMAGES / 4; turn++) {
        decoded = decoded_of_cancelled(client, turn);
        print_message("%u of %d images were decoded\n", decoded, IMAGES);
        assert_true(decoded >= 1);
    }
    assert_true(decoded <= DECODERS + 1 + IMAGES / 4);
    relight_close(client);
}

// One client keeps 24 large pictures on the way, the other four small ones: the greedy one gets
// less than 60 % of the compute time.
static void test_greedy_and_modest(void **state)
{
    struct stream greedy = {.f = frames_open(&d), .side = 500, .depth = 24, .id = 10};
    struct stream modest = {.f = open_tcp(), .side = 250, .depth = 6, .id = 10, .turn = 50000};
    struct frames *g = frames_open(&d), *m = open_tcp();
    for (int i = 0; i < 20; i++) pump(&greedy, 5), pump(&modest, 5);
    double g0 = metric_of(g, "relightd_own_work_seconds");
    double m0 = metric_of(m, "relightd_own_work_seconds");
    unsigned done = modest.done;
    while (modest.done < done + 120) pump(&greedy, 2), pump(&modest, 2);
    double used = metric_of(g, "relightd_own_work_seconds") - g0;
    double left = metric_of(m, "relightd_own_work_seconds") - m0;
    print_message("greedy %.3f thread-s, modest %.3f: %.1f %%\n", used, left,
                  100 * used / (used + left));
    assert_true(used < 0.6 * (used + left));
    while (greedy.open || modest.open) {
        greedy.depth = modest.depth = 0;
        pump(&greedy, 10), pump(&modest, 10);
    }
    frames_close(greedy.f), frames_close(modest.f), frames_close(g), frames_close(m);
}

// A square of SIDE x SIDE quads as OBJ text, to free().
static char *sheet(unsigned side)
{
    const size_t room = 64 * (size_t)(side + 1) * (side + 1);
    char *text = malloc(room);
    size_t at = 0;
    for (unsigned y = 0; y <= side; y++)
        for (unsigned x = 0; x <= side; x++)
            at += (size_t)snprintf(text + at, room - at, "v %u %u 0\n", x, y);
    for (unsigned y = 0; y < side; y++)
        for (unsigned x = 0; x < side; x++) {
            const unsigned v = y * (side + 1) + x + 1;
            at += (size_t)snprintf(text + at, room - at, "f %u %u %u %u\n", v, v + 1,
                                   v + side + 2, v + side + 1);
        }
    return text;
}

// Loads previews of a file by sizes from this one on, cancels all, and then wants another: how
// often was the file read?
static unsigned read_of_cancelled(struct frames *f, Relight__LoadRequest load, float first_mm)
{
    Relight__CancelRequest cancel = RELIGHT__CANCEL_REQUEST__INIT;
    unsigned before = count_in_log(" read ms=");
    uint64_t id = 10000 + 1000 * (uint64_t)first_mm;
    for (unsigned i = 0; i < IMAGES; i++) {
        load.size_mm = first_mm + (float)i; // each is another model
        frames_add(f, RELIGHT_TYPE_LOAD, id + i, &load.base, NULL, 0);
    }
    frames_send(f);
    while (count_in_log(" read ms=") == before) sleep_ms(5); // the others are in the queue
    for (unsigned i = 0; i < IMAGES; i++) {
        cancel.id = id + i;
        frames_add(f, RELIGHT_TYPE_CANCEL, id + 100 + i, &cancel.base, NULL, 0);
    }
    frames_send(f);
    assert_int_equal(frames_wait(f, id + 100 + IMAGES - 1).code, 0);
    load.size_mm = first_mm + IMAGES; // wanted, and behind all that were queued
    frames_add(f, RELIGHT_TYPE_LOAD, id + 500, &load.base, NULL, 0);
    frames_send(f);
    assert_int_equal(frames_wait(f, id + 500).code, 0);
    return count_in_log(" read ms=") - before;
}

// LOADs of previews whose files wait to be read are cancelled: those are not read, in the best
// turn.
static void test_cancelled_previews_are_not_read(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct frames *f = frames_open(&d);
    Relight__LoadRequest load = RELIGHT__LOAD_REQUEST__INIT;
    Relight__FileRef file = RELIGHT__FILE_REF__INIT, *files[] = {&file};
    char *text = sheet(200), hash[65];
    OK(relight_upload(client, "sheet.obj", text, strlen(text), NULL, NULL, hash, NULL, &error));
    free(text);
    file.name = "sheet.obj", file.blob = hash;
    load.files = files, load.n_files = 1;
    load.material = "marble";
    load.preview = true;
    unsigned read = IMAGES;
    for (unsigned turn = 0; turn < TURNS && read > 2 * DECODERS + IMAGES / 4; turn++) {
        read = read_of_cancelled(f, load, 10 + 30 * (float)turn);
        print_message("%u of %d files were read\n", read, IMAGES + 1);
        assert_true(read >= 2);
    }
    assert_true(read <= 2 * DECODERS + IMAGES / 4);
    frames_close(f);
    relight_close(client);
}

// A wrong priority is refused.
static void test_priorities(void **state)
{
    struct frames *f = frames_open(&d);
    add_picture(f, 10, 1, 64, (Relight__Priority)77);
    for (int p = 0; p < 4; p++) add_picture(f, 11 + (uint64_t)p, 1, 64, (Relight__Priority)p);
    frames_send(f);
    assert_int_equal(frames_wait(f, 10).code, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
    for (uint64_t id = 11; id < 15; id++) (void)id;
    assert_int_equal(frames_wait(f, 14).code, 0);
    frames_close(f);
}

// States that a view is given, 30 ms apart, until a frame is reduced. One is reduced after a
// whole one was drawn, which may take longer than 18 s under the thread sanitizer.
enum { STATES = INSTRUMENTED ? 6000 : 600 };

// Turning a large picture's light faster than it can be drawn: some frame has half the width,
// says so, and the last one is as it was asked for, byte for byte what IMAGE answers.
static void test_reduced_then_exact(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_light light = {.env = "constant:1,0.9,0.8", .gain = {1, 1, 1}};
    struct relight_view_request open = {
        .model = model, .n_light = 1, .lights = &light, .window = 4};
    open.picture.width = 2000, open.picture.height = 1500;
    open.picture.format = RELIGHT_IMAGE_PNG;
    struct relight_view *view;
    OK(relight_view_open(client, &open, &view, &error));
    uint64_t sequence = 0;
    bool reduced = false;
    struct relight_frame_out frame;
    for (int i = 0; i < STATES && !reduced; i++) {
        light.rotate_deg = (float)i;
        open.picture.exposure_ev = 0.001f * (float)i;
        OK(relight_view_set(view, 1, &light, NULL, &open.picture, &sequence, &error));
        sleep_ms(30);
        while (!reduced && !relight_view_next(view, 0.001, &frame, &error)) {
            reduced = frame.has_image && frame.image.cost.reduced == 2;
            if (reduced) {
                assert_int_equal(frame.image.width, 1000);
                assert_int_equal(frame.image.height, 750);
            }
            relight_frame_out_finish(&frame);
        }
    }
    assert_true(reduced);
    bool exact = false;
    while (!exact) {
        OK(relight_view_next(view, 60, &frame, &error));
        exact = frame.sequence == sequence && frame.has_image && !frame.image.cost.reduced;
        if (!exact) relight_frame_out_finish(&frame);
    }
    assert_int_equal(frame.image.width, 2000);
    struct relight_image_request request = {
        .model = model, .n_light = 1, .lights = &light, .picture = open.picture};
    struct relight_image image;
    OK(relight_image(client, &request, &image, &error));
    assert_int_equal(image.n_byte, frame.image.n_byte);
    assert_memory_equal(image.data, frame.image.data, image.n_byte);
    relight_image_finish(&image);
    relight_frame_out_finish(&frame);
    OK(relight_view_close(view, NULL, NULL, &error));
    assert_true(metric(client, "relightd_view_reduced_total") >= 1);
    relight_close(client);
}

// Colours under a light that turns, while pictures keep all workers: some frame is made of
// fewer rows and says so, and the last one is what COLORS answers.
static void test_reduced_colors_then_exact(void **state)
{
    // Three pictures at a time: the view's frames wait for one of them each, not for all.
    struct stream pictures = {.depth = 3, .side = 1200, .id = 10, .turn = 90000};
    struct relight_client *client = client_open(d.address);
    struct frames *f = frames_open(&d);
    struct relight_error error;
    struct relight_light light = {.env = "constant:1,0.9,0.8", .gain = {1, 1, 1}};
    const struct relight_view_request open = {
        .model = model, .n_light = 1, .lights = &light, .window = 4, .colors = true};
    struct relight_view *view;
    struct relight_frame_out frame;
    OK(relight_view_open(client, &open, &view, &error));
    pictures.f = f;
    uint64_t sequence = 0;
    bool reduced = false, exact = false;
    for (int i = 0; i < STATES && !reduced; i++) {
        light.gain[0] = 1 + 0.01f * (float)i;
        OK(relight_view_set(view, 1, &light, NULL, NULL, &sequence, &error));
        pump(&pictures, 0);
        sleep_ms(30);
        while (!reduced && !relight_view_next(view, 0.001, &frame, &error)) {
            reduced = frame.has_colors && frame.colors.cost.reduced == 2;
            relight_frame_out_finish(&frame);
        }
    }
    assert_true(reduced);
    while (!exact) {
        OK(relight_view_next(view, 60, &frame, &error));
        exact = frame.sequence == sequence && frame.has_colors && !frame.colors.cost.reduced;
        if (!exact) relight_frame_out_finish(&frame);
    }
    const struct relight_colors_request request = {
        .model = model, .n_light = 1, .lights = &light, .sum = true};
    struct relight_colors colors;
    OK(relight_colors(client, &request, &colors, &error));
    float got[3 * OCTAHEDRON_VERTICES], want[3 * OCTAHEDRON_VERTICES];
    assert_int_equal(relight_colors_decode(&frame.colors, 0, got), 0);
    assert_int_equal(relight_colors_decode(&colors, 0, want), 0);
    assert_memory_equal(got, want, sizeof got);
    relight_colors_finish(&colors);
    relight_frame_out_finish(&frame);
    OK(relight_view_close(view, NULL, NULL, &error));
    frames_close(f);
    relight_close(client);
}

// Of forty pictures at once two are computed at a time: all together wait longer than they
// take, and the histograms tell one from the other.
static void test_waiting_is_told(void **state)
{
    enum { N = 40 };
    static const char waits[] = "relightd_queue_seconds_sum",
                      takes[] = "relightd_compute_seconds_sum";
    struct frames *f = frames_open(&d), *watch = frames_open(&d);
    struct frames_answer a;
    double waited = fmax(metric_of(watch, waits), 0), took = fmax(metric_of(watch, takes), 0);
    for (unsigned i = 0; i < N; i++)
        add_picture(f, 10 + i, 90000 + i, 300, RELIGHT__PRIORITY__PRIORITY_DEFAULT);
    frames_send(f);
    for (unsigned n = 0; n < N; n++) {
        assert_true(frames_next(f, &a, 120000, NULL));
        assert_int_equal(a.code, 0);
    }
    waited = metric_of(watch, waits) - waited;
    took = metric_of(watch, takes) - took;
    print_message("%d pictures waited %.3f s and took %.3f s\n", N, waited, took);
    assert_true(took > 0 && waited > took);
    frames_close(watch);
    frames_close(f);
}

// BUSY says when to come back: longer where more waits.
static void test_busy_says_when(void **state)
{
    enum { N = 200 };
    struct frames *f = frames_open(&d);
    struct frames_answer a;
    ProtobufCMessage *m = NULL;
    uint32_t busy = 0, most = 0;
    for (uint64_t i = 0; i < N; i++)
        add_picture(f, 10 + i, 70000 + (unsigned)i, 300, RELIGHT__PRIORITY__PRIORITY_DEFAULT);
    frames_send(f);
    for (unsigned n = 0; n < N; n++) {
        assert_true(frames_next(f, &a, 120000, &m));
        assert_false(a.closed);
        if (a.code == RELIGHT__ERROR_CODE__ERROR_BUSY) {
            uint32_t ms = ((Relight__Error *)m)->retry_after_ms;
            assert_true(ms >= 1 && ms <= 10000);
            if (ms > most) most = ms;
            busy++;
        }
        protobuf_c_message_free_unpacked(m, NULL);
    }
    print_message("%u of %d busy, retry after up to %u ms\n", busy, N, most);
    assert_true(busy > 0);
    frames_close(f);
}

static int setup(void **state)
{
    static const char *const two[] = {"--threads", "2", "--requests", "128", NULL};
    daemon_folder(&d);
    daemon_start(&d, two);
    struct relight_client *client = client_open(d.address);
    bake_small(client, &d, model);
    relight_close(client);
    return 0;
}

static int teardown(void **state)
{
    int status = daemon_end(&d);
    daemon_remove(&d);
    return status;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_cancelled_work_never_runs),
        cmocka_unit_test(test_cancelled_order_is_withdrawn),
        cmocka_unit_test(test_cancelled_images_are_not_decoded),
        cmocka_unit_test(test_cancelled_previews_are_not_read),
        cmocka_unit_test(test_greedy_and_modest),
        cmocka_unit_test(test_priorities),
        cmocka_unit_test(test_waiting_is_told),
        cmocka_unit_test(test_busy_says_when),
        cmocka_unit_test(test_reduced_then_exact),
        cmocka_unit_test(test_reduced_colors_then_exact),
    };
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("schedule", tests, setup, teardown);
}
