// SPDX-License-Identifier: MIT
// Tasks without a daemon: --list, --check, --learn.
#include "control.h"

#include <math.h>
#include <pthread.h>
#include <string.h>
#include <time.h>

// ---- --list

struct listing {
    struct control *control;
    pthread_mutex_t lock;
    pthread_cond_t wake;
    uint32_t n_expected, n_seen, n_listed;
};

static const char *kind_word(const struct usb_control *c)
{
    static const char *const words[] = {"deflection", "dial", "slider", "button"};
    return words[c->kind];
}

static bool is_named(const struct control *c, uint16_t vendor, uint16_t product)
{
    for (uint32_t i = 0; i < c->options.n_named; i++)
        if (c->options.named[i].vendor == vendor && c->options.named[i].product == product)
            return true;
    return mapping_find(&c->mapping, vendor, product) != NULL;
}

static bool wanted(void *user, uint16_t vendor, uint16_t product)
{
    return is_named(((struct listing *)user)->control, vendor, product);
}

static void list_controls(void *user, struct usb_device *d)
{
    struct listing *l = user;
    pthread_mutex_lock(&l->lock);
    if (l->control->options.json) {
        printf("{\"vendor\": \"%04x\", \"product\": \"%04x\", \"led\": %s, \"controls\": [",
               d->vendor, d->product, d->has_led ? "true" : "false");
        for (uint32_t i = 0; i < d->n_control; i++)
            printf("%s{\"name\": \"%s\", \"kind\": \"%s\"}", i ? ", " : "", d->control[i].name,
                   kind_word(&d->control[i]));
        printf("]}\n");
    } else {
        printf("%04x:%04x %s, controls:", d->vendor, d->product, d->name);
        for (uint32_t i = 0; i < d->n_control; i++)
            printf(" %s (%s)", d->control[i].name, kind_word(&d->control[i]));
        printf("%s\n", d->has_led ? ", light" : "");
    }
    l->n_seen++;
    pthread_cond_signal(&l->wake);
    pthread_mutex_unlock(&l->lock);
}

static void no_movement(void *user, struct usb_device *d, struct usb_control *c,
                        uint64_t before, uint64_t now)
{
    (void)user, (void)d, (void)c, (void)before, (void)now;
}

static void no_end(void *user, struct usb_device *d)
{
    (void)user, (void)d;
}

// A device that cannot be opened is reported by this line.
static void list_fault(void *user, const char *line)
{
    struct listing *l = user;
    say("%s", line);
    pthread_mutex_lock(&l->lock);
    l->n_seen++;
    pthread_cond_signal(&l->wake);
    pthread_mutex_unlock(&l->lock);
}

static void list_device(void *user, uint16_t vendor, uint16_t product, uint8_t bus,
                        uint8_t address, const char *name)
{
    struct listing *l = user;
    bool used = *name || is_named(l->control, vendor, product);
    l->n_listed++;
    if (used) l->n_expected++;
    if (l->control->options.json && !used)
        printf("{\"vendor\": \"%04x\", \"product\": \"%04x\", \"controls\": null}\n", vendor,
               product);
    else if (!l->control->options.json)
        printf("%04x:%04x bus %03u device %03u: %s\n", vendor, product, bus, address,
               *name  ? name
               : used ? "HID device"
                      : "HID device, not used; --device VENDOR:PRODUCT shows its controls");
}

int run_list(struct control *control)
{
    struct listing l = {.control = control,
                        .lock = PTHREAD_MUTEX_INITIALIZER,
                        .wake = PTHREAD_COND_INITIALIZER};
    const struct usb_events events = {&l,          wanted, list_controls,
                                      no_movement, no_end, list_fault};
    struct usb *usb;
    char fault[256];
    if (!usb_list(list_device, &l, fault) ||
        (l.n_expected && !usb_start(&events, &usb, fault))) {
        say("%s", fault);
        return EXIT_FAILED;
    }
    if (!l.n_listed && !control->options.json) puts("no HID device is connected");
    if (!l.n_expected) return EXIT_DONE;
    struct timespec end;
    clock_gettime(CLOCK_REALTIME, &end);
    end.tv_sec += 5;
    pthread_mutex_lock(&l.lock);
    while (l.n_seen < l.n_expected && !pthread_cond_timedwait(&l.wake, &l.lock, &end)) continue;
    pthread_mutex_unlock(&l.lock);
    usb_stop(usb, NULL);
    return EXIT_DONE;
}

