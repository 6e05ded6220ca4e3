// SPDX-License-Identifier: MIT
// Output beside the answer: errors with their exit status, JSON, text of the daemon made safe
// for terminals, the progress bar.
#include "cli.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

int report_error(const struct options *options, const struct relight_error *error)
{
    progress_clear();
    if (options->json) {
        cJSON *json = cJSON_CreateObject(), *e = cJSON_AddObjectToObject(json, "error");
        cJSON_AddNumberToObject(e, "code", error->code);
        cJSON_AddStringToObject(e, "text", error->text);
        cJSON_AddStringToObject(e, "hint", error->hint);
        if (error->retry_after_ms)
            cJSON_AddNumberToObject(e, "retry_after_ms", error->retry_after_ms);
        if (*error->parameter) cJSON_AddStringToObject(e, "parameter", error->parameter);
        if (error->has_range) {
            cJSON_AddNumberToObject(e, "minimum", error->minimum);
            cJSON_AddNumberToObject(e, "maximum", error->maximum);
            cJSON_AddStringToObject(e, "unit", error->unit);
        }
        print_json(json);
    }
    fprintf(stderr, "relight: %s\n", error->text);
    if (*error->hint) fprintf(stderr, "relight: %s\n", error->hint);
    return exit_status(error->code);
}

int report_usage(const struct options *options, const char *fmt, ...)
{
    va_list list;
    fprintf(stderr, "relight %s: ", options->command);
    va_start(list, fmt);
    vfprintf(stderr, fmt, list);
    va_end(list);
    fprintf(stderr, "\nTry 'relight %s --help'.\n", options->command);
    return EXIT_USAGE;
}

// Copies the next character of *text as a terminal may print it and advances; returns its
// length.
static size_t escape_next(const char **text, char out[8])
{
    const unsigned char *c = (const unsigned char *)*text;
    if (*c < 0x20 || *c == 0x7f) {
        ++*text;
        return (size_t)snprintf(out, 8, "\\x%02x", *c);
    }
    if (*c == 0xc2 && c[1] >= 0x80 && c[1] < 0xa0) { // C1 controls, in UTF-8
        *text += 2;
        return (size_t)snprintf(out, 8, "\\x%02x", c[1]);
    }
    size_t n = 1;
    while (n < 4 && (c[n] & 0xc0) == 0x80 && *c >= 0xc0) n++;
    memcpy(out, c, n);
    *text += n;
    return n;
}

struct escaped escape(const char *text)
{
    struct escaped out;
    char next[8];
    size_t used = 0;
    while (*text) {
        size_t n = escape_next(&text, next);
        if (used + n >= sizeof out.text) break;
        memcpy(out.text + used, next, n);
        used += n;
    }
    out.text[used] = 0;
    return out;
}

void print_text(FILE *file, const char *text)
{
    char next[8];
    while (*text) {
        size_t n = escape_next(&text, next);
        fwrite(next, 1, n, file);
    }
}

size_t whole_characters(const char *text, size_t most)
{
    size_t n = strnlen(text, most + 1);
    if (n <= most) return n;
    for (n = most; n && ((unsigned char)text[n] & 0xc0) == 0x80;) n--;
    return n;
}

void print_json(cJSON *json)
{
    char *text = cJSON_PrintUnformatted(json);
    // cJSON escapes C0 controls; DEL and C1 controls, also only inside strings, are escaped
    // here.
    for (const char *at = text; at && *at; at++) {
        unsigned char next = (unsigned char)at[1];
        bool c1 = (unsigned char)*at == 0xc2 && next >= 0x80 && next < 0xa0;
        if (c1 || *at == 0x7f) printf("\\u%04x", c1 ? next : 0x7f);
        else putchar(*at);
        at += c1;
    }
    if (text) putchar('\n');
    free(text);
    cJSON_Delete(json);
}

void add_float(cJSON *json, const char *key, double x)
{
    char text[40];
    snprintf(text, sizeof text, "%.7g", x);
    cJSON_AddRawToObject(json, key, text);
}

void add_floats(cJSON *json, const char *key, const float x[3])
{
    char text[120];
    snprintf(text, sizeof text, "[%.9g,%.9g,%.9g]", x[0], x[1], x[2]);
    cJSON_AddRawToObject(json, key, text);
}

static bool bar_shown;

void progress_clear(void)
{
    if (!bar_shown) return;
    fputs("\r\033[K", stderr);
    bar_shown = false;
}

int progress_bar(void *user, const struct relight_progress *progress)
{
    if (!isatty(STDERR_FILENO)) return 0;
    struct winsize window = {.ws_col = 80};
    ioctl(STDERR_FILENO, TIOCGWINSZ, &window);
    int width = window.ws_col > 70 ? 30 : 10;
    double fraction = progress->fraction < 0   ? 0
                      : progress->fraction > 1 ? 1
                                               : progress->fraction;
    int filled = (int)(fraction * width);
    char left[32] = "";
    if (progress->eta_s >= 0 && progress->eta_s < 1e6)
        snprintf(left, sizeof left, ", %d:%02d left", (int)progress->eta_s / 60,
                 (int)progress->eta_s % 60);
    fprintf(stderr, "\r\033[K[%.*s%*s] %3.0f %% %.24s%s", filled,
            "##############################", width - filled, "", 100 * fraction,
            escape(progress->stage).text, left);
    fflush(stderr);
    bar_shown = true;
    return 0;
}
