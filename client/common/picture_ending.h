/* SPDX-License-Identifier: MIT */
/* picture_ending.h finds the daemon's picture format by a file's ending. */
#ifndef RELIGHT_PICTURE_ENDING_H
#define RELIGHT_PICTURE_ENDING_H

#include "relight/relight.h"

/* The format that the ending of `path` names ("-", a terminal: IMAGE_RGB8); false for any other
 * and for NULL. */
bool picture_ending(const char *path, enum relight_image_format *out);
/* The endings of all formats, as ".jpg, .png": for messages. */
const char *picture_ending_list(char text[128]);

#endif
