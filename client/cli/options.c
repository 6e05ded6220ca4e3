// SPDX-License-Identifier: MIT
// The commands and their options. One table of options yields the parsers and --help.
// Above 600 lines: a row and the parser of its value change together.
#include "cli.h"

#include <argp.h>
#include <assert.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

const char *argp_program_version = "relight " RELIGHT_VERSION;

// The type of an option's value. A plain one is stored at `field`; the others have a case in
// set_special.
enum kind {
    FLAG,  // bool
    TEXT,  // const char *
    REAL,  // float in [low, high]
    WHOLE, // uint32_t in [low, high]
    WORD,  // enum: `first` + index in `words`
    SPECIAL,
};

enum { FOREIGN = 1 }; // before a material's path

static const char *const terms[] = {"total", "irradiance", "multiple", "single", NULL};
static const char *const engines[] = {"default", "reference", "wavelet", "polynomial", "joint",
                                      "splat",   "tangent",   "texture", "hybrid",     NULL};
static const char *const color_formats[] = {
    "f32", "f16", "rgb9e5", "srgb8", "coefficients", "coefficients-packed", NULL};
static const char *const tones[] = {"filmic", "reinhard", "none", NULL};
static const char *const transports[] = {"wavelet", "polynomial", "joint", NULL};
static const char *const axes[] = {"y", "z", NULL};
static const char *const priorities[] = {"interactive", "still", "bulk", NULL};
static const char *const storages[] = {"factored", "sparse", NULL};
static const char *const scatterings[] = {"dipole", "walk", NULL};
static const char *const sample_counts[] = {"1", "2", "4", "8", NULL}; // of a pixel

// The words are in the order of the enums.
_Static_assert(RELIGHT_TERM_TOTAL == 0 && RELIGHT_TERM_SINGLE == 3, "terms");
_Static_assert(RELIGHT_ENGINE_HYBRID == 8, "engines");
_Static_assert(RELIGHT_COLOR_F32 == 0 && RELIGHT_COLOR_SRGB8 == 3, "formats of colours");
_Static_assert(RELIGHT_TONE_NONE == 2, "tones");
_Static_assert(RELIGHT_TRANSPORT_WAVELET == 1 && RELIGHT_TRANSPORT_JOINT == 3, "transports");
_Static_assert(RELIGHT_PRIORITY_INTERACTIVE == 1 && RELIGHT_PRIORITY_BULK == 3, "priorities");
_Static_assert(RELIGHT_SCATTERING_DIPOLE == 1 && RELIGHT_SCATTERING_WALK == 2, "scattering");
_Static_assert(RELIGHT_STORAGE_FACTORED == 1 && RELIGHT_STORAGE_SPARSE == 2, "storages");

#define AT(member) offsetof(struct options, member)

