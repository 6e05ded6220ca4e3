/* SPDX-License-Identifier: MIT */
/* image_format.h owns what each ImageFormat of relight.proto is: a row is all that the daemon
 * needs of a format that prt/picture.h writes. */
#ifndef RELIGHTD_IMAGE_FORMAT_H
#define RELIGHTD_IMAGE_FORMAT_H

#include <stdbool.h>

struct image_format {
    const char *media_type; /* of HTTP */
    const char *ending;    /* of the file format of prt/picture.h; NULL: bytes without a file */
    bool full_float, fine; /* of struct prt_picture_options */
};
/* NULL for a number that is no format. */
const struct image_format *image_format_of(unsigned format);

#endif
