// SPDX-License-Identifier: MIT
// Endings of picture files, from the rows of relight.h.
#include "picture_ending.h"

#include <stdio.h>
#include <string.h>
#include <strings.h>

// Raw pixels and variants of another format's files have no ending.
static const struct {
    const char *ending;
    enum relight_image_format format;
} formats[] = {
#define X(name, number, ending) {ending, RELIGHT_IMAGE_##name},
    RELIGHT_IMAGE_FORMAT_LIST(X)
#undef X
        {"jpeg", RELIGHT_IMAGE_JPEG},
};
enum { N_FORMAT = sizeof formats / sizeof *formats };

bool picture_ending(const char *path, enum relight_image_format *out)
{
    if (path && !strcmp(path, "-")) {
        *out = RELIGHT_IMAGE_RGB8;
        return true;
    }
    const char *dot = path ? strrchr(path, '.') : NULL;
    for (int i = 0; dot && dot[1] && i < N_FORMAT; i++)
        if (!strcasecmp(dot + 1, formats[i].ending)) {
            *out = formats[i].format;
            return true;
        }
    return false;
}

const char *picture_ending_list(char text[128])
{
    size_t n = 0;
    *text = 0;
    for (int i = 0; i < N_FORMAT - 1 && n < 128; i++) // "jpeg" is another word for "jpg"
        if (*formats[i].ending)
            n += (size_t)snprintf(text + n, 128 - n, "%s.%s", n ? ", " : "", formats[i].ending);
    return text;
}
