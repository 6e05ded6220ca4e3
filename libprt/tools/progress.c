// SPDX-License-Identifier: MIT
// Log lines, the progress bar or its lines for programs, signals, and threads of a run.
#include "tool.h"

#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <limits.h>
#include <math.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static volatile sig_atomic_t stop_signal;
static atomic_bool error_logged; // an error line was printed
static bool bar_drawn;           // the terminal's line holds a bar; touched under stderr's lock

static void on_signal(int signal)
{
    stop_signal = signal;
}

static void log_line(void *user, enum prt_log_level level, const char *line)
{
    static const char *const prefix[] = {"error: ", "warning: ", "note: "};
    const struct tool *tool = user;
    if (tool->opt.quiet && level == PRT_LOG_NOTE) return;
    if (level == PRT_LOG_ERROR) error_logged = true;
    flockfile(stderr);
    fprintf(stderr, "%s%s%s\n", bar_drawn ? "\r\033[K" : "", prefix[level], line);
    bar_drawn = false;
    funlockfile(stderr);
}

struct progress_state {
    char stage[48];
    double started, last;
    bool broken; // the reader of the progress pipe has ended
};
static struct progress_state progress;

static void draw_bar(const char *stage, double fraction, double eta_s)
{
    char bar[31], eta[32] = "";
    int n = (int)(fraction * 30 + 0.5);
    for (int i = 0; i < 30; i++) bar[i] = i < n ? '#' : '.';
    bar[30] = 0;
    if (eta_s >= 0 && eta_s < 1e6)
        snprintf(eta, sizeof eta, "  ETA %d:%02d", (int)eta_s / 60, (int)eta_s % 60);
    flockfile(stderr);
    fprintf(stderr, "\r\033[K%-28.28s [%s] %3.0f %%%s", stage, bar, 100 * fraction, eta);
    fflush(stderr);
    bar_drawn = true;
    funlockfile(stderr);
}

static void write_line(int fd, const char *stage, double fraction, double eta_s)
{
    char line[96], word[48];
    snprintf(word, sizeof word, "%s", stage);
    for (char *c = word; *c; c++)
        if (*c == ' ' || *c == '\n' || *c == '\t') *c = '-';
    int n = snprintf(line, sizeof line, "%s %.4f %.1f\n", word, fraction, eta_s);
    ssize_t put;
    do put = write(fd, line, (size_t)n);
    while (put < 0 && errno == EINTR && !stop_signal);
    if (put < 0 && errno == EPIPE) progress.broken = true;
}

static int on_progress(void *user, const char *stage, double fraction, double eta_s)
{
    const struct tool *tool = user;
    double now = prt_time_s();
    bool fresh = strncmp(stage, progress.stage, sizeof progress.stage - 1) != 0;
    if (fresh) {
        snprintf(progress.stage, sizeof progress.stage, "%s", stage);
        progress.started = now;
    }
    fraction = fraction > 0 ? fmin(fraction, 1) : 0;
    if (eta_s < 0 && fraction > 0.01)
        eta_s = (now - progress.started) * (1 - fraction) / fraction;
    if (fresh || fraction >= 1 || now - progress.last >= 0.1) {
        progress.last = now;
        if (tool->opt.progress_fd >= 0)
            write_line(tool->opt.progress_fd, stage, fraction, eta_s);
        else if (!tool->opt.quiet && isatty(STDERR_FILENO)) draw_bar(stage, fraction, eta_s);
    }
    // The reader of the progress pipe has ended: nobody needs the result any more.
    return stop_signal || progress.broken;
}

int tool_begin(struct tool *tool)
{
    struct prt_context *ctx = &tool->ctx;
    prt_context_init(ctx);
    ctx->log = log_line;
    ctx->log_user = tool;
    ctx->progress = on_progress;
    ctx->progress_user = tool;
    if (tool->opt.cpu) prt_cpu_parse(tool->opt.cpu, &ctx->cpu);
    if (tool->opt.progress_fd >= 0 && fcntl(tool->opt.progress_fd, F_GETFD) < 0)
        return usage_error(&tool->opt, "--progress-fd %d: no such open file descriptor",
                           tool->opt.progress_fd);
    // A second signal of the same number ends the program at once.
    struct sigaction act = {.sa_handler = on_signal, .sa_flags = (int)SA_RESETHAND};
    sigaction(SIGINT, &act, NULL);
    sigaction(SIGTERM, &act, NULL);
    signal(SIGPIPE, SIG_IGN);
    int status = prt_pool_create((unsigned)tool->opt.threads, &ctx->pool);
    return status ? tool_exit(tool, prt_fail(ctx, status, "threads could not be started")) : -1;
}

void tool_end(struct tool *tool)
{
    if (bar_drawn) fputs("\r\033[K", stderr);
    bar_drawn = false;
    prt_pool_destroy(tool->ctx.pool);
    tool->ctx.pool = NULL;
}

int tool_exit(const struct tool *tool, int status)
{
    if (status == PRT_OK) return EXIT_DONE;
    if (status == PRT_CANCELLED)
        prt_log(&tool->ctx, PRT_LOG_ERROR, "cancelled%s",
                stop_signal ? " by a signal; nothing was written" : "; nothing was written");
    else if (!error_logged)
        prt_log(&tool->ctx, PRT_LOG_ERROR, "%s: %s", tool->opt.input[0],
                prt_status_text(status));
    // The arguments of library functions are options of the command line.
    return status == PRT_ARG ? EXIT_USAGE : EXIT_FAILED;
}

int check_writable(const struct tool *tool, const char *path)
{
    char folder[PATH_MAX];
    if ((size_t)snprintf(folder, sizeof folder, "%s", path) >= sizeof folder)
        return tool_exit(tool, prt_fail(&tool->ctx, PRT_IO, "%s: the path is too long", path));
    int fault = access(dirname(folder), W_OK) ? errno : 0;
    if (fault && access(path, W_OK))
        return tool_exit(tool, prt_fail(&tool->ctx, PRT_IO, "%s: %s", path, strerror(fault)));
    return EXIT_DONE;
}
