// SPDX-License-Identifier: MIT
// The daemon under measurement, and the environment files it is given.
#include "daemon.h"

#include "synthetic.h"

#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <limits.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

// A benchmark that is interrupted ends its daemon and removes its folder.

static int remove_one(const char *path, const struct stat *st, int kind, struct FTW *where)
{
    return remove(path);
}

static void remove_folder(const char *folder)
{
    if (folder[0]) nftw(folder, remove_one, 16, FTW_DEPTH | FTW_PHYS);
}

static const int ending[] = {SIGINT, SIGTERM, SIGHUP};
static int told[2] = {-1, -1};
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
enum { MOST_RUNNING = 2 };
static const struct bench_daemon *running[MOST_RUNNING]; // guarded by lock; NULL: none

static void on_ending(int number)
{
    unsigned char byte = (unsigned char)number;
    if (write(told[1], &byte, 1) < 0) _exit(128 + number);
}

// Ends the daemons, removes their folders and then the process as the signal would have.
static void *clean_up(void *arg)
{
    unsigned char number;
    while (read(told[0], &number, 1) != 1) continue;
    pthread_mutex_lock(&lock); // never unlocked: threads that stop or start a daemon wait here
    for (int d = 0; d < MOST_RUNNING; d++) {
        if (running[d] && running[d]->pid > 0) {
            kill(running[d]->pid, SIGTERM);
            for (int i = 0; i < 500 && !waitpid(running[d]->pid, NULL, WNOHANG); i++)
                usleep(10000);
            kill(running[d]->pid, SIGKILL);
        }
        if (running[d]) remove_folder(running[d]->folder);
    }
    signal(number, SIG_DFL);
    kill(getpid(), number);
    _exit(128 + number);
}

static void watch_for_ending(void)
{
    static bool watching;
    pthread_t thread;
    struct sigaction act = {.sa_handler = on_ending, .sa_flags = SA_RESTART};
    if (watching || pipe2(told, O_CLOEXEC) || pthread_create(&thread, NULL, clean_up, NULL))
        return;
    watching = true;
    pthread_detach(thread);
    for (size_t i = 0; i < sizeof ending / sizeof *ending; i++) {
        struct sigaction old;
        sigaction(ending[i], NULL, &old);
        if (old.sa_handler == SIG_DFL)
            sigaction(ending[i], &act, NULL); // nohup's stays ignored
    }
}

// Replaces an entry of `running`: (NULL, d) adds a daemon, (d, NULL) removes it.
static void put_in_place_of(const struct bench_daemon *old, const struct bench_daemon *d)
{
    pthread_mutex_lock(&lock);
    for (int i = 0; i < MOST_RUNNING; i++)
        if (running[i] == old) {
            running[i] = d;
            break;
        }
    pthread_mutex_unlock(&lock);
}

// ---- the process

static int made_up_models(struct bench_env *env, struct bench_daemon *d, unsigned n)
{
    char path[64];
    int status = PRT_OK;
    snprintf(d->model, sizeof d->model, "model-0");
    for (unsigned i = 0; i < n && !status; i++) {
        snprintf(path, sizeof path, "%s/models/model-%u.prt", d->folder, i);
        status = synthetic_bunny(&env->ctx, path, env->quick, env->seed + i);
    }
    return status;
}

