/* SPDX-License-Identifier: MIT */
/* hid.h reads report descriptors and reports of USB HID 1.11. Both come from the device and are
 * not trusted. */
#ifndef RELIGHT_CONTROL_HID_H
#define RELIGHT_CONTROL_HID_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum {
    HID_MOST_FIELDS = 96,
    HID_MOST_DESCRIPTOR = 4096, /* bytes of a report descriptor */
    HID_MOST_REPORT = 1024,     /* bytes of a report, with its id */
    HID_FAULT = 96,             /* bytes of a message */
    HID_NAME = 16               /* bytes of a control's name */
};

/* Usages: page << 16 | usage. */
enum {
    HID_MOUSE = 0x10002,
    HID_KEYBOARD = 0x10006,
    HID_KEYPAD = 0x10007,
    HID_MULTI_AXIS = 0x10008,
    HID_X = 0x10030,
    HID_RZ = 0x10035,
    HID_SLIDER = 0x10036,
    HID_DIAL = 0x10037,
    HID_WHEEL = 0x10038,
    HID_PAGE_LED = 0x08,
    HID_PAGE_BUTTON = 0x09,
    HID_PAGE_CONSUMER = 0x0c,
    HID_VOLUME_UP = 0xc00e9,
    HID_VOLUME_DOWN = 0xc00ea
};

/* One value in a report: bits [bit, bit + size) behind the id. */
struct hid_field {
    uint32_t bit, usage, application; /* application: usage of the collection around it */
    int64_t minimum, maximum;         /* logical, minimum < maximum */
    uint8_t report, size;             /* report: id, 0 without ids; size: bits, 1 to 32 */
    bool relative, output;            /* output: of a report to the device */
    char name[HID_NAME];              /* "rz", "button1", "dial2" */
};
struct hid_description {
    bool numbered; /* each report begins with its id */
    uint32_t n_field;
    struct hid_field field[HID_MOST_FIELDS];
    uint16_t input_bits[256], output_bits[256]; /* of each report, without the id */
    uint32_t application;                       /* of the first collection */
};

/* Reads a report descriptor.
 * bytes [n]. Kept are axes (X to wheel), buttons, volume keys and LEDs; of more than
 * HID_MOST_FIELDS the first ones.
 * Returns true and *out, or false with a line in fault, and *out undefined.
 * Thread-safety: Safe. Does not block. */
bool hid_parse(const uint8_t *bytes, size_t n, struct hid_description *out,
               char fault[HID_FAULT]);

/* Whether these bytes are an input report of the description, whole.
 * Thread-safety: Safe. Does not block. */
bool hid_is_report(const struct hid_description *d, const uint8_t *report, size_t n);

/* Reads a field of an input report.
 * report [n]: as it came, with its id where reports are numbered.
 * Returns true and the value in *out; false when the report is another one, or too short, or
 * the value is out of the field's range (HID: no data).
 * Thread-safety: Safe. Does not block. */
bool hid_value(const struct hid_description *d, const struct hid_field *field,
               const uint8_t *report, size_t n, int64_t *out);

/* Puts a value into an output report of (output_bits + 7) / 8 bytes and its id, whose bytes are
 * zero otherwise.
 * report [n]. Returns the report's bytes, 0 when n is too small.
 * Thread-safety: Safe. Does not block. */
size_t hid_output(const struct hid_description *d, const struct hid_field *field, int64_t value,
                  uint8_t *report, size_t n);

#endif
