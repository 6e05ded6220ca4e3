// SPDX-License-Identifier: MIT
// The runner that starts `prt` as a child process: progress on one pipe, error output on
// another, SIGTERM to cancel and SIGKILL for one that does not listen.
#include "jobs/jobs.h"
#include "core/log.h"
#include "core/server.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

extern char **environ;

enum { LINE = 1000, PROGRESS_FD = 3 };
static const uint64_t patience_ns = 5000000000u;

struct lines {
    struct loop_watch watch; // fd -1: ended
    char text[LINE];
    size_t n;
};

struct job_run {
    struct job_run *next;
    struct server *server;
    pid_t pid;
    bool ended, cancelled;
    int how;
    struct lines progress, errors;
    struct loop_timer kill_timer;
    char last_error[400];
    struct job_events events;
    void *user;
};

static struct job_run *runs;

static void take_progress(struct job_run *run, char *line)
{
    char stage[64];
    double fraction, eta_s;
    if (sscanf(line, "%63s %lf %lf", stage, &fraction, &eta_s) != 3) return;
    if (!(fraction >= 0)) fraction = 0;
    run->events.progress(run->user, stage, fraction > 1 ? 1 : fraction, eta_s);
}

static void take_error(struct job_run *run, char *line)
{
    if (!*line) return;
    const char *text = !strncmp(line, "error: ", 7) ? line + 7 : line;
    if (strncmp(line, "warning: ", 9) && strncmp(line, "note: ", 6))
        snprintf(run->last_error, sizeof run->last_error, "%s", text);
    run->events.line(run->user, line);
}

static void close_lines(struct job_run *run, struct lines *lines)
{
    if (lines->watch.fd < 0) return;
    loop_watch_remove(run->server->loop, &lines->watch);
    close(lines->watch.fd);
    lines->watch.fd = -1;
}

static void finish(struct job_run *run)
{
    struct job_run **at = &runs;
    while (*at != run) at = &(*at)->next;
    *at = run->next;
    close_lines(run, &run->progress);
    close_lines(run, &run->errors);
    loop_timer_stop(run->server->loop, &run->kill_timer);
    enum job_outcome outcome = JOB_OUT_FAILED;
    char error[480] = "";
    if (WIFEXITED(run->how) && WEXITSTATUS(run->how) == 0) {
        outcome = JOB_OUT_DONE;
    } else if (run->cancelled) {
        outcome = JOB_OUT_CANCELLED;
        snprintf(error, sizeof error, "cancelled");
    } else if (WIFSIGNALED(run->how)) {
        snprintf(error, sizeof error, "the bake process was killed by signal %d (%s)",
                 WTERMSIG(run->how), strsignal(WTERMSIG(run->how)));
    } else {
        snprintf(error, sizeof error, "%s",
                 run->last_error[0] ? run->last_error : "the bake process failed");
    }
    run->events.ended(run->user, outcome, error);
    free(run);
}

// Reads what is there; false when the other end is closed. Over-long lines are cut.
static bool read_lines(struct job_run *run, struct lines *lines,
                       void (*take)(struct job_run *run, char *line))
{
    for (int round = 0; round < 64; round++) {
        char piece[4096];
        ssize_t n = read(lines->watch.fd, piece, sizeof piece);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) return errno == EAGAIN;
        if (n == 0) return false;
        for (ssize_t i = 0; i < n; i++) {
            if (piece[i] != '\n' && lines->n < LINE - 1) lines->text[lines->n++] = piece[i];
            if (piece[i] != '\n') continue;
            lines->text[lines->n] = 0;
            lines->n = 0;
            take(run, lines->text);
        }
    }
    return true;
}

static void lines_ready(struct job_run *run, struct lines *lines,
                        void (*take)(struct job_run *run, char *line))
{
    if (!read_lines(run, lines, take)) close_lines(run, lines);
}

static void progress_ready(struct loop_watch *watch, uint32_t events)
{
    struct job_run *run =
        (struct job_run *)((char *)watch - offsetof(struct job_run, progress));
    lines_ready(run, &run->progress, take_progress);
}

static void errors_ready(struct loop_watch *watch, uint32_t events)
{
    struct job_run *run = (struct job_run *)((char *)watch - offsetof(struct job_run, errors));
    lines_ready(run, &run->errors, take_error);
}

static void kill_now(struct loop_timer *timer)
{
    struct job_run *run =
        (struct job_run *)((char *)timer - offsetof(struct job_run, kill_timer));
    log_line(LOG_WARN, "child pid=%d did not heed SIGTERM", (int)run->pid);
    kill(-run->pid, SIGKILL);
    kill(run->pid, SIGKILL);
}

static bool child_reap(int pid, int how)
{
    struct job_run *run = runs;
    while (run && run->pid != pid) run = run->next;
    if (!run) return false;
    run->how = how;
    // Its last words may still be in the pipes.
    if (run->progress.watch.fd >= 0) read_lines(run, &run->progress, take_progress);
    if (run->errors.watch.fd >= 0) read_lines(run, &run->errors, take_error);
    finish(run);
    return true;
}

