// SPDX-License-Identifier: MIT
// Opening a controller: its interfaces are taken from their drivers, and given back.
#include "usb_private.h"

#include <stdlib.h>
#include <string.h>
#include <sys/time.h>

enum { HID_DESCRIPTOR = 0x21, REPORT_DESCRIPTOR = 0x22, CONTROL_TIMEOUT_MS = 1000 };

// ---- descriptors of a device

// The length of the report descriptor, from the HID descriptor behind the interface's.
static uint16_t report_descriptor_size(const struct libusb_interface_descriptor *i)
{
    const unsigned char *at = i->extra;
    for (int left = i->extra_length; left >= 2 && at[0] >= 2 && at[0] <= left;
         left -= at[0], at += at[0])
        if (at[1] == HID_DESCRIPTOR && at[0] >= 9 && at[6] == REPORT_DESCRIPTOR)
            return (uint16_t)(at[7] | at[8] << 8);
    return 0;
}

static void add_interface(struct usb_open *d, const struct libusb_interface_descriptor *i)
{
    if (d->n_interface == USB_MOST_INTERFACES) return;
    if (i->bInterfaceClass != LIBUSB_CLASS_HID) return;
    // libusb keeps the number of endpoints of a descriptor that ends before them.
    for (int e = 0; i->endpoint && e < i->bNumEndpoints; e++) {
        const struct libusb_endpoint_descriptor *p = &i->endpoint[e];
        uint16_t packet = p->wMaxPacketSize & 0x7ff;
        if ((p->bmAttributes & 3) != LIBUSB_TRANSFER_TYPE_INTERRUPT) continue;
        if (!(p->bEndpointAddress & LIBUSB_ENDPOINT_IN)) continue;
        if (packet < 1 || packet > HID_MOST_REPORT) continue;
        d->interface[d->n_interface++] =
            (struct usb_interface){.device = d,
                                   .number = i->bInterfaceNumber,
                                   .endpoint = p->bEndpointAddress,
                                   .packet = packet,
                                   .descriptor_size = report_descriptor_size(i)};
        return;
    }
}

static void find_interfaces(struct usb_open *d)
{
    struct libusb_config_descriptor *config;
    if (libusb_get_active_config_descriptor(d->at, &config)) return;
    for (int i = 0; i < config->bNumInterfaces; i++)
        if (config->interface[i].num_altsetting > 0)
            add_interface(d, &config->interface[i].altsetting[0]);
    libusb_free_config_descriptor(config);
}

// ---- its interfaces

static const char *remedy(int status)
{
    switch (status) {
    case LIBUSB_ERROR_ACCESS:
        return "no access: install relight's udev rule and join the group relight";
    case LIBUSB_ERROR_BUSY:
        return "in use by another program, such as spacenavd: end it, then plug the device in "
               "again";
    case LIBUSB_ERROR_NO_DEVICE:
        return "unplugged";
    default:
        return libusb_strerror(status);
    }
}

static bool claim(struct usb_interface *i)
{
    struct usb_open *d = i->device;
    int status = 0;
    if (libusb_kernel_driver_active(d->handle, i->number) == 1) {
        status = libusb_detach_kernel_driver(d->handle, i->number);
        i->detached = status == 0;
    }
    if (!status) status = libusb_claim_interface(d->handle, i->number);
    i->claimed = status == 0;
    if (status) usb_say(d->usb, d, "%s", remedy(status));
    return !status;
}

static void give_back(struct usb_interface *i)
{
    struct usb_open *d = i->device;
    if (i->claimed) libusb_release_interface(d->handle, i->number);
    int status = i->detached ? libusb_attach_kernel_driver(d->handle, i->number) : 0;
    if (status && status != LIBUSB_ERROR_NO_DEVICE && status != LIBUSB_ERROR_NOT_FOUND)
        usb_say(d->usb, d, "its driver does not come back: plug it in again");
    i->claimed = i->detached = false;
}

