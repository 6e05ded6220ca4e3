/* SPDX-License-Identifier: MIT */
/* view_pace.h owns how coarse the colours of a view are while its state moves, by the time in
 * which the client acknowledges them. It reads no clock. */
#ifndef RELIGHTD_VIEW_PACE_H
#define RELIGHTD_VIEW_PACE_H

#include <stdbool.h>

enum { VIEW_PACE_LEVELS = 4 }; /* of 1, 1/2, 1/4 and 1/8 of the vertices */

/* Zeroed: full frames. */
struct view_pace {
    unsigned level;
    unsigned late, early, patience; /* frames in a row; before a finer level is tried */
    bool tried;                     /* the level was refined and has not held yet */
    double mean_ms;                 /* running mean of the level's delays; 0: none yet */
};

/* A frame of `level` was acknowledged after delay_ms. Others than those of the present level
 * change nothing. */
void view_pace_acknowledged(struct view_pace *pace, double delay_ms, unsigned level);

#endif
