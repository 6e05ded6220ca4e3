// SPDX-License-Identifier: MIT
// A configuration file's text: it is taken, or refused with a line that says why.
#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/options.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n);

static void check(const struct options *o, const char *text, size_t n)
{
    // Words point into the text or are a default.
    const char *const word[] = {o->models, o->data, o->http, o->page, o->log, o->cpu};
    for (size_t i = 0; i < sizeof word / sizeof *word; i++) assert(strlen(word[i]) <= n + 8);
    assert(o->n_listen <= OPTIONS_MAX_LISTEN);
    for (unsigned i = 0; i < o->n_listen; i++)
        assert(o->listen[i] >= text && o->listen[i] <= text + n);
    const double seconds[] = {o->idle, o->frame_time, o->deadline, o->drain};
    for (size_t i = 0; i < sizeof seconds / sizeof *seconds; i++)
        assert(isfinite(seconds[i]) && seconds[i] >= 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n)
{
    static char *argv[] = {"relightd", NULL};
    struct options options;
    char error[300] = "", *text = malloc(n + 1);
    options_parse(1, argv, &options);
    options.n_listen = 0; // the default goes when the file names one
    memcpy(text, bytes, n);
    text[n] = 0;
    int status = options_read_config(&options, "fuzz.conf", text, error);
    assert(status == 0 || status == -1);
    assert(!status == !error[0]);
    if (status) assert(!strncmp(error, "fuzz.conf:", 10) && strlen(error) < 299);
    else check(&options, text, n);
    free(text);
    return 0;
}
