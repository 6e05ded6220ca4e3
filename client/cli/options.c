// SPDX-License-Identifier: MIT
// The command table and its options. One table of options yields the parsers and --help.
#include "cli.h"

#include <argp.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

const char *argp_program_version = "relight " RELIGHT_VERSION;

// Keys. Each command lists the ones it takes as a string of these letters.
static const struct {
    char key;
    struct argp_option option;
} table[] = {
    {'s',
     {"server", 's', "ADDR", 0,
      "tcp:HOST:PORT or unix:PATH (default: $RELIGHT_SERVER, "
      "unix:$XDG_RUNTIME_DIR/relightd.sock, tcp:127.0.0.1:7413)",
      0}},
    {'T', {"timeout", 'T', "SECONDS", 0, "give up after this long (default: wait)", 0}},
    {'k',
     {"token", 'k', "TOKEN", 0, "for a daemon that wants one (default: $RELIGHT_TOKEN)", 0}},
    {'j', {"json", 'j', NULL, 0, "answer in JSON", 0}},
    {'o', {"output", 'o', "FILE", 0, "the answer goes here; its suffix tells the format", 0}},
    {'e',
     {"env", 'e', "ENV", 0,
      "an image file, env:HASH, constant or constant:R,G,B; lights of "
      "several --env add up",
      0}},
    {'r',
     {"rotate", 'r', "DEG", 0,
      "turn the light counter-clockwise about +y; the n-th belongs "
      "to the n-th --env, a single one to all",
      0}},
    {'G', {"gain", 'G', "X|R,G,B", 0, "multiplies the n-th light", 0}},
    {'t', {"term", 't', "TERM", 0, "irradiance, multiple, single or total (default)", 0}},
    {'E', {"eye", 'E', "X,Y,Z", 0, "eye of view-dependent terms, in the model's units", 0}},
    {'m', {"material", 'm', "NAME|FILE", 0, "a preset's name, a JSON file or JSON text", 0}},
    {'g',
     {"engine", 'g', "ENGINE", 0,
      "reference, wavelet, polynomial, joint, splat, tangent, "
      "texture or hybrid (default: what the model was baked for)",
      0}},
    {'X',
     {"max-error", 'X', "X", 0,
      "load: error target of the bake; else refuse an answer whose "
      "measured error bound is larger",
      0}},
    {'b', {"budget-ms", 'b', "MS", 0, "time the image-space engines aim for", 0}},
    {'Y',
     {"albedo-map", 'Y', "FILE", 0,
      "an image over the model's uv whose colours multiply the "
      "medium's reflectance; pictures by image-space engines",
      0}},
    {'y',
     {"normal-map", 'y', "FILE", 0,
      "the same of tangent-space normals, for the light that "
      "falls in",
      0}},
    {'J', {"bump-map", 'J', "FILE", 0, "the same of heights", 0}},
    {'W', {"bump-mm", 'W', "H", 0, "height of a bump map's white (default 0.5)", 0}},
    {'f',
     {"format", 'f', "FORMAT", 0, "colours travel as f32 (default), f16, rgb9e5 or srgb8", 0}},
    {'c',
     {"camera", 'c', "CAMERA", 0,
      "EYE:TARGET[:UP][:FOVY] as x,y,z:x,y,z:x,y,z:deg "
      "(default: frames the model)",
      0}},
    {'z', {"size", 'z', "WxH", 0, "pixels, up to 4096x4096 (default 800x600)", 0}},
    {'q', {"quality", 'q', "1..100", 0, "of a JPEG (default 90)", 0}},
    {'n', {"tone", 'n', "MAP", 0, "filmic (default), reinhard or none", 0}},
    {'x', {"exposure", 'x', "STOPS", 0, "brighten by a factor 2^STOPS", 0}},
    {'B', {"background", 'B', "R,G,B", 0, "plain background instead of the environment", 0}},
    {'a', {"samples-per-pixel", 'a', "1|2|4|8", 0, "anti-aliasing (default 4)", 0}},
    {'S', {"no-specular", 'S', NULL, 0, "leave reflections out", 0}},
    {'D', {"size-mm", 'D', "D", 0, "diagonal of the model's bounding box in millimetres", 0}},
    {'U', {"mm-per-unit", 'U', "X", 0, "millimetres in a unit of the model", 0}},
    {'P', {"transport", 'P', "KIND", 0, "wavelet, polynomial or joint", 0}},
    {'R', {"storage", 'R', "KIND", 0, "factored (default) or sparse", 0}},
    {'N', {"samples", 'N', "N", 0, "irradiance samples of the bake", 0}},
    {'C', {"cube", 'C', "N", 0, "size of the wavelet cubemap: 16, 32, 64 or 128", 0}},
    {'K', {"coeffs", 'K', "N", 0, "sparse: coefficients a vertex", 0}},
    {'A', {"rank", 'A', "R", 0, "factored: a fixed rank", 0}},
    {'H', {"phase-terms", 'H', "1|4|9", 0, "terms of the phase function", 0}},
    {'d', {"seed", 'd', "N", 0, "of the bake's random numbers", 0}},
    {'O', {"opaque", 'O', "NAME", 0, "this material or node is opaque (may repeat)", 0}},
    {'M', {"name", 'M', "NAME", 0, "what the list shows (default: the file's name)", 0}},
    {'p', {"pin", 'p', NULL, 0, "never evict", 0}},
    {'w', {"wait", 'w', NULL, 0, "return when the model is ready", 0}},
    {'Z', {"remote", 'Z', NULL, 0, "MODEL is a path in the daemon's models folder", 0}},
    {'V', {"preview", 'V', NULL, 0, "no bake: image-space engines answer at once", 0}},
    {'i', {"positions", 'i', "FILE", 0, "a .npy of f32 [n][3]: where the vertices are now", 0}},
    {'v', {"normals", 'v', "FILE", 0, "the same of normals (default: made anew)", 0}},
    {'I', {"first", 'I', "N", 0, "the first vertex that moves (default 0)", 0}},
    {'l', {"files", 'l', NULL, 0, "also list the loadable files of the daemon's folder", 0}},
    {'F', {"forget", 'F', NULL, 0, "delete the bake as well", 0}},
    {'u', {"own-units", 'u', NULL, 0, "positions in the model's units (default: mm)", 0}},
};
enum { N_TABLE = sizeof table / sizeof *table };
#define COMMON "sTkj"
#define LIGHT "erGtEgXbm"
#define PICTURE "czqnxBaSYyJW"

