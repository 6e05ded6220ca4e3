// SPDX-License-Identifier: MIT
// The command line: one table of options is the parser and every --help.
#include "prt/bake_limits.h"
#include "tool.h"

#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum kind {
    FLAG,   // bool
    TEXT,   // const char *
    NAMES,  // appended to options.opaque
    ENVS,   // appended to options.envs
    WORD,   // const char *, one of `words`
    REAL,   // double in [low, high], low itself excluded when it is 0
    SIGNED, // double in [low, high]
    WHOLE,  // uint64_t in [low, high]
    VECTOR, // struct vector_option
    SIZE,   // WxH into width, height
    SIDE,   // N or WxH into width, height
    CUBE,   // N or full
    SHARD,  // I/N
    FD,     // an open file descriptor
};

enum {
    BAKE = 1 << CMD_BAKE,
    COLORS = 1 << CMD_COLORS,
    IMAGE = 1 << CMD_IMAGE,
    INFO = 1 << CMD_INFO,
    COMPARE = 1 << CMD_COMPARE,
    ENV = 1 << CMD_ENV,
    EVERY = BAKE | COLORS | IMAGE | INFO | COMPARE | ENV,
    LIGHTS = COLORS | IMAGE | COMPARE,
};

struct row {
    const char *name;
    char letter;
    const char *label;
    enum kind kind;
    size_t field;
    double low, high;
    const char *const *words;
    unsigned commands;
    const char *help;
};

static const char *const transports[] = {"wavelet", "polynomial", "joint", NULL};
static const char *const bases[] = {"reduced", "polynomial", "hat", NULL}; // prt_radial_kind
static const char *const storages[] = {"factored", "sparse", NULL};
static const char *const engines[] = {"reference", "wavelet", "polynomial", "joint", NULL};
static const char *const pictures[] = {"vertex", "splat",     "tangent", "texture",
                                       "hybrid", "reference", NULL};
static const char *const terms[] = {"irradiance", "multiple", "single", "total", NULL};
static const char *const cpus[] = {
#define X(word, bit, allowed) word,
    PRT_CPU_WORD_LIST(X)
#undef X
        NULL};
static const char *const tones[] = {"filmic", "reinhard", "none", NULL};
static const char *const layouts[] = {"latlong", "envmap", "vcross", "hcross",
                                      "vstrip",  "hstrip", NULL};