static bool read_descriptor(struct usb_interface *i)
{
    struct usb_open *d = i->device;
    char fault[HID_FAULT];
    uint8_t bytes[HID_MOST_DESCRIPTOR];
    if (d->known->kind == KNOWN_POWERMATE)
        return hid_parse(known_powermate_descriptor, known_powermate_size, &i->hid, fault);
    if (i->descriptor_size < 1 || i->descriptor_size > sizeof bytes) {
        usb_say(d->usb, d, "its report descriptor has %u bytes, outside [1, %zu]",
                i->descriptor_size, sizeof bytes);
        return false;
    }
    int n = libusb_control_transfer(d->handle, LIBUSB_ENDPOINT_IN | LIBUSB_RECIPIENT_INTERFACE,
                                    LIBUSB_REQUEST_GET_DESCRIPTOR, REPORT_DESCRIPTOR << 8,
                                    i->number, bytes, i->descriptor_size, CONTROL_TIMEOUT_MS);
    if (n < 0) {
        usb_say(d->usb, d, "its report descriptor cannot be read: %s", libusb_strerror(n));
        return false;
    }
    if (n < i->descriptor_size)
        usb_say(d->usb, d, "its report descriptor has %d bytes in place of %u", n,
                i->descriptor_size);
    if (hid_parse(bytes, (size_t)n, &i->hid, fault)) return true;
    usb_say(d->usb, d, "its report descriptor is not valid: %s", fault);
    return false;
}

// ---- its controls

static enum control_kind kind_of(const struct usb_open *d, const struct hid_field *f)
{
    uint32_t page = f->usage >> 16;
    bool axis = f->usage >= HID_X && f->usage <= HID_RZ;
    // Several SpaceMice call their axes relative; the values are deflections all the same.
    if (axis && d->known->kind == KNOWN_SPACEMOUSE) return CONTROL_DEFLECTION;
    if (page == HID_PAGE_BUTTON || page == HID_PAGE_CONSUMER) return CONTROL_BUTTON;
    if (f->relative) return CONTROL_RELATIVE;
    return axis ? CONTROL_DEFLECTION : CONTROL_POSITION;
}

static bool has_name(const struct usb_open *d, const char *name)
{
    for (uint32_t i = 0; i < d->base.n_control; i++)
        if (!strcmp(d->base.control[i].name, name)) return true;
    return false;
}

static void add_control(struct usb_open *d, uint32_t interface, const struct hid_field *f)
{
    if (f->output) {
        if (d->base.has_led) return;
        d->base.has_led = true;
        d->led = *f;
        d->led_interface = interface;
        return;
    }
    if (d->base.n_control == USB_MOST_CONTROLS) return;
    struct usb_control *c = &d->base.control[d->base.n_control];
    *c = (struct usb_control){.field = *f, .interface = interface, .kind = kind_of(d, f)};
    c->repeats = c->kind == CONTROL_DEFLECTION && d->known->kind == KNOWN_SPACEMOUSE;
    memcpy(c->name, f->name, sizeof c->name);
    // The same name on another interface.
    for (unsigned n = 2; has_name(d, c->name); n++) {
        char other[HID_NAME];
        snprintf(other, sizeof other, "%.10s_%u", f->name, n % 1000);
        memcpy(c->name, other, sizeof other);
    }
    d->base.n_control++;
}

static bool prepare(struct usb_interface *i)
{
    i->transfer = libusb_alloc_transfer(0);
    i->buffer = malloc(i->packet);
    return i->transfer && i->buffer;
}

// Takes an interface if it has controls.
static void take(struct usb_open *d, uint32_t index)
{
    struct usb_interface *i = &d->interface[index];
    uint32_t before = d->base.n_control;
    if (claim(i) && read_descriptor(i) && prepare(i))
        for (uint32_t k = 0; k < i->hid.n_field; k++) add_control(d, index, &i->hid.field[k]);
    bool led = d->base.has_led && d->led_interface == index;
    if (d->base.n_control == before && !led) give_back(i);
}

// ---- devices

