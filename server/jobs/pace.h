/* SPDX-License-Identifier: MIT */
/* pace.h owns how far a bake is and how long it will take: the share of each of its stages,
 * from the kind and size of the bake and from how long the stages of earlier bakes took on this
 * machine. Loop thread only. */
#ifndef RELIGHTD_PACE_H
#define RELIGHTD_PACE_H

#include <stdbool.h>
#include <stdint.h>

enum pace_stage {
    PACE_DRAFT, /* all stages of `prt bake --draft` */
    PACE_IRRADIANCE,
    PACE_HIERARCHY,
    PACE_MULTIPLE,
    PACE_SINGLE,
    PACE_MEASURING,
    PACE_STAGES
};

/* What decides how long the stages take. */
struct pace_kind {
    bool joint, single, draft; /* single: with single scattering; draft: one comes before it */
    bool walk;                 /* the bake is by random walks */
    uint32_t n_sample;         /* 0: the default */
    uint32_t n_vertex;         /* 0: not known yet */
};

/* Learned from bakes that were finished: the time of a stage over what was planned, for wavelet
 * and joint bakes, each by the dipole and by walks. A zeroed struct knows nothing. */
enum { PACE_KINDS = 4 };
struct pace_history {
    double factor[PACE_KINDS][PACE_STAGES];
};

/* One job's. */
struct pace {
    double planned[PACE_STAGES]; /* shares, any unit */
    double spent[PACE_STAGES];   /* seconds */
    double fraction;             /* [0,1] of the whole; never falls */
    int stage;                   /* the one that runs; -1: none yet */
    double begin_s;              /* when it began */
};

/* The shares before the job starts; again when n_vertex becomes known. */
void pace_plan(struct pace *pace, const struct pace_kind *kind,
               const struct pace_history *history);
/* Whether prt reports, before the stages of a bake or of its draft, that the bake is by walks.
 */
bool pace_is_walk(const char *stage);
/* prt reports `fraction` of a stage of its own ("multiple-scattering") at now_s; draft: of the
 * draft. An unknown stage changes nothing. */
void pace_report(struct pace *pace, bool draft, const char *stage, double fraction,
                 double now_s);
/* Seconds that the job will still take; < 0: not known. */
double pace_left_s(const struct pace *pace, double now_s);
/* The job ended well at now_s: the next one's plan is nearer to it. */
void pace_learn(struct pace *pace, const struct pace_kind *kind, struct pace_history *history,
                double now_s);

#endif
