// SPDX-License-Identifier: MIT
// The log: lines are built in a local buffer and written whole, so threads never mix them.
#include "core/log.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static const char *const level_word[] = {"error", "warning", "event", "trace"};
static enum log_level shown = LOG_EVENT;

int log_level_parse(const char *word)
{
    for (int i = 0; i < 4; i++)
        if (!strcmp(word, level_word[i])) return i;
    return -1;
}

void log_set_level(enum log_level level)
{
    shown = level;
}

void log_line(enum log_level level, const char *fmt, ...)
{
    if (level > shown) return;
    char line[1200];
    struct timespec now;
    struct tm utc;
    clock_gettime(CLOCK_REALTIME, &now);
    gmtime_r(&now.tv_sec, &utc);
    size_t n = strftime(line, sizeof line, "%Y-%m-%dT%H:%M:%S", &utc);
    n += (size_t)snprintf(line + n, sizeof line - n, ".%03ldZ %s ", now.tv_nsec / 1000000,
                          level_word[level]);
    va_list args;
    va_start(args, fmt);
    int m = vsnprintf(line + n, sizeof line - n - 1, fmt, args);
    va_end(args);
    if (m < 0) return;
    size_t end = n + (size_t)m < sizeof line - 2 ? n + (size_t)m : sizeof line - 2;
    // What clients send ends up here (names, errors): it may not forge lines.
    for (size_t i = 0; i < end; i++)
        if ((unsigned char)line[i] < 32 || line[i] == 127) line[i] = '?';
    line[end] = '\n';
    if (write(STDERR_FILENO, line, end + 1) < 0) return; // nowhere left to complain to
}
