// SPDX-License-Identifier: MIT
// The command line of relight-preview.
#include "preview.h"
#include "common/picture_ending.h"

#include "video.h"

#include <argp.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

const char *argp_program_version = "relight-preview " RELIGHT_VERSION;

enum { KEY_NO_TEXTURES = 256, KEY_TRY, KEY_DIFFERENCE, KEY_FPS, KEY_FOLLOW, KEY_VARIANT };
static const struct argp_option table[] = {
    {"server", 's', "ADDR", 0,
     "tcp:HOST:PORT, tls:HOST:PORT or unix:PATH (default as for relight)", 0},
    {"timeout", 'T', "SECONDS", 0, "fail after this time without an answer (default: wait)", 0},
    {"env", 'e', "ENV", 0,
     "an image file, env:HASH, constant or constant:R,G,B; each --env gives "
     "a row of pictures. Background and reflections need a file",
     0},
    {"rotate", 'r', "DEG", 0, "turn the light counter-clockwise about +y", 0},
    {"frames", 'N', "N", 0, "draw a full turn in N pictures", 0},
    {"turn", 't', "camera|light", 0, "turn the camera (default) or the light", 0},
    {"sheet", 'S', NULL, 0,
     "all pictures in one file: a row for each --env, a column for each "
     "frame or --try",
     0},
    {"try", KEY_TRY, "[OBJECT=]NAME|FILE", 0,
     "a column with this material; may repeat, in place of --frames", 0},
    {"difference", KEY_DIFFERENCE, NULL, 0,
     "of two pictures (two --env or two --try) the map of CIEDE2000, black 0 to white 10, as "
     ".png, and its numbers",
     0},
    {"follow", KEY_FOLLOW, "ROOM", 0,
     "in place of ID and --env: a picture of this review room's scene now and after every change, "
     "drawn by the daemon, until --frames or Ctrl-C; FILE-0001 and so on, or a film. A scene that the "
     "daemon refuses is told and left out",
     0},
    {"fps", KEY_FPS, "RATE", 0, "frames a second of a film (default 25)", 0},
    {"gap", 'g', "PIXELS", 0, "space between the pictures of a sheet (default 4)", 0},
    {"output", 'o', "FILE", 0,
     "a picture, whose ending is its format, such as .png or .exr; of several, FILE-ENV-FRAME. A "
     "film ends in .mp4 or .webm and needs ffmpeg",
     0},
    {"variant", KEY_VARIANT, "NAME", 0,
     "materials of this variant of the glTF (relight info lists them), or default: the file's own",
     0},
    {"material", 'm', "[OBJECT=]NAME|FILE", 0,
     "another material (joint transport), of this glTF material or node or of all others; may "
     "repeat",
     0},
    {"size", 'z', "WxH", 0, "pixels of a picture, up to 4096x4096 (default 800x600)", 0},
    {"camera", 'c', "NAME|CAMERA", 0,
     "a camera of the model's file (relight info lists them), or EYE:TARGET[:UP[:FOVY]] as "
     "x,y,z:x,y,z:x,y,z:deg (default: frame the model)",
     0},
    {"orbit", 'O', "AZ,EL[,ZOOM]", 0,
     "look at the framed centre from this azimuth and elevation in degrees; 0,0 looks along -z, "
     "90,0 along -x; ZOOM magnifies",
     0},
    {"samples-per-pixel", 'a', "1|2|4|8", 0, "anti-aliasing (default 4)", 0},
    {"no-specular", 'n', NULL, 0, "draw no specular reflection", 0},
    {"no-textures", KEY_NO_TEXTURES, NULL, 0, "leave the model's textures out", 0},
    {"background", 'B', "R,G,B|transparent", 0,
     "plain background in place of the environment, or none: alpha in PNG (straight colours) and "
     "EXR (premultiplied)",
     0},
    {"tone", 'M', "MAP", 0, "filmic (default), reinhard or none", 0},
    {"exposure", 'x', "STOPS", 0, "brighten by a factor 2^STOPS", 0},
    {"quality", 'q', "1..100", 0, "quality of a JPEG (default 90)", 0},
    {"format", 'f', "FORMAT", 0,
     "encoding of colours on the wire: f32, f16 (default) or rgb9e5, which gives way to f16 where "
     "colours depend on the view (g is not 0, planes of exit)",
     0},
    {"json", 'j', NULL, 0, "print a line of JSON for each file", 0},
    {0},
};

static int word(struct argp_state *state, const char *what, const char *text, const char *list)
{
    char all[64] = "";
    int i = 0;
    for (const char *at = list; *at; at += strlen(at) + 1, i++) {
        if (!strcmp(at, text)) return i;
        snprintf(all + strlen(all), sizeof all - strlen(all), "%s%s", i ? ", " : "", at);
    }
    argp_error(state, "--%s %s: expected one of %s", what, text, all);
    return 0;
}