// ---- --check

int run_check(struct control *control)
{
    struct mapping *m = &control->mapping;
    char fault[MAPPING_FAULT];
    if (!mapping_read(control->options.file, m, fault)) {
        say("%s", fault);
        return EXIT_USAGE;
    }
    for (uint32_t i = 0; i < m->n_device; i++) {
        const struct device_map *d = &m->device[i];
        printf("%04x:%04x, %u entries\n", d->vendor, d->product, d->n_entry);
        for (uint32_t k = 0; k < d->n_entry; k++) {
            const struct map_entry *e = &d->entry[k];
            printf("  %s -> %s, scale %g, dead zone %g, curve %g (half deflection: %.0f %%)\n",
                   e->control, target_word(e->target), e->scale, e->dead, e->curve,
                   100 * mapping_curve(e, .5));
        }
    }
    return EXIT_DONE;
}

// ---- --learn

enum {
    STARTED = 1, // deflections are told apart from noise by their size
    MOST_SLIDERS = 64,
};
struct lesson {
    struct control *control;
    pthread_mutex_t lock; // all below
    pthread_cond_t wake;
    bool asked;
    // The control that moved most since the question.
    double most;
    struct map_entry found;
    uint16_t vendor, product;
    uint32_t n_device;
    uint32_t n_slider;
    struct {
        const struct usb_control *control;
        double from; // its place in the first report after the question
    } slider[MOST_SLIDERS];
};

static bool wanted_lesson(void *user, uint16_t vendor, uint16_t product)
{
    return is_named(((struct lesson *)user)->control, vendor, product);
}

static void joined_lesson(void *user, struct usb_device *d)
{
    struct lesson *l = user;
    say("%s (%04x:%04x): connected", d->name, d->vendor, d->product);
    pthread_mutex_lock(&l->lock);
    l->n_device++;
    pthread_mutex_unlock(&l->lock);
}

// A slider may rest anywhere: its way counts, not its place.
static double way_of(struct lesson *l, const struct usb_control *c)
{
    uint32_t i = 0;
    while (i < l->n_slider && l->slider[i].control != c) i++;
    if (i == MOST_SLIDERS) return 0;
    if (i == l->n_slider) {
        l->slider[i].control = c;
        l->slider[i].from = c->value;
        l->n_slider++;
    }
    return fabs(c->value - l->slider[i].from);
}

// How far a movement counts: a deflection by half its way, three counts of a dial, a tenth of a
// slider's way, a press.
static double weight_of(struct lesson *l, const struct usb_control *c)
{
    switch (c->kind) {
    case CONTROL_DEFLECTION:
        return fabs(c->value) / .5;
    case CONTROL_RELATIVE:
        return fabs(c->value) / 3;
    case CONTROL_POSITION:
        return way_of(l, c) / .1;
    default:
        return c->value > 0 ? 1.5 : 0;
    }
}

static void movement(void *user, struct usb_device *d, struct usb_control *c, uint64_t before,
                     uint64_t now)
{
    static const double dead[] = {.08, 0, .01, 0}, curve[] = {1.5, 1, 1, 1},
                        degrees[] = {120, 3, 360, 15};
    struct lesson *l = user;
    (void)before, (void)now;
    pthread_mutex_lock(&l->lock);
    double weight = l->asked ? weight_of(l, c) : 0;
    if (weight > l->most) {
        l->most = weight;
        l->vendor = d->vendor;
        l->product = d->product;
        l->found =
            (struct map_entry){.scale = c->kind == CONTROL_POSITION || c->value > 0 ? 1 : -1,
                               .dead = dead[c->kind],
                               .curve = curve[c->kind]};
        l->found.scale *= degrees[c->kind];
        memcpy(l->found.control, c->name, sizeof l->found.control);
        if (weight >= STARTED) pthread_cond_signal(&l->wake);
    }
    pthread_mutex_unlock(&l->lock);
}

