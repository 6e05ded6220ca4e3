// SPDX-License-Identifier: MIT
// relight-control with scripted USB devices against a live relightd: turning them turns the
// light of a room and of a view; devices that fail, lie or leave harm nothing. Above 600 lines:
// every case plugs in the same scripted devices.
#include "lone_daemon.h"
#include "usb_mock.h"
#include "usb_reports.h"

#include <cjson/cJSON.h>
#include <math.h>
#include <sys/resource.h>

static const uint8_t no_report[] = {0};

static const struct mock_design navigator = {.vendor = 0x046d,
                                             .product = 0xc626,
                                             .packet = 7,
                                             .report = navigator_report,
                                             .report_size = sizeof navigator_report,
                                             .has_driver = true},
                                powermate = {.vendor = 0x077d,
                                             .product = 0x0410,
                                             .packet = 8,
                                             .report = no_report,
                                             .report_size = 1},
                                knob = {.vendor = 0x1234,
                                        .product = 0xabcd,
                                        .packet = 8,
                                        .report = knob_report,
                                        .report_size = sizeof knob_report,
                                        .has_driver = true};

// ---- the program

// Times 20 ms that a state is waited for: it ends the test of a daemon that is stuck, not that
// of one on a busy machine.
enum { PATIENCE = 3000 };

static struct program {
    pid_t pid;
    char out[120], err[120];
} control;

static void start_control(const char *const arguments[])
{
    const char *argv[24] = {PRT_BINARY_DIR "/relight-control", "--server", d.address};
    int n = 3;
    for (int i = 0; arguments[i]; i++) argv[n++] = arguments[i];
    snprintf(control.out, sizeof control.out, "%s/out", d.folder);
    snprintf(control.err, sizeof control.err, "%s/err", d.folder);
    unlink(control.err);
    control.pid = fork();
    if (control.pid) return;
    setenv("LD_PRELOAD", CONTROL_PRELOAD, 1);
    dup2(open(control.out, O_CREAT | O_TRUNC | O_WRONLY, 0600), 1);
    dup2(open(control.err, O_CREAT | O_TRUNC | O_APPEND | O_WRONLY, 0600), 2);
    execv(argv[0], (char *const *)argv);
    _exit(127);
}

static bool control_says(const char *word, int ms)
{
    struct daemon log = {0};
    snprintf(log.log, sizeof log.log, "%.90s", control.err);
    return log_says(&log, word, ms);
}

static void expect_says(const char *word)
{
    if (control_says(word, 20 * PATIENCE)) return;
    char *text = read_text(control.err);
    fail_msg("no \"%s\" in: %s", word, text);
}

// The exit status, and the line of --measure in *measured (NULL: not wanted).
static int end_control(cJSON **measured)
{
    int how;
    kill(control.pid, SIGTERM);
    for (int i = 0; i < PATIENCE; i++) {
        if (waitpid(control.pid, &how, WNOHANG) == control.pid) break;
        if (i == PATIENCE - 1) {
            kill(control.pid, SIGKILL);
            fail_msg("relight-control does not end");
        }
        sleep_ms(20);
    }
    control.pid = 0;
    char *text = read_text(control.out);
    if (measured) *measured = cJSON_Parse(text);
    free(text);
    return WIFEXITED(how) ? WEXITSTATUS(how) : 1000 + WTERMSIG(how);
}

static double number_of(const cJSON *json, const char *a, const char *b)
{
    const cJSON *item = cJSON_GetObjectItem(json, a);
    if (b) item = cJSON_GetObjectItem(item, b);
    return cJSON_IsNumber(item) ? item->valuedouble : NAN;
}

// ---- the room

static struct relight_client *client;
static char room[RELIGHT_ROOM];

static void begin_room(int hold_ms)
{
    struct relight_error error;
    begin(NULL);
    client = client_open(d.address);
    OK(relight_room_create(client, "Light, by hand",
                           "{\"lights\": [{\"env\": \"constant:1,1,1\", \"rotate_deg\": 10}],"
                           " \"camera\": {\"eye\": {\"x\": 0, \"y\": 0, \"z\": 5}}}",
                           "ann", room, &error));
    mock_begin(hold_ms);
}

static void end_room(void)
{
    relight_close(client);
    mock_end();
    end();
}

static cJSON *room_scene(void)
{
    struct relight_error error;
    char *text;
    OK(relight_room_state(client, room, &text, NULL, &error));
    cJSON *state = cJSON_Parse(text), *scene = cJSON_DetachItemFromObject(state, "scene");
    free(text);
    cJSON_Delete(state);
    return scene;
}