// Each command lists the keys of the options that it takes. Keys that cannot be printed have
// no short form.
static const struct row {
    char key;
    const char *name, *label;
    enum kind kind;
    size_t field;
    double low, high;
    const char *const *words;
    int first;
    const char *help;
} table[] = {
    {'s', "server", "ADDR", TEXT, AT(server), 0, 0, NULL, 0,
     "tcp:HOST:PORT, tls:HOST:PORT or unix:PATH (default: $RELIGHT_SERVER, "
     "unix:$XDG_RUNTIME_DIR/relightd.sock, tcp:127.0.0.1:7413)"},
    {'T', "timeout", "SECONDS", SPECIAL, 0, 1e-3, 1e6, NULL, 0,
     "fail after this time (default: wait)"},
    {'k', "token", "TOKEN", SPECIAL, 0, 0, 0, NULL, 0,
     "token for a daemon that requires one. Prefer $RELIGHT_TOKEN: other users of this machine can "
     "see arguments until the program has overwritten them"},
    {19, "ca", "FILE", TEXT, AT(ca), 0, 0, NULL, 0,
     "PEM file of the certificates that may sign the server's at tls:HOST:PORT (default: $RELIGHT_CA, "
     "the system's store)"},
    {'j', "json", NULL, FLAG, AT(json), 0, 0, NULL, 0, "print the answer as JSON"},
    {'o', "output", "FILE", TEXT, AT(output), 0, 0, NULL, 0,
     "file to write; its ending chooses the format"},
    {'e', "env", "ENV", SPECIAL, 0, 0, 0, NULL, 0,
     "light: an image file, env:HASH, constant or constant:R,G,B; may repeat, the lights are "
     "added"},
    {'r', "rotate", "DEG", SPECIAL, 0, -1e6, 1e6, NULL, 0,
     "turn the light counter-clockwise about +y, seen from above; one for every --env, or one for "
     "all"},
    {'G', "gain", "X|R,G,B", SPECIAL, 0, 0, 1e9, NULL, 0,
     "multiply the light; one for every --env, or one for all"},
    {'t', "term", "TERM", WORD, AT(shade.term), 0, 0, terms, 0,
     "irradiance, multiple, single or total (default)"},
    {'E', "eye", "X,Y,Z", SPECIAL, 0, 0, 0, NULL, 0,
     "viewpoint of view-dependent terms, in the model's units"},
    {'m', "material", "[OBJECT=]NAME|FILE", SPECIAL, 0, 0, 0, NULL, 0,
     "a preset's name, JSON text, a JSON file, or FILE or FILE#NAME of another program (MaterialX, "
     "Principled, pbrt), which the daemon converts; with OBJECT=, which may repeat, of this glTF "
     "material or node, else of all others"},
    {'g', "engine", "ENGINE", WORD, AT(shade.engine), 0, 0, engines, 0,
     "reference, wavelet, polynomial, joint, splat, tangent, texture or hybrid (default: the "
     "transport of the bake)"},
    {'X', "max-error", "X", SPECIAL, 0, 0, 1, NULL, 0,
     "load: error target of the bake; other commands: refuse an answer whose measured error bound "
     "is larger"},
    {'b', "budget-ms", "MS", WHOLE, AT(shade.budget_ms), 1, 1e6, NULL, 0,
     "image-space engines: time for one picture, in ms"},
    {'\27', "priority", "CLASS", WORD, AT(priority), 0, 0, priorities, 1,
     "order among your own requests: interactive, still (default) or bulk"},
    {'Y', "albedo-map", "FILE", TEXT, AT(map[0]), 0, 0, NULL, 0,
     "image-space engines: an image over the model's uv; its colours multiply the medium's "
     "reflectance"},
    {'y', "normal-map", "FILE", TEXT, AT(map[1]), 0, 0, NULL, 0,
     "image-space engines: tangent-space normals over the model's uv; they change the incident "
     "light"},
    {'J', "bump-map", "FILE", TEXT, AT(map[2]), 0, 0, NULL, 0,
     "image-space engines: heights over the model's uv; they change the incident light"},
    {'W', "bump-mm", "H", REAL, AT(shade.bump_mm), 1e-6, 1e4, NULL, 0,
     "height in mm of white in --bump-map (default 0.5)"},
    {'f', "format", "FORMAT", WORD, AT(format), 0, 0, color_formats, 0,
     "encoding of colours on the wire: f32 (default), f16, rgb9e5, srgb8, coefficients (small "
     "answers, which this program multiplies with the bake's factors) or coefficients-packed (two "
     "thirds of their bytes, colours some 0.1 % off)"},
    {'c', "camera", "NAME|CAMERA", SPECIAL, 0, 0, 0, NULL, 0,
     "a camera of the model's file (info lists them), or EYE:TARGET[:UP][:FOVY] as "
     "x,y,z:x,y,z:x,y,z:degrees (default: frame the model)"},
    {'\21', "orbit", "AZ,EL[,ZOOM]", SPECIAL, 0, 0, 0, NULL, 0,
     "look at the framed centre from this azimuth and elevation in degrees; 0,0 looks along -z, "
     "90,0 along -x; ZOOM magnifies"},
    {'z', "size", "WxH", SPECIAL, 0, 0, 0, NULL, 0,
     "size in pixels, up to 4096x4096 (default 800x600)"},
    {'q', "quality", "1..100", WHOLE, AT(picture.quality), 1, 100, NULL, 0,
     "quality of a JPEG (default 90)"},
    {'n', "tone", "MAP", WORD, AT(picture.tone), 0, 0, tones, 0,
     "filmic (default), reinhard or none"},
    {'x', "exposure", "STOPS", REAL, AT(picture.exposure_ev), -40, 40, NULL, 0,
     "brighten by a factor 2^STOPS"},
    {10, "floor", NULL, FLAG, AT(picture.floor), 0, 0, NULL, 0,
     "draw the shadow of the model on a plane under it; with --background transparent as alpha"},
    {'B', "background", "R,G,B|transparent", SPECIAL, 0, 0, 0, NULL, 0,
     "plain background in place of the environment, or none: alpha in PNG (straight colours) and "
     "EXR (premultiplied)"},
    {'a', "samples-per-pixel", "1|2|4|8", SPECIAL, 0, 0, 0, sample_counts, 0,
     "anti-aliasing (default 4)"},
    {'S', "no-specular", NULL, FLAG, AT(picture.no_specular), 0, 0, NULL, 0,
     "draw no specular reflection"},
    {'D', "size-mm", "D", REAL, AT(load.size_mm), 1e-3, 1e6, NULL, 0,
     "diagonal of the bounding box of the translucent objects, in mm"},
    {'U', "mm-per-unit", "X", REAL, AT(load.mm_per_unit), 1e-6, 1e6, NULL, 0,
     "millimetres in one unit of the model"},
    {'\22', "up", "AXIS", SPECIAL, 0, 0, 0, axes, 0,
     "the model's upward axis: y (default) or z, as scans and STL files often have it"},
    {'6', "flip-v", NULL, FLAG, AT(load.flip_v), 0, 0, NULL, 0,
     "the model's textures lie upside down (a face on the neck): v becomes 1 - v"},
    {'P', "transport", "KIND", WORD, AT(load.bake.transport), 0, 0, transports,
     RELIGHT_TRANSPORT_WAVELET, "wavelet, polynomial or joint"},
    {'R', "storage", "KIND", WORD, AT(load.bake.storage), 0, 0, storages,
     RELIGHT_STORAGE_FACTORED, "factored (default) or sparse"},
    {'Q', "scattering", "KIND", WORD, AT(load.bake.scattering), 0, 0, scatterings,
     RELIGHT_SCATTERING_DIPOLE,
     "multiple scattering: dipole (default), or walk, random walks inside the "
     "model"},
    // The daemon checks the ranges of a bake's settings.
    {'L', "walks", "N", WHOLE, AT(load.bake.walks), 1, UINT32_MAX, NULL, 0,
     "with --scattering walk: walks a vertex and channel (default: by vertices)"},
    {'N', "samples", "N", WHOLE, AT(load.bake.samples), 1, UINT32_MAX, NULL, 0,
     "irradiance samples on the surface"},
    {'C', "cube", "N", WHOLE, AT(load.bake.cube), 1, UINT32_MAX, NULL, 0,
     "resolution 6xNxN of the light: 16, 32, 64 or 128"},
    {'K', "coeffs", "N", WHOLE, AT(load.bake.coeffs), 1, UINT32_MAX, NULL, 0,
     "sparse: wavelet coefficients a vertex"},
    {'A', "rank", "R", WHOLE, AT(load.bake.rank), 1, UINT32_MAX, NULL, 0,
     "factored: dense numbers a vertex and term (default: chosen from --max-error)"},
    {'H', "phase-terms", "1|4|9", WHOLE, AT(load.bake.phase_terms), 1, UINT32_MAX, NULL, 0,
     "spherical-harmonic terms of the phase function"},
    {'9', "exit-planes", NULL, FLAG, AT(load.bake.exit_planes), 0, 0, NULL, 0,
     "add nine planes that correct single scattering towards an eye; frames of coefficients grow to "
     "three times their size"},
    {'7', "any-eta", NULL, FLAG, AT(load.bake.any_eta), 0, 0, NULL, 0,
     "joint transport for media of every refractive index from 1.2 to 1.6, not of the bake's own "
     "alone; takes two fifths more time"},
    {'d', "seed", "N", SPECIAL, 0, 0, 0, NULL, 0, "seed of the bake's random numbers"},
    {'O', "opaque", "NAME", SPECIAL, 0, 0, 0, NULL, 0,
     "a material or node that is opaque; may repeat"},
    {'M', "name", "NAME", TEXT, AT(load.name), 0, 0, NULL, 0,
     "name of the model in the list (default: the file's name)"},
    {'p', "pin", NULL, FLAG, AT(load.pin), 0, 0, NULL, 0, "never evict the model"},
    {'w', "wait", NULL, FLAG, AT(wait), 0, 0, NULL, 0, "return when the model is ready"},
    {'Z', "remote", NULL, FLAG, AT(remote), 0, 0, NULL, 0,
     "MODEL is a path in the daemon's models folder"},
    {'V', "preview", NULL, FLAG, AT(load.preview), 0, 0, NULL, 0,
     "order no bake: image-space engines answer"},
    {'\177', "no-draft", NULL, FLAG, AT(load.no_draft), 0, 0, NULL, 0,
     "no draft before the bake: it is ready some seconds sooner"},
    {'i', "positions", "FILE", TEXT, AT(positions), 0, 0, NULL, 0,
     "a .npy [n][3]: new positions of the vertices"},
    {'v', "normals", "FILE", TEXT, AT(normals), 0, 0, NULL, 0,
     "a .npy [n][3]: new normals (default: computed from the triangles)"},
    {'I', "first", "N", WHOLE, AT(first), 0, UINT32_MAX, NULL, 0,
     "the first vertex that moves (default 0)"},
    {'l', "files", NULL, FLAG, AT(files), 0, 0, NULL, 0,
     "also list the loadable files of the daemon's models folder and your uploaded images"},
    {'F', "forget", NULL, FLAG, AT(forget), 0, 0, NULL, 0, "delete the bake as well"},
    {'8', "force", NULL, FLAG, AT(force), 0, 0, NULL, 0,
     "with --forget: also where review rooms need the model, whose pins are lost then (needs admin)"},
    // Keys below the blank have no short option.
    {1, "name", "NAME", TEXT, AT(token_order.name), 0, 0, NULL, 0,
     "name of the token: letters, digits, dots, hyphens, underscores"},
    {2, "scope", "LIST", TEXT, AT(scopes), 0, 0, NULL, 0,
     "rights, comma-separated: view (look), edit (vertices, unload, cancel), upload (files, load), "
     "admin (what others made, tokens)"},
    {3, "expires", "TIME", SPECIAL, 0, 0, 0, NULL, 0,
     "it is valid for this time, such as 30d, 12h, 90m or 3600s (default: a token for ever, a link "
     "one day)"},
    {4, "rate", "N", SPECIAL, 0, 1e-6, 1e9, NULL, 0, "requests a second"},
    {5, "memory", "BYTES", SPECIAL, AT(token_order.quotas.memory), 0, 0, NULL, 0,
     "bytes held by its requests and views; k, M, G and T multiply by 1024"},
    {6, "models", "N", SPECIAL, AT(token_order.quotas.models), 0, 0, NULL, 0, "loaded models"},
    {7, "bakes", "N", SPECIAL, AT(token_order.quotas.bakes), 0, 0, NULL, 0,
     "bakes that wait or run"},
    {8, "views", "N", SPECIAL, AT(token_order.quotas.views), 0, 0, NULL, 0,
     "open views, watches and subscriptions"},
    {11, "disk", "BYTES", SPECIAL, AT(token_order.quotas.disk), 0, 0, NULL, 0,
     "bytes of its uploads and bakes on disk"},
    {12, "requests", "N", SPECIAL, AT(token_order.quotas.requests), 0, 0, NULL, 0,
     "open requests"},
    {14, "connections", "N", SPECIAL, AT(token_order.quotas.connections), 0, 0, NULL, 0,
     "open connections"},
    {15, "uploads", "N", SPECIAL, AT(token_order.quotas.uploads), 0, 0, NULL, 0,
     "unfinished uploads"},
    {16, "output", "BYTES", SPECIAL, AT(token_order.quotas.output), 0, 0, NULL, 0,
     "bytes of answers that it has not read yet"},
    {30, "follow", NULL, FLAG, AT(follow), 0, 0, NULL, 0,
     "wait for further events, also over a restart of the daemon"},
    {20, "as", "NAME", TEXT, AT(as), 0, 0, NULL, 0, "your name in the room (default: $USER)"},
    {21, "role", "ROLE", TEXT, AT(role), 0, 0, NULL, 0,
     "viewer, reviewer or owner; member: none removes"},
    {22, "at", "OBJECT,TRIANGLE,B1,B2", TEXT, AT(at), 0, 0, NULL, 0,
     "a point of the surface: the weights are those of the triangle's second and third corner"},
    {24, "model", "ID", TEXT, AT(model), 0, 0, NULL, 0, "the model that the room shows"},
    {25, "revision", "N", WHOLE, AT(revision), 1, UINT32_MAX, NULL, 0,
     "show: the picture of this revision"},
    {26, "decision", "N", WHOLE, AT(decision), 1, UINT32_MAX, NULL, 0,
     "show: the picture that this decision was about"},
    {13, "layout", "LAYOUT", TEXT, AT(layout), 0, 0, NULL, 0,
     "compare: side (both beside each other), wipe (the left half of one, the right half of the "
     "other), delta (differences, black 0 to white 10), or sheet (default: all of them)"},
    {28, "expires", "TIME", SPECIAL, 0, 0, 0, NULL, 0,
     "invite: for this time, such as 30d, 12h, 90m or 3600s (default: until it is revoked)"},
    {9, "variant", "NAME", SPECIAL, 0, 0, 0, NULL, 0,
     "materials of this variant of the glTF (info lists them; default: the file's own); load: the "
     "one that is baked"},
    {29, "animation", "NAME", TEXT, AT(animation), 0, 0, NULL, 0,
     "an animation of the glTF by its name or the unique beginning of it (prt info lists them)"},
    {31, "time", "S", REAL, AT(animation_time), 0, 1e9, NULL, 0,
     "moment of the animation in seconds (default 0)"},
    {27, "pose", "HASH", TEXT, AT(pose), 0, 0, NULL, 0,
     "vertices that relight pose put there, in place of the model's; image-space engines draw "
     "them"},
    {'u', "own-units", NULL, FLAG, AT(own_units), 0, 0, NULL, 0,
     "positions in the model's units (default: mm)"},
};
enum { N_TABLE = sizeof table / sizeof *table };
#define COMMON "sTkj\23"
#define LIGHT "erGtEgXbm\27\11"
#define TOKEN "\1\2\3\4\5\6\7\10\13\14\16\17\20"
#define PICTURE "cz\21qnxB\12aSYyJW\33"

