// SPDX-License-Identifier: MIT
// Readers of the option table: argp, the configuration file, and --print-config.
#include "core/options.h"

#include "core/ledger.h"
#include "core/token_store.h"

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
    KEY_PRINT,
    KEY_CHECK
};

const char *argp_program_version = "relightd " RELIGHT_VERSION;

// NULL, or the error's text.
static const char *set_row(struct options *options, const struct row *row, const char *text)
{
    void *field = (char *)options + row->offset;
    char *end;
    errno = 0;
    if (row->kind == KIND_TEXT) {
        *(const char **)field =
            text; // argv, a preset or the configuration's text: all stay valid
        return NULL;
    }
    if (row->kind == KIND_FLAG) { // the option without a value means yes
        *(bool *)field = !text || !strcmp(text, "yes");
        return text && strcmp(text, "yes") && strcmp(text, "no") ? "expected yes or no" : NULL;
    }
    double x = strtod(text, &end);
    if (end == text || !isfinite(x) || x < 0 || errno) return "expected a number >= 0";
    if (row->kind == KIND_BYTES) {
        static const char units[] = " kMGT";
        int power = *end ? 4 : 0;
        while (power && units[power] != *end) power--;
        if (*end && !power) return "expected bytes with an optional k, M, G or T";
        for (int i = 0; i < power; i++) x *= 1024;
        if (power) end++;
        if (x > 1e18) return "expected at most 1e18 bytes";
        *(uint64_t *)field = (uint64_t)x;
    } else if (row->kind == KIND_COUNT) {
        if (x != floor(x) || x > 1e9) return "expected a whole number up to 1e9";
        *(uint32_t *)field = (uint32_t)x;
    } else {
        if (x > 1e9) return "expected seconds up to 1e9";
        *(double *)field = x;
    }
    while (isspace((unsigned char)*end)) end++;
    return *end ? "unexpected text after the number" : NULL;
}

static const char *add_listen(struct options *options, const char *text)
{
    if (options->n_listen == OPTIONS_MAX_LISTEN) return "too many listen addresses";
    bool tcp = (!strncmp(text, "tcp:", 4) || !strncmp(text, "tls:", 4)) &&
               strrchr(text, ':') > text + 3;
    if (!tcp && (strncmp(text, "unix:", 5) || !text[5]))
        return "expected tcp:HOST:PORT, tls:HOST:PORT or unix:PATH";
    options->listen[options->n_listen++] = text;
    return NULL;
}

static char *trim(char *s)
{
    while (isspace((unsigned char)*s)) s++;
    for (char *end = s + strlen(s); end > s && isspace((unsigned char)end[-1]);) *--end = 0;
    return s;
}

// Texts of configuration files; options point into them, also after a later reading.
struct config_text {
    struct config_text *next;
    char text[];
};
static struct config_text *config_texts;

// NULL with the error's text in *fault.
static char *read_text(const char *path, const char **fault)
{
    enum { MOST = 1 << 20 };
    FILE *file = fopen(path, "re");
    struct config_text *own = file ? calloc(1, sizeof *own + MOST + 1) : NULL;
    size_t n = own ? fread(own->text, 1, MOST + 1, file) : 0;
    *fault = NULL;
    if (!own || ferror(file)) *fault = strerror(errno);
    else if (n > MOST) *fault = "longer than 1048576 bytes";
    else if (memchr(own->text, 0, n)) *fault = "not text: it contains a zero byte";
    if (file) fclose(file);
    if (*fault) {
        free(own);
        return NULL;
    }
    struct config_text *small = realloc(own, sizeof *own + n + 1);
    own = small ? small : own;
    own->next = config_texts;
    config_texts = own;
    return own->text;
}

int options_read_config(struct options *options, const char *name, char *text, char error[300])
{
    for (int n = 1; text; n++) {
        char *word = trim(strsep(&text, "\n"));
        if (!*word || *word == '#') continue;
        char *value = strchr(word, '=');
        const char *fault = value ? "no such option" : "expected `word = value`";
        if (value) {
            *value++ = 0;
            word = trim(word);
            value = trim(value);
            if (!strcmp(word, "listen")) fault = add_listen(options, value);
            for (size_t i = 0; i < N_ROW; i++)
                if (!strcmp(word, table[i].word)) fault = set_row(options, &table[i], value);
        }
        if (!fault) continue;
        snprintf(error, 300, "%.100s:%d: %.80s: %s", name, n, word, fault);
        return -1;
    }
    return 0;
}