static double light_value(const char *field, const char *axis)
{
    cJSON *scene = room_scene();
    const cJSON *light = cJSON_GetArrayItem(cJSON_GetObjectItem(scene, "lights"), 0);
    double value = axis ? number_of(light, field, axis) : number_of(light, field, NULL);
    cJSON_Delete(scene);
    return value;
}

// Waits until a value of the light is as wanted.
static void expect_light(const char *field, const char *axis, double wanted, double tolerance)
{
    double value = NAN;
    for (int i = 0; i < PATIENCE; i++) {
        value = light_value(field, axis);
        if (fabs(value - wanted) <= tolerance) return;
        sleep_ms(20);
    }
    fail_msg("%s is %g in place of %g", field, value, wanted);
}

static int expect_number(const char *what, double value, double least, double most)
{
    print_message("%s: %g, expected in [%g, %g]\n", what, value, least, most);
    return value >= least && value <= most ? 0 : 1;
}

// ---- devices

static void turn_powermate(struct mock_device *mate, int counts, bool pressed)
{
    uint8_t report[6] = {pressed, (uint8_t)counts, 0, 0x4f, 0, 0x10};
    mock_report(mate, report, sizeof report);
}

// Report 2 of a SpaceNavigator: a twist in [-350,350].
static void twist(struct mock_device *mouse, int rz)
{
    uint8_t report[7] = {2, 0, 0, 0, 0, (uint8_t)rz, (uint8_t)(rz >> 8)};
    mock_report(mouse, report, sizeof report);
}

// ---- tests

// 30 counts of 3 degrees; the button puts the light back, once it is pressed.
static void powermate_turns_a_room(void **state)
{
    begin_room(20);
    struct mock_device *mate = mock_plug(&powermate);
    start_control((const char *[]){room, "--as", "ann's hand", "--measure", NULL});
    expect_says("Griffin PowerMate (077d:0410): connected, 2 controls");
    for (int i = 0; i < 30; i++) {
        turn_powermate(mate, i % 2 ? 2 : 0, false); // half of the reports say nothing
        sleep_ms(10);
    }
    expect_light("rotate_deg", NULL, 10 + 3 * 30, 1e-3);
    turn_powermate(mate, -128, false);
    expect_light("rotate_deg", NULL, remainder(100 - 3 * 128, 360), 1e-3);
    turn_powermate(mate, 0, true);
    expect_light("rotate_deg", NULL, 10, 1e-3);
    turn_powermate(mate, 0, true); // it is held: no second press
    turn_powermate(mate, 1, true);
    turn_powermate(mate, 0, false);
    expect_light("rotate_deg", NULL, 13, 1e-3);
    assert_int_equal(mock_counts(mate).led, 255);
    cJSON *measured;
    assert_int_equal(end_control(&measured), 0);
    assert_int_equal(mock_counts(mate).led, 0);
    int wrong = expect_number("requests", number_of(measured, "requests", NULL), 4, 20);
    cJSON_Delete(measured);
    assert_int_equal(wrong, 0);
    end_room();
}

// A SpaceNavigator is taken from usbhid and given back. Its deflection is a speed: at half its
// way (behind the dead zone of .06, to the power of 1.5) 120 deg/s.
static void spacemouse_turns_a_room(void **state)
{
    begin_room(20);
    struct mock_device *mouse = mock_plug(&navigator);
    start_control((const char *[]){room, "--measure", NULL});
    expect_says("SpaceNavigator (046d:c626): connected, 8 controls");
    struct mock_counts c = mock_counts(mouse);
    assert_int_equal(c.detached, 1);
    assert_int_equal(c.claimed, 1);
    assert_int_equal(c.attached, 0);
    for (int i = 0; i < 20; i++) {
        twist(mouse, 20); // within the dead zone
        sleep_ms(8);
    }
    assert_true(fabs(light_value("rotate_deg", NULL) - 10) < 1e-6);
    uint64_t last = 0;
    double seconds = 0;
    for (int i = 0; i < 60; i++) {
        twist(mouse, 175);
        sleep_ms(8);
        assert_true(mock_drained(mouse, 10000));
        uint64_t now = mock_counts(mouse).delivered_ns;
        double step = (double)(now - last) * 1e-9;
        seconds += i && step < .05 ? step : .008; // a longer pause counts as 8 ms
        last = now;
    }
    twist(mouse, 0);
    double angle = -120 * pow((.5 - .06) / .94, 1.5) * seconds;
    expect_light("rotate_deg", NULL, 10 + angle, .2 * fabs(angle));
    double still = light_value("rotate_deg", NULL);
    sleep_ms(200);
    assert_true(light_value("rotate_deg", NULL) == still);
    assert_int_equal(mock_counts(mouse).led, 1);
    cJSON *measured;
    assert_int_equal(end_control(&measured), 0);
    c = mock_counts(mouse);
    assert_int_equal(c.released, 1);
    assert_int_equal(c.attached, 1); // usbhid has it again
    assert_int_equal(c.led, 0);
    cJSON_Delete(measured);
    end_room();
}