#define AT(member) offsetof(struct options, member)
static const struct row table[] = {
    {"output", 'o', "FILE", TEXT, AT(out), 0, 0, NULL, BAKE | COLORS | IMAGE | ENV,
     "where the result goes; the ending picks the format"},
    {"material", 'm', "NAME|FILE", TEXT, AT(material), 0, 0, NULL, BAKE | COLORS | IMAGE,
     "a preset (marble, skin1, …), a JSON file, or JSON text"},
    {"size-mm", 0, "D", REAL, AT(size_mm), 0, 1e6, NULL, BAKE | COLORS | IMAGE,
     "bounding-box diagonal of the translucent objects [mm]"},
    {"mm-per-unit", 0, "X", REAL, AT(mm_per_unit), 0, 1e9, NULL, BAKE | COLORS | IMAGE,
     "millimetres in one unit of the model"},
    {"opaque", 0, "NAME", NAMES, 0, 0, 0, NULL, BAKE | COLORS | IMAGE | INFO,
     "a material or node that is opaque; may repeat"},
    {"env", 'e', "ENV", TEXT, AT(env), 0, 0, NULL, BAKE | COLORS | IMAGE,
     "light: lat-long or cube image, folder of six faces, constant[:R,G,B]"},
    {"env", 'e', "ENV", ENVS, 0, 0, 0, NULL, COMPARE,
     "with B = reference: the light; several make a table, a column each"},
    {"materials", 0, "LIST", TEXT, AT(materials), 0, 0, NULL, COMPARE,
     "with B = reference: a table, a row each: all (measured media of the bake's eta and both\n"
     "                              ends of the range), media, range, or NAME|FILE,…"},
    {"rotate", 0, "DEG", SIGNED, AT(rotate_deg), -1e6, 1e6, NULL, BAKE | LIGHTS | ENV,
     "turns the light counter-clockwise about +y seen from above"},
    {"engine", 0, "NAME", WORD, AT(engine), 0, 0, engines, COLORS,
     "default: the .prt's own; reference for a model"},
    {"engine", 0, "NAME", WORD, AT(engine), 0, 0, pictures, IMAGE,
     "default: vertex for a .prt; reference for a model"},
    {"term", 0, "NAME", WORD, AT(term), 0, 0, terms, LIGHTS, "default: total"},
    {"eye", 0, "X,Y,Z", VECTOR, AT(eye), 0, 0, NULL, COLORS | IMAGE | COMPARE,
     "where the light is seen from, in the model's units"},
    {"camera", 0, "E:T:U:F", TEXT, AT(camera), 0, 0, NULL, IMAGE,
     "eye x,y,z:target x,y,z[:up x,y,z[:fovy degrees]]; default: frames the model"},
    {"transport", 0, "KIND", WORD, AT(transport), 0, 0, transports, BAKE,
     "what stays free after the bake: the light (wavelet; default with --material), the\n"
     "                              material (polynomial), or both (joint; default without)"},
    {"storage", 0, "KIND", WORD, AT(storage), 0, 0, storages, BAKE,
     "factored (default): shared bases; sparse: W05's vectors"},
    {"basis", 0, "KIND", WORD, AT(basis), 0, 0, bases, BAKE,
     "polynomial: functions of radius; reduced (default): the range's singular vectors;\n"
     "                              polynomial: X07's 32 (single: 16), linear pieces; hat: on the same knots"},
    {"rank", 0, "R", WHOLE, AT(rank), PRT_BAKE_RANK_MIN, PRT_BAKE_RANK_MAX, NULL, BAKE,
     "factored: dense numbers a vertex and term; default: from --max-error"},
    {"basis-coeffs", 0, "N", WHOLE, AT(basis_coeffs), PRT_BAKE_BASIS_COEFFS_MIN,
     PRT_BAKE_BASIS_COEFFS_MAX, NULL, BAKE,
     "factored: mean coefficients a basis vector; default: from --max-error"},
    {"coeffs", 0, "N", WHOLE, AT(coeffs), PRT_BAKE_COEFFS_MIN, PRT_BAKE_COEFFS_MAX, NULL, BAKE,
     "sparse: wavelet coefficients a vertex (default 128)"},
    {"max-error", 0, "E", SIGNED, AT(max_error), PRT_BAKE_ERROR_MIN, PRT_BAKE_ERROR_MAX, NULL,
     BAKE, "relative RMSE the factored storage is cut to (default 0.01)"},
    {"cube", 0, "N", CUBE, AT(cube), PRT_BAKE_CUBE_MIN, PRT_BAKE_CUBE_MAX, NULL, BAKE,
     "light resolution 6xNxN (default 32)"},
    {"cube", 0, "N|full", CUBE, AT(cube), PRT_CUBE_MIN, PRT_CUBE_MAX, NULL, LIGHTS,
     "light resolution for reference (default: the .prt's, else 32)"},
    {"phase-terms", 0, "K", WHOLE, AT(phase_terms), 1, 16, NULL, BAKE | COLORS | IMAGE,
     "spherical-harmonic terms of the phase function: 1, 4, 9 (reference: default exact)"},
    {"samples", 0, "N", WHOLE, AT(samples), PRT_BAKE_SAMPLES_MIN, PRT_BAKE_SAMPLES_MAX, NULL,
     BAKE, "irradiance samples on the surface (default: 150000 or one a mean free path)"},
    {"samples", 0, "N", WHOLE, AT(samples), 1, 100000000, NULL, LIGHTS,
     "irradiance samples on the surface (default: 150000 or one a mean free path)"},
    {"rays", 0, "N", WHOLE, AT(rays), 1, 1 << 24, NULL, LIGHTS,
     "reference: rays a sample (default 2048)"},
    {"single-points", 0, "N", WHOLE, AT(single_points), 1, PRT_BAKE_SINGLE_POINTS_MAX, NULL,
     BAKE, "single scattering: points a vertex (default 16)"},
    {"single-points", 0, "N", WHOLE, AT(single_points), 1, 1 << 20, NULL, LIGHTS,
     "single scattering: paths a vertex (default 4096)"},
    {"no-single", 0, NULL, FLAG, AT(no_single), 0, 0, NULL, BAKE,
     "leave single scattering out"},
    {"every-ray", 0, NULL, FLAG, AT(every_ray), 0, 0, NULL, BAKE,
     "single scattering without ray saving, for measurements"},
    {"straight", 0, NULL, FLAG, AT(straight), 0, 0, NULL, COLORS | IMAGE,
     "reference: single scattering along -n_o even with an eye, as W05 does"},
    {"seed", 0, "N", WHOLE, AT(seed), 0, 1.8e19, NULL, BAKE | LIGHTS,
     "of all random numbers (default 0)"},
    {"shard", 0, "I/N", SHARD, AT(shard), 0, 0, NULL, BAKE,
     "do part I of N, I from 0 to N-1, and leave it beside OUT.prt; the shard that ends last\n"
     "                              assembles OUT.prt, as one bake alone would write it"},
    {"size", 0, "WxH", SIZE, AT(width), 1, 4096, NULL, IMAGE, "pixels (default 800x600)"},
    {"size", 0, "N|WxH", SIDE, AT(width), 1, 16384, NULL, ENV,
     "cube side, or lat-long width and height"},
    {"layout", 0, "NAME", WORD, AT(layout), 0, 0, layouts, ENV,
     "default: envmap (cube faces in one EXR) from lat-long, else latlong"},
    {"msaa", 0, "N", WHOLE, AT(msaa), 1, 8, NULL, IMAGE, "sub-samples a pixel (default 4)"},
    {"exposure", 0, "EV", SIGNED, AT(exposure_ev), -40, 40, NULL, IMAGE | ENV,
     "stops, for PNG and JPEG"},
    {"tone", 0, "NAME", WORD, AT(tone), 0, 0, tones, IMAGE | ENV,
     "tone map for PNG and JPEG (default filmic)"},
    {"background", 0, "B", TEXT, AT(background), 0, 0, NULL, IMAGE,
     "env (default), none, or R,G,B in linear radiance"},
    {"budget-ms", 0, "MS", REAL, AT(budget_ms), 0, 1e7, NULL, IMAGE,
     "image-space engines: time they may take"},
    {"albedo-map", 0, "FILE", TEXT, AT(albedo_map), 0, 0, NULL, IMAGE,
     "image-space engines: an image over the model's uv (row 0 at v = 0, as glTF) whose colours multiply\n"
     "                              the medium's reflectance, by absorption"},
    {"normal-map", 0, "FILE", TEXT, AT(normal_map), 0, 0, NULL, IMAGE,
     "image-space engines: tangent-space normals, for the light that falls in"},
    {"bump-map", 0, "FILE", TEXT, AT(bump_map), 0, 0, NULL, IMAGE,
     "image-space engines: heights (the red channel), for the light that falls in"},
    {"bump-mm", 0, "H", REAL, AT(bump_mm), 0, 1e4, NULL, IMAGE,
     "height of a bump map's white (default 0.5)"},
    {"measure-error", 0, NULL, FLAG, AT(measure_error), 0, 0, NULL, IMAGE,
     "image-space engines: compare some pixels with brute force (see --json)"},
    {"quality", 0, "Q", WHOLE, AT(quality), 1, 100, NULL, IMAGE | ENV,
     "of a JPEG (default 92)"},
    {"float", 0, NULL, FLAG, AT(full_float), 0, 0, NULL, IMAGE | ENV,
     "EXR with 32-bit floats instead of halves"},
    {"max-rmse", 0, "X", SIGNED, AT(max_rmse), 0, 1e30, NULL, COMPARE,
     "exit 1 when the relative RMSE is above it"},
    {"vertices", 0, "N", WHOLE, AT(vertices), 1, 100000000, NULL, COMPARE,
     "with B = reference: compare this many random vertices (default 512)"},
    {"threads", 0, "N", WHOLE, AT(threads), 1, 1024, NULL, EVERY, "default: all cores"},
    {"cpu", 0, "ISA", WORD, AT(cpu), 0, 0, cpus, EVERY,
     "use no more than this instruction set"},
    {"progress-fd", 0, "FD", FD, AT(progress_fd), 0, 0, NULL, BAKE | COLORS | IMAGE,
     "write lines \"stage fraction eta-seconds\" there"},
    {"memory", 0, "BYTES", WHOLE, AT(memory), 0, 1e15, NULL, BAKE,
     "fail rather than take more memory; 0: no more than the settings are estimated to need,\n"
     "                              nor than the machine has"},
    {"estimate", 0, NULL, FLAG, AT(estimate), 0, 0, NULL, BAKE,
     "print the bytes of memory it is estimated to need, and do not bake"},
    {"accept-weak-sandbox", 0, NULL, FLAG, AT(accept_weak_sandbox), 0, 0, NULL, EVERY,
     "decode files where the system cannot confine the process that does it"},
    {"json", 0, NULL, FLAG, AT(json), 0, 0, NULL, EVERY, "the answer as one JSON object"},
    {"quiet", 'q', NULL, FLAG, AT(quiet), 0, 0, NULL, EVERY, "no notes, no progress bar"},
};
enum { N_ROW = sizeof table / sizeof *table };

