/* SPDX-License-Identifier: MIT */
/* log.h owns the daemon's log: one line an event, `time level event key=value…`, on stderr. */
#ifndef RELIGHTD_LOG_H
#define RELIGHTD_LOG_H

#include <stdint.h>

enum log_level { LOG_ERR, LOG_WARN, LOG_EVENT, LOG_TRACE };

/* "error", "warning", "event", "trace"; -1 for another word. */
int log_level_parse(const char *word);
void log_set_level(enum log_level level);
/* enum log_format (core/log_format.h); text until it is called. Before log_start. */
void log_set_format(int format);

/* Writes one line. Thread-safe; never blocks once log_start was called.
 * Arguments of %s are untrusted: quotes and backslashes are escaped with a backslash,
 * control characters (C0, DEL, C1) and bytes that are not UTF-8 become \xNN, so that no
 * argument can forge a field or reach a terminal. Conversions: d i u x c f g s, with flags,
 * width, precision and the lengths l ll z. A call site that logs more than LOG_BURST lines and
 * then more than LOG_RATE lines a second is limited; its next line that passes has the number
 * of suppressed ones (`suppressed=N`). */
enum { LOG_BURST = 200, LOG_RATE = 50 };
void log_line(enum log_level level, const char *fmt, ...) __attribute__((format(printf, 2, 3)));

/* The id of the request whose work the loop's thread is doing, "" for none: what is begun for
 * it (decoding, a bake) keeps it. The text is copied, at most 64 characters. Loop thread only.
 */
void log_request_set(const char *id);
const char *log_request(void);

/* Starts the thread that writes. Until then, and when it cannot be started, log_line writes
 * to stderr itself. While stderr blocks, LOG_QUEUE bytes are queued; further lines are dropped
 * and counted, and a line `log dropped=N` follows. */
enum { LOG_QUEUE = 256 << 10 };
void log_start(void);
/* Writes the queued lines, for at most a second, and ends the thread. */
void log_stop(void);
/* Lines lost so far to a full queue and to the rate limit. */
uint64_t log_lost(void);

#endif
