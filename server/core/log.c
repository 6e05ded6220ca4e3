// SPDX-License-Identifier: MIT
// The log: lines are built in a local buffer, queued whole, and written by a separate thread,
// so that a full pipe behind stderr never blocks the daemon.
#include "core/log.h"

#include "core/log_format.h"

#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { LINE = 1200, SITES = 256 };

static const char *const level_word[] = {"error", "warning", "event", "trace"};
static atomic_int shown = LOG_EVENT; // a reload sets it while other threads log
static enum log_format line_format = LOG_FORMAT_TEXT;

int log_level_parse(const char *word)
{
    for (int i = 0; i < 4; i++)
        if (!strcmp(word, level_word[i])) return i;
    return -1;
}

void log_set_level(enum log_level level)
{
    atomic_store_explicit(&shown, (int)level, memory_order_relaxed);
}

void log_set_format(int format)
{
    line_format = (enum log_format)format;
}

static char current_request[65];

void log_request_set(const char *id)
{
    snprintf(current_request, sizeof current_request, "%s", id);
}

const char *log_request(void)
{
    return current_request;
}

// ---- building a line

struct line {
    size_t n;
    char text[LINE];
};

static void put_byte(struct line *line, char c)
{
    if (line->n < LINE - 2) line->text[line->n++] = c; // room for the newline
}

static void put_text(struct line *line, const char *text)
{
    while (*text) put_byte(line, *text++);
}

static void put_hex(struct line *line, unsigned char c)
{
    static const char digit[] = "0123456789abcdef";
    put_text(line, "\\x");
    put_byte(line, digit[c >> 4]);
    put_byte(line, digit[c & 15]);
}

// Bytes of the UTF-8 character at s (n bytes); 0 for invalid bytes and for C1 controls.
static size_t utf8_length(const unsigned char *s, size_t n)
{
    size_t m = s[0] >= 0xf0 ? 4 : s[0] >= 0xe0 ? 3 : 2;
    if (s[0] < 0xc2 || s[0] > 0xf4 || m > n) return 0;
    for (size_t i = 1; i < m; i++)
        if ((s[i] & 0xc0) != 0x80) return 0;
    bool overlong = (s[0] == 0xe0 && s[1] < 0xa0) || (s[0] == 0xf0 && s[1] < 0x90);
    bool surrogate = s[0] == 0xed && s[1] > 0x9f, beyond = s[0] == 0xf4 && s[1] > 0x8f;
    bool control = s[0] == 0xc2 && s[1] < 0xa0;
    return overlong || surrogate || beyond || control ? 0 : m;
}

static void put_escaped(struct line *line, const char *text, size_t most)
{
    const unsigned char *s = (const unsigned char *)text;
    size_t n = strnlen(text, most);
    for (size_t i = 0; i < n;) {
        unsigned char c = s[i];
        size_t m = c < 0x80 ? 1 : utf8_length(s + i, n - i);
        if (m == 0 || c < 32 || c == 127) {
            put_hex(line, c);
            i++;
            continue;
        }
        if (line->n + m + 2 > LINE - 2) return; // whole characters only
        if (c == '"' || c == '\\') put_byte(line, '\\');
        for (size_t k = 0; k < m; k++) put_byte(line, text[i + k]);
        i += m;
    }
}

// One conversion of a format: %[flags][width][.precision][length]kind.
struct conversion {
    char spec[24]; // without precision or length of strings
    int precision; // -1: none
    int length;    // number of l, or 'z'
    char kind;
};

static const char *read_conversion(const char *at, va_list *args, struct conversion *c)
{
    size_t n = 0;
    *c = (struct conversion){.precision = -1};
    c->spec[n++] = *at++;
    while (*at && strchr("-+ #0123456789", *at) && n < 12) c->spec[n++] = *at++;
    if (*at == '.') {
        at++;
        c->precision = *at == '*' ? va_arg(*args, int) : (int)strtol(at, (char **)&at, 10);
        if (*at == '*') at++;
        n += (size_t)snprintf(c->spec + n, sizeof c->spec - n, ".%d", c->precision);
    }
    while (*at == 'l') c->length++, at++;
    if (*at == 'z') c->length = 'z', at++;
    c->kind = *at ? *at++ : 0;
    const char *length = c->length == 1     ? "l"
                         : c->length == 2   ? "ll"
                         : c->length == 'z' ? "z"
                                            : "";
    snprintf(c->spec + n, sizeof c->spec - n, "%s%c", length, c->kind);
    return at;
}