static const struct {
    const char *name, *operands, *summary;
    unsigned min_input, max_input;
    const char *examples;
} commands[N_COMMAND] = {
    [CMD_BAKE] =
        {"bake", "MODEL -o OUT.prt", "precompute a model's light transport", 1, 1,
         "prt bake bunny.glb --material marble --size-mm 50 -o bunny.prt\n"
         "prt bake bird.glb --material skin1 --mm-per-unit 1000 --opaque floor -o bird.prt\n"
         "prt bake bunny.obj --transport polynomial --env grace.exr --size-mm 50 -o edit.prt"},
    [CMD_COLORS] = {"colors", "SOURCE --env ENV -o OUT.{csv,npy,ply,glb}",
                    "light a .prt, or a model, to one colour a vertex", 1, 1,
                    "prt colors bunny.prt --env studio.exr --rotate 90 -o bunny.csv\n"
                    "prt colors bunny.glb --material marble --size-mm 50 --env studio.exr \\\n"
                    "    --engine reference --term multiple -o truth.npy\n"
                    "prt colors bunny.prt --env constant --term irradiance -o e.ply"},
    [CMD_IMAGE] =
        {"image", "SOURCE --env ENV -o OUT.{png,jpg,exr}",
         "light a .prt, or a model, and draw it", 1, 1,
         "prt image bunny.prt --env grace.exr --size 800x600 -o bunny.png\n"
         "prt image bunny.prt --env grace.exr --rotate 45 --background none \\\n"
         "    --camera 0,0.1,0.5:0,0.08,0:0,1,0:30 -o bunny.exr\n"
         "prt image head.glb --material skin1 --size-mm 300 --env grace.exr \\\n"
         "    --engine tangent --albedo-map skin.jpg --normal-map skin_n.jpg -o head.png"},
    [CMD_INFO] = {"info", "FILE", "what a .prt, a model or an environment holds", 1, 1,
                  "prt info bunny.prt\n"
                  "prt info studio.exr --json"},
    [CMD_COMPARE] = {"compare", "A B", "relative RMSE |A-B|/|B| of colours or pictures", 2, 2,
                     "prt compare bunny.csv truth.npy --max-rmse 0.01\n"
                     "prt compare a.exr b.exr --json\n"
                     "prt compare bunny.prt reference --env studio.exr --term multiple\n"
                     "prt compare joint.prt reference --env studio.exr --env grace.exr \\\n"
                     "    --materials all --term multiple --max-rmse 0.01"},
    [CMD_ENV] = {"env", "IN -o OUT", "convert, turn and resize an environment", 1, 1,
                 "prt env studio.exr --size 128 -o studio_cube.exr\n"
                 "prt env lobby_gl.dds --size 1024x512 --rotate 30 -o lobby.exr"},
};

