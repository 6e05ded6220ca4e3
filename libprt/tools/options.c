// SPDX-License-Identifier: MIT
// The command line. argp parses a subcommand's rows of option_table and prints them for --help.
//
// argp prints no error itself (ARGP_NO_ERRS): every error of prt is one line that begins with
// "error: " and ends with the place of the help. Abbreviated long options are refused, because
// a new option would silently change the meaning of an abbreviation in an old script.
#include "options.h"

#include <argp.h>
#include <ctype.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    KEY_HELP = 'h',
    KEY_VERSION = 255,
    KEY_ROW = 256, // key of option_table[0]; below: characters, the keys of short options
    PARSE_FLAGS = ARGP_NO_ERRS | ARGP_NO_EXIT | ARGP_NO_HELP | ARGP_IN_ORDER,
    GROUP_OWN = 0, // groups of --help: options of one subcommand, options of all
    GROUP_COMMON = 1,
};

static const struct {
    const char *name, *operands, *summary;
    unsigned min_input, max_input;
    const char *examples;
} commands[N_COMMAND] = {
    [CMD_BAKE] = {"bake", "MODEL -o OUT.prt", "precompute a model's light transport", 1, 1,
                  "  prt bake bunny.glb --material marble --size-mm 50 -o bunny.prt\n"
                  "  prt bake bird.glb --material skin1 --mm-per-unit 1000 \\\n"
                  "      --opaque floor -o bird.prt\n"
                  "  prt bake bunny.obj --transport polynomial --env grace.exr \\\n"
                  "      --size-mm 50 -o edit.prt\n"},
    [CMD_COLORS] = {"colors", "SOURCE --env ENV -o OUT.{csv,npy,ply,glb}",
                    "light a .prt or a model, one colour a vertex", 1, 1,
                    "  prt colors bunny.prt --env studio.exr --rotate 90 -o bunny.csv\n"
                    "  prt colors bunny.glb --material marble --size-mm 50 \\\n"
                    "      --env studio.exr --term multiple -o truth.npy\n"
                    "  prt colors bunny.prt --env constant --term irradiance -o e.ply\n"
                    "  prt colors leaf.glb --material marble --size-mm 50 --env studio.exr \\\n"
                    "      --scattering walk --walks 4096 -o leaf.csv\n"},
    [CMD_IMAGE] = {"image", "SOURCE --env ENV -o PICTURE|-",
                   "light a .prt or a model, and draw it; the ending is the format (.png,\n"
                   ".exr, ...), - draws in the terminal (kitty's protocol, sixels or half\n"
                   "blocks; $RELIGHT_TERMINAL overrides: kitty, sixel, blocks, blocks256)",
                   1, 2,
                   "  prt image bunny.prt --env grace.exr -\n"
                   "  prt image bunny.prt --env grace.exr --size 800x600 -o bunny.png\n"
                   "  prt image bunny.prt --env grace.exr --rotate 45 --background none \\\n"
                   "      --camera 0,0.1,0.5:0,0.08,0:0,1,0:30 -o bunny.exr\n"
                   "  prt image statue.stl --up z --size-mm 80 --material marble \\\n"
                   "      --env grace.exr --orbit 30,20 -o statue.png\n"
                   "  prt image head.glb --material skin1 --size-mm 300 --env grace.exr \\\n"
                   "      --engine tangent --albedo-map skin.jpg -o head.png\n"},
    [CMD_INFO] =
        {"info", "FILE",
         "print the contents of a .prt, a model, an environment or a file of materials", 1, 1,
         "  prt info bunny.prt\n"
         "  prt info studio.exr --json\n"
         "  prt info honey.mtlx\n"},
    [CMD_COMPARE] = {"compare", "A B", "relative RMSE |A-B|/|B| of colours or pictures", 2, 2,
                     "  prt compare bunny.csv truth.npy --max-rmse 0.01\n"
                     "  prt compare a.exr b.exr --json\n"
                     "  prt compare bunny.prt reference --env studio.exr --term multiple\n"
                     "  prt compare joint.prt reference --env studio.exr --env grace.exr \\\n"
                     "      --materials all --term multiple --max-rmse 0.01\n"},
    [CMD_ENV] = {"env", "IN -o OUT", "convert, turn and resize an environment", 1, 1,
                 "  prt env studio.exr --size 128 -o studio_cube.exr\n"
                 "  prt env lobby_gl.dds --size 1024x512 --rotate 30 -o lobby.exr\n"},
    [CMD_MATERIAL] =
        {"material", "IN[#NAME] [-o OUT.json]",
         "list the media of another program's materials, or convert one", 1, 1,
         "  prt material honey.mtlx -o honey.json\n"
         "  prt material chess_set.mtlx\n"
         "  prt material chess_set.mtlx#M_King_W --mm-per-unit 1000 -o king.json\n"
         "  prt material principled.json -o skin.json\n"
         "  prt material scene.pbrt#fog -o fog.json\n"
         "  prt material dragon.glb -o wax.json\n"
         "  prt material \"Lowfat Milk\" -o milk.json\n\n"
         "IN is MaterialX (open_pbr_surface, standard_surface), the inputs of\n"
         "Blender's Principled BSDF as JSON, a pbrt scene, a glTF file, or a name:\n"
         "the presets of --material and pbrt's named media. `prt material names`\n"
         "lists the names.\n"},
};

