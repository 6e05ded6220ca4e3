/* SPDX-License-Identifier: MIT */
/* errors.h owns the ERROR message: codes of library statuses, hints, and the range of a
 * parameter as fields. Ranges reach this place as text, from libprt's log, from children and
 * from the cache of results. Each is one sentence:
 *     PARAMETER is VALUE, allowed range LOW to HIGH[ UNIT][: REMARK]
 * libprt prints it (prt_material_range, prt_bake_setting_ok); in the daemon range_refuse does.
 * Thread-safety: Safe. */
#ifndef RELIGHTD_ERRORS_H
#define RELIGHTD_ERRORS_H

#include "relight.pb-c.h"

/* Advice for the user about an error; "" for none. */
const char *error_hint(int code);
/* The protocol's error for a library status. */
int error_of_status(int status);

/* Texts that an Error message refers to. */
struct error_fields {
    char parameter[80], unit[32];
};
/* Fills the message with code, text, hint, and with the range that the text states. A code of 0
 * becomes INTERNAL, an empty text the name of the code. text and fields must outlive it. */
void error_fill(Relight__Error *out, int code, const char *text, struct error_fields *fields);

/* Writes the sentence into error and returns ERROR_OUT_OF_RANGE. unit: "" where there is none.
 * fmt names the parameter ("lights[3].rotate_deg"). */
int range_refuse(char *error, size_t n, double value, double low, double high, const char *unit,
                 const char *fmt, ...) __attribute__((format(printf, 7, 8)));

#endif
