/* SPDX-License-Identifier: MIT */
/* Shared by usb.c, usb_open.c and usb_transfer.c. Everything belongs to the USB thread but what
 * is said to be atomic. */
#ifndef RELIGHT_CONTROL_USB_PRIVATE_H
#define RELIGHT_CONTROL_USB_PRIVATE_H

#include "known.h"
#include "usb.h"

#include <libusb.h>
#include <pthread.h>
#include <stdatomic.h>

enum { USB_MOST_INTERFACES = 4, USB_MOST_FAULTS = 16 };

struct usb_open;
struct usb_interface {
    struct usb_open *device;
    uint8_t number, endpoint;
    uint16_t packet, descriptor_size;
    bool claimed, detached; /* detached: from a kernel driver */
    bool pending, stalled;  /* the transfer is under way; the endpoint waits for clear_halt */
    uint32_t n_fault;       /* in a row */
    struct libusb_transfer *transfer;
    uint8_t *buffer; /* [packet] */
    struct hid_description hid;
};
/* A device that is open. */
struct usb_open {
    struct usb_device base; /* first */
    struct usb_open *next;
    struct usb *usb;
    libusb_device *at;
    libusb_device_handle *handle;
    const struct known_device *known;
    uint32_t n_interface;
    struct usb_interface interface[USB_MOST_INTERFACES];
    bool gone, said_bad, announced;
    struct hid_field led;
    uint32_t led_interface;
};
struct usb_news { /* of the hot plug, not yet looked at */
    struct usb_news *next;
    libusb_device *at;
    bool left;
};
struct usb {
    struct usb_events events;
    libusb_context *context;
    libusb_hotplug_callback_handle hotplug;
    pthread_t thread;
    struct usb_open *first;
    struct usb_news *news;
    struct usb_counts counts;
    atomic_bool stop;
    atomic_int led; /* brightness 0 to 255 that is wanted */
    int led_now;    /* that the devices have; -1: none was set */
};

void usb_say(struct usb *usb, const struct usb_open *device, const char *fmt, ...)
    __attribute__((format(printf, 3, 4)));

/* usb_open.c */
/* Opens a device if it is wanted; says why it cannot. NULL: not opened. */
struct usb_open *usb_open_device(struct usb *usb, libusb_device *at);
/* Stops its transfers, gives it back to its drivers, frees it. */
void usb_close_device(struct usb_open *device);
void usb_write_led(struct usb_open *device, int brightness);

/* usb_transfer.c */
/* Starts reading; false: the device is of no use. */
bool usb_read(struct usb_interface *interface);
/* Clears a stalled endpoint and reads on. */
void usb_recover(struct usb_interface *interface);

#endif
