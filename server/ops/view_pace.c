// SPDX-License-Identifier: MIT
// Levels of a view's colours, as client/web/src/scene/pace.ts has them for coefficients.
#include "ops/view_pace.h"

static const double most_delay_ms = 200; // a delay that a hand can follow
// Frames that agree before a level is left; before a finer one is tried, at first and at most.
enum { AGREE = 3, FIRST_PATIENCE = 45, MOST_PATIENCE = 720 };

static void change_level(struct view_pace *p, unsigned level)
{
    p->tried = level < p->level;
    p->level = level;
    p->late = p->early = 0;
    p->mean_ms = 0;
}

void view_pace_acknowledged(struct view_pace *p, double delay_ms, unsigned level)
{
    if (level != p->level) return;
    if (!p->patience) p->patience = FIRST_PATIENCE;
    p->mean_ms = p->mean_ms > 0 ? 0.6 * p->mean_ms + 0.4 * delay_ms : delay_ms;
    p->late = p->mean_ms > most_delay_ms ? p->late + 1 : 0;
    p->early = p->mean_ms < most_delay_ms / 2 ? p->early + 1 : 0;
    if (p->late >= AGREE) {
        if (p->level + 1 >= VIEW_PACE_LEVELS) {
            p->late = 0;
            return;
        }
        if (p->tried)
            p->patience = 2 * p->patience < MOST_PATIENCE ? 2 * p->patience : MOST_PATIENCE;
        change_level(p, p->level + 1);
    } else if (p->early >= p->patience && p->level) {
        change_level(p, p->level - 1);
    }
}