const struct command commands[] = {
    {"ping", "",
     "Measures the round trip to the daemon.\v"
     "Example:\n  relight -s unix:/run/relightd.sock ping",
     COMMON, false, run_ping},
    {"models", "",
     "Lists the models the daemon holds.\v"
     "Examples:\n  relight models\n  relight models --files --json",
     COMMON "l", false, run_models},
    {"load", "MODEL",
     "Loads a model into the daemon and starts its bake.\v"
     "MODEL is a local .glb, .gltf, .obj, .ply or .stl file, which is uploaded unless the daemon has it, "
     "or a path in the daemon's models folder, which may also name a .prt. Prints the model's id and "
     "the bake's job.\n\n"
     "Image-space engines draw the model first. After some seconds a draft answers, with an error of "
     "some 3 % and without single scattering, and then the bake. With --no-draft there is no draft, "
     "with --preview no bake.\n\n"
     "Examples:\n  relight load bunny.obj --size-mm 50 --material marble --wait\n"
     "  relight load baked.prt --remote --name rabbit\n"
     "  relight load leaf.glb --size-mm 60 --material skin1 --scattering walk\n"
     "  relight load jade.glb --material jade.json --transport joint\n"
     "  relight load sketch.glb --material marble --preview",
     COMMON "DUm6\22\11PRQLNCKAH97dXOMpwZerV\177", true, run_load},
    {"info", "ID",
     "Prints a model's geometry, bake and measured error.\v"
     "Examples:\n  relight info bunny\n  relight info 3f9a --json",
     COMMON, true, run_info},
    {"watch", "JOB",
     "Follows a job to its end; exit status 1 if it fails.\v"
     "JOB may also be a model's id. With --json each change is one line.\n\n"
     "Example:\n  relight watch 12",
     COMMON, true, run_watch},
    {"events", "",
     "Prints what happens in the daemon: models that come, change and go, bakes, own uploads.\v"
     "Without --follow it prints the events that the daemon still keeps (up to 1024) and ends. With "
     "--json each event is one line.\n\n"
     "Examples:\n  relight events\n  relight events --follow --json",
     COMMON "\36", false, run_events},
    {"download", "HASH",
     "Fetches one of your uploads back.\v"
     "HASH is env:HASH as in `relight models --files`, or the 64 digits alone.\n\n"
     "Example:\n  relight download env:HASH -o sunrise.exr",
     COMMON "o", true, run_download},
    {"cancel", "JOB", "Stops a job.\vExample:\n  relight cancel 12", COMMON, true, run_cancel},
    {"env", "FILE",
     "Uploads and decodes an environment; prints env:HASH.\v"
     "Example:\n  relight env sunrise.exr",
     COMMON, true, run_env},
    {"colors", "ID",
     "Relights a model to vertex colours.\v"
     "Linear RGB radiance, one colour for each vertex of the model's file. FILE ends in .csv, "
     ".npy, .ply or .glb; the last two also hold the geometry.\n\n"
     "Examples:\n  relight colors bunny --env sunrise.exr --rotate 90 -o bunny.csv\n"
     "  relight colors bunny --env constant:1,1,1 --term multiple -o bunny.npy",
     COMMON LIGHT "ofx", true, run_colors},
    {"image", "ID",
     "Relights a model to a picture.\v"
     "FILE's ending is its format: .png, .exr (linear radiance) or another; - draws in the terminal: by kitty's "
     "protocol, as sixels or as half blocks, which $RELIGHT_TERMINAL (kitty, sixel, blocks, "
     "blocks256) overrides.\n\n"
     "Examples:\n  relight image bunny --env sunrise.exr --size 1280x720 -o bunny.png\n"
     "  relight image bunny --env env:HASH --camera 0,1,3:0,1,0 \\\n"
     "      --exposure -1 -o bunny.exr\n"
     "  relight image head --env studio.exr --albedo-map skin.jpg \\\n"
     "      --normal-map skin_n.png "
     "-o head.png",
     COMMON LIGHT PICTURE "o", true, run_image},
    {"edit", "ID",
     "Relights a model with another material, without a bake.\v"
     "Writes a picture or vertex colours, by the ending of FILE. The model needs joint or polynomial "
     "transport; polynomial transport keeps the light of its bake.\n\n"
     "Examples:\n  relight edit bunny --material skin1 --env studio.hdr -o bunny.png\n"
     "  relight edit bunny --env studio.hdr -o bunny.npy \\\n"
     "      --material '{\"sigma_s_prime\":[2,3,4],\"sigma_a\":[0,0,.1],\"eta\":1.3}'",
     COMMON LIGHT PICTURE "of", true, run_edit},
    {"geometry", "ID",
     "Fetches positions, normals and triangles.\v"
     "FILE ends in .ply, .glb or .npy (positions).\n\n"
     "Example:\n  relight geometry bunny -o bunny.ply",
     COMMON "ou", true, run_geometry},
    {"update-vertices", "ID",
     "Moves a model's vertices, without a bake.\v"
     "Triangles do not change. Image-space engines draw the new shape at once; the bake still answers "
     "for the old shape. unload restores the vertices.\n\n"
     "Example:\n  relight geometry bunny --own-units -o p.npy\n"
     "  relight update-vertices bunny --own-units --positions moved.npy",
     COMMON "iIuv", true, run_update},
    {"pose", "ID FILE",
     "Makes a pose of a moment of an animation; prints its name for --pose.\v"
     "FILE is the glTF that the model was loaded from; it is uploaded unless the daemon has it. "
     "Nodes, skins and morph targets move. The pose is named by its vertices and changes nothing "
     "for other clients; the daemon may drop one that nobody uses.\n\n"
     "Example:\n  relight pose walker walker.glb --animation walk --time 0.4\n"
     "  relight image walker --env studio.exr --pose HASH -o walker.png",
     COMMON "\35\37\22", true, run_pose},
    {"unload", "ID",
     "Frees a model's memory; keeps its bake without --forget.\v"
     "Example:\n  relight unload bunny",
     COMMON "F8", true, run_unload},
    {"token", "create|list|revoke [NAME]",
     "Creates, lists and revokes the daemon's tokens.\v"
     "Needs the scope admin, which the daemon's own user and root have on its unix socket. create "
     "prints the token, once; the daemon keeps its hash. revoke closes the connections of the "
     "token. As soon as a token exists, clients of TCP, HTTP and WebSocket need one. The other "
     "options of create are quotas; without one the daemon's limits apply.\n\n"
     "Examples:\n  relight token create --name anna --scope view,edit,upload --expires 30d\n"
     "  relight token create --name scraper --scope view --rate 1\n"
     "  relight token list\n  relight token revoke anna",
     COMMON TOKEN, true, run_token},
    {"room", "VERB [ARGUMENT...]",
     "Reviews models and materials with others.\v"
     "A room has a scene (model, lights, material, camera), pins with notes on the surface, and "
     "decisions. ROOM is its id, the beginning of one, or its name.\n\n"
     "  create NAME, list, show ROOM [PIN], log ROOM, watch ROOM\n"
     "  scene ROOM (--model, --env, --material, --camera, ...), undo ROOM, redo ROOM,\n"
     "  save ROOM [NOTE], variant ROOM NAME [--material M]\n"
     "  pin ROOM TEXT --at POINT, reply ROOM PIN TEXT, change ROOM NOTE TEXT,\n"
     "  resolve ROOM PIN, reopen ROOM PIN, erase ROOM NUMBER\n"
     "  approve ROOM [NOTE], reject ROOM [NOTE]\n"
     "  member ROOM PRINCIPAL --role R, invite ROOM [NAME] --role R --expires T,\n"
     "  revoke ROOM INVITATION, rename ROOM NAME, close ROOM, open ROOM\n"
     "  anchors ROOM (where the pins lie on the model that the room shows now),\n"
     "  act ROOM JSON (a RoomAction of relight.proto, such as a stroke)\n"
     "  compare ROOM [REVISION [REVISION]] [-o FILE.png]\n"
     "  export ROOM -o FOLDER, import ROOM FILE.bcf, backup -o FILE\n\n"
     "show with -o FILE.png draws the scene, or what the author of a pin (PIN), of a --decision or "
     "of a --revision saw. export writes the room as JSON with pictures, decisions as CSV, pins as "
     "BCF 2.1, and the approved material; what cannot be drawn any more is left out, with exit "
     "status 1. Files of an earlier export that the room no longer has are removed. import "
     "makes pins of the topics of a BCF file (2.1, 3.0); one of another program is placed where "
     "the middle of its view shows the room's model. compare prints the CIEDE2000 of two "
     "revisions' pictures, of a revision and the scene now, or of the newest decision and the "
     "scene now.\n\n"
     "Examples:\n  relight room create 'Bunny in jade' --model bunny \\\n"
     "      --env studio.exr --material jade\n"
     "  relight room invite 'Bunny in jade' Ann --role reviewer --expires 7d\n"
     "  relight room pin 'Bunny in jade' 'too red, @Bob' --at 0,1204,0.3,0.2\n"
     "  relight room show 'Bunny in jade' 12 -o pin.png\n"
     "  relight room approve 'Bunny in jade' 'as agreed'\n"
     "  relight room compare 'Bunny in jade' 7 9 -o changed.png\n"
     "  relight room export 'Bunny in jade' -o review",
     COMMON LIGHT "cz\21xnBaSo\24\25\26\30\31\32\34\15", true, run_room},
    {"sign", "PATH",
     "Signs a link to a picture: whoever has it sees that picture, until it expires.\v"
     "PATH is the path and query of a picture over HTTP. Prints the path to put behind the address "
     "of --http, for <img> in any page. The link has the rights of your token, `view` at most, and "
     "ends with it; a token of its own, with a --rate, keeps viewers of links apart from you.\n\n"
     "Examples:\n  relight sign '/v1/models/bunny/image.jpg?env=constant&size=800x600'\n"
     "  relight sign --expires 30d '/v1/models/bunny/image.png?env=studio'",
     COMMON "\3", true, run_sign},
    {"stats", "", "Prints the daemon's counters.\vExample:\n  relight stats --json", COMMON,
     false, run_stats},
    {NULL, NULL, NULL, NULL, false, NULL},
};

