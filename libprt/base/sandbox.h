/* SPDX-License-Identifier: MIT */
/* sandbox.h owns what confines the isolated child: resource limits, Landlock and the filter of
 * system calls. All of it is called in the child, after fork. */
#ifndef PRT_SANDBOX_H
#define PRT_SANDBOX_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#if defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define SANITIZED 1
#endif
#endif
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define SANITIZED 1
#endif
#ifndef SANITIZED
#define SANITIZED 0
#endif

enum { NOISE_BYTES = 1 << 20 }; /* of a sanitized child's stderr */

/* Which of the confinements the kernel has granted. */
enum landlock_state { LANDLOCK_ON, LANDLOCK_ABSENT, LANDLOCK_FAILED };

/* Address space beyond what the process has, CPU seconds, open files, core and file sizes, and
 * no processes nor threads but with may_thread: that limit counts threads as processes, of all
 * the user's. False with errno when the kernel refuses one. */
bool prt_sandbox_limits(uint64_t memory_bytes, double seconds, bool may_thread);
/* No file can be opened from here on but for reading beneath `folder` (NULL: none at all).
 * Needs no_new_privs. FAILED: the kernel has Landlock and refused; errno says why. */
enum landlock_state prt_sandbox_landlock(const char *folder);
/* Allows the system calls a decoder needs; every other one fails with EPERM. may_open: files
 * may be opened for reading; may_thread: threads may be started, processes never. 0 or a
 * negative errno. */
int prt_sandbox_filter(bool may_open, bool may_thread);

#endif
