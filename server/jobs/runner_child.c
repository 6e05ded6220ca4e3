// SPDX-License-Identifier: MIT
// The runner that starts `prt`, or with --runner slurm `relight-slurm` in its place, as a
// child: progress on one pipe, error output on another, SIGTERM to cancel, then SIGKILL if it
// does not exit. The child has a limit on time, keeps to a limit on memory by itself (prt bake
// --memory), and is killed when the daemon exits, even by a crash.
#include "jobs/jobs.h"
#include "core/log.h"
#include "core/server.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

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
    bool ended, cancelled, late; // late: it exceeded its time limit
    int how;
    struct lines progress, errors;
    struct loop_timer kill_timer, time_timer;
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
    loop_timer_stop(run->server->loop, &run->time_timer);
    enum job_outcome outcome = JOB_OUT_FAILED;
    char error[480] = "";
    if (WIFEXITED(run->how) && WEXITSTATUS(run->how) == 0) {
        outcome = JOB_OUT_DONE;
    } else if (run->late || (WIFSIGNALED(run->how) && WTERMSIG(run->how) == SIGXCPU)) {
        snprintf(error, sizeof error,
                 "the bake took longer than %g s and was stopped: ask for fewer samples, or "
                 "raise relightd's --bake-time",
                 run->server->options.bake_time);
    } else if (run->cancelled) {
        outcome = JOB_OUT_CANCELLED;
        snprintf(error, sizeof error, "cancelled");
    } else if (WIFSIGNALED(run->how)) {
        run->server->stats.children_crashed++;
        snprintf(error, sizeof error,
                 "the bake process was killed by signal %d (%s); it may have run out of memory "
                 "(relightd's --bake-memory)",
                 WTERMSIG(run->how), strsignal(WTERMSIG(run->how)));
    } else {
        snprintf(error, sizeof error, "%s",
                 run->last_error[0] ? run->last_error : "the bake process failed");
    }
    run->events.ended(run->user, outcome, error);
    free(run);
}

// Reads the available bytes; false when the other end is closed. Over-long lines are cut.
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
    log_line(LOG_WARN, "child pid=%d did not exit after SIGTERM: it is killed", (int)run->pid);
    kill(-run->pid, SIGKILL);
    kill(run->pid, SIGKILL);
}

static void stop(struct job_run *run)
{
    kill(run->pid, SIGTERM);
    run->kill_timer.fire = kill_now;
    loop_timer_set(run->server->loop, &run->kill_timer, loop_now_ns() + patience_ns);
}

static void time_over(struct loop_timer *timer)
{
    struct job_run *run =
        (struct job_run *)((char *)timer - offsetof(struct job_run, time_timer));
    run->late = true;
    stop(run);
}

static bool child_reap(int pid, int how)
{
    struct job_run *run = runs;
    while (run && run->pid != pid) run = run->next;
    if (!run) return false;
    run->how = how;
    // Its last lines may still be in the pipes.
    if (run->progress.watch.fd >= 0) read_lines(run, &run->progress, take_progress);
    if (run->errors.watch.fd >= 0) read_lines(run, &run->errors, take_error);
    finish(run);
    return true;
}

static void child_cancel(struct job_run *run)
{
    run->cancelled = true;
    stop(run);
}

// The child's set-up between vfork and exec.
struct birth {
    const char *program, *cwd;
    char **argv, **environment;
    int progress_fd, error_fd;
    pid_t daemon;
    struct rlimit cpu;
    int error; // written by the child, which shares memory until exec
};

static void enter(struct birth *b)
{
    sigset_t none;
    const struct rlimit core = {0, 0};
    sigemptyset(&none);
    int null = open("/dev/null", O_RDWR | O_CLOEXEC);
    bool ok = null >= 0 && dup2(null, 0) == 0 && dup2(null, 1) == 1 &&
              dup2(b->error_fd, 2) == 2 && dup2(b->progress_fd, PROGRESS_FD) == PROGRESS_FD &&
              !chdir(b->cwd) && !setpgid(0, 0) && // the daemon handles a terminal's ^C
              !prctl(PR_SET_PDEATHSIG, SIGKILL) && getppid() == b->daemon &&
              !setrlimit(RLIMIT_CORE, &core) &&
              (!b->cpu.rlim_cur || !setrlimit(RLIMIT_CPU, &b->cpu)) &&
              signal(SIGPIPE, SIG_DFL) != SIG_ERR && !sigprocmask(SIG_SETMASK, &none, NULL);
    if (ok) execvpe(b->program, b->argv, b->environment);
    b->error = errno ? errno : ESRCH;
    _exit(127);
}

// vfork, since posix_spawn sets neither limits nor a parent-death signal, and a fork would copy
// the page tables of all mapped transport. No signal is handled before exec: all are blocked.
static int spawn(struct birth *b, pid_t *pid)
{
    sigset_t all, old;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &old);
    b->daemon = getpid();
    *pid = vfork();
    if (*pid == 0) enter(b);
    int error = *pid < 0 ? errno : b->error;
    if (*pid > 0 && b->error) waitpid(*pid, NULL, 0);
    pthread_sigmask(SIG_SETMASK, &old, NULL);
    return error;
}

// CPU seconds over all of its threads; holds also while the daemon itself is stopped.
static struct rlimit cpu_limit(const struct server *server)
{
    const struct options *o = &server->options;
    double threads = o->bake_threads ? o->bake_threads : server->n_core;
    double seconds = ceil(o->bake_time) * threads + 60;
    if (o->bake_time <= 0) return (struct rlimit){0, 0};
    return (struct rlimit){(rlim_t)seconds, (rlim_t)seconds + 5};
}