struct input {
    struct options *options;
    const struct command *command;
};

static double number(struct argp_state *state, const struct row *row, const char *text)
{
    char *end;
    errno = 0;
    double x = strtod(text, &end);
    if (end == text || *end || errno || !isfinite(x) || x < row->low || x > row->high)
        argp_error(state, "--%s %s: expected a number in [%g, %g]", row->name, text, row->low,
                   row->high);
    return x;
}

static uint64_t whole(struct argp_state *state, const struct row *row, const char *text,
                      uint64_t low, uint64_t high)
{
    char *end;
    errno = 0;
    unsigned long long x = strtoull(text, &end, 10);
    if (end == text || *end || errno || strchr(text, '-') || x < low || x > high)
        argp_error(state, "--%s %s: expected a whole number in [%llu, %llu]", row->name, text,
                   (unsigned long long)low, (unsigned long long)high);
    return x;
}

static void triple(struct argp_state *state, const struct row *row, const char *text,
                   float out[3])
{
    int used = 0;
    if (sscanf(text, "%f,%f,%f%n", out, out + 1, out + 2, &used) != 3 || text[used] ||
        !isfinite(out[0]) || !isfinite(out[1]) || !isfinite(out[2]))
        argp_error(state, "--%s %s: expected three numbers x,y,z", row->name, text);
}

