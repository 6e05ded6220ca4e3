/* SPDX-License-Identifier: MIT */
/* job_record.h owns DATA/jobs/ID.json: one job, queued or ended, as a restart finds it. */
#ifndef RELIGHTD_JOB_RECORD_H
#define RELIGHTD_JOB_RECORD_H

#include <stdbool.h>
#include <stdint.h>

enum { JOB_WARNING_BYTES = 8000 };

struct job_record {
    char id[32], model[40], owner[96];
    char folder[64]; /* below DATA/work */
    uint64_t order;  /* microseconds since 1970 when it was queued; unique */
    int state;       /* Relight__JobState; RUNNING is kept as QUEUED */
    char stage[64];
    double fraction, elapsed_s;
    char error[400], warnings[JOB_WARNING_BYTES];
    char *recipe; /* JSON of the operation that ordered it; malloc */
};

/* JSON text to free(); NULL without memory. */
char *job_record_print(const struct job_record *record);
/* False: it is not such a record. On success the recipe is the caller's. */
bool job_record_parse(const char *text, struct job_record *out);

#endif