static void put_conversion(struct line *line, const struct conversion *c, va_list *args)
{
    char number[64] = "";
    switch (c->kind) {
    case 's': {
        const char *text = va_arg(*args, const char *);
        put_escaped(line, text ? text : "", c->precision >= 0 ? (size_t)c->precision : LINE);
        return;
    }
    case 'c':
        number[0] = (char)va_arg(*args, int);
        put_escaped(line, number, 1);
        return;
    case 'f':
    case 'g':
        snprintf(number, sizeof number, c->spec, va_arg(*args, double));
        break;
    case '%':
        put_byte(line, '%');
        return;
    default:
        if (c->length == 'z') snprintf(number, sizeof number, c->spec, va_arg(*args, size_t));
        else if (c->length == 2)
            snprintf(number, sizeof number, c->spec, va_arg(*args, unsigned long long));
        else if (c->length == 1)
            snprintf(number, sizeof number, c->spec, va_arg(*args, unsigned long));
        else snprintf(number, sizeof number, c->spec, va_arg(*args, unsigned));
    }
    put_text(line, number);
}

static void put_format(struct line *line, const char *fmt, va_list *args)
{
    while (*fmt) {
        if (*fmt != '%') {
            put_byte(line, *fmt++);
            continue;
        }
        struct conversion c;
        fmt = read_conversion(fmt, args, &c);
        put_conversion(line, &c, args);
    }
}

static void put_time(struct line *line, enum log_level level)
{
    struct timespec now;
    struct tm utc;
    clock_gettime(CLOCK_REALTIME, &now);
    gmtime_r(&now.tv_sec, &utc);
    line->n = strftime(line->text, LINE, "%Y-%m-%dT%H:%M:%S", &utc);
    line->n += (size_t)snprintf(line->text + line->n, LINE - line->n, ".%03ldZ %s ",
                                now.tv_nsec / 1000000, level_word[level]);
}

// ---- the queue and its thread

static struct {
    pthread_mutex_t lock;
    pthread_cond_t filled, emptied;
    pthread_t thread;
    bool running, stopping;
    size_t first, n; // ring of bytes
    uint64_t dropped, suppressed, told;
    char bytes[LOG_QUEUE];
} queue = {.lock = PTHREAD_MUTEX_INITIALIZER,
           .filled = PTHREAD_COND_INITIALIZER,
           .emptied = PTHREAD_COND_INITIALIZER};

// A token bucket for each call site, found by its format's address. Under queue.lock.
static struct site {
    const char *fmt;
    double tokens, at_s;
    uint64_t suppressed;
} site[SITES];

static struct site *find_site(const char *fmt, double now_s)
{
    size_t i = (size_t)(((uintptr_t)fmt * 0x9e3779b97f4a7c15u) >> 32) % SITES;
    for (size_t k = 0; k < SITES; k++, i = (i + 1) % SITES) {
        if (site[i].fmt == fmt) return &site[i];
        if (site[i].fmt) continue;
        site[i] = (struct site){fmt, LOG_BURST, now_s, 0};
        return &site[i];
    }
    return NULL; // more call sites than slots: the rest is not limited
}

// False when this call site is over its rate; *before: lines suppressed since its last one.
static bool may_log(const char *fmt, uint64_t *before)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    double now_s = (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
    struct site *s = find_site(fmt, now_s);
    *before = 0;
    if (!s) return true;
    s->tokens += (now_s - s->at_s) * LOG_RATE;
    if (s->tokens > LOG_BURST) s->tokens = LOG_BURST;
    s->at_s = now_s;
    if (s->tokens < 1) {
        s->suppressed++;
        queue.suppressed++;
        return false;
    }
    s->tokens--;
    *before = s->suppressed;
    s->suppressed = 0;
    return true;
}

static void enqueue(const char *bytes, size_t n)
{
    for (size_t i = 0; i < n; i++)
        queue.bytes[(queue.first + queue.n + i) % LOG_QUEUE] = bytes[i];
    queue.n += n;
    pthread_cond_signal(&queue.filled);
}