// Index of a word in the row's list.
static int word(struct argp_state *state, const struct row *row, const char *text)
{
    char all[128] = "";
    for (int i = 0; row->words[i]; i++) {
        if (!strcmp(row->words[i], text)) return i;
        size_t n = strlen(all);
        snprintf(all + n, sizeof all - n, "%s%s", i ? ", " : "", row->words[i]);
    }
    argp_error(state, "--%s %s: expected one of %s", row->name, text, all);
    return 0;
}

// The text of a material's file; malloc()ed. NULL: it is another program's.
static char *material_file(struct argp_state *state, const char *path, FILE *file)
{
    enum { MAX = 1 << 16 };
    char *bytes = malloc(MAX + 1);
    size_t n = bytes ? fread(bytes, 1, MAX + 1, file) : 0;
    if (!n || ferror(file)) argp_failure(state, EXIT_FAILED, 0, "%s: cannot be read", path);
    bytes[n < MAX ? n : MAX] = 0;
    // The daemon recognises JSON text by its first character.
    char *text = bytes + strspn(bytes, " \t\r\n");
    const char *dot = strrchr(path, '.');
    if (*text != '{' && dot && !strcmp(dot, ".json"))
        argp_failure(state, EXIT_FAILED, 0,
                     "%s: is not a material's JSON: it does not begin with {", path);
    bool own =
        *text == '{' && (strstr(text, "\"sigma_s_prime\"") || strstr(text, "\"profile\""));
    if (own && (n > MAX || strnlen(bytes, n) != n))
        argp_failure(state, EXIT_FAILED, 0, "%s: is not a material's JSON (1 to 65536 bytes)",
                     path);
    text = own ? strdup(text) : NULL;
    if (own && !text) argp_failure(state, EXIT_FAILED, 0, "not enough memory");
    free(bytes);
    return text;
}

