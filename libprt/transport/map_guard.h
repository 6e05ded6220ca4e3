/* SPDX-License-Identifier: MIT */
/* Maps of files whose pages may become unreadable: the file becomes shorter, or its disk fails.
 * The system raises SIGBUS at the read. With the guard on (prt_file_guard_maps) the page reads
 * as zeros, and whoever watches the map learns of it. Internal to transport; thread-safe. */
#ifndef PRT_TRANSPORT_MAP_GUARD_H
#define PRT_TRANSPORT_MAP_GUARD_H

#include <stdbool.h>
#include <stddef.h>

enum { PRT_MOST_WATCHED = 64 };
/* Watches a map from now on. Returns a number for the calls below; -1: the map is not watched,
 * because the guard is off or PRT_MOST_WATCHED maps are watched already. */
int prt_map_watch(const void *map, size_t bytes);
/* Whether a page of it could not be read since. -1: false. */
bool prt_map_lost(int number);
/* Before the map is unmapped. -1: nothing. */
void prt_map_unwatch(int number);

#endif
