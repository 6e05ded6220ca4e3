// SPDX-License-Identifier: MIT
// USB devices that do not exist, for programs under libumockdev-preload.so: a C handler answers
// the usbfs ioctls, and a test scripts reports, faults and plugs.
#ifndef TESTS_SERVICE_USB_MOCK_H
#define TESTS_SERVICE_USB_MOCK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct mock_design {
    uint16_t vendor, product, packet; // packet: wMaxPacketSize
    const uint8_t *report;            // report descriptor, report_size bytes
    uint16_t report_size;
    uint16_t said_size;    // as the HID descriptor says; 0: report_size
    bool has_driver;       // a kernel driver has the interface
    bool busy;             // another program has it
    uint8_t broken_config; // > 0: configuration descriptor is cut to so many bytes
};

struct mock_device;
struct mock_counts {
    int open, detached, attached, claimed, released, clear_halt;
    int reaps;             // calls of REAPURB
    int led;               // last brightness or LED bit; -1: none
    int n_report;          // reports that were delivered
    uint64_t delivered_ns; // when the last one was
};

// Starts this program anew under the preload library where it is not; call it first in main.
void mock_preload(char **argv);
// A bus without devices; hold_ms: how long a REAPURB waits before it says EAGAIN, in place of
// the kernel's poll, which umockdev does not emulate.
void mock_begin(int hold_ms);
void mock_end(void); // also without a bus

struct mock_device *mock_plug(const struct mock_design *design);
void mock_unplug(struct mock_device *device);
// The next transfer gets these bytes.
void mock_report(struct mock_device *device, const void *bytes, size_t n);
// The next n transfers end with this error: -EPIPE (stall), -EOVERFLOW, -EPROTO.
void mock_fault(struct mock_device *device, int error, int n);
struct mock_counts mock_counts(struct mock_device *device);
// Whether all scripted reports and faults were taken, within the time.
bool mock_drained(struct mock_device *device, int ms);

#endif