int command_find(const char *name)
{
    for (int i = 0; i < N_COMMAND; i++)
        if (!strcmp(commands[i].name, name)) return i;
    return -1;
}

void usage_print(void)
{
    puts("Usage: prt SUBCOMMAND …\n"
         "Bakes, lights, draws and compares translucent models without a daemon.\n");
    for (int i = 0; i < N_COMMAND; i++)
        printf("  prt %-8s %-45s %s\n", commands[i].name, commands[i].operands,
               commands[i].summary);
    puts("\nSOURCE is a .prt, or a model (.glb .gltf .obj .ply) with --material and --size-mm "
         "or\n"
         "--mm-per-unit. prt SUBCOMMAND --help has options and examples.\n"
         "Exit status: 0 done, 1 failed, 2 wrong usage.");
}

static void print_row(const struct row *row)
{
    char left[64], letter[8] = "   ";
    if (row->letter) snprintf(letter, sizeof letter, "-%c,", row->letter);
    snprintf(left, sizeof left, "%s --%s%s%s", letter, row->name, row->label ? " " : "",
             row->label ? row->label : "");
    printf("  %-27s ", left);
    if (row->kind == WORD) {
        for (const char *const *word = row->words; *word; word++)
            printf("%s%s", *word, word[1] ? "|" : "");
        printf("\n%30s", "");
    }
    puts(row->help);
}

