/* SPDX-License-Identifier: MIT */
/* program.h owns the exit statuses of relight, relight-preview and relight-control, and the
 * reading of numbers and sizes in their options. */
#ifndef RELIGHT_PROGRAM_H
#define RELIGHT_PROGRAM_H

#include <argp.h>
#include <stdint.h>

enum { EXIT_DONE = 0, EXIT_FAILED = 1, EXIT_USAGE = 2, EXIT_UNREACHABLE = 3 };

/* The exit status for an error of librelight (RELIGHT_E_…). */
int exit_status(int code);
/* text as a number in [min, max]; argp ends the program with EXIT_USAGE where it is none. what:
 * the option's name. */
double option_number(struct argp_state *state, const char *what, const char *text, double min,
                     double max);
/* text as WxH, each in [1, 4096], the value of --size. As option_number(). */
void option_size(struct argp_state *state, const char *text, uint32_t *width, uint32_t *height);

#endif
