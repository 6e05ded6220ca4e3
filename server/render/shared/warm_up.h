/* SPDX-License-Identifier: MIT */
/* warm.h owns what a first picture would otherwise wait for: the specular filter's table and
 * the rasteriser's start, a few hundred milliseconds once a process. */
#ifndef RELIGHTD_WARM_H
#define RELIGHTD_WARM_H

#include "core/work.h"

/* Does it in the background, behind every request. */
void warm_start(struct work_pool *pool);

#endif