const struct command commands[] = {
    {"ping", "",
     "Asks whether the daemon answers.\v"
     "Example:\n  relight -s unix:/run/relightd.sock ping",
     COMMON, false, run_ping},
    {"models", "",
     "Lists the models the daemon holds.\v"
     "Examples:\n  relight models\n  relight models --files --json",
     COMMON "l", false, run_models},
    {"load", "MODEL",
     "Hands a model to the daemon and starts its bake.\v"
     "MODEL is a local .glb, .gltf, .obj or .ply file, which is uploaded unless the daemon has it, "
     "or a path in the daemon's models folder, where a .prt may lie too. Prints the model's id and "
     "the bake's job.\n\n"
     "Until the bake is ready, and with --preview for good, pictures come from the image-space "
     "engines.\n\n"
     "Examples:\n  relight load bunny.obj --size-mm 50 --material marble --wait\n"
     "  relight load baked.prt --remote --name rabbit\n"
     "  relight load jade.glb --material jade.json --transport joint\n"
     "  relight load draft.glb --material marble --preview",
     COMMON "DUmPRNCKAHdXOMpwZerV", true, run_load},
    {"info", "ID",
     "Tells all about a model: geometry, bake, measured error.\v"
     "Examples:\n  relight info bunny\n  relight info 3f9a --json",
     COMMON, true, run_info},
    {"watch", "JOB",
     "Follows a job to its end; exit status 1 when it fails.\v"
     "JOB may also be a model's id. With --json one line for each change.\n\n"
     "Example:\n  relight watch 12",
     COMMON, true, run_watch},
    {"cancel", "JOB", "Stops a job.\vExample:\n  relight cancel 12", COMMON, true, run_cancel},
    {"env", "FILE",
     "Uploads an environment, has it decoded, prints env:HASH.\v"
     "Example:\n  relight env sunrise.exr",
     COMMON, true, run_env},
    {"colors", "ID",
     "Relights a model to vertex colours.\v"
     "Linear RGB radiance, one colour for each vertex of the model's file. FILE ends in .csv, "
     ".npy, .ply or .glb; the last two hold the geometry too.\n\n"
     "Examples:\n  relight colors bunny --env sunrise.exr --rotate 90 -o bunny.csv\n"
     "  relight colors bunny --env constant:1,1,1 --term multiple -o bunny.npy",
     COMMON LIGHT "ofx", true, run_colors},
    {"image", "ID",
     "Relights a model to a picture.\v"
     "FILE ends in .png, .jpg or .exr (linear radiance).\n\n"
     "Examples:\n  relight image bunny --env sunrise.exr --size 1280x720 -o bunny.png\n"
     "  relight image bunny --env env:HASH --camera 0,1,3:0,1,0 --exposure -1 -o bunny.exr\n"
     "  relight image head --env studio.exr --albedo-map skin.jpg --normal-map skin_n.png "
     "-o head.png",
     COMMON LIGHT PICTURE "o", true, run_image},
    {"edit", "ID",
     "Gives a model another material, without a bake.\v"
     "Writes a picture or vertex colours, by FILE's suffix. Needs a model with joint or polynomial "
     "transport; the latter keeps its own light.\n\n"
     "Examples:\n  relight edit bunny --material skin1 --env studio.hdr -o bunny.png\n"
     "  relight edit bunny --material '{\"sigma_s_prime\":[2,3,4],\"sigma_a\":[0,0,.1],"
     "\"eta\":1.3}' --env studio.hdr -o bunny.npy",
     COMMON LIGHT PICTURE "of", true, run_edit},
    {"geometry", "ID",
     "Fetches positions, normals and triangles.\v"
     "FILE ends in .ply, .glb or .npy (positions).\n\n"
     "Example:\n  relight geometry bunny -o bunny.ply",
     COMMON "ou", true, run_geometry},
    {"update-vertices", "ID",
     "Moves a model's vertices, without a bake.\v"
     "Triangles stay. Pictures follow at once, from the image-space engines; what the bake answers "
     "stays that of the old shape. unload puts the vertices back.\n\n"
     "Example:\n  relight geometry bunny --own-units -o p.npy\n"
     "  relight update-vertices bunny --own-units --positions moved.npy",
     COMMON "iIuv", true, run_update},
    {"unload", "ID",
     "Frees a model's memory; its bake stays unless --forget.\v"
     "Example:\n  relight unload bunny",
     COMMON "F", true, run_unload},
    {"stats", "", "Prints the daemon's counters.\vExample:\n  relight stats --json", COMMON,
     false, run_stats},
    {NULL, NULL, NULL, NULL, false, NULL},
};