// A HID knob that a mapping file names: its dial, its slider by the whole way, its button.
static void mapping_file(void **state)
{
    static const char text[] =
        "{\"devices\": [{\"vendor\": \"1234\", \"product\": \"abcd\", \"map\": ["
        "{\"control\": \"dial\", \"target\": \"light.azimuth\", \"scale\": 0.5},"
        "{\"control\": \"slider\", \"target\": \"light.gain\", \"scale\": 4},"
        "{\"control\": \"button1\", \"target\": \"undo\"}]}]}";
    char file[128];
    begin_room(20);
    snprintf(file, sizeof file, "%s/map.json", d.folder);
    write_text(file, text);
    struct mock_device *device = mock_plug(&knob), *other = mock_plug(&knob);
    start_control((const char *[]){room, "--mapping", file, NULL});
    expect_says("HID device (1234:abcd): connected, 3 controls");
    for (int i = 0; i < PATIENCE && !mock_counts(other).claimed; i++) sleep_ms(20);
    assert_int_equal(mock_counts(other).claimed, 1); // both of them
    const uint8_t turned[4] = {40, 0xff, 0x03, 0}, back[4] = {0, 0, 0, 0},
                  pressed[4] = {0, 0, 0, 1};
    mock_report(device, turned, sizeof turned); // 20 degrees; the slider at its end: two stops
    expect_light("rotate_deg", NULL, 30, 1e-3);
    expect_light("gain", "y", 4, 1e-3);
    mock_report(device, back, sizeof back); // at the other end
    expect_light("gain", "y", .25, 1e-3);
    sleep_ms(1200); // a step of its own for undo
    const uint8_t more[4] = {-80, 0, 0, 0};
    mock_report(other, more, sizeof more);
    expect_light("rotate_deg", NULL, -10, 1e-3);
    mock_report(device, pressed, sizeof pressed);
    expect_light("rotate_deg", NULL, 30, 1e-3);
    // The next count begins at the value that undo brought back.
    const uint8_t one[4] = {2, 0, 0, 0};
    sleep_ms(200);
    mock_report(device, one, sizeof one);
    expect_light("rotate_deg", NULL, 31, 1e-3);
    assert_int_equal(end_control(NULL), 0);
    assert_int_equal(mock_counts(device).attached, 1);
    end_room();
}

// Ctrl-Z and fg: the program goes on, and --for ends it in its time.
static void stopped_and_continued(void **state)
{
    int how;
    begin_room(20);
    struct mock_device *mate = mock_plug(&powermate);
    for (int limited = 0; limited < 2; limited++) {
        start_control((const char *[]){room, "--for", limited ? "4" : "1000", NULL});
        expect_says("connected");
        kill(control.pid, SIGSTOP);
        assert_int_equal(waitpid(control.pid, &how, WUNTRACED), control.pid);
        kill(control.pid, SIGCONT);
        sleep_ms(300);
        turn_powermate(mate, 1, false);
        expect_light("rotate_deg", NULL, 13 + 3 * limited, 1e-3);
        if (!limited) assert_int_equal(end_control(NULL), 0);
    }
    assert_int_equal(waitpid(control.pid, &how, 0), control.pid);
    control.pid = 0;
    assert_int_equal(how, 0);
    end_room();
}

static uint64_t room_sequence(void)
{
    struct relight_error error;
    struct relight_room_info info;
    char *text;
    OK(relight_room_state(client, room, &text, &info, &error));
    free(text);
    return info.sequence;
}

// Undo right after a movement takes back this movement, not the change before it.
static void undo_of_what_still_moves(void **state)
{
    static const char text[] =
        "{\"devices\": [{\"vendor\": \"1234\", \"product\": \"abcd\", \"map\": ["
        "{\"control\": \"dial\", \"target\": \"light.azimuth\", \"scale\": 0.5},"
        "{\"control\": \"button1\", \"target\": \"undo\"}]}]}";
    const uint8_t first[4] = {40}, second[4] = {60}, pressed[4] = {0, 0, 0, 1};
    char file[128];
    begin_room(20);
    snprintf(file, sizeof file, "%s/map.json", d.folder);
    write_text(file, text);
    struct mock_device *device = mock_plug(&knob);
    start_control((const char *[]){room, "--mapping", file, NULL});
    expect_says("HID device (1234:abcd): connected");
    uint64_t before = room_sequence();
    mock_report(device, first, sizeof first);
    expect_light("rotate_deg", NULL, 30, 1e-3);
    sleep_ms(1200); // a step of its own for undo
    mock_report(device, second, sizeof second);
    mock_report(device, pressed, sizeof pressed);
    for (int i = 0; i < PATIENCE && room_sequence() < before + 3; i++) sleep_ms(20);
    assert_int_equal(room_sequence(), before + 3); // two changes and the undo
    assert_float_equal(light_value("rotate_deg", NULL), 30, 1e-3);
    assert_int_equal(end_control(NULL), 0);
    end_room();
}

