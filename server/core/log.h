/* SPDX-License-Identifier: MIT */
/* log.h owns the daemon's log: one line an event, `time level event key=value…`, on stderr. */
#ifndef RELIGHTD_LOG_H
#define RELIGHTD_LOG_H

enum log_level { LOG_ERR, LOG_WARN, LOG_EVENT, LOG_TRACE };

/* "error", "warning", "event", "trace"; -1 for another word. */
int log_level_parse(const char *word);
void log_set_level(enum log_level level);
/* Thread-safe; the line goes out in one write. Control characters become '?'. */
void log_line(enum log_level level, const char *fmt, ...) __attribute__((format(printf, 2, 3)));

#endif
