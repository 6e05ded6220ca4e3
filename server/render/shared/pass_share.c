// SPDX-License-Identifier: MIT
// Turns of principals in a pass.
#include "render/shared/pass_share.h"

#include <string.h>

static int find(const struct pass_share *share, const char *name)
{
    for (unsigned i = 0; i < share->n; i++)
        if (!strcmp(share->of[i].name, name)) return (int)i;
    return -1;
}

void pass_share_add(struct pass_share *share, const char *name)
{
    int i = find(share, name);
    if (i < 0 && share->n < PASS_SHARE_NAMES) {
        i = (int)share->n++;
        share->of[i].name = name;
    }
    if (i >= 0) share->of[i].waiting++;
}

void pass_share_before(struct pass_share *share, const char *name)
{
    if (!share->before) share->before = name;
    else share->others_before |= strcmp(share->before, name) != 0;
}

// Whether a principal other than this one waits, or was in the pass before.
static bool has_others(const struct pass_share *share, unsigned i)
{
    return share->n > 1 || share->others_before ||
           (share->before && strcmp(share->before, share->of[i].name));
}

void pass_share_grant(struct pass_share *share, unsigned most)
{
    unsigned n_open = share->n;
    for (unsigned round = 1; n_open && share->n_granted < most; round++) {
        n_open = 0;
        for (unsigned i = 0; i < share->n; i++) n_open += share->of[i].waiting >= round;
        for (unsigned i = 0; i < share->n && share->n_granted < most; i++) {
            if (share->of[i].waiting < round) continue;
            if (n_open == 1 && round > PASS_SHARE_ALONE && has_others(share, i)) return;
            share->of[i].granted++;
            share->n_granted++;
        }
    }
}

bool pass_share_take(struct pass_share *share, const char *name)
{
    int i = find(share, name);
    if (i < 0 || !share->of[i].granted) return false;
    share->of[i].granted--;
    share->n_granted--;
    return true;
}