// The daemon reads no links in --models.
static int copy_file(struct bench_env *env, const char *from, const char *to)
{
    int in = open(from, O_RDONLY | O_CLOEXEC);
    int out = in < 0 ? -1 : open(to, O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
    ssize_t n = 1;
    while (out >= 0 && n > 0) n = copy_file_range(in, NULL, out, NULL, 64 << 20, 0);
    int status = out < 0 || n < 0
                     ? prt_fail(&env->ctx, PRT_IO, "%s to %s: %s", from, to, strerror(errno))
                     : PRT_OK;
    if (in >= 0) close(in);
    if (out >= 0) close(out);
    return status;
}

static int lay_out(struct bench_env *env, unsigned n_model, struct bench_daemon *d)
{
    char path[64];
    strcpy(d->folder, "/tmp/prt-bench-XXXXXX");
    if (!mkdtemp(d->folder)) {
        d->folder[0] = 0;
        return prt_fail(&env->ctx, PRT_IO, "no temporary folder: %s", strerror(errno));
    }
    snprintf(path, sizeof path, "%s/models", d->folder);
    if (mkdir(path, 0700)) return prt_fail(&env->ctx, PRT_IO, "%s: %s", path, strerror(errno));
    if (n_model) return made_up_models(env, d, n_model);
    snprintf(d->model, sizeof d->model, "measured");
    snprintf(path, sizeof path, "%s/models/measured.prt", d->folder);
    if (!env->file) return synthetic_bunny(&env->ctx, path, env->quick, env->seed);
    return copy_file(env, env->file, path);
}

static void find_program(char out[PATH_MAX])
{
    ssize_t n = readlink("/proc/self/exe", out, PATH_MAX - 16);
    char *slash = NULL;
    if (n > 0) {
        out[n] = 0;
        slash = strrchr(out, '/');
    }
    if (slash) strcpy(slash + 1, "relightd");
    if (!slash || access(out, X_OK)) strcpy(out, "relightd");
}

static int spawn(struct bench_env *env, const char *const extra[], struct bench_daemon *d,
                 const char *log)
{
    char program[PATH_MAX], models[64], data[64], threads[16], cpu[16], *argv[40];
    unsigned n = 0;
    find_program(program);
    snprintf(models, sizeof models, "%s/models", d->folder);
    snprintf(data, sizeof data, "%s/data", d->folder);
    snprintf(d->address[0], sizeof d->address[0], "unix:%s/socket", d->folder);
    snprintf(threads, sizeof threads, "%u", env->threads);
    snprintf(cpu, sizeof cpu, "%s", env->cpu_name);
    char *const all[] = {"relightd",    "--models", models,
                         "--data",      data,       "--listen",
                         d->address[0], "--listen", "tcp:127.0.0.1:0",
                         "--threads",   threads,    "--cpu",
                         cpu,           NULL};
    for (; all[n]; n++) argv[n] = all[n];
    for (unsigned i = 0; extra && extra[i] && n < 39; i++) argv[n++] = (char *)extra[i];
    argv[n] = NULL;
    int fd = open(log, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    pid_t parent = getpid();
    d->pid = fd < 0 ? -1 : fork();
    if (d->pid == 0) {
        prctl(PR_SET_PDEATHSIG, SIGTERM); // a benchmark that is cut short leaves no daemon
        if (getppid() != parent || dup2(fd, 2) < 0) _exit(1);
        execvp(program, argv);
        dprintf(2, "%s: %s\n", program, strerror(errno));
        _exit(127);
    }
    int err = errno;
    if (fd >= 0) close(fd);
    if (d->pid > 0) return PRT_OK;
    d->pid = 0;
    return prt_fail(&env->ctx, PRT_IO, "%s cannot be started: %s", program, strerror(err));
}

// The log names the port it was given, and says when everything is up.
static bool came_up(struct bench_daemon *d, const char *log, char last[256])
{
    char line[256];
    bool up = false;
    FILE *file = fopen(log, "r");
    while (file && fgets(line, sizeof line, file)) {
        char *at = strstr(line, "listen address=tcp:");
        up |= strstr(line, " start version=") != NULL;
        snprintf(last, 256, "%.*s", (int)strcspn(line, "\n"), line);
        if (!at) continue;
        at += strlen("listen address=");
        snprintf(d->address[1], sizeof d->address[1], "%.*s", (int)strcspn(at, " \n"), at);
    }
    if (file) fclose(file);
    return up && d->address[1][0];
}

int bench_daemon_start(struct bench_env *env, struct bench_daemon *out)
{
    return bench_daemon_start_with(env, NULL, 0, out);
}

int bench_daemon_start_with(struct bench_env *env, const char *const extra[], unsigned n_model,
                            struct bench_daemon *out)
{
    char log[64], last[256] = "";
    *out = (struct bench_daemon){.pid = 0};
    watch_for_ending();
    put_in_place_of(NULL, out);
    int status = lay_out(env, n_model, out);
    snprintf(log, sizeof log, "%s/log", out->folder);
    if (!status) status = spawn(env, extra, out, log);
    double begin = prt_time_s();
    while (!status && !came_up(out, log, last)) {
        int how;
        bool gone = waitpid(out->pid, &how, WNOHANG) == out->pid;
        if (gone) out->pid = 0;
        if (gone || prt_time_s() - begin > 30)
            status = prt_fail(&env->ctx, PRT_IO, "relightd did not come up: %s", last);
        usleep(2000);
    }
    if (status) bench_daemon_stop(out);
    return status;
}

void bench_daemon_stop(struct bench_daemon *d)
{
    if (d->pid > 0) {
        kill(d->pid, SIGTERM);
        while (waitpid(d->pid, NULL, 0) < 0 && errno == EINTR) continue;
    }
    remove_folder(d->folder);
    put_in_place_of(d, NULL);
    d->pid = 0;
    d->folder[0] = 0;
}

double bench_daemon_cpu_s(const struct bench_daemon *d)
{
    clockid_t clock;
    struct timespec t;
    if (clock_getcpuclockid(d->pid, &clock) || clock_gettime(clock, &t)) return NAN;
    return (double)t.tv_sec + (double)t.tv_nsec * 1e-9;
}

double bench_daemon_rss_kib(const struct bench_daemon *d)
{
    char path[64], line[128];
    double kib = NAN;
    snprintf(path, sizeof path, "/proc/%d/status", (int)d->pid);
    FILE *file = fopen(path, "r");
    while (file && fgets(line, sizeof line, file))
        if (!strncmp(line, "VmRSS:", 6)) kib = strtod(line + 6, NULL);
    if (file) fclose(file);
    return kib;
}

// ---- environment files

enum { WIDTH = 1024, HEIGHT = 512 };

static int paint(uint32_t number, struct prt_image *out)
{
    struct prt_rng rng;
    prt_rng_init(&rng, number, 17);
    *out = (struct prt_image){WIDTH, HEIGHT, prt_alloc((size_t)WIDTH * HEIGHT, 12)};
    if (!out->rgb) return PRT_NOMEM;
    float sun_x = (float)WIDTH * prt_rng_f32(&rng);
    float sun_y = (float)HEIGHT * (0.1f + 0.35f * prt_rng_f32(&rng));
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) {
            float *p = out->rgb + 3 * ((size_t)y * WIDTH + (size_t)x);
            float up = 1 - 2 * (float)y / HEIGHT, dx = (float)x - sun_x, dy = (float)y - sun_y;
            float sun = 400 * expf(-(dx * dx + dy * dy) / 18), grain;
            for (int c = 0; c < 3; c++) {
                grain = 0.9f + 0.2f * prt_rng_f32(&rng);
                float sky = up > 0 ? 0.5f + 0.25f * (float)c * up : 0.2f - 0.05f * (float)c;
                p[c] = grain * sky + sun;
            }
        }
    return PRT_OK;
}

static void rgbe(const float p[3], uint8_t out[4])
{
    int e;
    float high = fmaxf(p[0], fmaxf(p[1], p[2])), m = frexpf(high, &e) * 256 / high;
    for (int c = 0; c < 3; c++) out[c] = (uint8_t)(p[c] * m);
    out[3] = (uint8_t)(e + 128);
}

// Radiance's run-length rows; grain leaves no runs, so all are literal.
static int encode_hdr(const struct prt_image *image, struct prt_blob *out)
{
    static const char head[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 512 +X 1024\n";
    size_t row = 4 + 4 * (WIDTH + WIDTH / 128);
    uint8_t *bytes = prt_alloc(sizeof head - 1 + row * HEIGHT, 1), *p = bytes;
    if (!bytes) return PRT_NOMEM;
    memcpy(p, head, sizeof head - 1);
    p += sizeof head - 1;
    for (uint32_t y = 0; y < HEIGHT; y++) {
        uint8_t texel[WIDTH][4];
        for (uint32_t x = 0; x < WIDTH; x++)
            rgbe(image->rgb + 3 * ((size_t)y * WIDTH + x), texel[x]);
        *p++ = 2;
        *p++ = 2;
        *p++ = WIDTH >> 8;
        *p++ = WIDTH & 255;
        for (int c = 0; c < 4; c++)
            for (uint32_t x = 0; x < WIDTH; x++) {
                if (x % 128 == 0) *p++ = 128;
                *p++ = texel[x][c];
            }
    }
    *out = (struct prt_blob){bytes, (size_t)(p - bytes)};
    return PRT_OK;
}

static int encode_png(const struct prt_context *ctx, const struct prt_image *image,
                      struct prt_blob *out)
{
    uint8_t *rgb8 = prt_alloc((size_t)WIDTH * HEIGHT, 3);
    if (!rgb8) return PRT_NOMEM;
    for (size_t i = 0; i < (size_t)WIDTH * HEIGHT * 3; i++)
        rgb8[i] = (uint8_t)(255 * powf(fminf(image->rgb[i], 1), 1 / 2.2f) + 0.5f);
    int status = prt_encode_png(ctx, rgb8, WIDTH, HEIGHT, 3, out);
    prt_free(rgb8);
    return status;
}

int bench_env_file(const struct prt_context *ctx, const char *format, uint32_t number,
                   struct prt_blob *out)
{
    struct prt_image image;
    int status = paint(number, &image);
    if (status) return prt_fail(ctx, status, "no memory for an environment");
    if (!strcmp(format, "hdr")) status = encode_hdr(&image, out);
    else if (!strcmp(format, "exr")) status = prt_encode_exr(ctx, &image, false, out);
    else status = encode_png(ctx, &image, out);
    prt_image_finish(&image);
    return status;
}