static void camera(struct argp_state *state, struct options *o, const char *text)
{
    struct relight_camera c;
    struct relight_error error;
    if (relight_camera_parse(text, &c, &error)) argp_error(state, "%s", error.text);
    o->camera_name = c.name[0] ? text : NULL;
    o->orbit.zoom = 0;
    if (o->camera_name) return;
    memcpy(o->camera.eye, c.eye, sizeof c.eye);
    memcpy(o->camera.target, c.target, sizeof c.target);
    bool up = c.up[0] != 0 || c.up[1] != 0 || c.up[2] != 0;
    for (int i = 0; i < 3; i++) o->camera.up[i] = up ? c.up[i] : i == 1;
    o->camera.fovy_deg = c.fovy_deg > 0 ? c.fovy_deg : 36;
    o->camera.automatic = false;
}

static void orbit(struct argp_state *state, struct options *o, const char *text)
{
    struct relight_camera c;
    struct relight_error error;
    if (relight_orbit_parse(text, &c, &error)) argp_error(state, "%s", error.text);
    o->orbit = (struct prt_orbit){c.azimuth_deg, c.elevation_deg, c.zoom};
    o->camera_name = NULL;
    o->camera.automatic = true;
}

// Options of each picture.
static error_t parse_picture(int key, char *arg, struct argp_state *state)
{
    struct options *o = state->input;
    int used = 0;
    switch (key) {
    case 'z':
        option_size(state, arg, &o->width, &o->height);
        break;
    case 'c':
        camera(state, o, arg);
        break;
    case 'O':
        orbit(state, o, arg);
        break;
    case 'a':
        o->samples = 1u << word(state, "samples-per-pixel", arg,
                                "1\0"
                                "2\0"
                                "4\0"
                                "8\0");
        break;
    case 'n':
        o->no_specular = true;
        break;
    case KEY_VARIANT:
        o->variant = arg;
        break;
    case KEY_NO_TEXTURES:
        o->no_textures = true;
        break;
    case 'B':
        if (!strcmp(arg, "transparent")) {
            o->transparent = true;
            break;
        }
        if (sscanf(arg, "%f,%f,%f%n", o->background, o->background + 1, o->background + 2,
                   &used) != 3 ||
            arg[used])
            argp_error(state, "--background %s: expected r,g,b or transparent", arg);
        o->plain = true;
        break;
    case 'M':
        o->tone = (enum prt_tone)word(state, "tone", arg, "filmic\0reinhard\0none\0");
        break;
    case 'x':
        o->exposure_ev = (float)option_number(state, "exposure", arg, -40, 40);
        break;
    case 'q':
        o->quality = (int)option_number(state, "quality", arg, 1, 100);
        break;
    case 'f':
        o->format = (enum relight_color_format)word(state, "format", arg, "f32\0f16\0rgb9e5\0");
        break;
    default:
        return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static void check_output(struct argp_state *state, const struct options *o)
{
    char endings[100];
    const bool film = o->output && video_is_name(o->output);
    const struct prt_picture_format *format = o->output ? prt_picture_format(o->output) : NULL;
    if (!film && !format)
        argp_error(state, "-o FILE has to end in %s, .mp4 or .webm",
                   prt_picture_endings(endings));
    if (o->n_try && o->n_frame > 1) argp_error(state, "--try: a column each, as --frames");
    if (o->n_try && o->n_material == PRT_MEDIA_MAX)
        argp_error(state, "--material: at most %d with --try", PRT_MEDIA_MAX - 1);
    if (film && (o->sheet || o->difference))
        argp_error(state, "%s: a film has neither --sheet nor --difference", o->output);
    if (o->transparent && !(format && format->alpha))
        argp_error(state, "%s has no alpha: --background transparent is for .png and .exr",
                   o->output);
    if (!o->difference) return;
    if (o->sheet || o->n_env * options_columns(o) != 2)
        argp_error(state, "--difference: of two pictures, two --env or two --try");
    if (format != prt_picture_format(".png") || o->transparent)
        argp_error(state, "--difference: -o FILE has to end in .png, with a background");
}

// --follow ROOM takes model, lights, materials and camera from the room. Without it ID and
// --env are required.
static void check_follow(struct argp_state *state, const struct options *o)
{
    if (!o->follow && !o->model) argp_error(state, "ID is missing");
    if (!o->follow && !o->n_env) argp_error(state, "--env is missing");
    if (!o->follow) return;
    if (o->model || o->n_env || o->n_material || o->n_try || o->variant || o->camera_name ||
        o->orbit.zoom > 0 || !o->camera.automatic || o->look_given)
        argp_error(state, "--follow: the room has the model, its lights, materials, camera and "
                          "picture; --size and --quality are this program's");
    if (o->sheet || o->difference || o->turn_light)
        argp_error(state, "--follow: no --sheet, --difference or --turn");
    enum relight_image_format format;
    char list[128];
    if (o->output && !video_is_name(o->output) && !picture_ending(o->output, &format))
        argp_error(state, "--follow: the daemon writes %s", picture_ending_list(list));
}

// How a picture looks, which a room's scene says.
static bool is_look(int key)
{
    return key == 'r' || key == 'a' || key == 'n' || key == KEY_NO_TEXTURES || key == 'B' ||
           key == 'M' || key == 'x';
}

static error_t parse(int key, char *arg, struct argp_state *state)
{
    struct options *o = state->input;
    o->look_given |= is_look(key);
    switch (key) {
    case 's':
        o->server = arg;
        break;
    case 'T':
        o->timeout_s = option_number(state, "timeout", arg, 1e-3, 1e6);
        break;
    case 'e':
        if (o->n_env == MAX_ENV) argp_error(state, "--env: at most %d", MAX_ENV);
        o->env[o->n_env++] = arg;
        break;
    case 'r':
        o->rotate_deg = option_number(state, "rotate", arg, -1e6, 1e6);
        break;
    case 'N':
        o->n_frame = (uint32_t)option_number(state, "frames", arg, 1, 3600);
        break;
    case 't':
        o->turn_light = word(state, "turn", arg, "camera\0light\0");
        break;
    case 'S':
        o->sheet = true;
        break;
    case 'g':
        o->gap = (uint32_t)option_number(state, "gap", arg, 0, 256);
        break;
    case 'o':
        o->output = arg;
        break;
    case 'm':
        if (o->n_material == PRT_MEDIA_MAX)
            argp_error(state, "--material: at most %d", PRT_MEDIA_MAX);
        o->material[o->n_material++] = arg;
        break;
    case KEY_TRY:
        if (o->n_try == MAX_TRY) argp_error(state, "--try: at most %d", MAX_TRY);
        o->attempt[o->n_try++] = arg;
        break;
    case KEY_DIFFERENCE:
        o->difference = true;
        break;
    case KEY_FOLLOW:
        o->follow = arg;
        break;
    case KEY_FPS:
        o->fps = option_number(state, "fps", arg, 0.1, 240);
        break;
    case 'j':
        o->json = true;
        break;
    case ARGP_KEY_ARG:
        if (o->model) argp_error(state, "one argument too many: %s", arg);
        o->model = arg;
        break;
    case ARGP_KEY_END:
        check_follow(state, o);
        if (!o->follow && !o->n_frame) o->n_frame = 1;
        check_output(state, o);
        break;
    default:
        return parse_picture(key, arg, state);
    }
    return 0;
}

void options_parse(int argc, char **argv, struct options *options)
{
    *options = (struct options){.width = 800,
                                .height = 600,
                                .samples = 4,
                                .gap = 4,
                                .fps = 25,
                                .quality = 90,
                                .format = RELIGHT_COLOR_F16};
    options->camera.automatic = true;
    argp_err_exit_status = EXIT_USAGE;
    static const struct argp how = {
        table,
        parse,
        "ID\n--follow=ROOM",
        "Draws pictures of a model with colours from a relightd daemon.\v"
        "The daemon sends geometry and colours; this program draws the pictures. It sends the "
        "token of $RELIGHT_TOKEN to a daemon that requires one.\n\n"
        "Examples:\n"
        "  relight-preview bunny --env sunrise.exr -o bunny.png\n"
        "  relight-preview bunny --env sunrise.exr --frames 36 -o turn.jpg\n"
        "  relight-preview bunny --env sunrise.exr --env studio.exr --frames 6 \\\n"
        "      --turn light --sheet --size 320x240 -o sheet.png\n"
        "  relight-preview bunny --env sunrise.exr --env studio.exr --try marble \\\n"
        "      --try jade.json --sheet -o sheet.png\n"
        "  relight-preview bunny --env studio.exr --try marble --try skin1 \\\n"
        "      --difference -o difference.png\n"
        "  relight-preview bunny --env studio.exr --frames 100 --turn light -o turn.mp4\n"
        "  relight-preview --follow 'Bunny, first review' -o review.webm\n\n"
        "Exit status: 0 done, 1 failed, 2 wrong usage, 3 server unreachable.",
        NULL,
        NULL,
        NULL};
    argp_parse(&how, argc, argv, 0, NULL, options);
}