int usage_error(const struct options *options, const char *fmt, ...)
{
    va_list args;
    char line[512];
    va_start(args, fmt);
    vsnprintf(line, sizeof line, fmt, args);
    va_end(args);
    for (char *c = line; *c; c++)
        if ((unsigned char)*c < 32 || *c == 127) *c = ' ';
    fprintf(stderr, "error: %s; see prt%s%s --help\n", line,
            options->command < N_COMMAND ? " " : "",
            options->command < N_COMMAND ? commands[options->command].name : "");
    return EXIT_USAGE;
}

// One run of a parser: argp's input.
struct parse {
    struct options *options;
    struct argp argp;
    struct argp_option *option; // ends with an empty one
    char name[32];              // of the usage line
    unsigned n_option;
    int status; // -1 while parsing continues, else the exit status
    int rest;   // top level: index of the first argument after the subcommand, or 0
};

static const struct argp_option standard_options[] = {
    {"help", KEY_HELP, NULL, 0, "print this text", GROUP_COMMON},
    {"version", KEY_VERSION, NULL, 0, "print the version", GROUP_COMMON},
    {NULL, 0, NULL, 0, NULL, 0},
};

static const struct option_row *row_of(enum command command, int key)
{
    for (unsigned i = 0; i < n_option_row; i++)
        if (option_table[i].commands & 1u << command &&
            (key == KEY_ROW + (int)i ||
             (option_table[i].letter && key == option_table[i].letter)))
            return &option_table[i];
    return NULL;
}

// A word's help begins with the allowed words: "a|b|c: help". Owned by the caller.
static char *row_help(const struct option_row *row)
{
    char *text = NULL;
    size_t n;
    FILE *f = open_memstream(&text, &n);
    if (!f) return NULL;
    for (const char *const *word = row->words; word && *word; word++)
        fprintf(f, "%s%s", *word, word[1] ? "|" : "; ");
    fputs(row->help, f);
    fclose(f);
    return text;
}

static void add_rows(struct parse *p, enum command command)
{
    p->option = calloc(n_option_row + 3, sizeof *p->option);
    for (unsigned i = 0; i < n_option_row && p->option; i++) {
        const struct option_row *row = &option_table[i];
        bool common = row->commands == (1u << N_COMMAND) - 1;
        if (!(row->commands & 1u << command)) continue;
        p->option[p->n_option++] = (struct argp_option){
            .name = row->name,
            .key = row->letter ? row->letter : KEY_ROW + (int)i,
            .arg = row->label,
            .doc = row_help(row),
            .group = common ? GROUP_COMMON : GROUP_OWN,
        };
    }
    if (p->option) memcpy(p->option + p->n_option, standard_options, sizeof standard_options);
}

static void free_rows(struct parse *p)
{
    for (unsigned i = 0; i < p->n_option; i++) free((char *)(uintptr_t)p->option[i].doc);
    free(p->option);
}

static const struct argp_option *find_option(const struct argp *argp, const char *name,
                                             size_t n)
{
    for (const struct argp_option *o = argp->options; o->name; o++)
        if (strlen(o->name) == n && !memcmp(o->name, name, n)) return o;
    return NULL;
}

static const struct argp_option *find_letter(const struct argp *argp, char letter)
{
    for (const struct argp_option *o = argp->options; o->name; o++)
        if (o->key == (unsigned char)letter) return o;
    return NULL;
}