static void describe(struct usb_open *d)
{
    struct libusb_device_descriptor m;
    libusb_get_device_descriptor(d->at, &m);
    d->base.vendor = m.idVendor;
    d->base.product = m.idProduct;
    d->base.bus = libusb_get_bus_number(d->at);
    d->base.address = libusb_get_device_address(d->at);
    d->known = known_find(m.idVendor, m.idProduct);
    snprintf(d->base.name, sizeof d->base.name, "%s",
             *d->known->name ? d->known->name : "HID device");
}

static struct usb_open *open_interfaces(struct usb_open *d)
{
    int status = libusb_open(d->at, &d->handle);
    if (status) {
        usb_say(d->usb, d, "%s", remedy(status));
        d->handle = NULL;
        return NULL;
    }
    for (uint32_t i = 0; i < d->n_interface && !d->gone; i++) take(d, i);
    if (!d->base.n_control) return NULL;
    if (d->known->kind == KNOWN_POWERMATE) d->base.has_led = true;
    for (uint32_t i = 0; i < d->n_interface; i++)
        if (d->interface[i].claimed && d->interface[i].transfer && !usb_read(&d->interface[i]))
            return NULL;
    return d;
}

struct usb_open *usb_open_device(struct usb *usb, libusb_device *at)
{
    struct usb_open *d = calloc(1, sizeof *d);
    if (!d) return NULL;
    d->usb = usb;
    d->at = libusb_ref_device(at);
    describe(d);
    bool wanted = d->known->kind != KNOWN_NOT ||
                  usb->events.wanted(usb->events.user, d->base.vendor, d->base.product);
    if (wanted) find_interfaces(d);
    if (wanted && !d->n_interface)
        usb_say(usb, d, "it has no HID interface with an interrupt endpoint");
    if (d->n_interface && open_interfaces(d)) return d;
    if (wanted && d->handle && !d->base.n_control)
        usb_say(usb, d, "it has no axis, dial or button that can be used");
    usb_close_device(d);
    return NULL;
}

static bool any_pending(const struct usb_open *d)
{
    for (uint32_t i = 0; i < d->n_interface; i++)
        if (d->interface[i].pending) return true;
    return false;
}

void usb_close_device(struct usb_open *d)
{
    d->gone = true;
    for (uint32_t i = 0; i < d->n_interface; i++)
        if (d->interface[i].pending) libusb_cancel_transfer(d->interface[i].transfer);
    uint64_t end = control_now_ns() + 2000000000u;
    while (any_pending(d) && control_now_ns() < end) {
        struct timeval most = {0, 100000};
        libusb_handle_events_timeout_completed(d->usb->context, &most, NULL);
    }
    for (uint32_t i = 0; i < d->n_interface; i++) {
        if (d->handle) give_back(&d->interface[i]);
        // A transfer that does not end keeps its memory.
        if (d->interface[i].pending) continue;
        libusb_free_transfer(d->interface[i].transfer);
        free(d->interface[i].buffer);
    }
    bool pending = any_pending(d);
    if (d->handle && !pending) libusb_close(d->handle);
    libusb_unref_device(d->at);
    if (!pending) free(d);
}

// ---- lights

void usb_write_led(struct usb_open *d, int brightness)
{
    uint8_t report[HID_MOST_REPORT];
    if (!d->base.has_led || d->gone) return;
    if (d->known->kind == KNOWN_POWERMATE) { // vendor request 1: a steady brightness
        libusb_control_transfer(d->handle,
                                LIBUSB_REQUEST_TYPE_VENDOR | LIBUSB_RECIPIENT_INTERFACE, 1, 1,
                                (uint16_t)brightness, NULL, 0, CONTROL_TIMEOUT_MS);
        return;
    }
    struct usb_interface *i = &d->interface[d->led_interface];
    int64_t most = d->led.maximum;
    size_t n = hid_output(&i->hid, &d->led, brightness * most / 255, report, sizeof report);
    if (!n) return;
    libusb_control_transfer(d->handle, LIBUSB_REQUEST_TYPE_CLASS | LIBUSB_RECIPIENT_INTERFACE,
                            LIBUSB_REQUEST_SET_CONFIGURATION /* SET_REPORT */,
                            (uint16_t)(0x200 | d->led.report), i->number, report, (uint16_t)n,
                            CONTROL_TIMEOUT_MS);
}
