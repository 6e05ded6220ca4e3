/* SPDX-License-Identifier: MIT */
/* What relight, relight-preview and relight-control share as programs: how they end, and how an
 * option's number is read. */
#ifndef RELIGHT_PROGRAM_H
#define RELIGHT_PROGRAM_H

#include <argp.h>

enum { EXIT_DONE = 0, EXIT_FAILED = 1, EXIT_USAGE = 2, EXIT_UNREACHABLE = 3 };

/* The exit status for an error of librelight (RELIGHT_E_…). */
int exit_status(int code);
/* text as a number in [min, max]; argp ends the program with EXIT_USAGE where it is none. what:
 * the option's name. */
double option_number(struct argp_state *state, const char *what, const char *text, double min,
                     double max);

#endif
