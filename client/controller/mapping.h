/* SPDX-License-Identifier: MIT */
/* mapping.h owns the mapping of controls to targets and their scales, from a file or by the
 * kind of device. */
#ifndef RELIGHT_CONTROL_MAPPING_H
#define RELIGHT_CONTROL_MAPPING_H

#include "usb.h"

/* X(NAME, word in the file) */
#define CONTROL_TARGETS(X)                  \
    X(LIGHT_AZIMUTH, "light.azimuth")       \
    X(LIGHT_GAIN, "light.gain")             \
    X(EXPOSURE, "exposure")                 \
    X(CAMERA_AZIMUTH, "camera.azimuth")     \
    X(CAMERA_ELEVATION, "camera.elevation") \
    X(CAMERA_ZOOM, "camera.zoom")           \
    X(RESET, "reset")                       \
    X(UNDO, "undo")                         \
    X(REDO, "redo")
enum target {
#define X(name, word) TARGET_##name,
    CONTROL_TARGETS(X)
#undef X
        N_TARGET,
    N_VALUE = TARGET_RESET /* targets before it are numbers, the others actions of buttons */
};

enum { MOST_ENTRIES = 32, MOST_DEVICES = 16, MAPPING_FAULT = 256 };
struct map_entry {
    char control[HID_NAME];
    enum target target;
    /* Of light.azimuth, camera.azimuth and camera.elevation degrees, of the others stops
     * (factors of two): a second at full deflection, a count of a dial, the whole way of a
     * slider, a press of a button. */
    double scale;
    double dead;  /* [0,0.9]: deflections and movements up to this size are ignored */
    double curve; /* [0.2,5]: exponent of the deflection; 1: linear */
};
struct device_map {
    uint16_t vendor, product;
    double led; /* [0,1] while connected */
    uint32_t n_entry;
    struct map_entry entry[MOST_ENTRIES];
};
struct mapping {
    uint32_t n_device;
    struct device_map device[MOST_DEVICES];
};

const char *target_word(enum target target);

/* Reads a mapping file. Returns true, or false with the fault and its place in `fault`. */
bool mapping_read(const char *path, struct mapping *out, char fault[MAPPING_FAULT]);
/* Writes one, whole or not at all. Returns as mapping_read. */
bool mapping_write(const char *path, const struct mapping *mapping, char fault[MAPPING_FAULT]);
/* The entry of a device; NULL: the mapping has none for it. */
const struct device_map *mapping_find(const struct mapping *mapping, uint16_t vendor,
                                      uint16_t product);
/* The mapping of a device that the file does not name. camera: the device's axes move the
 * camera, else the light. */
void mapping_default(const struct usb_device *device, bool camera, struct device_map *out);

/* Applies the dead zone and the curve to a deflection in [-1,1]; the result is in [-1,1]. */
double mapping_curve(const struct map_entry *entry, double deflection);

#endif
