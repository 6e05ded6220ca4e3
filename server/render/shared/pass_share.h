/* SPDX-License-Identifier: MIT */
/* pass_share.h owns how the places of one pass are shared between the principals that wait for
 * it: they take turns until the pass is full. One that waits alone, while others waited too or
 * took part in the pass before, gets PASS_SHARE_ALONE places at least and no more than its
 * turns: the pass is short, and the answers and next requests of the others are not behind a
 * full pass of one principal's. Thread-safety: none. */
#ifndef RELIGHTD_PASS_SHARE_H
#define RELIGHTD_PASS_SHARE_H

#include "core/work.h"

#include <stdbool.h>

enum { PASS_SHARE_NAMES = 16, PASS_SHARE_ALONE = 4, PASS_SHARE_SEEN = 1024 };

/* Zeroed at first. */
struct pass_share {
    struct {
        const char *name; /* the caller's */
        unsigned waiting, granted;
    } of[PASS_SHARE_NAMES];
    unsigned n, n_granted;
    const char
        *before; /* a principal of the pass before, if all of that were one's; NULL: none */
    bool others_before; /* several were in the pass before */
};

/* Counts an evaluation that waits. Of more principals than PASS_SHARE_NAMES the first count. */
void pass_share_add(struct pass_share *share, const char *name);
/* A place of the pass before was this principal's. */
void pass_share_before(struct pass_share *share, const char *name);
/* Fills `granted`, at most `most` in all. */
void pass_share_grant(struct pass_share *share, unsigned most);
/* Takes one of the principal's grants; false: it has none left. */
bool pass_share_take(struct pass_share *share, const char *name);

#endif
