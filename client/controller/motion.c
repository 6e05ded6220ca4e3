// SPDX-License-Identifier: MIT
// Turns movements of controls into requests. A deflection is a speed. The speed of a device
// that repeats its reports is integrated from report to report; for other devices the sender's
// thread wakes up while a control is deflected. Without a deflected control no thread wakes up.
#include "motion.h"

#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

// A bucket of 5 requests that fills at 120 a second: no second has more than 125.
static const double fill_per_s = 120, bucket = 5;
static const double tick_s = 1. / 100, most_step_s = .05, first_step_s = .008;
enum { MOST_TIMES = 1 << 16 };

struct bound {
    struct device_map map;
    double speed[MOST_ENTRIES]; // [1/s] of controls that do not repeat
    double position[MOST_ENTRIES];
    bool has_position[MOST_ENTRIES];
};
struct motion {
    motion_send_fn send;
    void *user;
    pthread_t thread;
    pthread_mutex_t lock; // all below
    pthread_cond_t wake;
    bool stop, changed;
    struct change change;
    double speed[N_VALUE];
    uint64_t moved_ns; // speed was integrated up to here
    uint64_t n_report, first_ns;
    // the sender's alone
    double tokens;
    uint64_t filled_ns;
    struct motion_times times;
    uint64_t second, in_second;
    uint32_t n_time;
    float *time_ms; // [MOST_TIMES]
};

// ---- input

static void add(struct motion *m, enum target t, double amount)
{
    m->change.delta[t] += amount;
}

// A reset undoes the movements of the same request that came before it.
static void reset(struct motion *m)
{
    const struct change was = m->change;
    m->change = (struct change){.reset = true, .undo = was.undo, .redo = was.redo};
}

static void press(struct motion *m, const struct map_entry *e)
{
    if (e->target == TARGET_RESET) reset(m);
    else if (e->target == TARGET_UNDO) m->change.undo = true;
    else if (e->target == TARGET_REDO) m->change.redo = true;
    else add(m, e->target, e->scale);
}

static bool is_change(const struct change *c)
{
    bool any = c->reset || c->undo || c->redo;
    for (int i = 0; i < N_VALUE; i++) any |= c->has_position[i] || c->delta[i] != 0;
    return any;
}

// A report may be older than the sender's clock, which has integrated past it.
static void integrate(struct motion *m, uint64_t now)
{
    if (now <= m->moved_ns) return;
    double step = fmin((double)(now - m->moved_ns) * 1e-9, most_step_s);
    m->moved_ns = now;
    for (int i = 0; i < N_VALUE; i++) add(m, (enum target)i, m->speed[i] * step);
    m->changed |= is_change(&m->change);
}

static void deflect(struct motion *m, struct bound *b, uint32_t i, const struct usb_control *c,
                    uint64_t previous_ns, uint64_t now_ns)
{
    const struct map_entry *e = &b->map.entry[i];
    double speed = mapping_curve(e, c->value) * e->scale;
    if (c->repeats) {
        double step = previous_ns ? (double)(now_ns - previous_ns) * 1e-9 : first_step_s;
        if (step > most_step_s) step = first_step_s; // the control was at rest in between
        add(m, e->target, speed * step);
        return;
    }
    // The speed until now, also of the other controls, counts until now.
    integrate(m, now_ns);
    if (b->speed[i] == 0) add(m, e->target, speed * first_step_s);
    m->speed[e->target] += speed - b->speed[i];
    if (fabs(m->speed[e->target]) < 1e-9) m->speed[e->target] = 0; // rounding
    b->speed[i] = speed;
}

static void slide(struct motion *m, struct bound *b, uint32_t i, double value)
{
    const struct map_entry *e = &b->map.entry[i];
    if (b->has_position[i] && fabs(value - b->position[i]) <= e->dead) return;
    b->has_position[i] = true;
    b->position[i] = value;
    m->change.has_position[e->target] = true;
    m->change.position[e->target] = (pow(value, e->curve) - .5) * e->scale;
    m->change.delta[e->target] = 0;
}

static void apply(struct motion *m, struct bound *b, uint32_t i, const struct usb_control *c,
                  uint64_t previous_ns, uint64_t now_ns)
{
    const struct map_entry *e = &b->map.entry[i];
    if (e->target >= N_VALUE && c->kind != CONTROL_BUTTON) return;
    switch (c->kind) {
    case CONTROL_BUTTON:
        if (c->value > 0) press(m, e);
        break;
    case CONTROL_DEFLECTION:
        deflect(m, b, i, c, previous_ns, now_ns);
        break;
    case CONTROL_RELATIVE:
        if (fabs(c->value) > e->dead) add(m, e->target, c->value * e->scale);
        break;
    case CONTROL_POSITION:
        slide(m, b, i, c->value);
    }
}

void motion_input(struct motion *m, struct bound *b, const struct usb_control *c,
                  uint64_t previous_ns, uint64_t now_ns)
{
    pthread_mutex_lock(&m->lock);
    for (uint32_t i = 0; i < b->map.n_entry; i++)
        if (!strcmp(b->map.entry[i].control, c->name)) apply(m, b, i, c, previous_ns, now_ns);
    if (is_change(&m->change)) {
        m->changed = true;
        if (!m->n_report++) m->first_ns = now_ns;
        pthread_cond_signal(&m->wake);
    }
    pthread_mutex_unlock(&m->lock);
}