static void help_print(enum command command)
{
    printf("Usage: prt %s %s [OPTION]…\n%c%s.\n\nOptions:\n", commands[command].name,
           commands[command].operands, toupper((unsigned char)commands[command].summary[0]),
           commands[command].summary + 1);
    for (int i = 0; i < N_ROW; i++)
        if (table[i].commands & 1u << command) print_row(&table[i]);
    printf("  -h, --help                  this text\n\nExamples:\n");
    for (const char *at = commands[command].examples; *at;) {
        size_t n = strcspn(at, "\n");
        printf("  %.*s\n", (int)n, at);
        at += n + (at[n] == '\n');
    }
    puts("\nExit status: 0 done, 1 failed, 2 wrong usage.");
}

int usage_error(const struct options *options, const char *fmt, ...)
{
    va_list args;
    char line[512];
    va_start(args, fmt);
    vsnprintf(line, sizeof line, fmt, args);
    va_end(args);
    for (char *c = line; *c; c++)
        if ((unsigned char)*c < 32 || *c == 127) *c = ' ';
    fprintf(stderr, "error: %s; see prt %s --help\n", line, commands[options->command].name);
    return EXIT_USAGE;
}

// A whole finite decimal number; hexadecimal, nan and inf are typing errors here.
static bool parse_real(const char *text, double *out)
{
    if (!*text || text[strspn(text, "0123456789+-.eE")]) return false;
    char *end;
    *out = strtod(text, &end);
    return !*end && isfinite(*out);
}

static bool parse_whole(const char *text, uint64_t *out)
{
    if (!*text || text[strspn(text, "0123456789")]) return false;
    errno = 0;
    *out = strtoull(text, NULL, 10);
    return !errno;
}

bool parse_vector(const char *text, float v[3])
{
    char part[64];
    for (int i = 0; i < 3; i++) {
        size_t n = strcspn(text, ",");
        double x;
        if (n >= sizeof part || (i < 2 && text[n] != ',') || (i == 2 && text[n])) return false;
        memcpy(part, text, n);
        part[n] = 0;
        if (!parse_real(part, &x) || fabs(x) > 1e30) return false;
        v[i] = (float)x;
        text += n + 1;
    }
    return true;
}