static void child_cancel(struct job_run *run)
{
    run->cancelled = true;
    kill(run->pid, SIGTERM);
    run->kill_timer.fire = kill_now;
    loop_timer_set(run->server->loop, &run->kill_timer, loop_now_ns() + patience_ns);
}

static int spawn(const char *program, char **argv, const char *cwd, int progress_fd,
                 int error_fd, pid_t *pid)
{
    posix_spawn_file_actions_t actions;
    posix_spawnattr_t attr;
    sigset_t none, standard;
    sigemptyset(&none);
    sigemptyset(&standard);
    sigaddset(&standard, SIGPIPE);
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_addopen(&actions, 0, "/dev/null", O_RDONLY, 0);
    posix_spawn_file_actions_addopen(&actions, 1, "/dev/null", O_WRONLY, 0);
    posix_spawn_file_actions_adddup2(&actions, error_fd, 2);
    posix_spawn_file_actions_adddup2(&actions, progress_fd, PROGRESS_FD);
    posix_spawn_file_actions_addchdir_np(&actions, cwd);
    posix_spawnattr_init(&attr);
    posix_spawnattr_setsigmask(&attr, &none);
    posix_spawnattr_setsigdefault(&attr, &standard);
    posix_spawnattr_setpgroup(&attr, 0); // a terminal's ^C is the daemon's to handle
    posix_spawnattr_setflags(&attr, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF |
                                        POSIX_SPAWN_SETPGROUP);
    int err = posix_spawnp(pid, program, &actions, &attr, argv, environ);
    posix_spawn_file_actions_destroy(&actions);
    posix_spawnattr_destroy(&attr);
    return err;
}

// The prt beside our own program, else the one on PATH.
static void find_program(const struct server *server, char out[4096])
{
    ssize_t n = readlink("/proc/self/exe", out, 4000);
    if (server->options.prt[0]) {
        snprintf(out, 4096, "%s", server->options.prt);
        return;
    }
    if (n > 0) {
        out[n] = 0;
        char *slash = strrchr(out, '/');
        strcpy(slash ? slash + 1 : out, "prt");
        if (!access(out, X_OK)) return;
    }
    strcpy(out, "prt");
}

static struct job_run *child_start(struct server *server, const struct job_order *order,
                                   const struct job_events *events, void *user, char error[256])
{
    char program[4096], number[12];
    find_program(server, program);
    size_t n = 0;
    while (order->argv[n]) n++;
    char **argv = calloc(n + 2, sizeof *argv);
    struct job_run *run = calloc(1, sizeof *run);
    int progress[2] = {-1, -1}, errors[2] = {-1, -1}, err = ENOMEM;
    if (!argv || !run) goto fail;
    argv[0] = "prt";
    snprintf(number, sizeof number, "%d", PROGRESS_FD);
    for (size_t i = 0; i < n; i++)
        argv[i + 1] = strcmp(order->argv[i], "{progress}") ? order->argv[i] : number;
    if (pipe2(progress, O_CLOEXEC) || pipe2(errors, O_CLOEXEC)) {
        err = errno;
        goto fail;
    }
    // dup2 onto the same number would leave close-on-exec set.
    if (progress[1] == PROGRESS_FD) progress[1] = fcntl(PROGRESS_FD, F_DUPFD_CLOEXEC, 10);
    *run = (struct job_run){.server = server, .events = *events, .user = user, .next = runs};
    err = spawn(program, argv, order->cwd, progress[1], errors[1], &run->pid);
    if (err) goto fail;
    // Relighting goes first. Relative: the daemon itself may have been started with a niceness.
    int own = getpriority(PRIO_PROCESS, 0);
    setpriority(PRIO_PROCESS, (id_t)run->pid, own + (int)server->options.bake_nice);
    close(progress[1]);
    close(errors[1]);
    free(argv);
    runs = run;
    fcntl(progress[0], F_SETFL, O_NONBLOCK);
    fcntl(errors[0], F_SETFL, O_NONBLOCK);
    run->progress.watch = (struct loop_watch){progress[0], progress_ready};
    run->errors.watch = (struct loop_watch){errors[0], errors_ready};
    loop_watch_add(server->loop, &run->progress.watch, EPOLLIN);
    loop_watch_add(server->loop, &run->errors.watch, EPOLLIN);
    return run;
fail:
    snprintf(error, 256, "%.200s cannot be started: %s", program, strerror(err));
    for (int i = 0; i < 2; i++) {
        if (progress[i] >= 0) close(progress[i]);
        if (errors[i] >= 0) close(errors[i]);
    }
    free(argv);
    free(run);
    return NULL;
}

const struct job_runner job_runner_child = {"child", child_start, child_cancel, child_reap};
