/* SPDX-License-Identifier: MIT */
/* difference.h declares the comparison of the dipole with random walks at every vertex. */
#ifndef PRT_TOOL_DIFFERENCE_H
#define PRT_TOOL_DIFFERENCE_H

#include "tool.h"

struct difference {
    double rms; /* relative, of the dipole's multiple scattering from the walks' */
    double darkest, brightest; /* of the dipole over the walks, less 1: beyond these lies one
                                * vertex in fifty */
};
/* The colour, linear RGB, of a vertex where the dipole is 1 + excess times as bright as the
 * walks: white at 0, red above and blue below, full at a factor of two: 1 and -0.5. */
void difference_color(double excess, float out[3]);
/* The excesses of a legend, ascending, [DIFFERENCE_LEGEND]. */
enum { DIFFERENCE_LEGEND = 7 };
extern const double difference_legend[DIFFERENCE_LEGEND];

/* False colours of every vertex: white where both are equal, red where the dipole is too bright
 * and blue where it is too dark, full at a factor of two. baked: the walks are those of the
 * .prt, else of the reference engine. Blocks. Returns an exit status. */
int difference_colors(struct tool *tool, const struct source *source,
                      const struct prt_cube *light, bool baked, float (*color)[3],
                      struct difference *out);

#endif