// "I/N" or "WxH": two whole numbers with a mark between them.
static bool parse_pair(const char *text, char mark, uint64_t *a, uint64_t *b)
{
    char part[32];
    const char *at = strchr(text, mark);
    if (!at || (size_t)(at - text) >= sizeof part) return false;
    memcpy(part, text, (size_t)(at - text));
    part[at - text] = 0;
    return parse_whole(part, a) && parse_whole(at + 1, b);
}

static int set_word(struct options *o, const struct row *row, const char *value)
{
    char list[128] = "";
    for (const char *const *word = row->words; *word; word++) {
        if (!strcmp(*word, value)) {
            *(const char **)((char *)o + row->field) = *word;
            return -1;
        }
        size_t n = strlen(list);
        snprintf(list + n, sizeof list - n, "%s%s", n ? ", " : "", *word);
    }
    return usage_error(o, "--%s %s: expected one of %s", row->name, value, list);
}

static int set_number(struct options *o, const struct row *row, const char *value)
{
    if (row->kind == WHOLE) {
        uint64_t x;
        if (!parse_whole(value, &x) || (double)x < row->low || (double)x > row->high)
            return usage_error(o, "--%s %s: expected a whole number in [%.10g, %.10g]",
                               row->name, value, row->low, row->high);
        *(uint64_t *)((char *)o + row->field) = x;
        return -1;
    }
    double x;
    bool open = row->kind == REAL;
    if (!parse_real(value, &x) || x < row->low || (open && x == row->low) || x > row->high)
        return usage_error(o, "--%s %s: expected a number in %c%.10g, %.10g]", row->name, value,
                           open ? '(' : '[', row->low, row->high);
    *(double *)((char *)o + row->field) = x;
    return -1;
}

static int set_cube(struct options *o, const struct row *row, const char *value)
{
    uint64_t n = 0;
    bool bake = o->command == CMD_BAKE;
    if (!bake && !strcmp(value, "full")) {
        o->cube_full = true;
        o->cube = 0;
        return -1;
    }
    if (!parse_whole(value, &n) || (double)n < row->low || (double)n > row->high ||
        (bake && (n & (n - 1))))
        return usage_error(o, "--cube %s: expected %s", value,
                           bake ? "16, 32, 64 or 128" : "a whole number in [4, 2048], or full");
    o->cube = (uint32_t)n;
    o->cube_full = false;
    return -1;
}

static int set_size(struct options *o, const struct row *row, const char *value)
{
    uint64_t w = 0, h = 0;
    bool ok = row->kind == SIDE && parse_whole(value, &w);
    if (!ok) ok = parse_pair(value, 'x', &w, &h) && h >= 1;
    if (!ok || w < 1 || (double)w > row->high || (double)h > row->high)
        return usage_error(o, "--%s %s: expected %s with sides in [1, %g]", row->name, value,
                           row->label, row->high);
    o->width = (uint32_t)w;
    o->height = (uint32_t)h;
    return -1;
}

static int set_option(struct options *o, const struct row *row, const char *value)
{
    uint64_t a, b;
    void *field = (char *)o + row->field;
    switch (row->kind) {
    case FLAG:
        *(bool *)field = true;
        return -1;
    case TEXT:
        if (!*value) return usage_error(o, "--%s: expected %s", row->name, row->label);
        *(const char **)field = value;
        return -1;
    case NAMES:
        if (o->n_opaque == MAX_OPAQUE)
            return usage_error(o, "--%s: at most %d names", row->name, MAX_OPAQUE);
        o->opaque[o->n_opaque++] = value;
        return -1;
    case ENVS:
        if (!*value) return usage_error(o, "--%s: expected %s", row->name, row->label);
        if (o->n_env == MAX_ENV)
            return usage_error(o, "--%s: at most %d lights", row->name, MAX_ENV);
        o->envs[o->n_env++] = value;
        o->env = o->envs[0];
        return -1;
    case WORD:
        return set_word(o, row, value);
    case REAL:
    case SIGNED:
    case WHOLE:
        if (field == &o->max_rmse) o->max_rmse_set = true;
        if (field == &o->memory) o->memory_set = true;
        return set_number(o, row, value);
    case VECTOR:
        if (!parse_vector(value, ((struct vector_option *)field)->v))
            return usage_error(o, "--%s %s: expected three numbers x,y,z", row->name, value);
        ((struct vector_option *)field)->set = true;
        return -1;
    case SIZE:
    case SIDE:
        return set_size(o, row, value);
    case CUBE:
        return set_cube(o, row, value);
    case SHARD:
        if (!parse_pair(value, '/', &a, &b) || b < 1 || b > 100000 || a >= b)
            return usage_error(o,
                               "--shard %s: expected I/N with N in [1, 100000] and I in "
                               "[0, N-1]",
                               value);
        o->shard = (uint32_t)a;
        o->n_shard = (uint32_t)b;
        return -1;
    case FD:
        if (!parse_whole(value, &a) || a > 1 << 20)
            return usage_error(o, "--%s %s: expected a file descriptor", row->name, value);
        *(int *)field = (int)a;
        return -1;
    }
    return -1;
}