static int read_config(struct options *options, const char *path, char fault[256])
{
    const char *wrong;
    char error[300];
    char *text = read_text(path, &wrong);
    if (!text) snprintf(error, sizeof error, "%.150s: %s", path, wrong);
    int failed = !text || options_read_config(options, path, text, error);
    if (failed) snprintf(fault, 256, "%.255s", error);
    return failed ? -1 : 0;
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
    printf(
        "# relightd's configuration: `word = value` lines, with the option names of the\n"
        "# command line, which takes precedence. Every line shows the default.\n\n"
        "# Where clients connect: tcp:HOST:PORT, tls:HOST:PORT (as tcp: with tls-cert, also\n"
        "# on loopback) or unix:PATH; may be repeated.\n"
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
    if (key == KEY_CONFIG) return 0; // read already, so that the command line takes precedence
    if (key == KEY_PRINT) {
        print_config();
        exit(0);
    }
    if (key == KEY_CHECK) {
        parse->options->check = true;
        return 0;
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
    if (key == ARGP_KEY_ARG)
        argp_error(state, "%s: unexpected argument; only options are accepted", arg);
    return ARGP_ERR_UNKNOWN;
}

// Checks that the type of a row does not cover.
static const char *fault_of_values(const struct options *options)
{
    char *end;
    unsigned scopes;
    if (!scopes_parse(options->local_scopes, &scopes))
        return "local-scopes: expected view, edit, upload, admin, comma-separated";
    if (!options->tls_cert[0] != !options->tls_key[0])
        return "tls-cert and tls-key belong together: one of them is missing";
    for (unsigned i = 0; i < options->n_listen; i++)
        if (!strncmp(options->listen[i], "tls:", 4) && !options->tls_cert[0])
            return "listen tls:HOST:PORT needs --tls-cert and --tls-key";
    if (options->bake_nice > 19) return "bake-nice is outside 0 to 19";
    unsigned long mode = strtoul(options->socket_mode, &end, 8);
    if (end == options->socket_mode || *end || mode > 0777)
        return "socket-mode: expected octal permissions such as 0660";
    return NULL;
}

// The defaults, then the configuration file, which the command line names.
static int read_defaults(int argc, char **argv, struct options *options, char fault[256])
{
    const char *path = NULL;
    *options = (struct options){0};
    for (size_t i = 0; i < N_ROW; i++) set_row(options, &table[i], table[i].preset);
    for (int i = 1; i < argc && strcmp(argv[i], "--"); i++) {
        const char *found = NULL;
        if (!strncmp(argv[i], "--config=", 9)) found = argv[i] + 9;
        if (!strcmp(argv[i], "--config") && i + 1 < argc) found = argv[i + 1];
        if (found && path) {
            snprintf(fault, 256, "--config %s: a configuration file was given already", found);
            return -1;
        }
        if (found) path = found;
    }
    return path ? read_config(options, path, fault) : 0;
}

static int read_all(int argc, char **argv, struct options *options, unsigned flags,
                    char fault[256])
{
    struct argp_option list[N_ROW + 5] = {
        {"config", KEY_CONFIG, "FILE", 0, "Read `word = value` lines first", 0},
        {"listen", KEY_LISTEN, "tcp:HOST:PORT|tls:HOST:PORT|unix:PATH", 0,
         "Where clients connect; may be repeated (tcp:127.0.0.1:7413). tls: as tcp: with "
         "--tls-cert, also on loopback",
         0},
        {"print-config", KEY_PRINT, NULL, 0, "Print the annotated default configuration", 0},
        {"check", KEY_CHECK, NULL, 0,
         "Check the configuration, print the result in one line and exit with status 0 or 2",
         0},
    };
    char doc[N_ROW][400];
    for (size_t i = 0; i < N_ROW; i++) {
        snprintf(doc[i], sizeof doc[i], "%s%s%s%s", table[i].text, *table[i].preset ? " (" : "",
                 table[i].preset, *table[i].preset ? ")" : "");
        list[i + 4] = (struct argp_option){
            table[i].word,  KEY_FIRST + (int)i,
            table[i].value, table[i].kind == KIND_FLAG ? OPTION_ARG_OPTIONAL : 0,
            doc[i],         0};
    }
    struct argp argp = {
        list, parse_one, NULL,
        "The relighting daemon: holds precomputed light transport and answers "
        "clients that send it lights and materials.\v"
        "SIGTERM and SIGINT: let clients leave (--lame-duck), answer the open requests (--drain), "
        "then exit; a second signal skips the waiting. SIGHUP: read the configuration and the "
        "token file again and log each change.\n\n"
        "Exit status: 0 after SIGTERM or SIGINT, 1 failed, 2 wrong usage."};
    if (read_defaults(argc, argv, options, fault)) return -1;
    struct parse parse = {.options = options};
    argp_err_exit_status = 2;
    if (argp_parse(&argp, argc, argv, flags, NULL, &parse)) {
        snprintf(fault, 256, "the command line has an error");
        return -1;
    }
    const char *wrong = fault_of_values(options);
    if (wrong) {
        snprintf(fault, 256, "%s", wrong);
        return -1;
    }
    if (!options->n_listen) add_listen(options, "tcp:127.0.0.1:7413");
    return 0;
}

void options_parse(int argc, char **argv, struct options *options)
{
    char fault[256];
    if (!read_all(argc, argv, options, 0, fault)) return;
    fprintf(stderr, "relightd: %s\n", fault);
    exit(2);
}

int options_reread(int argc, char **argv, struct options *options, char fault[256])
{
    return read_all(argc, argv, options, ARGP_SILENT, fault);
}

// ---- options that may change while the daemon runs

#define FIELD(f) offsetof(struct options, f)
static const size_t changeable[] = {
    FIELD(log),        FIELD(origins),        FIELD(local_scopes),
    FIELD(hosts),      FIELD(token_file),     FIELD(tls_cert),
    FIELD(tls_key),    FIELD(requests),       FIELD(handshake),
    FIELD(idle),       FIELD(write_time),     FIELD(send_buffer),
    FIELD(deadline),   FIELD(max_side),       FIELD(frame_time),
    FIELD(drain),      FIELD(goaway_address), FIELD(lame_duck),
    FIELD(log_access),
#define X(name, words, unit, by_client, in_all) FIELD(by_client), FIELD(in_all),
    LEDGER_LIST(X)
#undef X
};

static bool may_change(const struct row *row)
{
    for (size_t i = 0; i < sizeof changeable / sizeof *changeable; i++)
        if (changeable[i] == row->offset) return true;
    return false;
}

static size_t row_size(const struct row *row)
{
    static const size_t sizes[] = {[KIND_TEXT] = sizeof(char *),
                                   [KIND_COUNT] = sizeof(uint32_t),
                                   [KIND_BYTES] = sizeof(uint64_t),
                                   [KIND_SECONDS] = sizeof(double),
                                   [KIND_FLAG] = sizeof(bool)};
    return sizes[row->kind];
}

static void show_value(const struct row *row, const void *field, char out[200])
{
    if (row->kind == KIND_TEXT) snprintf(out, 200, "%s", *(const char *const *)field);
    if (row->kind == KIND_COUNT) snprintf(out, 200, "%u", *(const uint32_t *)field);
    if (row->kind == KIND_BYTES)
        snprintf(out, 200, "%llu", (unsigned long long)*(const uint64_t *)field);
    if (row->kind == KIND_SECONDS) snprintf(out, 200, "%g", *(const double *)field);
    if (row->kind == KIND_FLAG) snprintf(out, 200, "%s", *(const bool *)field ? "yes" : "no");
}

static bool same_listen(const struct options *a, const struct options *b)
{
    bool same = a->n_listen == b->n_listen;
    for (unsigned i = 0; same && i < a->n_listen; i++)
        same = !strcmp(a->listen[i], b->listen[i]);
    return same;
}

void options_update(struct options *options, const struct options *fresh,
                    void (*report)(const char *word, const char *value, bool taken))
{
    for (size_t i = 0; i < N_ROW; i++) {
        void *to = (char *)options + table[i].offset;
        const void *from = (const char *)fresh + table[i].offset;
        char value[200];
        bool same = table[i].kind == KIND_TEXT
                        ? !strcmp(*(const char **)to, *(const char *const *)from)
                        : !memcmp(to, from, row_size(&table[i]));
        if (same) continue;
        show_value(&table[i], from, value);
        if (may_change(&table[i])) memcpy(to, from, row_size(&table[i]));
        report(table[i].word, value, may_change(&table[i]));
    }
    if (!same_listen(options, fresh)) report("listen", fresh->listen[0], false);
}
