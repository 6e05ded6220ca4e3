/* SPDX-License-Identifier: MIT */
/* Tables behind profiles, shared by the files that fill them. */
#ifndef MEDIUM_PROFILE_H
#define MEDIUM_PROFILE_H

#include "prt/profile.h"

#include <stdio.h>

int profile_table(struct prt_profile *profile, uint32_t n); /* zeroed r, rd, outside */
/* outside[] from r[] and rd[], 0 at the last point */
void profile_table_integrate(struct prt_profile *profile);

#endif