static const struct row *find_row(const struct options *o, const char *name, size_t n,
                                  char letter)
{
    for (int i = 0; i < N_ROW; i++) {
        const struct row *row = &table[i];
        if (!(row->commands & 1u << o->command)) continue;
        if (letter ? row->letter == letter
                   : strlen(row->name) == n && !memcmp(row->name, name, n))
            return row;
    }
    return NULL;
}

// One option at argv[*i]; advances *i over its value.
static int parse_one(struct options *o, int argc, char **argv, int *i)
{
    const char *arg = argv[*i], *value = NULL;
    const struct row *row;
    if (arg[1] == '-') {
        size_t n = strcspn(arg + 2, "=");
        row = find_row(o, arg + 2, n, 0);
        if (arg[2 + n] == '=') value = arg + 3 + n;
    } else {
        row = find_row(o, NULL, 0, arg[1]);
        if (arg[2]) value = arg + 2;
    }
    if (!row) return usage_error(o, "%s is not an option here", arg);
    if (row->kind == FLAG && value) return usage_error(o, "--%s takes no value", row->name);
    if (row->kind != FLAG && !value) {
        if (++*i >= argc) return usage_error(o, "--%s needs %s", row->name, row->label);
        value = argv[*i];
    }
    return set_option(o, row, value);
}

int options_parse(enum command command, int argc, char **argv, struct options *out)
{
    struct options *o = out;
    memset(o, 0, sizeof *o);
    o->command = command;
    o->progress_fd = -1;
    bool only_operands = false;
    for (int i = 0; i < argc; i++) {
        const char *arg = argv[i];
        if (!only_operands && (!strcmp(arg, "--help") || !strcmp(arg, "-h"))) {
            help_print(command);
            return EXIT_DONE;
        }
        if (!only_operands && !strcmp(arg, "--")) {
            only_operands = true;
        } else if (!only_operands && arg[0] == '-' && arg[1]) {
            int status = parse_one(o, argc, argv, &i);
            if (status >= 0) return status;
        } else if (o->n_input == commands[command].max_input) {
            return usage_error(o, "%s is one operand too many", arg);
        } else {
            o->input[o->n_input++] = arg;
        }
    }
    if (o->n_input < commands[command].min_input)
        return usage_error(o, "expected %s", commands[command].operands);
    if (o->phase_terms && o->phase_terms != 1 && o->phase_terms != 4 && o->phase_terms != 9 &&
        (o->phase_terms != 16 || command == CMD_BAKE))
        return usage_error(o, "--phase-terms %d: expected 1, 4 or 9", (int)o->phase_terms);
    if (o->accept_weak_sandbox) setenv(PRT_ACCEPT_WEAK_SANDBOX, "1", 1);
    if (o->msaa & (o->msaa - 1))
        return usage_error(o, "--msaa %d: expected 1, 2, 4 or 8", (int)o->msaa);
    if (o->size_mm > 0 && o->mm_per_unit > 0)
        return usage_error(o, "--size-mm and --mm-per-unit both give the scale: choose one");
    return -1;
}
