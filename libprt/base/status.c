// SPDX-License-Identifier: MIT
// Status texts, the context, logging and progress.
#include "prt/base.h"

#include <stdio.h>
#include <string.h>
#include <time.h>

const char *prt_status_text(int status)
{
    switch (status) {
#define X(name, code, text) \
    case (code):            \
        return text;
        PRT_STATUS_LIST(X)
#undef X
    }
    return "unknown status";
}

void prt_context_init(struct prt_context *ctx)
{
    memset(ctx, 0, sizeof *ctx);
    ctx->cpu = prt_cpu_detect();
}

static void log_line(const struct prt_context *ctx, enum prt_log_level level, const char *fmt,
                     va_list args)
{
    static const char *const prefix[] = {"error: ", "warning: ", ""};
    char line[1024];
    vsnprintf(line, sizeof line, fmt, args);
    for (char *c = line; *c; c++)
        if ((unsigned char)*c < 32 || *c == 127) *c = ' ';
    if (ctx && ctx->log) ctx->log(ctx->log_user, level, line);
    else fprintf(stderr, "%s%s\n", prefix[level], line);
}

void prt_log(const struct prt_context *ctx, enum prt_log_level level, const char *fmt, ...)
{
    va_list args;
    va_start(args, fmt);
    log_line(ctx, level, fmt, args);
    va_end(args);
}

void prt_log_none(void *user, enum prt_log_level level, const char *line)
{
}

int prt_fail(const struct prt_context *ctx, int status, const char *fmt, ...)
{
    va_list args;
    va_start(args, fmt);
    log_line(ctx, PRT_LOG_ERROR, fmt, args);
    va_end(args);
    return status;
}

int prt_progress(const struct prt_context *ctx, const char *stage, double fraction)
{
    if (!ctx || !ctx->progress) return PRT_OK;
    return ctx->progress(ctx->progress_user, stage, fraction, -1) ? PRT_CANCELLED : PRT_OK;
}

double prt_time_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

// Suppressions for libraries that are not built for sanitizers. They are here because every
// program links this file.
#if defined(__SANITIZE_ADDRESS__)
// OSMesa never frees a few hundred bytes of its first context.
__attribute__((weak)) const char *__lsan_default_suppressions(void);
__attribute__((weak)) const char *__lsan_default_suppressions(void)
{
    return "leak:libOSMesa\nleak:swrast_dri\nleak:libEGL\nleak:libgallium\n";
}

// The table of suppressions that were used would follow the log of a daemon on stderr.
__attribute__((weak)) const char *__lsan_default_options(void);
__attribute__((weak)) const char *__lsan_default_options(void)
{
    return "print_suppressions=0";
}
#endif

#if defined(__SANITIZE_THREAD__)
// The thread sanitizer does not see the locks of OSMesa, Embree, TBB and OpenBLAS and reports
// races between their threads; their strings are freed in libstdc++.
__attribute__((weak)) const char *__tsan_default_suppressions(void);
__attribute__((weak)) const char *__tsan_default_suppressions(void)
{
    return "race:libOSMesa\nrace:swrast_dri\nrace:libgallium\nmutex:libOSMesa\n"
           "race:libembree\nrace:libtbb\nrace:libopenblas\nrace:libstdc++\n";
}
#endif