// Another person's change is where the next count begins; a viewer may not turn the light.
static void others_turn_it_too(void **state)
{
    struct relight_error error;
    begin_room(20);
    struct mock_device *mate = mock_plug(&powermate);
    start_control((const char *[]){room, NULL});
    expect_says("connected");
    turn_powermate(mate, 10, false);
    expect_light("rotate_deg", NULL, 40, 1e-3);
    OK(relight_room_edit(client, room,
                         "{\"scene\": {\"parts\": [\"lights\"], \"scene\": {\"lights\": "
                         "[{\"env\": \"constant:1,1,1\", \"rotate_deg\": 100}]}}}",
                         "ann", NULL, &error));
    sleep_ms(300);
    turn_powermate(mate, 10, false);
    expect_light("rotate_deg", NULL, 130, 1e-3);
    OK(relight_room_edit(client, room, "{\"close\": {\"closed\": true}}", "ann", NULL, &error));
    turn_powermate(mate, 10, false);
    expect_says("closed");
    assert_true(fabs(light_value("rotate_deg", NULL) - 130) < 1e-3);
    assert_int_equal(end_control(NULL), 0);
    end_room();
}

// Another person undoes a change of theirs while the hand moves: the scene is fetched once the
// hand rests, and what it moved stays. A light that the room does not have is noted.
static void undo_of_others_meanwhile(void **state)
{
    struct relight_error error;
    begin_room(20);
    struct mock_device *mate = mock_plug(&powermate);
    start_control((const char *[]){room, "--light", "1", NULL});
    expect_says("connected");
    OK(relight_room_edit(client, room,
                         "{\"scene\": {\"parts\": [\"picture\"], \"scene\": {\"picture\": "
                         "{\"exposure_ev\": 2}}}}",
                         "ann", NULL, &error));
    sleep_ms(300);
    for (int i = 0; i < 20; i++) {
        turn_powermate(mate, 1, false);
        if (i == 5) OK(relight_room_edit(client, room, "{\"undo\": {}}", "ann", NULL, &error));
        sleep_ms(50);
    }
    expect_light("rotate_deg", NULL, 10 + 3 * 20, 1e-3);
    turn_powermate(mate, 1, false);
    expect_light("rotate_deg", NULL, 10 + 3 * 21, 1e-3);
    assert_int_equal(end_control(NULL), 0);
    start_control((const char *[]){room, "--light", "2", NULL});
    expect_says("--light 2: the room has 1 light now");
    assert_int_equal(end_control(NULL), 0);
    start_control(
        (const char *[]){"none", "--env", "constant", "-o", "x.png", "--light", "2", NULL});
    expect_says("--light 2: there is 1 --env");
    int how;
    waitpid(control.pid, &how, 0);
    assert_int_equal(WEXITSTATUS(how), 2);
    control.pid = 0;
    end_room();
}

// The view of a model: its picture is another one after the light was turned.
static void powermate_turns_a_view(void **state)
{
    struct relight_error error;
    struct relight_loaded loaded;
    char picture[128], model[ID_SIZE];
    begin(NULL);
    client = client_open(d.address);
    mock_begin(20);
    struct relight_load load = small_bake(1, 100);
    load.preview = true;
    OK(load_octahedron(client, &d, "small.obj", &load, &loaded, &error));
    snprintf(model, sizeof model, "%s", loaded.model);
    relight_loaded_finish(&loaded);
    snprintf(picture, sizeof picture, "%s/view.png", d.folder);
    struct mock_device *mate = mock_plug(&powermate);
    start_control((const char *[]){model, "--env", "constant", "-o", picture, "--size", "64x48",
                                   "--measure", NULL});
    expect_says("connected");
    for (int i = 0; i < PATIENCE && access(picture, R_OK); i++) sleep_ms(20);
    char before[65], after[65] = "";
    struct relight_error hashed;
    char *bytes = read_text(picture);
    assert_memory_equal(bytes + 1, "PNG", 3);
    free(bytes);
    uint64_t sent;
    assert_int_equal(relight_upload_file(client, picture, NULL, NULL, before, &sent, &hashed),
                     0);
    write_text(control.err, "");
    const uint8_t pressed[6] = {1};
    (void)pressed;
    turn_powermate(mate, 30, false);
    for (int i = 0; i < PATIENCE && (!*after || !strcmp(before, after)); i++) {
        sleep_ms(20);
        relight_upload_file(client, picture, NULL, NULL, after, &sent, &hashed);
        if (i % 10 == 9) turn_powermate(mate, 1, false);
    }
    assert_string_not_equal(before, after);
    cJSON *measured;
    assert_int_equal(end_control(&measured), 0);
    cJSON_Delete(measured);
    end_room();
}

