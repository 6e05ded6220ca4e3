/* SPDX-License-Identifier: MIT */
/* chunked.h owns the framing of a body with Transfer-Encoding: chunked (RFC 9112 section 7.1).
 * Extensions and trailers are skipped and bounded. Thread-safety: none. */
#ifndef RELIGHTD_CHUNKED_H
#define RELIGHTD_CHUNKED_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { CHUNKED_SKIPPED = 4096 }; /* most bytes of extensions and trailers in a body */

/* Zeroed at first. */
struct chunked {
    int state;
    uint64_t left; /* of the chunk; while its size is read, the size */
    unsigned digits, skipped;
    bool done, wrong; /* the last chunk was read; the framing is broken */
};

/* Takes bytes from *bytes and *n up to the end of the next piece of data. Its length, with its
 * place in *data; 0: nothing is left, or the body is done or wrong. */
size_t chunked_next(struct chunked *chunked, const char **bytes, size_t *n, const char **data);

#endif
