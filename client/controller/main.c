// SPDX-License-Identifier: MIT
// relight-control: USB controllers turn the light of a view or a review room.
#include "control.h"

#include "common/room_name.h"

#include <errno.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

void say(const char *fmt, ...)
{
    char line[768];
    va_list args;
    va_start(args, fmt);
    vsnprintf(line, sizeof line, fmt, args);
    va_end(args);
    for (char *at = line; *at; at++)
        if ((unsigned char)*at < 32 || *at == 127) *at = '?';
    fprintf(stderr, "relight-control: %s\n", line);
}

int report(const struct relight_error *error)
{
    say("%s", error->text);
    if (*error->hint) say("%s", error->hint);
    return exit_status(error->code);
}

// ---- devices

static bool is_wanted(void *user, uint16_t vendor, uint16_t product)
{
    const struct control *c = user;
    for (uint32_t i = 0; i < c->options.n_named; i++)
        if (c->options.named[i].vendor == vendor && c->options.named[i].product == product)
            return true;
    return mapping_find(&c->mapping, vendor, product) != NULL;
}

static void attached(void *user, struct usb_device *device)
{
    struct control *c = user;
    struct device_map own;
    const struct device_map *map = mapping_find(&c->mapping, device->vendor, device->product);
    if (!map) {
        mapping_default(device, c->options.camera, &own);
        map = &own;
    }
    for (uint32_t i = 0; i < map->n_entry; i++) {
        bool there = map == &own;
        for (uint32_t k = 0; k < device->n_control; k++)
            there |= !strcmp(device->control[k].name, map->entry[i].control);
        if (!there)
            say("%s has no control \"%s\": --list shows those that it has", device->name,
                map->entry[i].control);
    }
    device->user = motion_bind(map);
    if (!c->options.quiet)
        say("%s (%04x:%04x): connected, %u controls", device->name, device->vendor,
            device->product, device->n_control);
}

static void moved(void *user, struct usb_device *device, struct usb_control *control,
                  uint64_t previous_ns, uint64_t now_ns)
{
    struct control *c = user;
    if (device->user) motion_input(c->motion, device->user, control, previous_ns, now_ns);
}

static void detached(void *user, struct usb_device *device)
{
    struct control *c = user;
    motion_unbind(c->motion, device->user);
    device->user = NULL;
    if (!c->options.quiet)
        say("%s (%04x:%04x): given back", device->name, device->vendor, device->product);
}

static void log_line(void *user, const char *line)
{
    (void)user;
    say("%s", line);
}

void show_connected(struct control *control, bool connected)
{
    if (control->usb) usb_set_led(control->usb, connected ? 1 : 0);
}

// ---- the target

static struct destination *open_target(struct control *c, int *status)
{
    const char *word = c->options.target;
    char room[RELIGHT_ROOM];
    struct relight_error error;
    int found = room_of_word(c->client, word, room, &error);
    if (!found) return open_room(c, room, status);
    if (found != -RELIGHT_E_NOT_FOUND) {
        *status = report(&error);
        return NULL;
    }
    *status = EXIT_USAGE;
    if (c->options.output && c->options.n_env) return open_view(c, status);
    say("%s: no room of this name; a view of a model needs --env ENV and -o FILE", word);
    return NULL;
}

// ---- running

// A program that was stopped and goes on (Ctrl-Z, fg) waits on: EINTR ends both calls then.
static void wait_for_end(const struct options *o, const sigset_t *signals)
{
    const uint64_t end = control_now_ns() + (uint64_t)(o->for_s * 1e9);
    int got;
    do {
        uint64_t now = control_now_ns(), left = end > now ? end - now : 0;
        struct timespec t = {(time_t)(left / 1000000000u), (long)(left % 1000000000u)};
        got = o->for_s > 0 ? sigtimedwait(signals, NULL, &t) : sigwaitinfo(signals, NULL);
    } while (got < 0 && errno == EINTR);
}

static void print_measures(const struct usb_counts *u, const struct motion_times *t)
{
    printf("{\"reports\": %llu, \"bad_reports\": %llu, \"stalls\": %llu, \"faults\": %llu, "
           "\"requests\": %llu, \"most_requests_a_second\": %llu, \"held_reports\": %llu, "
           "\"report_to_request_ms\": {\"median\": %.3f, \"p99\": %.3f, \"max\": %.3f}}\n",
           (unsigned long long)u->reports, (unsigned long long)u->bad_reports,
           (unsigned long long)u->stalls, (unsigned long long)u->faults,
           (unsigned long long)t->requests, (unsigned long long)t->most_a_second,
           (unsigned long long)t->held, t->median_ms, t->p99_ms, t->most_ms);
}

static int run(struct control *c, const sigset_t *signals)
{
    const struct usb_events events = {c, is_wanted, attached, moved, detached, log_line};
    struct usb_counts counts = {0};
    struct motion_times times;
    char fault[256];
    c->motion = motion_start(c->destination->send, c->destination);
    if (!c->motion) {
        say("not enough memory");
        return EXIT_FAILED;
    }
    struct usb *usb;
    bool good = usb_start(&events, &usb, fault);
    if (!good) say("%s", fault);
    if (good) {
        c->usb = usb;
        show_connected(c, true);
        wait_for_end(&c->options, signals);
        c->usb = NULL; // its lights go out with it
        usb_stop(usb, &counts);
    }
    motion_stop(c->motion, &times);
    c->destination->stop(c->destination);
    if (good && c->options.measure) print_measures(&counts, &times);
    return good ? EXIT_DONE : EXIT_FAILED;
}

static int control_target(struct control *c)
{
    sigset_t signals;
    struct relight_error error;
    struct relight_options how = {.name = "relight-control " RELIGHT_VERSION,
                                  .token = getenv("RELIGHT_TOKEN"),
                                  .ca = c->options.ca,
                                  .reconnect_s = 3600};
    int status;
    // Other threads inherit the mask: a signal ends the program only through wait_for_end.
    sigemptyset(&signals);
    sigaddset(&signals, SIGINT);
    sigaddset(&signals, SIGTERM);
    sigaddset(&signals, SIGHUP);
    pthread_sigmask(SIG_BLOCK, &signals, NULL);
    if (relight_connect(c->options.server, &how, &c->client, &error)) return report(&error);
    c->destination = open_target(c, &status);
    // Threads wait for the daemon's news: the connection ends with the program.
    return c->destination ? run(c, &signals) : status;
}

int main(int argc, char **argv)
{
    static struct control control;
    char fault[MAPPING_FAULT];
    options_parse(argc, argv, &control.options);
    const struct options *o = &control.options;
    control.me = o->as ? o->as : getenv("USER") ? getenv("USER") : "";
    if (o->mapping && !mapping_read(o->mapping, &control.mapping, fault)) {
        say("%s", fault);
        return EXIT_USAGE;
    }
    int status = o->task == TASK_LIST    ? run_list(&control)
                 : o->task == TASK_CHECK ? run_check(&control)
                 : o->task == TASK_LEARN ? run_learn(&control)
                                         : control_target(&control);
    fflush(stdout);
    return status;
}
