// SPDX-License-Identifier: MIT
// One daemon a case: begin() starts it, end() expects it to drain and leave with 0, and the
// teardown removes what a failed case left.
#ifndef TESTS_SERVICE_LONE_DAEMON_H
#define TESTS_SERVICE_LONE_DAEMON_H

#include "daemon.h"

static struct daemon d;

static inline void begin(const char *const extra[])
{
    setenv("MALLOC_PERTURB_", "165", 1); // what was freed does not look as before
    daemon_folder(&d);
    daemon_start(&d, extra);
}

static inline void end(void)
{
    int status = daemon_end(&d);
    daemon_remove(&d);
    assert_int_equal(status, 0);
}

static inline int teardown(void **state)
{
    if (d.pid) daemon_remove(&d);
    return 0;
}

#endif
