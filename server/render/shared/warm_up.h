/* SPDX-License-Identifier: MIT */
/* warm_up.h owns the initialisation that would delay the first picture: the specular filter's
 * table and the rasteriser's start, a few hundred milliseconds once a process. */
#ifndef RELIGHTD_WARM_H
#define RELIGHTD_WARM_H

#include "core/work.h"

/* Runs it on a background worker. */
void warm_start(struct work_pool *pool);

#endif