// Prints what is wrong with a word that getopt refused, or with an abbreviation that it
// accepted. Returns EXIT_USAGE, or -1 when the word is correct.
static int refuse_word(const struct parse *p, const char *word)
{
    const char *place = p->options->command < N_COMMAND ? " here" : " of prt";
    const struct argp_option *o = NULL;
    if (word[0] != '-' || !word[1]) return -1;
    if (word[1] != '-') {
        const char *letter = word + 1;
        while (*letter && (o = find_letter(&p->argp, *letter)) && !o->arg) letter++;
        if (!*letter) return -1;
        if (!o) return usage_error(p->options, "-%c is not an option%s", *letter, place);
        return usage_error(p->options, "--%s needs %s", o->name, o->arg);
    }
    size_t n = strcspn(word + 2, "=");
    o = find_option(&p->argp, word + 2, n);
    if (!o) return usage_error(p->options, "%s is not an option%s", word, place);
    if (!o->arg) return usage_error(p->options, "--%s takes no value", o->name);
    return usage_error(p->options, "--%s needs %s", o->name, o->arg);
}

// The command line's word of the option that argp has just parsed, NULL for a short one.
static const char *long_word(const struct argp_state *state, const char *value)
{
    const char *word = state->argv[state->next - 1];
    if (value && word == value) word = state->argv[state->next - 2];
    return word[0] == '-' && word[1] == '-' ? word : NULL;
}

static bool is_abbreviation(const struct parse *p, const struct argp_state *state,
                            const char *value)
{
    const char *word = long_word(state, value);
    return word && !find_option(&p->argp, word + 2, strcspn(word + 2, "="));
}

static error_t stop(struct parse *p, int status)
{
    if (p->status < 0) p->status = status;
    return ECANCELED;
}

// Help, version, wrong options: the same at the top level and for a subcommand.
static error_t parse_standard(int key, char *value, struct argp_state *state)
{
    struct parse *p = state->input;
    switch (key) {
    case KEY_HELP:
        if (is_abbreviation(p, state, NULL))
            return stop(p, refuse_word(p, long_word(state, NULL)));
        argp_help(&p->argp, stdout, ARGP_HELP_STD_HELP & ~(unsigned)ARGP_HELP_EXIT_OK, p->name);
        return stop(p, EXIT_DONE);
    case KEY_VERSION:
        if (is_abbreviation(p, state, NULL))
            return stop(p, refuse_word(p, long_word(state, NULL)));
        puts("prt " PRT_VERSION);
        return stop(p, EXIT_DONE);
    case ARGP_KEY_ERROR:
        // getopt stands behind the wrong word, or at it when letters of "-abc" are left.
        for (int i = state->next - 1; p->status < 0 && i <= state->next; i++)
            if (i > 0 && i < state->argc) p->status = refuse_word(p, state->argv[i]);
        return 0;
    default:
        return ARGP_ERR_UNKNOWN;
    }
}

static error_t parse_command(int key, char *value, struct argp_state *state)
{
    struct parse *p = state->input;
    struct options *o = p->options;
    if (key == ARGP_KEY_ARG) {
        if (o->n_input == commands[o->command].max_input)
            return stop(p, usage_error(o, "%s is one operand too many", value));
        o->input[o->n_input++] = value;
        return 0;
    }
    const struct option_row *row = key > 0 ? row_of(o->command, key) : NULL;
    if (!row) return parse_standard(key, value, state);
    if (is_abbreviation(p, state, value))
        return stop(p, refuse_word(p, long_word(state, value)));
    int status = option_set(o, row, value);
    return status < 0 ? 0 : stop(p, status);
}

static error_t parse_program(int key, char *value, struct argp_state *state)
{
    struct parse *p = state->input;
    if (key != ARGP_KEY_ARG) return parse_standard(key, value, state);
    int command = 0;
    while (command < N_COMMAND && strcmp(commands[command].name, value)) command++;
    if (!strcmp(value, "help")) return parse_standard(KEY_HELP, NULL, state);
    if (command == N_COMMAND)
        return stop(p, usage_error(p->options, "%s is not a subcommand of prt", value));
    p->options->command = (enum command)command;
    p->rest = state->next;
    state->next = state->argc; // the subcommand's own parser takes the rest
    return 0;
}

// "Summary.\vExamples: …", argp's texts before and after the options. Owned by the caller.
static char *command_doc(enum command command)
{
    char *text = NULL;
    const char *summary = commands[command].summary;
    if (asprintf(&text, "%c%s.\vExamples:\n%s\nExit status: 0 done, 1 failed, 2 wrong usage.",
                 toupper((unsigned char)summary[0]), summary + 1,
                 commands[command].examples) < 0)
        return NULL;
    return text;
}

