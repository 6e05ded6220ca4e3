/* SPDX-License-Identifier: MIT */
/* Memory for files that are read: huge pages where the system has them. The system clears pages
 * before it gives them, which takes about as long as reading the file; those of closed files
 * are used again (prt_file_keep_pages). Internal to transport; thread-safe. */
#ifndef PRT_TRANSPORT_PAGES_H
#define PRT_TRANSPORT_PAGES_H

#include <stddef.h>

/* Pages for so many bytes, of any content; NULL without memory. */
char *prt_pages_take(size_t size);
/* Frees pages that prt_pages_take returned for this size, or keeps them. NULL: does nothing. */
void prt_pages_give(char *pages, size_t size);

#endif
