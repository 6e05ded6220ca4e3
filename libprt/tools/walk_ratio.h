/* SPDX-License-Identifier: MIT */
/* walk_ratio.h declares what `image` and `info` say of the ratio of walks to the dipole. */
#ifndef PRT_TOOL_WALK_RATIO_H
#define PRT_TOOL_WALK_RATIO_H

#include "tool.h"
#include "prt/walk_ratio.h"

#include <cjson/cJSON.h>

/* Whether a picture by an image-space engine is scaled: by --scattering, else where no
 * --budget-ms bounds its time. */
bool ratio_wanted(const struct options *options);
/* The ratio of a mesh and its media by --walks and --seed; the caller ends *out with
 * prt_walk_ratio_destroy. Blocks for seconds. Library status. */
int ratio_create(const struct tool *tool, const struct prt_mesh *mesh,
                 const struct prt_media *media, struct prt_walk_ratio **out,
                 struct prt_walk_ratio_report *report);
/* One line as a note. */
void ratio_note(const struct tool *tool, const struct prt_walk_ratio_report *report);
/* The object "walk_ratio". */
void ratio_json(cJSON *to, const struct prt_walk_ratio_report *report);
/* The array "dipole_error": what the dipole costs in each medium, in numbers and `words`, with
 * places in the model's own units. Library status. */
int ratio_error_json(cJSON *to, const struct prt_walk_ratio *ratio,
                     const struct prt_walk_ratio_report *report, const struct prt_mesh *mesh,
                     const struct prt_media *media);

#endif
