// SPDX-License-Identifier: MIT
// Runs a fuzz target without libFuzzer: NAME [-s SECONDS] SEED... where a seed is a file or a
// folder of files. Every seed runs as it is, then mutations of them, the same ones each time.
#include <dirent.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

enum { MAX_SEEDS = 256, MAX_BYTES = 1 << 16, MAX_SECONDS_EACH = 10 };

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n);
__attribute__((weak)) void __sanitizer_set_death_callback(void (*)(void));

static uint8_t *seed[MAX_SEEDS], now[2 * MAX_BYTES];
static size_t seed_n[MAX_SEEDS], n_seed, now_n;
static uint64_t state = 0x9e3779b97f4a7c15u;

static uint32_t rnd(uint32_t below)
{
    state ^= state << 13, state ^= state >> 7, state ^= state << 17;
    return (uint32_t)((state >> 32) * below >> 32);
}

// Leaves the input that did it in ./crash-PID.
static void keep_input(void)
{
    char path[64];
    snprintf(path, sizeof path, "crash-%ld", (long)getpid());
    FILE *f = fopen(path, "wb");
    if (f) {
        fwrite(now, 1, now_n, f);
        fclose(f);
        fprintf(stderr, "the input is in %s\n", path);
    }
}

static void on_signal(int s)
{
    fprintf(stderr, s == SIGALRM || s == SIGPROF ? "an input took too long\n" : "crashed\n");
    keep_input();
    signal(s, SIG_DFL);
    raise(s);
}

static void add_seed(const char *path)
{
    struct stat st;
    char inner[4096];
    if (stat(path, &st)) return;
    if (S_ISDIR(st.st_mode)) {
        struct dirent **list = NULL;
        int n = scandir(path, &list, NULL, alphasort);
        for (int i = 0; i < n; i++) {
            if (list[i]->d_name[0] != '.' &&
                snprintf(inner, sizeof inner, "%s/%s", path, list[i]->d_name) < 4096)
                add_seed(inner);
            free(list[i]);
        }
        free(list);
        return;
    }
    FILE *f = st.st_size <= MAX_BYTES && n_seed < MAX_SEEDS ? fopen(path, "rb") : NULL;
    if (!f) return;
    seed[n_seed] = malloc(MAX_BYTES);
    seed_n[n_seed] = fread(seed[n_seed], 1, MAX_BYTES, f);
    n_seed++;
    fclose(f);
}

static void one_change(void)
{
    static const uint32_t odd[] = {0, 1, 0xff, 0x7f, 0x80, 0xffff, 0x7fffffff, 0x80000000, ~0u};
    static const char *const text[] = {"0", "-1", "99999999999", "1e400",
                                       "{", "[",  "\"",          "null"};
    uint32_t at = now_n ? rnd((uint32_t)now_n) : 0, n, from;
    switch (now_n > 8 ? rnd(7) : 6) {
    case 0:
        now[at] ^= (uint8_t)(1u << rnd(8));
        break;
    case 1:
        now[at] = (uint8_t)rnd(256);
        break;
    case 2:
        memcpy(now + (at > now_n - 4 ? now_n - 4 : at), &odd[rnd(9)], 4);
        break;
    case 3:
        now_n = at + 1;
        break;
    case 4: // take a piece out
        n = rnd((uint32_t)(now_n - at)) / 8;
        memmove(now + at, now + at + n, now_n - at - n);
        now_n -= n;
        break;
    case 5: // write a piece over another
        from = rnd((uint32_t)now_n);
        n = (uint32_t)now_n - (at > from ? at : from);
        memmove(now + at, now + from, rnd(n + 1));
        break;
    default: // put a word in
        from = rnd(8);
        n = (uint32_t)strlen(text[from]);
        if (now_n + n > sizeof now) break;
        memmove(now + at + n, now + at, now_n - at);
        memcpy(now + at, text[from], n);
        now_n += n;
    }
}

// CPU time, and a generous wall clock: the first image that our own parsers leave to
// OpenImageIO loads its hundreds of libraries, which on a cold, busy machine is ten seconds of
// waiting.
static void set_limit(int seconds)
{
    struct itimerval limit = {.it_value.tv_sec = seconds};
    setitimer(ITIMER_PROF, &limit, NULL);
    alarm((unsigned)seconds * 6);
}

static void run(void)
{
    uint8_t *exact = malloc(now_n ? now_n : 1); // so that a sanitizer sees the end
    if (now_n) memcpy(exact, now, now_n);
    set_limit(MAX_SECONDS_EACH);
    LLVMFuzzerTestOneInput(exact, now_n);
    set_limit(0);
    free(exact);
}

int main(int argc, char **argv)
{
    double seconds = 5;
    int first = 1;
    if (argc > 2 && !strcmp(argv[1], "-s")) {
        seconds = atof(argv[2]);
        first = 3;
    }
    for (int i = first; i < argc; i++) add_seed(argv[i]);
    if (!n_seed) return fprintf(stderr, "no seeds\n"), 2;
    signal(SIGALRM, on_signal);
    signal(SIGPROF, on_signal);
    if (__sanitizer_set_death_callback) __sanitizer_set_death_callback(keep_input);
    else signal(SIGSEGV, on_signal), signal(SIGABRT, on_signal), signal(SIGBUS, on_signal);
    for (size_t i = 0; i < n_seed; i++) {
        memcpy(now, seed[i], now_n = seed_n[i]);
        run();
    }
    unsigned long count = 0;
    for (time_t end = time(NULL) + (time_t)seconds; time(NULL) < end; count++) {
        size_t i = rnd((uint32_t)n_seed);
        memcpy(now, seed[i], now_n = seed_n[i]);
        for (uint32_t k = 1 + rnd(4); k; k--) one_change();
        run();
    }
    for (size_t i = 0; i < n_seed; i++) free(seed[i]);
    printf("%zu seeds and %lu mutations\n", n_seed, count);
    return 0;
}