struct input {
    struct options *options;
    const struct command *command;
};

// ---- values
// --------------------------------------------------------------------------------------

static double number(struct argp_state *state, const char *what, const char *text, double min,
                     double max)
{
    char *end;
    errno = 0;
    double x = strtod(text, &end);
    if (end == text || *end || errno || !isfinite(x) || x < min || x > max)
        argp_error(state, "--%s %s: expected a number in [%g, %g]", what, text, min, max);
    return x;
}

static uint64_t whole(struct argp_state *state, const char *what, const char *text,
                      uint64_t min, uint64_t max)
{
    char *end;
    errno = 0;
    unsigned long long x = strtoull(text, &end, 10);
    if (end == text || *end || errno || strchr(text, '-') || x < min || x > max)
        argp_error(state, "--%s %s: expected a whole number in [%llu, %llu]", what, text,
                   (unsigned long long)min, (unsigned long long)max);
    return x;
}

static void triple(struct argp_state *state, const char *what, const char *text, float out[3])
{
    int used = 0;
    if (sscanf(text, "%f,%f,%f%n", out, out + 1, out + 2, &used) != 3 || text[used] ||
        !isfinite(out[0]) || !isfinite(out[1]) || !isfinite(out[2]))
        argp_error(state, "--%s %s: expected three numbers as x,y,z", what, text);
}

// Index of a word in a list "a\0b\0c\0".
static int word(struct argp_state *state, const char *what, const char *text, const char *list)
{
    char all[128] = "";
    int i = 0;
    for (const char *at = list; *at; at += strlen(at) + 1, i++) {
        if (!strcmp(at, text)) return i;
        snprintf(all + strlen(all), sizeof all - strlen(all), "%s%s", i ? ", " : "", at);
    }
    argp_error(state, "--%s %s: expected one of %s", what, text, all);
    return 0;
}

// A preset's name and JSON text pass; a file is read.
static void material(struct argp_state *state, struct options *o, const char *text)
{
    free(o->material);
    o->material = NULL;
    FILE *file = *text == '{' ? NULL : fopen(text, "re");
    if (!file) {
        size_t n = strlen(text);
        if (n > 5 && !strcmp(text + n - 5, ".json"))
            argp_failure(state, EXIT_FAILED, errno, "%s", text);
        o->material = strdup(text);
    } else {
        enum { MAX = 1 << 16 };
        char *bytes = malloc(MAX + 1);
        size_t n = bytes ? fread(bytes, 1, MAX + 1, file) : 0;
        if (!n || n > MAX || ferror(file) || strnlen(bytes, n) != n)
            argp_failure(state, EXIT_FAILED, 0,
                         "%s: is not a material's JSON (1 to 65536 bytes)", text);
        bytes[n < MAX ? n : MAX] = 0;
        fclose(file);
        // The daemon takes a leading brace for JSON text.
        char *text_at = bytes + strspn(bytes, " \t\r\n");
        if (*text_at != '{')
            argp_failure(state, EXIT_FAILED, 0, "%s: is not a material's JSON", text);
        o->material = strdup(text_at);
        free(bytes);
    }
    if (!o->material) argp_failure(state, EXIT_FAILED, 0, "not enough memory");
    o->shade.material = o->load.material = o->material;
}