// Under queue.lock. Logs the number of dropped lines as soon as there is room again.
static void tell_dropped(void)
{
    if (queue.told == queue.dropped || queue.n > LOG_QUEUE / 2) return;
    struct line line;
    put_time(&line, LOG_WARN);
    char out[400];
    line.n += (size_t)snprintf(line.text + line.n, LINE - line.n, "log dropped=%llu",
                               (unsigned long long)(queue.dropped - queue.told));
    queue.told = queue.dropped;
    size_t n = log_reformat(line_format, line.text, line.n, out, sizeof out - 1);
    out[n++] = '\n';
    enqueue(out, n);
}

static void write_all(const char *bytes, size_t n)
{
    while (n) {
        ssize_t done = write(STDERR_FILENO, bytes, n);
        if (done < 0 && errno == EINTR) continue;
        if (done < 0 && errno == EAGAIN) { // another process made stderr non-blocking
            struct pollfd p = {STDERR_FILENO, POLLOUT, 0};
            poll(&p, 1, 1000);
            continue;
        }
        if (done <= 0) return; // stderr is closed: nothing can be reported
        bytes += done;
        n -= (size_t)done;
    }
}

static void *write_queue(void *unused)
{
    static char piece[16 << 10];
    pthread_mutex_lock(&queue.lock);
    for (;;) {
        while (!queue.n && !queue.stopping) pthread_cond_wait(&queue.filled, &queue.lock);
        if (!queue.n) break;
        size_t n = queue.n < sizeof piece ? queue.n : sizeof piece;
        for (size_t i = 0; i < n; i++) piece[i] = queue.bytes[(queue.first + i) % LOG_QUEUE];
        pthread_mutex_unlock(&queue.lock);
        write_all(piece, n);
        pthread_mutex_lock(&queue.lock);
        queue.first = (queue.first + n) % LOG_QUEUE;
        queue.n -= n;
        tell_dropped();
    }
    queue.running = false;
    pthread_cond_signal(&queue.emptied);
    pthread_mutex_unlock(&queue.lock);
    return NULL;
}

void log_start(void)
{
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before); // the loop's thread handles signals
    pthread_mutex_lock(&queue.lock);
    queue.stopping = false;
    queue.running = !pthread_create(&queue.thread, NULL, write_queue, NULL);
    if (queue.running) pthread_detach(queue.thread);
    pthread_mutex_unlock(&queue.lock);
    pthread_sigmask(SIG_SETMASK, &before, NULL);
}

void log_stop(void)
{
    struct timespec until;
    clock_gettime(CLOCK_REALTIME, &until);
    until.tv_sec++;
    pthread_mutex_lock(&queue.lock);
    queue.stopping = true;
    pthread_cond_signal(&queue.filled);
    while (queue.running)
        if (pthread_cond_timedwait(&queue.emptied, &queue.lock, &until)) break;
    pthread_mutex_unlock(&queue.lock);
}

uint64_t log_lost(void)
{
    pthread_mutex_lock(&queue.lock);
    uint64_t n = queue.dropped + queue.suppressed;
    pthread_mutex_unlock(&queue.lock);
    return n;
}

void log_line(enum log_level level, const char *fmt, ...)
{
    if ((int)level > atomic_load_explicit(&shown, memory_order_relaxed)) return;
    uint64_t before;
    pthread_mutex_lock(&queue.lock);
    bool pass = may_log(fmt, &before);
    pthread_mutex_unlock(&queue.lock);
    if (!pass) return;
    struct line line;
    va_list args;
    put_time(&line, level);
    va_start(args, fmt);
    put_format(&line, fmt, &args);
    va_end(args);
    if (before) {
        char text[48];
        snprintf(text, sizeof text, " suppressed=%llu", (unsigned long long)before);
        if (line.n + strlen(text) > LINE - 2) line.n = LINE - 2 - strlen(text);
        put_text(&line, text);
    }
    char out[2 * LINE];
    size_t n = log_reformat(line_format, line.text, line.n, out, sizeof out - 1);
    out[n++] = '\n';
    pthread_mutex_lock(&queue.lock);
    bool queued = queue.running;
    if (queued && queue.n + n <= LOG_QUEUE - LINE) enqueue(out, n);
    else if (queued) queue.dropped++;
    pthread_mutex_unlock(&queue.lock);
    if (!queued) write_all(out, n);
}
