/* SPDX-License-Identifier: MIT */
/* maps.h owns the images over uv that prt image gives to image-space engines. */
#ifndef PRT_TOOL_MAPS_H
#define PRT_TOOL_MAPS_H

#include "prt/screen.h"
#include "tool.h"

struct maps {
    struct prt_screen_map map[3]; /* albedo, normals, heights */
};
bool maps_given(const struct options *options);
/* Loads the files of --albedo-map, --normal-map and --bump-map, for this medium, and points
 * `screen` at it; `out` must outlive the picture. Returns an exit status. */
int maps_load(struct tool *tool, const struct prt_mesh *mesh, const struct prt_media *media,
              struct maps *out, struct prt_screen_options *screen);
void maps_finish(struct maps *maps);

#endif