// A preset's name and JSON text are sent as they are; of a file, the contents are sent. FOREIGN
// stands before the path of another program's file, which the daemon converts.
static char *material_text(struct argp_state *state, const char *text)
{
    FILE *file = *text == '{' ? NULL : fopen(text, "re");
    const char *dot = strrchr(text, '.'), *hash = strrchr(text, '#');
    char path[4096], *own = NULL;
    bool foreign = false;
    if (!file && hash && (size_t)(hash - text) < sizeof path) { // FILE#NAME
        snprintf(path, sizeof path, "%.*s", (int)(hash - text), text);
        foreign = *text != '{' && !access(path, R_OK);
    }
    if (!file && !foreign && dot && (!strcmp(dot, ".json") || !strcmp(dot, ".mtlx")))
        argp_failure(state, EXIT_FAILED, errno, "%s", text);
    if (file) own = material_file(state, text, file);
    foreign |= file && !own;
    if (file) fclose(file);
    if (!foreign && !own) own = strdup(text);
    if (foreign && asprintf(&own, "%c%s", FOREIGN, text) < 0) own = NULL;
    if (!own) argp_failure(state, EXIT_FAILED, 0, "not enough memory");
    return own;
}

// "OBJECT=" ends before the first '{' or '/', as for prt.
static void material(struct argp_state *state, struct options *o, const char *text)
{
    size_t n = strcspn(text, "={/");
    struct relight_object_material *own = &o->materials[o->n_material];
    if (text[n] != '=' || !n) {
        if (o->material)
            argp_error(state,
                       "two --material are for all objects: name the object of one, "
                       "--material OBJECT=%s",
                       text);
        o->material = material_text(state, text);
        o->shade.material = o->load.material = o->material;
        return;
    }
    if (o->n_material == RELIGHT_MAX_MATERIAL)
        argp_error(state, "--material: at most %d objects", RELIGHT_MAX_MATERIAL);
    own->object = strndup(text, n);
    if (!own->object) argp_failure(state, EXIT_FAILED, 0, "not enough memory");
    own->material = material_text(state, text + n + 1);
    o->n_material++;
    o->shade.n_material = o->load.n_material = o->n_material;
    o->shade.materials = o->load.materials = o->materials;
}

// Arguments of a process are visible to other users: the token is copied and overwritten.
static void take_token(struct argp_state *state, struct options *o, char *text)
{
    free(o->own_token);
    o->own_token = strdup(text);
    if (!o->own_token) argp_failure(state, EXIT_FAILED, 0, "not enough memory");
    o->token = o->own_token;
    memset(text, 'x', strlen(text));
}

