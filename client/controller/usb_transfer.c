// SPDX-License-Identifier: MIT
// Reports as they come: one interrupt transfer an interface is always under way.
#include "usb_private.h"

#include <time.h>

uint64_t control_now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

static double scaled(const struct usb_control *c, int64_t raw)
{
    const struct hid_field *f = &c->field;
    double low = (double)f->minimum, high = (double)f->maximum, x = (double)raw;
    switch (c->kind) {
    case CONTROL_DEFLECTION:
        return (2 * x - low - high) / (high - low);
    case CONTROL_POSITION:
        return (x - low) / (high - low);
    case CONTROL_BUTTON:
        return x != low;
    default:
        return x;
    }
}

// Whether there is something to tell about a value.
static bool has_moved(const struct usb_control *c, double before)
{
    if (c->kind == CONTROL_RELATIVE) return c->value != 0;
    return c->value != before || (c->repeats && c->value != 0);
}

static void take_report(struct usb_interface *interface, const uint8_t *report, size_t n)
{
    struct usb_open *d = interface->device;
    struct usb *usb = d->usb;
    uint64_t now = control_now_ns();
    bool whole = hid_is_report(&interface->hid, report, n), any = false;
    usb->counts.reports++;
    for (uint32_t i = 0; i < d->base.n_control && whole; i++) {
        struct usb_control *c = &d->base.control[i];
        int64_t raw;
        if (&d->interface[c->interface] != interface) continue;
        if (!hid_value(&interface->hid, &c->field, report, n, &raw)) continue;
        double before = c->value;
        uint64_t previous = c->time_ns;
        c->value = scaled(c, raw);
        c->time_ns = now;
        any = true;
        if (has_moved(c, before))
            usb->events.moved(usb->events.user, &d->base, c, previous, now);
    }
    if (any) return;
    // Some devices send reports of their own besides, such as the state of a battery.
    usb->counts.bad_reports++;
    if (!d->said_bad && d->announced)
        usb_say(usb, d, "reports of %zu bytes that its descriptor does not have are ignored",
                n);
    d->said_bad = true;
}

static void give_up(struct usb_interface *interface, const char *why)
{
    if (!interface->device->gone) usb_say(interface->device->usb, interface->device, "%s", why);
    interface->device->gone = true;
}

static void failed(struct usb_interface *interface, const char *how)
{
    interface->device->usb->counts.faults++;
    if (++interface->n_fault < USB_MOST_FAULTS) return;
    char why[160];
    snprintf(why, sizeof why, "%s %d times in a row; unplug it and plug it in again", how,
             USB_MOST_FAULTS);
    give_up(interface, why);
}

static void done(struct libusb_transfer *transfer)
{
    struct usb_interface *interface = transfer->user_data;
    struct usb_open *d = interface->device;
    interface->pending = false;
    switch (transfer->status) {
    case LIBUSB_TRANSFER_COMPLETED:
        interface->n_fault = 0;
        take_report(interface, transfer->buffer, (size_t)transfer->actual_length);
        break;
    case LIBUSB_TRANSFER_STALL:
        d->usb->counts.stalls++;
        interface->stalled = true;
        failed(interface, "its endpoint stalls");
        return; // usb_recover goes on
    case LIBUSB_TRANSFER_CANCELLED:
        return;
    case LIBUSB_TRANSFER_NO_DEVICE:
        give_up(interface, "unplugged");
        return;
    case LIBUSB_TRANSFER_OVERFLOW:
        d->usb->counts.bad_reports++;
        failed(interface, "it sends more than its endpoint allows");
        break;
    default:
        failed(interface, "reading fails");
    }
    if (!d->gone && !atomic_load(&d->usb->stop)) usb_read(interface);
}

bool usb_read(struct usb_interface *interface)
{
    if (interface->pending) return true;
    libusb_fill_interrupt_transfer(interface->transfer, interface->device->handle,
                                   interface->endpoint, interface->buffer, interface->packet,
                                   done, interface, 0);
    int status = libusb_submit_transfer(interface->transfer);
    interface->pending = status == 0;
    if (!status) return true;
    give_up(interface,
            status == LIBUSB_ERROR_NO_DEVICE ? "unplugged" : libusb_strerror(status));
    return false;
}

void usb_recover(struct usb_interface *interface)
{
    interface->stalled = false;
    if (interface->device->gone) return;
    int status = libusb_clear_halt(interface->device->handle, interface->endpoint);
    if (status == LIBUSB_ERROR_NO_DEVICE) give_up(interface, "unplugged");
    else if (status) give_up(interface, "its stalled endpoint cannot be cleared");
    else usb_read(interface);
}
