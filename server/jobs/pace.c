// SPDX-License-Identifier: MIT
// The plan of a bake's time. Seconds of CPU of each stage, linear in the vertices, were
// measured with `prt bake --progress-fd` (spot of 3,225 vertices, bunny of 34,835; marble, 50
// mm). The sum of the stages that have ended, against their plan, is the speed of the machine
// at the time.
#include "jobs/pace.h"

#include <math.h>
#include <string.h>

static const double default_samples[2] = {75000, 150000}; // fixed medium, long path; joint
static const double typical_vertices = 20000;
static const double learning =
    0.5; // weight of the newest bake after the first; chosen, not measured

// seconds = at_rest + a_vertex n_vertex; pass 1 in proportion to the samples.
static const struct {
    const char *stage;
    double at_rest, a_vertex;
} cost[2][PACE_STAGES] = {{{"draft", 3.5, 1.3e-4},
                           {"irradiance", 35, 0},
                           {"hierarchy", 1.2, 0},
                           {"multiple", 13, 1.0e-4},
                           {"single", -5, 3.9e-3},
                           {"measuring", 4, 1.5e-4}},
                          {{"draft", 5, 2.5e-4},
                           {"irradiance", 58, 0},
                           {"hierarchy", 2, 0},
                           {"multiple", 30, 2.0e-3},
                           {"single", 15, 8.0e-3},
                           {"measuring", 9, 3.0e-4}}};

// Parts of a draft, in [0,1] of it.
static const struct {
    const char *stage;
    double from, to;
} draft_part[] = {{"irradiance", 0, 0.35},
                  {"multiple", 0.35, 0.7},
                  {"single", 0.7, 0.8},
                  {"measuring", 0.8, 1}};

// Seconds of random walks: 18e6 a channel, but 512 to 2048 a vertex; where the medium is free
// 256 a vertex at each of 13 levels.
static const double measuring_walks = 27; // two references of 200 vertices
static double walk_seconds(const struct pace_kind *kind, double n_vertex)
{
    const double each = fmin(fmax(18e6 / n_vertex, 512), 2048);
    return kind->joint ? 10e-6 * 13 * 256 * n_vertex : 5.5e-6 * 3 * each * n_vertex;
}

static unsigned number_of(const struct pace_kind *kind)
{
    return 2u * kind->walk + kind->joint;
}

bool pace_is_walk(const char *stage)
{
    return !strcmp(stage, "by-walks");
}

void pace_plan(struct pace *p, const struct pace_kind *kind, const struct pace_history *history)
{
    const double n = kind->n_vertex ? kind->n_vertex : typical_vertices;
    const double samples = kind->n_sample ? kind->n_sample / default_samples[kind->joint] : 1;
    if (!p->fraction && !p->begin_s) p->stage = -1;
    for (int i = 0; i < PACE_STAGES; i++) {
        const double factor = history->factor[number_of(kind)][i];
        p->planned[i] = cost[kind->joint][i].at_rest + cost[kind->joint][i].a_vertex * n;
        p->planned[i] = fmax(p->planned[i], 1);
        if (kind->walk && i == PACE_MULTIPLE) p->planned[i] += walk_seconds(kind, n);
        if (kind->walk && i == PACE_MEASURING) p->planned[i] += measuring_walks;
        if (factor > 0) p->planned[i] *= factor;
    }
    p->planned[PACE_IRRADIANCE] *= samples;
    p->planned[PACE_HIERARCHY] *= samples;
    if (!kind->single) p->planned[PACE_SINGLE] = 0;
    if (!kind->draft) p->planned[PACE_DRAFT] = 0;
}

static double sum(const double *x, int n)
{
    double all = 0;
    for (int i = 0; i < n; i++) all += x[i];
    return all;
}

static void begin_stage(struct pace *p, int stage, double now_s)
{
    if (p->stage >= 0) p->spent[p->stage] += now_s - p->begin_s;
    p->stage = stage;
    p->begin_s = now_s;
}

void pace_report(struct pace *p, bool draft, const char *stage, double fraction, double now_s)
{
    int found = -1;
    for (size_t i = 0; draft && i < sizeof draft_part / sizeof *draft_part; i++)
        if (!strncmp(stage, draft_part[i].stage, strlen(draft_part[i].stage))) {
            found = PACE_DRAFT;
            fraction = draft_part[i].from + (draft_part[i].to - draft_part[i].from) * fraction;
        }
    for (int i = PACE_IRRADIANCE; !draft && i < PACE_STAGES; i++)
        if (!strncmp(stage, cost[0][i].stage, strlen(cost[0][i].stage))) found = i;
    // "opaque surfaces" of a joint bake, "surface", "hidden sky": short
    if (found < 0 || found < p->stage) return;
    if (found != p->stage) begin_stage(p, found, now_s);
    const double all =
        sum(p->planned, PACE_STAGES) / 0.995; // a bake is done when its file is open
    const double done = (sum(p->planned, found) + p->planned[found] * fraction) / all;
    if (done > p->fraction) p->fraction = done;
}

double pace_left_s(const struct pace *p, double now_s)
{
    if (p->fraction < 0.01) return -1;
    const double spent = sum(p->spent, PACE_STAGES) + (p->stage >= 0 ? now_s - p->begin_s : 0);
    return spent * (1 - p->fraction) / p->fraction;
}

void pace_learn(struct pace *p, const struct pace_kind *kind, struct pace_history *history,
                double now_s)
{
    begin_stage(p, -1, now_s);
    const double all = sum(p->spent, PACE_STAGES), planned = sum(p->planned, PACE_STAGES);
    for (int i = 0; i < PACE_STAGES && all > 0 && planned > 0; i++) {
        double *factor = &history->factor[number_of(kind)][i];
        if (!(p->planned[i] > 0) || !(p->spent[i] > 0)) continue;
        const double ratio = p->spent[i] / all / (p->planned[i] / planned);
        const double known = *factor > 0 ? *factor : 1, weight = *factor > 0 ? learning : 1;
        *factor = known * pow(fmin(fmax(ratio, 0.1), 10), weight);
    }
}