static char *program_doc(void)
{
    char *text = NULL;
    size_t n;
    FILE *f = open_memstream(&text, &n);
    if (!f) return NULL;
    fputs("Bakes, lights, draws and compares translucent models without a daemon.\v"
          "Subcommands:\n",
          f);
    for (int i = 0; i < N_COMMAND; i++)
        fprintf(f, "  prt %s %s\n      %s\n", commands[i].name, commands[i].operands,
                commands[i].summary);
    fputs("\nSOURCE is a .prt, or a model (.glb .gltf .obj .ply .stl) with --material and "
          "--size-mm or --mm-per-unit. 'prt SUBCOMMAND --help' prints options and examples.\n\n"
          "Exit status: 0 done, 1 failed, 2 wrong usage.",
          f);
    fclose(f);
    return text;
}

static int run_parser(struct parse *p, int argc, char **argv)
{
    if (!p->argp.doc || !p->argp.options) {
        fputs("error: no memory for the command line\n", stderr);
        return EXIT_FAILED;
    }
    p->status = -1;
    error_t error = argp_parse(&p->argp, argc, argv, PARSE_FLAGS, NULL, p);
    if (error && p->status < 0) p->status = EXIT_USAGE;
    return p->status;
}

static int find_command(struct options *o, int argc, char **argv, int *rest)
{
    char *doc = program_doc();
    struct parse p = {.options = o, .name = "prt"};
    p.argp =
        (struct argp){standard_options, parse_program, "SUBCOMMAND ...", doc, NULL, NULL, NULL};
    int status = run_parser(&p, argc, argv);
    free(doc);
    *rest = p.rest;
    if (status < 0 && !p.rest) return usage_error(o, "no subcommand given");
    return status;
}

static int parse_subcommand(struct options *o, int argc, char **argv)
{
    char *doc = command_doc(o->command);
    struct parse p = {.options = o};
    snprintf(p.name, sizeof p.name, "prt %s", commands[o->command].name);
    add_rows(&p, o->command);
    p.argp = (struct argp){p.option, parse_command, commands[o->command].operands, doc, NULL,
                           NULL,     NULL};
    int status = run_parser(&p, argc, argv);
    free_rows(&p);
    free(doc);
    return status;
}

// Combinations that the check of a single value cannot see.
static int check_together(const struct options *o)
{
    if (o->n_input < commands[o->command].min_input)
        return usage_error(o, "expected %s", commands[o->command].operands);
    if (o->phase_terms && o->phase_terms != 1 && o->phase_terms != 4 && o->phase_terms != 9 &&
        (o->phase_terms != 16 || o->command == CMD_BAKE))
        return usage_error(o, "--phase-terms %d: expected 1, 4 or 9", (int)o->phase_terms);
    // A .prt says how it was baked.
    const bool baked = o->command != CMD_BAKE && o->n_input && prt_file_probe(o->input[0]);
    const bool on_screen = o->command == CMD_IMAGE && o->engine &&
                           strcmp(o->engine, "vertex") && strcmp(o->engine, "reference");
    bool walk = o->scattering ? !strcmp(o->scattering, "walk")
                              : baked || on_screen || o->command == CMD_INFO;
    if (o->walks && !walk) return usage_error(o, "--walks is for --scattering walk");
    if (o->term && !strcmp(o->term, "unscattered") && (!walk || on_screen))
        return usage_error(o,
                           "--term unscattered is for --scattering walk: the dipole has none");
    if (o->term && !strcmp(o->term, "difference") && o->command != CMD_IMAGE)
        return usage_error(o, "--term difference is for prt image");
    if (o->msaa & (o->msaa - 1))
        return usage_error(o, "--msaa %d: expected 1, 2, 4 or 8", (int)o->msaa);
    if (o->size_mm > 0 && o->mm_per_unit > 0)
        return usage_error(o, "--size-mm and --mm-per-unit both give the scale: choose one");
    return -1;
}

int options_parse(int argc, char **argv, struct options *out)
{
    int rest;
    memset(out, 0, sizeof *out);
    out->command = N_COMMAND;
    out->progress_fd = -1;
    int status = find_command(out, argc, argv, &rest);
    // argp passes over argv[0], here the subcommand's name.
    if (status < 0) status = parse_subcommand(out, argc - rest + 1, argv + rest - 1);
    if (status < 0) status = check_together(out);
    if (status < 0 && out->accept_weak_sandbox) setenv(PRT_ACCEPT_WEAK_SANDBOX, "1", 1);
    return status;
}