// The hash of the picture once it is another one than `other`; with `same`, once it is that
// one.
static void expect_picture(const char *path, const char *other, const char *same, char hash[65])
{
    struct relight_error error;
    uint64_t sent;
    for (int i = 0; i < PATIENCE; i++) {
        *hash = 0;
        relight_upload_file(client, path, NULL, NULL, hash, &sent, &error);
        if (*hash && (!other || strcmp(hash, other)) && (!same || !strcmp(hash, same))) return;
        sleep_ms(20);
    }
    fail_msg("the picture does not %s", same ? "come back" : "change");
}

// A camera that no --orbit places is moved, too. Beyond 90 degrees it does not run on: the way
// back begins there.
static void camera_of_a_view(void **state)
{
    static const char text[] =
        "{\"devices\": [{\"vendor\": \"1234\", \"product\": \"abcd\", \"map\": ["
        "{\"control\": \"dial\", \"target\": \"camera.elevation\", \"scale\": 2.5}]}]}";
    char picture[128], file[128], model[ID_SIZE], first[65], above[65], back[65];
    begin(NULL);
    client = client_open(d.address);
    mock_begin(20);
    bake_small(client, &d, model);
    snprintf(picture, sizeof picture, "%s/view.png", d.folder);
    snprintf(file, sizeof file, "%s/map.json", d.folder);
    write_text(file, text);
    struct mock_device *device = mock_plug(&knob);
    start_control((const char *[]){model, "--env", "constant", "-o", picture, "--size", "64x48",
                                   "--mapping", file, NULL});
    expect_says("connected");
    expect_picture(picture, NULL, NULL, first);
    const uint8_t up[4] = {50}, down[4] = {(uint8_t)-30};
    mock_report(device, up, sizeof up); // by 125 degrees, to 90
    expect_picture(picture, first, NULL, above);
    mock_report(device, down, sizeof down); // by 75, to 15
    expect_picture(picture, above, first, back);
    assert_int_equal(end_control(NULL), 0);
    end_room();
}

// Devices come and go while it runs; a room's daemon, too.
static void hot_plug(void **state)
{
    begin_room(20);
    start_control((const char *[]){room, NULL});
    sleep_ms(300);
    struct mock_device *mate = mock_plug(&powermate);
    expect_says("connected");
    turn_powermate(mate, 10, false);
    expect_light("rotate_deg", NULL, 40, 1e-3);
    for (int i = 0; i < PATIENCE && mock_counts(mate).led != 255; i++) sleep_ms(20);
    assert_int_equal(mock_counts(mate).led, 255); // lit as one that was there at the start
    mock_unplug(mate);                            // a read is under way
    expect_says("unplugged");
    expect_says("given back");
    write_text(control.err, "");
    struct mock_device *mouse = mock_plug(&navigator);
    expect_says("SpaceNavigator");
    twist(mouse, -350);
    twist(mouse, -350);
    mock_unplug(mouse); // fully deflected: the light stands still
    expect_says("given back");
    for (int i = 0; i < PATIENCE && light_value("rotate_deg", NULL) < 40.1; i++) sleep_ms(20);
    double still = light_value("rotate_deg", NULL);
    assert_true(still > 40);
    sleep_ms(300);
    assert_true(light_value("rotate_deg", NULL) == still);
    mate = mock_plug(&powermate);
    for (int i = 0; i < PATIENCE && !mock_counts(mate).claimed; i++) sleep_ms(20);
    turn_powermate(mate, 1, false);
    expect_light("rotate_deg", NULL, remainder(still + 3, 360), 1e-3);
    assert_int_equal(end_control(NULL), 0);
    end_room();
}

