// SPDX-License-Identifier: MIT
// The USB thread: hot plug, events, lights.
#include "usb_private.h"

#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

void usb_say(struct usb *usb, const struct usb_open *d, const char *fmt, ...)
{
    char line[384];
    va_list args;
    int n = snprintf(line, sizeof line, "%s (%04x:%04x, bus %03u device %03u): ", d->base.name,
                     d->base.vendor, d->base.product, d->base.bus, d->base.address);
    va_start(args, fmt);
    vsnprintf(line + n, sizeof line - (size_t)n, fmt, args);
    va_end(args);
    usb->events.log(usb->events.user, line);
}

// ---- hot plug

// No device may be opened in here: news wait for the thread.
static int LIBUSB_CALL plugged(libusb_context *context, libusb_device *at,
                               libusb_hotplug_event event, void *user)
{
    struct usb *usb = user;
    struct usb_news *news = calloc(1, sizeof *news), **end = &usb->news;
    (void)context;
    if (!news) return 0;
    news->at = libusb_ref_device(at);
    news->left = event == LIBUSB_HOTPLUG_EVENT_DEVICE_LEFT;
    while (*end) end = &(*end)->next;
    *end = news;
    return 0;
}

static void arrived(struct usb *usb, libusb_device *at)
{
    for (struct usb_open *d = usb->first; d; d = d->next)
        if (d->at == at) return;
    struct usb_open *d = usb_open_device(usb, at);
    if (!d) return;
    d->next = usb->first;
    usb->first = d;
    usb->led_now = -1;
    d->announced = true;
    usb->events.attached(usb->events.user, &d->base);
}

static void left(struct usb *usb, libusb_device *at)
{
    for (struct usb_open *d = usb->first; d; d = d->next) {
        if (d->at != at) continue;
        if (!d->gone) usb_say(usb, d, "unplugged");
        d->gone = true;
    }
}

static void take_news(struct usb *usb)
{
    while (usb->news) {
        struct usb_news *news = usb->news;
        usb->news = news->next;
        if (news->left) left(usb, news->at);
        else if (!atomic_load(&usb->stop)) arrived(usb, news->at);
        libusb_unref_device(news->at);
        free(news);
    }
}

static void close_gone(struct usb *usb, bool all)
{
    for (struct usb_open **at = &usb->first; *at;) {
        struct usb_open *d = *at;
        if (!d->gone && !all) {
            at = &d->next;
            continue;
        }
        *at = d->next;
        if (all) usb_write_led(d, 0);
        usb->events.detached(usb->events.user, &d->base);
        usb_close_device(d);
        at = &usb->first; // closing handles events
    }
}

// ---- the thread

static void tend(struct usb *usb)
{
    take_news(usb);
    for (struct usb_open *d = usb->first; d; d = d->next)
        for (uint32_t i = 0; i < d->n_interface; i++)
            if (d->interface[i].stalled) usb_recover(&d->interface[i]);
    close_gone(usb, false);
    int led = atomic_load(&usb->led);
    if (led == usb->led_now) return;
    usb->led_now = led;
    for (struct usb_open *d = usb->first; d; d = d->next) usb_write_led(d, led);
}

// Requests to a device handle events of the others, too.
static bool has_work(const struct usb *usb)
{
    for (const struct usb_open *d = usb->first; d; d = d->next) {
        if (d->gone) return true;
        for (uint32_t i = 0; i < d->n_interface; i++)
            if (d->interface[i].stalled) return true;
    }
    return usb->news || atomic_load(&usb->led) != usb->led_now;
}

static void *run(void *user)
{
    struct usb *usb = user;
    while (!atomic_load(&usb->stop)) {
        tend(usb);
        if (has_work(usb)) continue;
        // Without transfers that have a timeout libusb waits without one.
        libusb_handle_events_completed(usb->context, NULL);
    }
    take_news(usb);
    close_gone(usb, true);
    return NULL;
}

static bool refuse(struct usb *usb, int status, char fault[256])
{
    snprintf(fault, 256, "the USB cannot be used: %s", libusb_strerror(status));
    if (usb && usb->context) libusb_exit(usb->context);
    free(usb);
    return false;
}

bool usb_start(const struct usb_events *events, struct usb **out, char fault[256])
{
    struct usb *usb = calloc(1, sizeof *usb);
    int status = usb ? libusb_init(&usb->context) : LIBUSB_ERROR_NO_MEM;
    if (status) return refuse(usb, status, fault);
    usb->events = *events;
    usb->led_now = -1;
    libusb_set_option(usb->context, LIBUSB_OPTION_LOG_LEVEL, LIBUSB_LOG_LEVEL_NONE);
    if (!libusb_has_capability(LIBUSB_CAP_HAS_HOTPLUG))
        return refuse(usb, LIBUSB_ERROR_NOT_SUPPORTED, fault);
    status = libusb_hotplug_register_callback(
        usb->context, LIBUSB_HOTPLUG_EVENT_DEVICE_ARRIVED | LIBUSB_HOTPLUG_EVENT_DEVICE_LEFT,
        LIBUSB_HOTPLUG_ENUMERATE, LIBUSB_HOTPLUG_MATCH_ANY, LIBUSB_HOTPLUG_MATCH_ANY,
        LIBUSB_HOTPLUG_MATCH_ANY, plugged, usb, &usb->hotplug);
    if (status) return refuse(usb, status, fault);
    if (pthread_create(&usb->thread, NULL, run, usb))
        return refuse(usb, LIBUSB_ERROR_NO_MEM, fault);
    *out = usb;
    return true;
}

void usb_stop(struct usb *usb, struct usb_counts *counts)
{
    if (!usb) return;
    atomic_store(&usb->stop, true);
    libusb_interrupt_event_handler(usb->context);
    pthread_join(usb->thread, NULL);
    libusb_hotplug_deregister_callback(usb->context, usb->hotplug);
    if (counts) *counts = usb->counts;
    libusb_exit(usb->context);
    free(usb);
}

void usb_set_led(struct usb *usb, double brightness)
{
    int wanted = brightness <= 0 ? 0 : brightness >= 1 ? 255 : (int)(brightness * 255 + .5);
    if (atomic_exchange(&usb->led, wanted) != wanted)
        libusb_interrupt_event_handler(usb->context);
}

// ---- listing

static bool has_hid(libusb_device *at)
{
    struct libusb_config_descriptor *config;
    bool found = false;
    if (libusb_get_active_config_descriptor(at, &config)) return false;
    for (int i = 0; i < config->bNumInterfaces; i++)
        for (int k = 0; k < config->interface[i].num_altsetting; k++)
            found |= config->interface[i].altsetting[k].bInterfaceClass == LIBUSB_CLASS_HID;
    libusb_free_config_descriptor(config);
    return found;
}

bool usb_list(usb_list_fn fn, void *user, char fault[256])
{
    libusb_context *context;
    libusb_device **list;
    int status = libusb_init(&context);
    if (status) return refuse(NULL, status, fault);
    ssize_t n = libusb_get_device_list(context, &list);
    for (ssize_t i = 0; i < n; i++) {
        struct libusb_device_descriptor m;
        if (libusb_get_device_descriptor(list[i], &m) || !has_hid(list[i])) continue;
        fn(user, m.idVendor, m.idProduct, libusb_get_bus_number(list[i]),
           libusb_get_device_address(list[i]), known_find(m.idVendor, m.idProduct)->name);
    }
    if (n >= 0) libusb_free_device_list(list, 1);
    libusb_exit(context);
    return n >= 0 ? true : refuse(NULL, (int)n, fault);
}
