/* SPDX-License-Identifier: MIT */
/* terminal.h owns pictures in a terminal: by kitty's graphics protocol, as sixels, or as half
 * blocks of text in 24-bit or 256 colours. Includes nothing of ours. Thread-safe. */
#ifndef PRT_TERMINAL_H
#define PRT_TERMINAL_H

#include <stdint.h>
#include <stdio.h>

#ifdef __cplusplus
extern "C" {
#endif

enum prt_terminal_kind {
    PRT_TERMINAL_BLOCKS_256, /* "blocks256" */
    PRT_TERMINAL_BLOCKS,     /* "blocks": 24-bit colours */
    PRT_TERMINAL_SIXEL,      /* "sixel" */
    PRT_TERMINAL_KITTY,      /* "kitty" */
};
struct prt_terminal {
    enum prt_terminal_kind kind;
    uint32_t columns, rows; /* characters */
    uint32_t width, height; /* pixels; 0: unknown */
};

/* Finds out what the terminal behind a descriptor shows, by $RELIGHT_TERMINAL (one of the words
 * above), $TERM, $TERM_PROGRAM and $COLORTERM; the size by the descriptor, else $COLUMNS and
 * $LINES, else 80 x 24. Does not block. */
void prt_terminal_detect(int fd, struct prt_terminal *out);

/* The size of a picture of this shape that fits into the terminal, for a caller that is about
 * to draw one: at most the pixels that are shown. */
void prt_terminal_fit(const struct prt_terminal *terminal, uint32_t *width, uint32_t *height);

/* Writes rgb [height][width][3], sRGB bytes, top row first. Half blocks are means over the
 * pixels; the other kinds show every pixel. 0, or -1: width or height is 0, or the stream or
 * memory failed. */
int prt_terminal_draw(FILE *out, const struct prt_terminal *terminal, uint32_t width,
                      uint32_t height, const uint8_t *rgb);

#ifdef __cplusplus
}
#endif
#endif