static void size(struct argp_state *state, struct options *o, const char *text)
{
    unsigned w, h;
    int used = 0;
    if (sscanf(text, "%ux%u%n", &w, &h, &used) != 2 || text[used] || w < 1 || h < 1 ||
        w > 4096 || h > 4096 || strchr(text, '-'))
        argp_error(state, "--size %s: expected WxH, each in [1, 4096]", text);
    o->picture.width = w;
    o->picture.height = h;
}

static void full(struct argp_state *state, const char *what, size_t n)
{
    if (n == MAX_WORDS) argp_error(state, "--%s: at most %d", what, MAX_WORDS);
}

static error_t set(int key, char *arg, struct argp_state *state)
{
    struct input *input = state->input;
    struct options *o = input->options;
    struct relight_error error;
    switch (key) {
    case 's':
        o->server = arg;
        break;
    case 'T':
        o->timeout_s = number(state, "timeout", arg, 1e-3, 1e6);
        break;
    case 'k':
        o->token = arg;
        break;
    case 'j':
        o->json = true;
        break;
    case 'o':
        o->output = arg;
        break;
    case 'e':
        full(state, "env", o->n_env);
        o->env[o->n_env++] = arg;
        break;
    case 'r':
        full(state, "rotate", o->n_rotate);
        o->rotate_deg[o->n_rotate++] = (float)number(state, "rotate", arg, -1e6, 1e6);
        break;
    case 'G':
        full(state, "gain", o->n_gain);
        if (strchr(arg, ',')) {
            triple(state, "gain", arg, o->gain[o->n_gain]);
        } else {
            float x = (float)number(state, "gain", arg, 0, 1e9);
            for (int c = 0; c < 3; c++) o->gain[o->n_gain][c] = x;
        }
        o->n_gain++;
        break;
    case 't':
        o->shade.term = (enum relight_term)word(state, "term", arg,
                                                "total\0irradiance\0multiple\0single\0");
        break;
    case 'E':
        triple(state, "eye", arg, o->shade.eye);
        o->shade.has_eye = true;
        break;
    case 'm':
        material(state, o, arg);
        break;
    case 'g':
        o->shade.engine = (enum relight_engine)word(
            state, "engine", arg,
            "default\0reference\0wavelet\0polynomial\0joint\0splat\0tangent\0texture\0hybrid\0");
        break;
    case 'X':
        o->load.bake.max_error = o->shade.max_error =
            (float)number(state, "max-error", arg, 1e-6, 1);
        break;
    case 'b':
        o->shade.budget_ms = (uint32_t)whole(state, "budget-ms", arg, 1, 1000000);
        break;
    case 'Y':
        o->map[0] = arg;
        break;
    case 'y':
        o->map[1] = arg;
        break;
    case 'J':
        o->map[2] = arg;
        break;
    case 'W':
        o->shade.bump_mm = (float)number(state, "bump-mm", arg, 1e-6, 1e4);
        break;
    case 'f':
        o->format =
            (enum relight_color_format)word(state, "format", arg, "f32\0f16\0rgb9e5\0srgb8\0");
        break;
    case 'c':
        if (relight_camera_parse(arg, &o->picture.camera, &error))
            argp_error(state, "%s", error.text);
        break;
    case 'z':
        size(state, o, arg);
        break;
    case 'q':
        o->picture.quality = (uint32_t)whole(state, "quality", arg, 1, 100);
        break;
    case 'n':
        o->picture.tone =
            (enum relight_tone)word(state, "tone", arg, "filmic\0reinhard\0none\0");
        break;
    case 'x':
        o->picture.exposure_ev = (float)number(state, "exposure", arg, -40, 40);
        break;
    case 'B':
        triple(state, "background", arg, o->picture.background);
        o->picture.plain_background = true;
        break;
    case 'a':
        o->picture.samples = 1u << word(state, "samples-per-pixel", arg,
                                        "1\0"
                                        "2\0"
                                        "4\0"
                                        "8\0");
        break;
    case 'S':
        o->picture.no_specular = true;
        break;
    case 'D':
        o->load.size_mm = (float)number(state, "size-mm", arg, 1e-3, 1e6);
        break;
    case 'U':
        o->load.mm_per_unit = (float)number(state, "mm-per-unit", arg, 1e-6, 1e6);
        break;
    case 'P':
        o->load.bake.transport = (enum relight_transport)(
            1 + word(state, "transport", arg, "wavelet\0polynomial\0joint\0"));
        break;
    case 'R':
        o->load.bake.storage =
            (enum relight_storage)(1 + word(state, "storage", arg, "factored\0sparse\0"));
        break;
    case 'N':
        o->load.bake.samples = (uint32_t)whole(state, "samples", arg, 1, UINT32_MAX);
        break;
    case 'C':
        o->load.bake.cube = 16u << word(state, "cube", arg,
                                        "16\0"
                                        "32\0"
                                        "64\0"
                                        "128\0");
        break;
    case 'K':
        o->load.bake.coeffs = (uint32_t)whole(state, "coeffs", arg, 1, UINT32_MAX);
        break;
    case 'A':
        o->load.bake.rank = (uint32_t)whole(state, "rank", arg, 1, UINT32_MAX);
        break;
    case 'H': {
        static const uint32_t terms[] = {1, 4, 9};
        o->load.bake.phase_terms = terms[word(state, "phase-terms", arg,
                                              "1\0"
                                              "4\0"
                                              "9\0")];
        break;
    }
    case 'd':
        o->load.bake.seed = whole(state, "seed", arg, 0, UINT64_MAX);
        break;
    case 'O':
        full(state, "opaque", o->load.n_opaque);
        o->opaque[o->load.n_opaque++] = arg;
        break;
    case 'M':
        o->load.name = arg;
        break;
    case 'p':
        o->load.pin = true;
        break;
    case 'w':
        o->wait = true;
        break;
    case 'Z':
        o->remote = true;
        break;
    case 'V':
        o->load.preview = true;
        break;
    case 'i':
        o->positions = arg;
        break;
    case 'v':
        o->normals = arg;
        break;
    case 'I':
        o->first = (uint32_t)whole(state, "first", arg, 0, UINT32_MAX);
        break;
    case 'l':
        o->files = true;
        break;
    case 'F':
        o->forget = true;
        break;
    case 'u':
        o->own_units = true;
        break;
    default:
        return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

// ---- the two parsers
// -----------------------------------------------------------------------------

static void pick(struct argp_option out[N_TABLE + 1], const char *keys)
{
    unsigned n = 0;
    for (unsigned i = 0; i < N_TABLE; i++) {
        if (!strchr(keys, table[i].key)) continue;
        out[n] = table[i].option;
        out[n++].group = strchr(COMMON, table[i].key) ? 1 : 0;
    }
    memset(out + n, 0, sizeof *out);
}

static error_t parse_command(int key, char *arg, struct argp_state *state)
{
    struct input *input = state->input;
    if (key == ARGP_KEY_ARG) {
        if (!input->command->has_target || input->options->target)
            argp_error(state, "one argument too many: %s", arg);
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
    fputs("Relights translucent models that a relightd holds.\vCommands:\n", f);
    for (const struct command *c = commands; c->name; c++) {
        char head[32];
        snprintf(head, sizeof head, "%s %s", c->name, c->args);
        fprintf(f, "  %-16s %.*s\n", head, (int)strcspn(c->doc, "\v"), c->doc);
    }
    fputs("\n'relight COMMAND --help' tells a command's options.\n\n"
          "Exit status: 0 done, 1 failed, 2 wrong usage, 3 server unreachable.\n\n"
          "Example:\n  relight load bunny.obj --size-mm 50 --material marble --wait\n"
          "  relight image bunny --env sunrise.exr -o bunny.png",
          f);
    fclose(f);
    return text;
}

const struct command *options_parse(int argc, char **argv, struct options *options)
{
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
    // The command is the first word that is no option and no option's value; what stands before
    // it, and it, is parsed here, the rest by the command's own parser.
    int first = 1;
    while (first < argc && argv[first][0] == '-' && argv[first][1]) {
        const char *w = argv[first];
        bool takes =
            (!strcmp(w, "-s") || !strcmp(w, "-T") || !strcmp(w, "-k") ||
             !strcmp(w, "--server") || !strcmp(w, "--timeout") || !strcmp(w, "--token"));
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

void options_finish(struct options *options)
{
    free(options->material);
}