// The protocol takes 0,0,0 for a gain that was not given.
static void gain(struct argp_state *state, const struct row *row, const char *text,
                 float out[3])
{
    if (strchr(text, ',')) {
        triple(state, row, text, out);
    } else {
        float x = (float)number(state, row, text);
        for (int c = 0; c < 3; c++) out[c] = x;
    }
    if (!(fabsf(out[0]) + fabsf(out[1]) + fabsf(out[2]) > 0))
        argp_error(state, "--gain %s: a light that is off: leave its --env out", text);
}

// Options that may repeat.
static error_t append(struct options *o, const struct row *row, char *arg,
                      struct argp_state *state)
{
    size_t *n = row->key == 'e'   ? &o->n_env
                : row->key == 'r' ? &o->n_rotate
                : row->key == 'G' ? &o->n_gain
                                  : &o->load.n_opaque;
    if (*n == MAX_WORDS) argp_error(state, "--%s: at most %d", row->name, MAX_WORDS);
    if (row->key == 'e') o->env[*n] = arg;
    else if (row->key == 'r') o->rotate_deg[*n] = (float)number(state, row, arg);
    else if (row->key == 'G') gain(state, row, arg, o->gain[*n]);
    else o->opaque[*n] = arg;
    ++*n;
    return 0;
}

// "30d" in seconds.
static uint64_t duration(struct argp_state *state, const struct row *row, const char *text)
{
    static const struct {
        char unit;
        double seconds;
    } units[] = {{'s', 1}, {'m', 60}, {'h', 3600}, {'d', 86400}, {'w', 7 * 86400}};
    char *end;
    double x = strtod(text, &end);
    for (size_t i = 0; end != text && i < sizeof units / sizeof *units; i++)
        if (*end == units[i].unit && !end[1] && x * units[i].seconds >= 1 &&
            x * units[i].seconds < 1e6 * 7 * 86400)
            return (uint64_t)(x * units[i].seconds);
    argp_error(state, "--%s %s: expected a time such as 30d, 12h, 90m or 3600s", row->name,
               text);
    return 0;
}

// A whole number with an optional k, M, G or T.
static uint64_t quota(struct argp_state *state, const struct row *row, const char *text)
{
    static const char units[] = "kMGT";
    char *end;
    double x = strtod(text, &end);
    const char *unit = *end ? strchr(units, *end) : NULL;
    for (long i = 0; unit && i <= unit - units; i++) x *= 1024;
    if (end == text || (*end && (!unit || end[1])) || !(x >= 1 && x < 9e15) || x != floor(x))
        argp_error(state,
                   "--%s %s: expected a whole number of at least 1, with an optional k, M, "
                   "G or T",
                   row->name, text);
    return (uint64_t)x;
}

static error_t set_special(struct options *o, const struct row *row, char *arg,
                           struct argp_state *state)
{
    struct relight_error error;
    switch (row->key) {
    case 'T':
        o->timeout_s = number(state, row, arg);
        return 0;
    case 'k':
        take_token(state, o, arg);
        return 0;
    case 'E':
        triple(state, row, arg, o->shade.eye);
        o->shade.has_eye = true;
        return 0;
    case 'm':
        material(state, o, arg);
        return 0;
    case 'X':
        o->load.bake.max_error = o->shade.max_error = (float)number(state, row, arg);
        return 0;
    case 'c':
        if (relight_camera_parse(arg, &o->picture.camera, &error))
            argp_error(state, "%s", error.text);
        return 0;
    case 9:
        o->shade.variant = o->load.variant = arg;
        return 0;
    case '\21':
        if (relight_orbit_parse(arg, &o->picture.camera, &error))
            argp_error(state, "%s", error.text);
        return 0;
    case '\22':
        o->load.up_z = word(state, row, arg) == 1;
        return 0;
    case 'z':
        option_size(state, arg, &o->picture.width, &o->picture.height);
        return 0;
    case 'B':
        if (!strcmp(arg, "transparent")) {
            o->picture.transparent = true;
            return 0;
        }
        triple(state, row, arg, o->picture.background);
        o->picture.plain_background = true;
        return 0;
    case 'a':
        o->picture.samples = 1u << word(state, row, arg);
        return 0;
    case 3:
    case 28:
        o->token_order.lifetime_s = duration(state, row, arg);
        return 0;
    case 4:
        o->token_order.quotas.rate = number(state, row, arg);
        return 0;
    case 'd':
        o->load.bake.seed = whole(state, row, arg, 0, UINT64_MAX);
        return 0;
    default:
        if (row->key < ' ') {
            *(uint64_t *)((char *)o + row->field) = quota(state, row, arg);
            return 0;
        }
        return append(o, row, arg, state);
    }
}

static error_t set(int key, char *arg, struct argp_state *state)
{
    struct options *o = ((struct input *)state->input)->options;
    const struct row *row = table;
    while (row < table + N_TABLE && row->key != key) row++;
    if (row == table + N_TABLE) return ARGP_ERR_UNKNOWN;
    o->given[(uint8_t)key] = true;
    void *field = (char *)o + row->field;
    switch (row->kind) {
    case FLAG:
        *(bool *)field = true;
        return 0;
    case TEXT:
        *(const char **)field = arg;
        return 0;
    case REAL:
        *(float *)field = (float)number(state, row, arg);
        return 0;
    case WHOLE:
        *(uint32_t *)field =
            (uint32_t)whole(state, row, arg, (uint64_t)row->low, (uint64_t)row->high);
        return 0;
    case WORD:
        *(int *)field = row->first + word(state, row, arg);
        return 0;
    case SPECIAL:
        return set_special(o, row, arg, state);
    }
    return ARGP_ERR_UNKNOWN;
}

static void pick(struct argp_option out[N_TABLE + 1], const char *keys)
{
    unsigned n = 0;
    for (unsigned i = 0; i < N_TABLE; i++) {
        if (!strchr(keys, table[i].key)) continue;
        out[n++] = (struct argp_option){
            .name = table[i].name,
            .key = table[i].key,
            .arg = table[i].label,
            .doc = table[i].help,
            .group = strchr(COMMON, table[i].key) ? 1 : 0,
        };
    }
    memset(out + n, 0, sizeof *out);
}

