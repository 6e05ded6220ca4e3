/* SPDX-License-Identifier: MIT */
/* usb.h owns the controllers on the USB: finding, opening and reading them, and giving them
 * back to the kernel. One thread handles all of them; it sleeps in the kernel while none moves.
 */
#ifndef RELIGHT_CONTROL_USB_H
#define RELIGHT_CONTROL_USB_H

#include "hid.h"

#include <stdio.h>

enum control_kind {
    CONTROL_DEFLECTION, /* returns to its middle: [-1,1] */
    CONTROL_RELATIVE,   /* counts since the last report */
    CONTROL_POSITION,   /* [0,1] */
    CONTROL_BUTTON      /* 0, 1 */
};
struct usb_control {
    char name[HID_NAME]; /* unique in its device */
    enum control_kind kind;
    bool repeats; /* reports come as long as it is deflected */
    struct hid_field field;
    uint32_t interface; /* index into the device's */
    double value;
    uint64_t time_ns; /* of its last report */
};
enum { USB_MOST_CONTROLS = 64 };
struct usb_device {
    uint16_t vendor, product;
    uint8_t bus, address;
    char name[64];
    uint32_t n_control;
    struct usb_control control[USB_MOST_CONTROLS];
    bool has_led;
    void *user; /* of the events' owner */
};

/* All on the USB thread. */
struct usb_events {
    void *user;
    /* Whether to open a device that no list names (known.h); it may take it from its driver. */
    bool (*wanted)(void *user, uint16_t vendor, uint16_t product);
    void (*attached)(void *user, struct usb_device *device);
    /* A control moved. previous_ns: control->time_ns before this report, 0: the first. */
    void (*moved)(void *user, struct usb_device *device, struct usb_control *control,
                  uint64_t previous_ns, uint64_t now_ns);
    void (*detached)(void *user, struct usb_device *device);
    void (*log)(void *user, const char *line);
};

struct usb;

/* Counts since the start. */
struct usb_counts {
    uint64_t reports, bad_reports, stalls, faults;
};

/* Opens the controllers that are there, and those plugged in later.
 * Returns true and *out, or false with a line in fault.
 * Thread-safety: Unsafe. Starts a thread. */
bool usb_start(const struct usb_events *events, struct usb **out, char fault[256]);
/* Stops the thread, gives the devices back to their drivers and frees usb (NULL is allowed). */
void usb_stop(struct usb *usb, struct usb_counts *counts);
/* Sets the light of every device that has one: brightness [0,1]. Takes effect on the USB
 * thread; of several calls the last counts. Thread-safety: Safe. Does not block. */
void usb_set_led(struct usb *usb, double brightness);

/* Calls fn for each HID device on the bus, without opening it. name: that of a known device,
 * else "". Returns false with a line in fault where the bus cannot be read. */
typedef void (*usb_list_fn)(void *user, uint16_t vendor, uint16_t product, uint8_t bus,
                            uint8_t address, const char *name);
bool usb_list(usb_list_fn fn, void *user, char fault[256]);

/* Monotonic clock, ns. */
uint64_t control_now_ns(void);

#endif
