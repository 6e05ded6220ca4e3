// SPDX-License-Identifier: MIT
// The command line of relight-control.
#include "control.h"

#include <argp.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

const char *argp_program_version = "relight-control " RELIGHT_VERSION;

enum {
    KEY_MEASURE = 256,
    KEY_FOR,
    KEY_LIST,
    KEY_CHECK,
    KEY_LEARN,
    KEY_WAIT,
    KEY_AS,
    KEY_STEER
};
static const struct argp_option table[] = {
    {0, 0, 0, 0, "What is controlled:", 1},
    {"server", 's', "ADDR", 0,
     "tcp:HOST:PORT, tls:HOST:PORT or unix:PATH (default as for relight)", 1},
    {"env", 'e', "ENV", 0, "a view's light, as for relight image; may be repeated", 1},
    {"output", 'o', "FILE", 0,
     "a view's picture, in the format of its ending, replaced at every frame; - draws in the terminal",
     1},
    {"size", 'z', "WxH", 0, "pixels of the picture (default 640x480)", 1},
    {"rotate", 'r', "DEG", 0, "where the light of a view begins", 1},
    {"orbit", 'O', "AZ,EL[,ZOOM]", 0, "where the camera of a view begins (default 0,15)", 1},
    {"exposure", 'x', "STOPS", 0, "where the exposure of a view begins", 1},
    {"light", 'l', "N", 0, "move only this light, from 1 (default: all)", 1},
    {"as", KEY_AS, "NAME", 0, "display name in a room (default $USER)", 1},
    {0, 0, 0, 0, "What controls:", 2},
    {"mapping", 'm', "FILE", 0, "which control moves what (default: by the kind of device)", 2},
    {"steer", KEY_STEER, "light|camera", 0,
     "what devices without a mapping move (default light)", 2},
    {"device", 'd', "VENDOR:PRODUCT", 0,
     "use this device, too, such as 1234:abcd: a HID knob or dial that --list shows; it is "
     "taken from its kernel driver while the program runs",
     2},
    {0, 0, 0, 0, "Other tasks:", 3},
    {"list", KEY_LIST, NULL, 0, "list the HID devices, with the controls of those it would use",
     3},
    {"learn", KEY_LEARN, "FILE", 0,
     "ask for a movement for each value, and write a mapping file", 3},
    {"wait", KEY_WAIT, "SECONDS", 0, "of --learn for a movement (default 8)", 3},
    {"check", KEY_CHECK, "FILE", 0, "test a mapping file", 3},
    {"measure", KEY_MEASURE, NULL, 0, "at the end print requests and delays as a line of JSON",
     3},
    {"for", KEY_FOR, "SECONDS", 0, "stop after this time (default: at SIGINT or SIGTERM)", 3},
    {"json", 'j', NULL, 0, "--list as lines of JSON", 3},
    {"quiet", 'q', NULL, 0, "say nothing about devices that come and go", 3},
    {0},
};

static void add_device(struct argp_state *state, struct options *o, const char *text)
{
    unsigned vendor, product;
    int used = 0;
    if (o->n_named == MOST_DEVICES) argp_error(state, "--device: at most %d", MOST_DEVICES);
    if (sscanf(text, "%4x:%4x%n", &vendor, &product, &used) != 2 || text[used] || used != 9)
        argp_error(state, "--device %s: expected VENDOR:PRODUCT, four hex digits each", text);
    o->named[o->n_named].vendor = (uint16_t)vendor;
    o->named[o->n_named++].product = (uint16_t)product;
}

static void orbit(struct argp_state *state, struct options *o, const char *text)
{
    struct relight_error error;
    if (relight_orbit_parse(text, &o->picture.camera, &error))
        argp_error(state, "%s", error.text);
}

static void set_task(struct argp_state *state, struct options *o, enum task task,
                     const char *file)
{
    if (o->task) argp_error(state, "only one of --list, --learn and --check");
    o->task = task;
    o->file = file;
}