// A device that is no controller, and that no mapping names, is not even opened: it may be a
// keyboard that somebody types on.
static void others_are_left_alone(void **state)
{
    begin_room(20);
    struct mock_device *stranger = mock_plug(&knob), *mate = mock_plug(&powermate);
    start_control((const char *[]){room, NULL});
    expect_says("Griffin PowerMate (077d:0410): connected");
    struct mock_device *later = mock_plug(&knob);
    turn_powermate(mate, 10, false);
    expect_light("rotate_deg", NULL, 40, 1e-3);
    assert_int_equal(end_control(NULL), 0);
    const struct mock_counts c = mock_counts(stranger), l = mock_counts(later);
    assert_true(!c.open && !c.detached && !c.claimed && !l.open && !l.claimed);
    end_room();
}

static struct mock_design changed(struct mock_design m, const uint8_t *report, uint16_t size,
                                  uint16_t said)
{
    m.report = report;
    m.report_size = size;
    m.said_size = said;
    return m;
}

// Each device with a fault is refused with a reason, and given back; a sound one goes on.
static void devices_that_lie(void **state)
{
    // 65,535 values of 255 bits; a collection that does not end; an end without a beginning.
    static const uint8_t huge[] = {0x05, 0x01, 0x09, 0x37, 0x15, 0x00, 0x25, 0x01,
                                   0x75, 0xff, 0x96, 0xff, 0xff, 0x81, 0x02},
                         endless[] = {0x05, 0x01, 0x09, 0x08, 0xa1, 0x01}, ends[] = {0xc0};
    const struct {
        struct mock_design design;
        const char *says;
    } cases[] = {
        {changed(navigator, huge, sizeof huge, 0), "a report of more than 1023 bytes"},
        {changed(navigator, endless, sizeof endless, 0), "a collection does not end"},
        {changed(navigator, ends, sizeof ends, 0), "a collection ends that did not begin"},
        {changed(navigator, navigator_report, sizeof navigator_report, 0xffff),
         "has 65535 bytes"},
        {changed(navigator, navigator_report, 9, 300), "has 9 bytes in place of 300"},
        {changed(navigator, no_report, 1, 0), "it has no axis"},
    };
    begin_room(5);
    struct mock_device *sound = mock_plug(&powermate);
    start_control((const char *[]){room, NULL});
    expect_says("Griffin PowerMate (077d:0410): connected");
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        write_text(control.err, "");
        struct mock_device *bad = mock_plug(&cases[i].design);
        expect_says(cases[i].says);
        for (int k = 0; k < PATIENCE && !mock_counts(bad).attached; k++) sleep_ms(20);
        struct mock_counts c = mock_counts(bad);
        assert_int_equal(c.detached, 1);
        assert_int_equal(c.attached, 1);
        assert_int_equal(c.claimed, c.released);
        mock_unplug(bad);
    }
    // A configuration that is cut off, which libusb refuses; an endpoint without bytes.
    struct mock_design cut = navigator, none = navigator;
    cut.broken_config = 20;
    none.packet = 0;
    mock_plug(&cut);
    struct mock_device *empty = mock_plug(&none);
    expect_says("no HID interface with an interrupt endpoint");
    assert_int_equal(mock_counts(empty).detached, 0);
    turn_powermate(sound, 10, false);
    expect_light("rotate_deg", NULL, 40, 1e-3);
    assert_int_equal(end_control(NULL), 0);
    end_room();
}

// A device that another program has; reports that are too short, too long, of an unknown id;
// transfers that fail and endpoints that stall. Sound reports go on.
static void bad_reports(void **state)
{
    struct mock_design busy = navigator;
    busy.busy = true;
    begin_room(5);
    struct mock_device *taken = mock_plug(&busy), *mouse = mock_plug(&navigator),
                       *mate = mock_plug(&powermate);
    start_control((const char *[]){room, "--measure", NULL});
    expect_says("in use by another program");
    expect_says("Griffin PowerMate (077d:0410): connected");
    expect_says("SpaceNavigator (046d:c626): connected");
    assert_int_equal(mock_counts(taken).attached, 1); // its driver has it again
    const uint8_t bad[12] = {9, 1, 2, 3, 4, 5, 6}, cut[3] = {2, 0, 0},
                  odd[7] = {2, 0, 0, 0, 0, 0xff, 0x7f};
    mock_report(mouse, bad, 7);  // no such report
    mock_report(mouse, cut, 3);  // half a report
    mock_report(mouse, bad, 0);  // nothing
    mock_report(mouse, bad, 12); // more than the endpoint's packet
    mock_report(mouse, odd, 7);  // 32767 of 350
    mock_fault(mouse, -EPROTO, 3);
    mock_fault(mouse, -EPIPE, 2); // stalls
    assert_true(mock_drained(mouse, 5000));
    assert_true(fabs(light_value("rotate_deg", NULL) - 10) < 1e-6);
    twist(mouse, -350);
    sleep_ms(300);
    twist(mouse, 0); // a hand that rests: its edit keeps what it moved
    for (int i = 0; i < PATIENCE && light_value("rotate_deg", NULL) < 10.1; i++) sleep_ms(20);
    assert_true(light_value("rotate_deg", NULL) > 10.1);
    assert_int_equal(mock_counts(mouse).clear_halt, 2);
    // One that never works again is given up; the other one is not disturbed.
    mock_fault(mouse, -EPIPE, 16);
    expect_says("its endpoint stalls 16 times in a row");
    for (int k = 0; k < PATIENCE && !mock_counts(mouse).attached; k++) sleep_ms(20);
    assert_int_equal(mock_counts(mouse).attached, 1);
    double angle = light_value("rotate_deg", NULL);
    turn_powermate(mate, 5, false);
    expect_light("rotate_deg", NULL, angle + 15, 1e-3);
    cJSON *measured;
    assert_int_equal(end_control(&measured), 0);
    int wrong = expect_number("bad reports", number_of(measured, "bad_reports", NULL), 4, 4) +
                expect_number("stalls", number_of(measured, "stalls", NULL), 18, 18);
    cJSON_Delete(measured);
    assert_int_equal(wrong, 0);
    end_room();
}

