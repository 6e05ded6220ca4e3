// SPDX-License-Identifier: MIT
// The option table's three readers: argp, the configuration file, and --print-config.
#include "core/options.h"

#include <argp.h>
#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum kind { KIND_TEXT, KIND_COUNT, KIND_BYTES, KIND_SECONDS, KIND_FLAG };
struct row {
    enum kind kind;
    size_t offset;
    const char *word, *value, *preset, *text;
};
static const struct row table[] = {
#define X(kind, field, word, value, preset, text) \
    {KIND_##kind, offsetof(struct options, field), word, value, preset, text},
    OPTIONS_LIST(X)
#undef X
};
enum {
    N_ROW = sizeof table / sizeof *table,
    KEY_FIRST = 0x100,
    KEY_CONFIG = 0x400,
    KEY_LISTEN,
    KEY_PRINT
};

const char *argp_program_version = "relightd " RELIGHT_VERSION;

// NULL when fine, else what was wrong.
static const char *set_row(struct options *options, const struct row *row, const char *text)
{
    void *field = (char *)options + row->offset;
    char *end;
    errno = 0;
    if (row->kind == KIND_TEXT) {
        *(const char **)field = text; // argv, a preset or the configuration's text: all stay
        return NULL;
    }
    if (row->kind == KIND_FLAG) { // the bare word says yes
        *(bool *)field = !text || !strcmp(text, "yes");
        return text && strcmp(text, "yes") && strcmp(text, "no") ? "yes or no is wanted" : NULL;
    }
    double x = strtod(text, &end);
    if (end == text || !isfinite(x) || x < 0 || errno) return "a number >= 0 is wanted";
    if (row->kind == KIND_BYTES) {
        static const char units[] = " kMGT";
        int power = *end ? 4 : 0;
        while (power && units[power] != *end) power--;
        if (*end && !power) return "bytes with an optional k, M, G or T are wanted";
        for (int i = 0; i < power; i++) x *= 1024;
        if (power) end++;
        if (x > 1e18) return "that many bytes do not exist";
        *(uint64_t *)field = (uint64_t)x;
    } else if (row->kind == KIND_COUNT) {
        if (x != floor(x) || x > 1e9) return "a whole number is wanted";
        *(uint32_t *)field = (uint32_t)x;
    } else {
        if (x > 1e9) return "seconds up to 1e9 are wanted";
        *(double *)field = x;
    }
    while (isspace((unsigned char)*end)) end++;
    return *end ? "there is something behind the number" : NULL;
}

static const char *add_listen(struct options *options, const char *text)
{
    if (options->n_listen == OPTIONS_MAX_LISTEN) return "too many listen addresses";
    bool tcp = !strncmp(text, "tcp:", 4) && strrchr(text, ':') > text + 3;
    if (!tcp && (strncmp(text, "unix:", 5) || !text[5]))
        return "tcp:HOST:PORT or unix:PATH is wanted";
    options->listen[options->n_listen++] = text;
    return NULL;
}

static char *trim(char *s)
{
    while (isspace((unsigned char)*s)) s++;
    for (char *end = s + strlen(s); end > s && isspace((unsigned char)end[-1]);) *--end = 0;
    return s;
}

static void fail_line(const char *path, int line, const char *word, const char *fault)
{
    fprintf(stderr, "relightd: %s:%d: %s: %s\n", path, line, word, fault);
    exit(2);
}

static char *config_text; // options point into it

static void read_config(struct options *options, const char *path)
{
    enum { MOST = 1 << 20 };
    FILE *file = fopen(path, "r");
    char *text = file && !config_text ? calloc(1, MOST) : NULL;
    if (!text || (!fread(text, 1, MOST - 1, file) && ferror(file))) {
        fprintf(stderr, "relightd: %s: %s\n", path,
                config_text ? "one configuration file is enough" : strerror(errno));
        exit(2);
    }
    fclose(file);
    config_text = text;
    for (int n = 1; text; n++) {
        char *word = trim(strsep(&text, "\n"));
        if (!*word || *word == '#') continue;
        char *value = strchr(word, '=');
        if (!value) fail_line(path, n, word, "`word = value` is wanted");
        *value++ = 0;
        word = trim(word);
        value = trim(value);
        const char *fault = "no such option";
        if (!strcmp(word, "listen")) fault = add_listen(options, value);
        for (size_t i = 0; i < N_ROW; i++)
            if (!strcmp(word, table[i].word)) fault = set_row(options, &table[i], value);
        if (fault) fail_line(path, n, word, fault);
    }
}

static void print_wrapped(const char *text)
{
    size_t column = 0;
    for (const char *p = text; *p;) {
        size_t n = strcspn(p, " ");
        if (!column || column + 1 + n > 78) {
            printf("%s#", column ? "\n" : "");
            column = 1;
        }
        printf(" %.*s", (int)n, p);
        column += 1 + n;
        p += n;
        while (*p == ' ') p++;
    }
    printf("\n");
}

static void print_config(void)
{
    printf("# relightd's configuration: `word = value` lines, the words of its command line,\n"
           "# which goes before this file. Every line shows the default.\n\n"
           "# Where clients connect: tcp:HOST:PORT or unix:PATH; may be repeated.\n"
           "#listen = tcp:127.0.0.1:7413\n");
    for (size_t i = 0; i < N_ROW; i++) {
        printf("\n");
        print_wrapped(table[i].text);
        printf("#%s = %s\n", table[i].word, table[i].preset);
    }
}

struct parse {
    struct options *options;
    unsigned config_listen; // addresses that came from the file: the command line replaces them
    bool listen_given;
};

static error_t parse_one(int key, char *arg, struct argp_state *state)
{
    struct parse *parse = state->input;
    const char *fault = NULL;
    if (key == KEY_CONFIG) return 0; // read before, so that the command line goes first
    if (key == KEY_PRINT) {
        print_config();
        exit(0);
    }
    if (key == KEY_LISTEN) {
        if (!parse->listen_given) parse->options->n_listen = 0;
        parse->listen_given = true;
        if ((fault = add_listen(parse->options, arg)))
            argp_error(state, "--listen %s: %s", arg, fault);
        return 0;
    }
    if (key >= KEY_FIRST && key < KEY_FIRST + N_ROW) {
        const struct row *row = &table[key - KEY_FIRST];
        if ((fault = set_row(parse->options, row, arg)))
            argp_error(state, "--%s %s: %s", row->word, arg ? arg : "", fault);
        return 0;
    }
    if (key == ARGP_KEY_ARG) argp_error(state, "%s: no plain arguments are taken", arg);
    return ARGP_ERR_UNKNOWN;
}

void options_parse(int argc, char **argv, struct options *options)
{
    struct argp_option list[N_ROW + 4] = {
        {"config", KEY_CONFIG, "FILE", 0, "Read `word = value` lines first", 0},
        {"listen", KEY_LISTEN, "tcp:HOST:PORT|unix:PATH", 0,
         "Where clients connect; may be repeated (tcp:127.0.0.1:7413)", 0},
        {"print-config", KEY_PRINT, NULL, 0, "Print the annotated default configuration", 0},
    };
    char doc[N_ROW][400];
    for (size_t i = 0; i < N_ROW; i++) {
        snprintf(doc[i], sizeof doc[i], "%s%s%s%s", table[i].text, *table[i].preset ? " (" : "",
                 table[i].preset, *table[i].preset ? ")" : "");
        list[i + 3] = (struct argp_option){
            table[i].word,  KEY_FIRST + (int)i,
            table[i].value, table[i].kind == KIND_FLAG ? OPTION_ARG_OPTIONAL : 0,
            doc[i],         0};
    }
    struct argp argp = {list, parse_one, NULL,
                        "The relighting daemon: holds precomputed light transport and answers "
                        "clients that send it lights and materials.\v"
                        "Exit status: 0 after SIGTERM or SIGINT, 1 failed, 2 wrong usage."};
    *options = (struct options){0};
    for (size_t i = 0; i < N_ROW; i++) set_row(options, &table[i], table[i].preset);
    for (int i = 1; i < argc && strcmp(argv[i], "--"); i++) {
        if (!strncmp(argv[i], "--config=", 9)) read_config(options, argv[i] + 9);
        if (!strcmp(argv[i], "--config") && i + 1 < argc) read_config(options, argv[i + 1]);
    }
    struct parse parse = {.options = options};
    argp_err_exit_status = 2;
    argp_parse(&argp, argc, argv, 0, NULL, &parse);
    if (options->bake_nice > 19) {
        fprintf(stderr, "relightd: bake-nice %u is outside 0..19\n", options->bake_nice);
        exit(2);
    }
    if (!options->n_listen) add_listen(options, "tcp:127.0.0.1:7413");
}