static bool on_slurm(const struct server *server)
{
    return !strcmp(server->options.runner, "slurm");
}

// The prt next to this program, else the one on PATH; or relight-slurm.
static void find_program(const struct server *server, char out[4096])
{
    const char *name = on_slurm(server) ? "relight-slurm" : "prt";
    ssize_t n = readlink("/proc/self/exe", out, 4000);
    if (server->options.prt[0] && !on_slurm(server)) {
        snprintf(out, 4096, "%s", server->options.prt);
        return;
    }
    if (n > 0) {
        out[n] = 0;
        char *slash = strrchr(out, '/');
        strcpy(slash ? slash + 1 : out, name);
        if (!access(out, X_OK)) return;
    }
    strcpy(out, name);
}

// What goes before the command of prt: texts to free(), as many as it returns, or -1.
static int leading(const struct server *server, char *out[4])
{
    const struct options *o = &server->options;
    if (!on_slurm(server)) return 0;
    if (asprintf(&out[0], "--folder=%s", o->slurm_folder) < 0) return -1;
    if (asprintf(&out[1], "--tasks=%u", o->slurm_tasks) < 0) return -1;
    if (asprintf(&out[2], "--sbatch=%s", o->slurm_arguments) < 0) return -1;
    return (out[3] = strdup("--")) ? 4 : -1;
}

static void free_texts(char *text[4])
{
    for (int i = 0; i < 4; i++) free(text[i]);
}

// This process's environment and the id of the request; NULL without memory. `word` must
// outlive it.
static char **make_environment(char *word)
{
    size_t n = 0, m = 0;
    while (environ[n]) n++;
    char **out = calloc(n + 2, sizeof *out);
    for (size_t i = 0; out && i < n; i++)
        if (strncmp(environ[i], "RELIGHT_REQUEST_ID=", 19)) out[m++] = environ[i];
    if (out && *word) out[m] = word;
    return out;
}

static struct job_run *child_start(struct server *server, const struct job_order *order,
                                   const struct job_events *events, void *user, char error[256])
{
    char program[4096], number[12], request[96] = "";
    find_program(server, program);
    size_t n = 0;
    char *first[4] = {NULL};
    int n_first = leading(server, first);
    while (order->argv[n]) n++;
    char **argv = n_first < 0 ? NULL : calloc(n + (size_t)n_first + 2, sizeof *argv);
    if (order->request_id[0])
        snprintf(request, sizeof request, "RELIGHT_REQUEST_ID=%s", order->request_id);
    char **environment = make_environment(request);
    struct job_run *run = calloc(1, sizeof *run);
    int progress[2] = {-1, -1}, errors[2] = {-1, -1}, err = ENOMEM;
    if (!argv || !run || !environment) goto fail;
    argv[0] = "prt";
    snprintf(number, sizeof number, "%d", PROGRESS_FD);
    for (int i = 0; i < n_first; i++) argv[i + 1] = first[i];
    for (size_t i = 0; i < n; i++)
        argv[i + 1 + (size_t)n_first] =
            strcmp(order->argv[i], "{progress}") ? order->argv[i] : number;
    if (pipe2(progress, O_CLOEXEC) || pipe2(errors, O_CLOEXEC)) {
        err = errno;
        goto fail;
    }
    // dup2 onto the same number would leave close-on-exec set, or close the other.
    for (int i = 0; i < 2; i++) {
        int *fd = i ? &errors[1] : &progress[1], low = *fd;
        if (low > PROGRESS_FD) continue;
        *fd = fcntl(low, F_DUPFD_CLOEXEC, 10);
        err = errno;
        close(low);
        if (*fd < 0) goto fail;
    }
    *run = (struct job_run){.server = server, .events = *events, .user = user, .next = runs};
    struct birth birth = {.program = program,
                          .cwd = order->cwd,
                          .argv = argv,
                          .environment = environment,
                          .progress_fd = progress[1],
                          .error_fd = errors[1],
                          .cpu = cpu_limit(server)};
    err = spawn(&birth, &run->pid);
    if (err) goto fail;
    // Relative to the daemon's own niceness: relighting has precedence.
    int own = getpriority(PRIO_PROCESS, 0);
    setpriority(PRIO_PROCESS, (id_t)run->pid, own + (int)server->options.bake_nice);
    close(progress[1]);
    close(errors[1]);
    free_texts(first);
    free(argv);
    free(environment);
    runs = run;
    fcntl(progress[0], F_SETFL, O_NONBLOCK);
    fcntl(errors[0], F_SETFL, O_NONBLOCK);
    run->progress.watch = (struct loop_watch){progress[0], progress_ready};
    run->errors.watch = (struct loop_watch){errors[0], errors_ready};
    loop_watch_add(server->loop, &run->progress.watch, EPOLLIN);
    loop_watch_add(server->loop, &run->errors.watch, EPOLLIN);
    run->time_timer.fire = time_over;
    if (server->options.bake_time > 0)
        loop_timer_set(server->loop, &run->time_timer,
                       loop_now_ns() + (uint64_t)(server->options.bake_time * 1e9));
    return run;
fail:
    snprintf(error, 256, "%.200s cannot be started: %s", program, strerror(err));
    for (int i = 0; i < 2; i++) {
        if (progress[i] >= 0) close(progress[i]);
        if (errors[i] >= 0) close(errors[i]);
    }
    free_texts(first);
    free(argv);
    free(environment);
    free(run);
    return NULL;
}

const struct job_runner job_runner_child = {"child", child_start, child_cancel, child_reap};