static error_t parse_command(int key, char *arg, struct argp_state *state)
{
    struct input *input = state->input;
    if (key == ARGP_KEY_ARG) {
        struct options *o = input->options;
        const char *args = input->command->args;
        // "[NAME]" or "ID FILE": one word more; "[ARGUMENT...]": several.
        unsigned most = strstr(args, "...]") ? MAX_WORDS : strchr(args, ' ') ? 1 : 0;
        if (!input->command->has_target || (o->target && o->n_word >= most))
            argp_error(state, "one argument too many: %s", arg);
        if (o->target) {
            o->words[o->n_word++] = arg;
            return 0;
        }
        input->options->target = arg;
        return 0;
    }
    if (key == ARGP_KEY_END) {
        if (input->command->has_target && !input->options->target)
            argp_error(state, "%s is missing", input->command->args);
        return 0;
    }
    return set(key, arg, state);
}

static error_t parse_main(int key, char *arg, struct argp_state *state)
{
    struct input *input = state->input;
    if (key == ARGP_KEY_NO_ARGS) argp_error(state, "no command given");
    if (key != ARGP_KEY_ARG) return set(key, arg, state);
    for (const struct command *c = commands; c->name; c++)
        if (!strcmp(c->name, arg)) input->command = c;
    if (!input->command) argp_error(state, "unknown command: %s", arg);
    input->options->command = input->command->name;
    return 0;
}

static char *main_doc(void)
{
    char *text = NULL;
    size_t n;
    FILE *f = open_memstream(&text, &n);
    if (!f) return NULL;
    fputs("Relights translucent models with a relightd daemon.\vCommands:\n", f);
    for (const struct command *c = commands; c->name; c++) {
        char head[32];
        snprintf(head, sizeof head, "%s %s", c->name, c->args);
        fprintf(f, "  %-16s %.*s\n", head, (int)strcspn(c->doc, "\v"), c->doc);
    }
    fputs("\n'relight COMMAND --help' prints the options of a command.\n\n"
          "Exit status: 0 done, 1 failed, 2 wrong usage, 3 server unreachable.\n\n"
          "Example:\n  relight load bunny.obj --size-mm 50 --material marble --wait\n"
          "  relight image bunny --env sunrise.exr -o bunny.png",
          f);
    fclose(f);
    return text;
}

// Two options with one key would be one.
static void check_keys(void)
{
    for (int i = 0; i < N_TABLE; i++)
        for (int k = 0; k < i; k++) assert(table[i].key != table[k].key);
}

const struct command *options_parse(int argc, char **argv, struct options *options)
{
    check_keys();
    *options = (struct options){0};
    struct input input = {options, NULL};
    struct argp_option picked[N_TABLE + 1];
    argp_err_exit_status = EXIT_USAGE;
    options->token = getenv("RELIGHT_TOKEN");
    options->load.opaque = options->opaque;

    char *doc = main_doc();
    pick(picked, COMMON);
    struct argp top = {picked, parse_main, "COMMAND [ARGUMENT] [OPTION...]", doc, NULL,
                       NULL,   NULL};
    // The command is the first word that is neither an option nor an option's value. The first
    // parser takes the words up to the command, the command's own parser takes the rest.
    int first = 1;
    while (first < argc && argv[first][0] == '-' && argv[first][1]) {
        const char *w = argv[first];
        bool takes = (!strcmp(w, "-s") || !strcmp(w, "-T") || !strcmp(w, "-k") ||
                      !strcmp(w, "--server") || !strcmp(w, "--timeout") ||
                      !strcmp(w, "--token") || !strcmp(w, "--ca"));
        first += takes ? 2 : 1;
    }
    if (first > argc) first = argc;
    argp_parse(&top, first < argc ? first + 1 : argc, argv, ARGP_IN_ORDER, NULL, &input);
    free(doc);

    static char name[64];
    snprintf(name, sizeof name, "relight %s", input.command->name);
    argv[first] = name;
    pick(picked, input.command->takes);
    struct argp sub = {picked, parse_command, input.command->args, input.command->doc, NULL,
                       NULL,   NULL};
    argp_parse(&sub, argc - first, argv + first, 0, NULL, &input);
    return input.command;
}

// The JSON text of a file that the daemon converts, in place of its path.
static int convert(struct relight_client *client, const struct options *o, char **text)
{
    struct relight_error error;
    struct relight_medium medium;
    if (!*text || **text != FOREIGN) return EXIT_DONE;
    char *path = *text + 1, *hash = access(path, R_OK) ? strrchr(path, '#') : NULL;
    if (hash) *hash = 0;
    int status = relight_material_file(client, path, hash ? hash + 1 : NULL, &medium, &error);
    if (status) return report_error(o, &error);
    for (size_t i = 0; i < medium.n_warning; i++)
        fprintf(stderr, "relight: %s\n", escape(medium.warning[i]).text);
    char *json = strdup(medium.json);
    relight_medium_finish(&medium);
    if (!json) return EXIT_FAILED;
    free(*text);
    *text = json;
    return EXIT_DONE;
}

int options_materials(struct relight_client *client, struct options *o)
{
    int status = convert(client, o, &o->material);
    o->shade.material = o->load.material = o->material;
    for (size_t i = 0; i < o->n_material && !status; i++) {
        char *text = (char *)(uintptr_t)o->materials[i].material;
        status = convert(client, o, &text);
        o->materials[i].material = text;
    }
    return status;
}

void options_finish(struct options *options)
{
    free(options->material);
    for (size_t i = 0; i < options->n_material; i++) {
        free((char *)(uintptr_t)options->materials[i].object);
        free((char *)(uintptr_t)options->materials[i].material);
    }
    free(options->own_token);
}