static void log_lesson(void *user, const char *line)
{
    (void)user;
    say("%s", line);
}

// Waits for a movement; false: none came.
static bool ask(struct lesson *l, double wait_s)
{
    struct timespec end;
    clock_gettime(CLOCK_REALTIME, &end);
    double until = (double)end.tv_sec + (double)end.tv_nsec * 1e-9 + wait_s;
    end = (struct timespec){(time_t)until, (long)((until - floor(until)) * 1e9)};
    pthread_mutex_lock(&l->lock);
    l->asked = true;
    l->most = 0;
    l->n_slider = 0;
    while (l->most < STARTED && !pthread_cond_timedwait(&l->wake, &l->lock, &end)) continue;
    l->asked = false;
    bool found = l->most >= STARTED;
    pthread_mutex_unlock(&l->lock);
    struct timespec pause = {0, 700000000}; // until the hand lets go
    if (found) nanosleep(&pause, NULL);
    return found;
}

static void keep(struct mapping *m, const struct lesson *l, enum target target)
{
    struct device_map *d = NULL;
    for (uint32_t i = 0; i < m->n_device; i++)
        if (m->device[i].vendor == l->vendor && m->device[i].product == l->product)
            d = &m->device[i];
    if (!d && m->n_device < MOST_DEVICES) {
        d = &m->device[m->n_device++];
        *d = (struct device_map){.vendor = l->vendor, .product = l->product, .led = 1};
    }
    if (!d || d->n_entry == MOST_ENTRIES) return;
    struct map_entry *e = &d->entry[d->n_entry++];
    *e = l->found;
    e->target = target;
    bool angle = target == TARGET_LIGHT_AZIMUTH || target == TARGET_CAMERA_AZIMUTH ||
                 target == TARGET_CAMERA_ELEVATION;
    if (target >= N_VALUE) e->scale = 1;
    else if (!angle) e->scale /= 60; // degrees to stops: two for a full deflection's second
}

static void ask_all(struct control *c, struct lesson *l, struct mapping *m)
{
    static const char *const questions[N_TARGET] = {
        [TARGET_LIGHT_AZIMUTH] = "Turn to the right what shall turn the light",
        [TARGET_LIGHT_GAIN] = "Move up what shall make the light brighter",
        [TARGET_EXPOSURE] = "Move up what shall raise the exposure",
        [TARGET_CAMERA_AZIMUTH] = "Turn to the right what shall turn the camera",
        [TARGET_CAMERA_ELEVATION] = "Move up what shall raise the camera",
        [TARGET_CAMERA_ZOOM] = "Move forward what shall zoom in",
        [TARGET_RESET] = "Press what shall put everything back",
        [TARGET_UNDO] = "Press what shall undo",
        [TARGET_REDO] = "Press what shall redo"};
    for (int t = 0; t < N_TARGET; t++) {
        printf("%s (nothing for %g s: no control)\n", questions[t], c->options.wait_s);
        fflush(stdout);
        if (!ask(l, c->options.wait_s)) continue;
        printf("  %s\n", l->found.control);
        keep(m, l, (enum target)t);
    }
}

int run_learn(struct control *control)
{
    struct lesson l = {.control = control,
                       .lock = PTHREAD_MUTEX_INITIALIZER,
                       .wake = PTHREAD_COND_INITIALIZER};
    const struct usb_events events = {&l,       wanted_lesson, joined_lesson,
                                      movement, no_end,        log_lesson};
    struct mapping learned = {0};
    struct usb *usb;
    char fault[256];
    if (!usb_start(&events, &usb, fault)) {
        say("%s", fault);
        return EXIT_FAILED;
    }
    ask_all(control, &l, &learned);
    usb_stop(usb, NULL);
    if (!learned.n_device) {
        say("no control was moved; %s was not written", control->options.file);
        return EXIT_FAILED;
    }
    if (!mapping_write(control->options.file, &learned, fault)) {
        say("%s", fault);
        return EXIT_FAILED;
    }
    printf("%s: written\n", control->options.file);
    return EXIT_DONE;
}