static error_t parse_other(int key, char *arg, struct argp_state *state)
{
    struct options *o = state->input;
    switch (key) {
    case KEY_LIST:
        set_task(state, o, TASK_LIST, NULL);
        break;
    case KEY_LEARN:
        set_task(state, o, TASK_LEARN, arg);
        break;
    case KEY_CHECK:
        set_task(state, o, TASK_CHECK, arg);
        break;
    case KEY_WAIT:
        o->wait_s = option_number(state, "wait", arg, .1, 600);
        break;
    case KEY_FOR:
        o->for_s = option_number(state, "for", arg, .01, 1e6);
        break;
    case KEY_MEASURE:
        o->measure = true;
        break;
    case 'j':
        o->json = true;
        break;
    case 'q':
        o->quiet = true;
        break;
    case 'm':
        o->mapping = arg;
        break;
    case 'd':
        add_device(state, o, arg);
        break;
    case KEY_STEER:
        o->camera = !strcmp(arg, "camera");
        if (!o->camera && strcmp(arg, "light"))
            argp_error(state, "--steer %s: expected light or camera", arg);
        break;
    default:
        return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static void finish(struct argp_state *state, const struct options *o)
{
    if (o->task) {
        if (o->target) argp_error(state, "one argument too many: %s", o->target);
        return;
    }
    if (!o->target) argp_error(state, "ID or ROOM is missing");
}

static error_t parse(int key, char *arg, struct argp_state *state)
{
    struct options *o = state->input;
    switch (key) {
    case 's':
        o->server = arg;
        break;
    case 'e':
        if (o->n_env == MOST_LIGHTS) argp_error(state, "--env: at most %d", MOST_LIGHTS);
        o->env[o->n_env++] = arg;
        break;
    case 'o':
        o->output = arg;
        break;
    case 'z':
        option_size(state, arg, &o->picture.width, &o->picture.height);
        break;
    case 'r':
        o->rotate_deg = (float)option_number(state, "rotate", arg, -1e6, 1e6);
        break;
    case 'O':
        orbit(state, o, arg);
        break;
    case 'x':
        o->picture.exposure_ev = (float)option_number(state, "exposure", arg, -40, 40);
        break;
    case 'l':
        o->light = (int)option_number(state, "light", arg, 1, MOST_LIGHTS) - 1;
        break;
    case KEY_AS:
        o->as = arg;
        break;
    case ARGP_KEY_ARG:
        if (o->target) argp_error(state, "one argument too many: %s", arg);
        o->target = arg;
        break;
    case ARGP_KEY_END:
        finish(state, o);
        break;
    default:
        return parse_other(key, arg, state);
    }
    return 0;
}

void options_parse(int argc, char **argv, struct options *out)
{
    *out = (struct options){.light = -1, .wait_s = 8};
    // The daemon's own camera, as an orbit that can be moved.
    out->picture.camera =
        (struct relight_camera){.set = true, .has_orbit = true, .elevation_deg = 15, .zoom = 1};
    argp_err_exit_status = EXIT_USAGE;
    static const struct argp how = {
        table,
        parse,
        "ID|ROOM",
        "Turns the light or the camera of a view or of a review room with USB controllers: "
        "3Dconnexion SpaceMice, the Griffin PowerMate, and HID knobs and dials that a mapping "
        "file or --device names.\v"
        "A room (its id, the beginning of one, or its name) is joined as a participant who may "
        "edit; of a model (ID) a view is opened. The others in the room see at once what a "
        "control moves; when it rests for 250 ms one edit keeps it, which is one step of undo. "
        "$RELIGHT_TOKEN is the token. Devices may come and go. Access to them needs the udev rule that is installed with this program "
        "(60-relight-control.rules), and the group relight: sudo usermod -aG relight $USER; no "
        "root.\n\n"
        "A mapping file is JSON:\n"
        "  {\"devices\": [{\"vendor\": \"046d\", \"product\": \"c626\", \"led\": 1, \"map\": [\n"
        "    {\"control\": \"rz\", \"target\": \"light.azimuth\", \"scale\": 120, \"dead\": 0.06, "
        "\"curve\": 1.5},\n"
        "    {\"control\": \"button1\", \"target\": \"reset\"}]}]}\n"
        "Targets are light.azimuth, light.gain, exposure, camera.azimuth, camera.elevation and "
        "camera.zoom, and for buttons reset, undo and redo. scale: degrees, or stops for gain, "
        "exposure and zoom: a second at full deflection, a count of a dial, the whole way of a "
        "slider, a press of a button. dead [0, 0.9]: deflection that does nothing. curve "
        "[0.2, 5]: exponent of the deflection.\n\n"
        "Examples:\n"
        "  relight-control --list\n"
        "  relight-control bunny --env sunrise.exr -o bunny.jpg\n"
        "  relight-control \"Head, in jade\" --steer camera\n"
        "  relight-control --learn knobs.json --device 1234:abcd\n"
        "  relight-control \"Head, in jade\" --mapping knobs.json\n\n"
        "Exit status: 0 done, 1 failed, 2 wrong usage, 3 server unreachable.",
        NULL,
        NULL,
        NULL};
    argp_parse(&how, argc, argv, 0, NULL, out);
}