// ---- numbers

static double cpu_s(void)
{
    char path[64], *text, *at;
    unsigned long user, system;
    snprintf(path, sizeof path, "/proc/%d/stat", (int)control.pid);
    text = read_text(path);
    at = strrchr(text, ')');
    assert_int_equal(
        sscanf(at, ") %*c %*d %*d %*d %*d %*d %*u %*u %*u %*u %*u %lu %lu", &user, &system), 2);
    free(text);
    return (double)(user + system) / (double)sysconf(_SC_CLK_TCK);
}

// An idle device costs nothing: no thread runs but for the mock's own REAPURB, once in 500 ms.
static void idle_costs_nothing(void **state)
{
    begin_room(500);
    struct mock_device *mate = mock_plug(&powermate);
    start_control((const char *[]){room, NULL});
    expect_says("connected");
    sleep_ms(1500);
    double before = cpu_s();
    int reaps = mock_counts(mate).reaps;
    sleep_ms(4000);
    int wrong = expect_number("CPU seconds in 4 s", cpu_s() - before, 0, .02) +
                expect_number("reaps in 4 s", mock_counts(mate).reaps - reaps, 1, 10);
    assert_int_equal(wrong, 0);
    assert_int_equal(end_control(NULL), 0);
    end_room();
}

// 100 reports a second for 5 s, each of them sent; then 400 a second, of which 125 requests.
static void delay_and_rate(void **state)
{
    begin_room(20);
    struct mock_device *mate = mock_plug(&powermate);
    start_control((const char *[]){room, "--measure", NULL});
    expect_says("connected");
    for (int i = 0; i < 500; i++) {
        turn_powermate(mate, 1, false);
        sleep_ms(10);
    }
    cJSON *measured;
    assert_true(mock_drained(mate, 2000));
    expect_light("rotate_deg", NULL, remainder(10 + 1500, 360), 1e-2);
    assert_int_equal(end_control(&measured), 0);
    int wrong = expect_number("median delay [ms]",
                              number_of(measured, "report_to_request_ms", "median"), 0, 2) +
                expect_number("reports held by the limit",
                              number_of(measured, "held_reports", NULL), 0, 100);
    print_message("p99 delay: %g ms (5 on a quiet machine)\n",
                  number_of(measured, "report_to_request_ms", "p99"));
    cJSON_Delete(measured);
    start_control((const char *[]){room, "--measure", NULL});
    expect_says("connected");
    for (int i = 0; i < 1200; i++) {
        turn_powermate(mate, i % 2 ? 3 : -1, false);
        sleep_ms(2);
    }
    assert_true(mock_drained(mate, 2000));
    expect_light("rotate_deg", NULL, remainder(10 + 1500 + 3 * 1200, 360), 1e-2);
    assert_int_equal(end_control(&measured), 0);
    wrong += expect_number("requests in the fullest second",
                           number_of(measured, "most_requests_a_second", NULL), 60, 125);
    cJSON_Delete(measured);
    assert_int_equal(wrong, 0);
    end_room();
}

// ---- tasks without a daemon

