/* SPDX-License-Identifier: MIT */
/* known.h lists the devices that are used without being named. */
#ifndef RELIGHT_CONTROL_KNOWN_H
#define RELIGHT_CONTROL_KNOWN_H

#include <stdint.h>

enum known_kind { KNOWN_NOT, KNOWN_SPACEMOUSE, KNOWN_POWERMATE };
struct known_device {
    uint16_t vendor, product;
    enum known_kind kind;
    const char *name;
};

/* The entry of a device, or one of KNOWN_NOT. Thread-safety: Safe. */
const struct known_device *known_find(uint16_t vendor, uint16_t product);

/* The PowerMate's reports as a report descriptor; the device's own says nothing about them. */
extern const uint8_t known_powermate_descriptor[];
extern const uint32_t known_powermate_size;

#endif
