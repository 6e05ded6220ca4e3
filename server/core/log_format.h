/* SPDX-License-Identifier: MIT */
/* log_format.h owns the formats of log lines. A line is built as text, `time level words
 * key=value…`; the other formats are made of it. Pure functions; thread-safe. */
#ifndef RELIGHTD_LOG_FORMAT_H
#define RELIGHTD_LOG_FORMAT_H

#include <stddef.h>

enum log_format { LOG_FORMAT_TEXT, LOG_FORMAT_LOGFMT, LOG_FORMAT_JSON };

/* "text", "logfmt", "json"; -1 for another word. */
int log_format_parse(const char *word);

/* Writes one line, without newline, in this format into out; returns its bytes, at most room
 * - 1. LOGFMT: `time=… level=… msg="words" key=value…`. JSON: one object with the same keys,
 * every value a string; a key that the line has twice keeps its last value for most readers.
 * Lines that do not fit end early, and are still whole objects. text[0, n) is a line as
 * core/log.c builds it: values are escaped already. */
size_t log_reformat(enum log_format format, const char *text, size_t n, char *out, size_t room);

#endif