static void list_check_learn(void **state)
{
    char file[128];
    begin_room(5);
    struct mock_device *device = mock_plug(&knob);
    mock_plug(&navigator);
    snprintf(file, sizeof file, "%s/learned.json", d.folder);
    start_control((const char *[]){"--list", "--device", "1234:abcd", NULL});
    int how;
    waitpid(control.pid, &how, 0);
    char *text = read_text(control.out);
    assert_non_null(strstr(text, "046d:c626 bus 001 device 003: SpaceNavigator"));
    assert_non_null(strstr(text, "dial (dial) slider (slider) button1 (button)"));
    assert_non_null(strstr(text, "rz (deflection)"));
    free(text);
    start_control(
        (const char *[]){"--learn", file, "--device", "1234:abcd", "--wait", "1", NULL});
    expect_says("HID device (1234:abcd): connected");
    // To the light's question; the slider rests at its end.
    const uint8_t turned[4] = {(uint8_t)-5, 0xff, 3, 0};
    mock_report(device, turned, sizeof turned);
    waitpid(control.pid, &how, 0);
    assert_int_equal(how, 0);
    text = read_text(file);
    assert_non_null(strstr(text, "\"control\":\t\"dial\""));
    assert_non_null(strstr(text, "light.azimuth"));
    assert_non_null(strstr(text, "-3")); // it was turned to the left
    free(text);
    // What was learned cannot be written: the exit status says so.
    char nowhere[160];
    snprintf(nowhere, sizeof nowhere, "%s/no-folder/learned.json", d.folder);
    start_control(
        (const char *[]){"--learn", nowhere, "--device", "1234:abcd", "--wait", "1", NULL});
    expect_says("HID device (1234:abcd): connected");
    mock_report(device, turned, sizeof turned);
    waitpid(control.pid, &how, 0);
    assert_true(WIFEXITED(how));
    assert_int_equal(WEXITSTATUS(how), 1);
    expect_says("no-folder/learned.json");
    // A signal ends it while it waits for a movement.
    start_control(
        (const char *[]){"--learn", file, "--device", "1234:abcd", "--wait", "100", NULL});
    expect_says("HID device (1234:abcd): connected");
    assert_int_equal(end_control(NULL), 1000 + SIGTERM);
    start_control((const char *[]){"--check", file, NULL});
    waitpid(control.pid, &how, 0);
    assert_int_equal(how, 0);
    write_text(file, "{\"devices\": [{\"vendor\": \"1234\", \"product\": \"abcd\", \"map\": "
                     "[{\"control\": \"dial\", \"target\": \"moon\"}]}]}");
    start_control((const char *[]){"--check", file, NULL});
    waitpid(control.pid, &how, 0);
    assert_int_equal(WEXITSTATUS(how), 2);
    expect_says("devices[0].map[0].target: expected one of light.azimuth");
    write_text(file, "{\"devices\": [{\"vendor\": \"1234\", \"product\": \"abcd\", \"map\": "
                     "[{\"target\": \"light.azimuth\"}]}]}");
    start_control((const char *[]){"--check", file, NULL});
    waitpid(control.pid, &how, 0);
    expect_says("devices[0].map[0].control: expected a control's name (--list shows them)");
    control.pid = 0;
    end_room();
}

static int stop_all(void **state)
{
    if (control.pid > 0) kill(control.pid, SIGKILL);
    control.pid = 0;
    mock_end(); // where the case failed
    return teardown(state);
}

int main(int argc, char **argv)
{
    mock_preload(argv);
    unsetenv("LD_PRELOAD"); // the daemon goes without
    if (argc > 1) cmocka_set_test_filter(argv[1]);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(powermate_turns_a_room, stop_all),
        cmocka_unit_test_teardown(spacemouse_turns_a_room, stop_all),
        cmocka_unit_test_teardown(mapping_file, stop_all),
        cmocka_unit_test_teardown(stopped_and_continued, stop_all),
        cmocka_unit_test_teardown(undo_of_what_still_moves, stop_all),
        cmocka_unit_test_teardown(others_turn_it_too, stop_all),
        cmocka_unit_test_teardown(undo_of_others_meanwhile, stop_all),
        cmocka_unit_test_teardown(powermate_turns_a_view, stop_all),
        cmocka_unit_test_teardown(camera_of_a_view, stop_all),
        cmocka_unit_test_teardown(hot_plug, stop_all),
        cmocka_unit_test_teardown(others_are_left_alone, stop_all),
        cmocka_unit_test_teardown(devices_that_lie, stop_all),
        cmocka_unit_test_teardown(bad_reports, stop_all),
        cmocka_unit_test_teardown(idle_costs_nothing, stop_all),
        cmocka_unit_test_teardown(delay_and_rate, stop_all),
        cmocka_unit_test_teardown(list_check_learn, stop_all),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