struct bound *motion_bind(const struct device_map *map)
{
    struct bound *b = calloc(1, sizeof *b);
    if (b) b->map = *map;
    return b;
}

void motion_unbind(struct motion *m, struct bound *b)
{
    if (!b) return;
    pthread_mutex_lock(&m->lock);
    for (uint32_t i = 0; i < b->map.n_entry; i++)
        if (b->speed[i] != 0) {
            double *speed = &m->speed[b->map.entry[i].target];
            *speed -= b->speed[i];
            if (fabs(*speed) < 1e-9) *speed = 0;
        }
    pthread_mutex_unlock(&m->lock);
    free(b);
}

const struct device_map *motion_map(const struct bound *b)
{
    return &b->map;
}

// ---- sending

static bool is_moving(const struct motion *m)
{
    bool any = false;
    for (int i = 0; i < N_VALUE; i++) any |= m->speed[i] != 0;
    return any;
}

static void wait_s(struct motion *m, double seconds)
{
    uint64_t at = control_now_ns() + (uint64_t)(seconds * 1e9);
    struct timespec t = {(time_t)(at / 1000000000u), (long)(at % 1000000000u)};
    pthread_cond_timedwait(&m->wake, &m->lock, &t);
}

// Seconds until a request may be sent; 0: now.
static double limit_s(struct motion *m, uint64_t now)
{
    m->tokens = fmin(bucket, m->tokens + (double)(now - m->filled_ns) * 1e-9 * fill_per_s);
    m->filled_ns = now;
    return m->tokens >= 1 ? 0 : (1 - m->tokens) / fill_per_s;
}

static void note(struct motion *m, uint64_t n_report, uint64_t first_ns, bool held)
{
    uint64_t now = control_now_ns(), second = now / 1000000000u;
    m->times.requests++;
    if (held) m->times.held += n_report;
    if (second != m->second) m->in_second = 0;
    m->second = second;
    if (++m->in_second > m->times.most_a_second) m->times.most_a_second = m->in_second;
    // A request that the sender's clock began has no report, and the time of one that waited
    // for the limit is the limit's.
    if (n_report && !held && m->n_time < MOST_TIMES)
        m->time_ms[m->n_time++] = (float)((double)(now - first_ns) * 1e-6);
}

// The caller holds the lock, which is released while the change is sent.
static void send_change(struct motion *m, bool held)
{
    struct change change = m->change;
    uint64_t n_report = m->n_report, first_ns = m->first_ns;
    memset(&m->change, 0, sizeof m->change);
    m->changed = false;
    m->n_report = 0;
    m->tokens -= 1;
    pthread_mutex_unlock(&m->lock);
    bool sent = m->send(m->user, &change);
    pthread_mutex_lock(&m->lock);
    if (sent) note(m, n_report, first_ns, held);
}

static void *run(void *user)
{
    struct motion *m = user;
    bool held = false;
    pthread_mutex_lock(&m->lock);
    while (!m->stop) {
        if (!m->changed && !is_moving(m)) {
            pthread_cond_wait(&m->wake, &m->lock);
            continue;
        }
        uint64_t now = control_now_ns();
        if (!m->changed && (double)(now - m->moved_ns) * 1e-9 < tick_s) {
            wait_s(m, tick_s - (double)(now - m->moved_ns) * 1e-9);
            continue;
        }
        integrate(m, now);
        double limit = limit_s(m, now);
        held |= limit > 0;
        if (limit > 0) {
            wait_s(m, limit);
            continue;
        }
        if (m->changed) send_change(m, held);
        held = false;
    }
    pthread_mutex_unlock(&m->lock);
    return NULL;
}

struct motion *motion_start(motion_send_fn send, void *user)
{
    struct motion *m = calloc(1, sizeof *m);
    pthread_condattr_t attr;
    if (!m) return NULL;
    m->send = send;
    m->user = user;
    m->tokens = bucket;
    m->filled_ns = m->moved_ns = control_now_ns();
    m->time_ms = calloc(MOST_TIMES, sizeof *m->time_ms);
    pthread_mutex_init(&m->lock, NULL);
    pthread_condattr_init(&attr);
    pthread_condattr_setclock(&attr, CLOCK_MONOTONIC);
    pthread_cond_init(&m->wake, &attr);
    pthread_condattr_destroy(&attr);
    if (m->time_ms && !pthread_create(&m->thread, NULL, run, m)) return m;
    free(m->time_ms);
    free(m);
    return NULL;
}

static int by_value(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

void motion_stop(struct motion *m, struct motion_times *times)
{
    if (!m) return;
    pthread_mutex_lock(&m->lock);
    m->stop = true;
    pthread_cond_signal(&m->wake);
    pthread_mutex_unlock(&m->lock);
    pthread_join(m->thread, NULL);
    if (m->n_time) {
        qsort(m->time_ms, m->n_time, sizeof *m->time_ms, by_value);
        m->times.median_ms = m->time_ms[m->n_time / 2];
        m->times.p99_ms = m->time_ms[(uint64_t)m->n_time * 99 / 100];
        m->times.most_ms = m->time_ms[m->n_time - 1];
    }
    if (times) *times = m->times;
    pthread_cond_destroy(&m->wake);
    pthread_mutex_destroy(&m->lock);
    free(m->time_ms);
    free(m);
}
