// SPDX-License-Identifier: MIT
// Mapping files: JSON, every field checked.
#include "mapping.h"

#include "known.h"

#include <cjson/cJSON.h>
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MOST_BYTES = 1 << 20 };

const char *target_word(enum target target)
{
    static const char *const words[] = {
#define X(name, word) word,
        CONTROL_TARGETS(X)
#undef X
    };
    return words[target];
}

double mapping_curve(const struct map_entry *e, double x)
{
    double size = fmin(fabs(x), 1);
    if (size <= e->dead) return 0;
    return copysign(pow((size - e->dead) / (1 - e->dead), e->curve), x);
}

const struct device_map *mapping_find(const struct mapping *m, uint16_t vendor,
                                      uint16_t product)
{
    for (uint32_t i = 0; i < m->n_device; i++)
        if (m->device[i].vendor == vendor && m->device[i].product == product)
            return &m->device[i];
    return NULL;
}

// ---- reading

struct reader {
    char *fault, where[80];
};

static bool wrong(struct reader *r, const char *field, const char *what)
{
    snprintf(r->fault, MAPPING_FAULT, "%s%s: %s", r->where, field, what);
    return false;
}

// A number of a field that may be missing.
static bool get_number(struct reader *r, const cJSON *json, const char *field, double least,
                       double most, double *out)
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(json, field);
    char text[80];
    if (!item) return true;
    snprintf(text, sizeof text, "expected a number in [%g, %g]", least, most);
    if (!cJSON_IsNumber(item) || !(item->valuedouble >= least && item->valuedouble <= most))
        return wrong(r, field, text);
    *out = item->valuedouble;
    return true;
}

static bool get_id(struct reader *r, const cJSON *json, const char *field, uint16_t *out)
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(json, field);
    char *end = NULL;
    const char *text = cJSON_IsString(item) ? item->valuestring : "";
    unsigned long value = strtoul(text, &end, 16);
    if (strlen(text) != 4 || strspn(text, "0123456789abcdefABCDEF") != 4 || *end)
        return wrong(r, field,
                     "expected four hex digits, such as \"046d\" (--list shows them)");
    *out = (uint16_t)value;
    return true;
}

// Every field of an object is one of the words.
static bool known_fields(struct reader *r, const cJSON *json, const char *const *words)
{
    const cJSON *item;
    if (!cJSON_IsObject(json)) return wrong(r, "", "expected an object");
    cJSON_ArrayForEach(item, json)
    {
        int i = 0;
        while (words[i] && strcmp(words[i], item->string)) i++;
        if (!words[i]) return wrong(r, item->string, "there is no such field");
    }
    return true;
}

static bool get_target(struct reader *r, const cJSON *json, enum target *out)
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(json, "target");
    char all[200] = "expected one of";
    for (int i = 0; i < N_TARGET; i++) {
        const char *word = target_word((enum target)i);
        size_t n = strlen(all);
        *out = (enum target)i;
        if (cJSON_IsString(item) && !strcmp(item->valuestring, word)) return true;
        snprintf(all + n, sizeof all - n, "%s %s", i ? "," : "", word);
    }
    return wrong(r, "target", all);
}

static bool get_entry(struct reader *r, const cJSON *json, struct map_entry *out)
{
    static const char *const words[] = {"control", "target", "scale", "dead", "curve", NULL};
    const cJSON *control = cJSON_GetObjectItemCaseSensitive(json, "control");
    *out = (struct map_entry){.scale = 1, .curve = 1};
    if (!known_fields(r, json, words) || !get_target(r, json, &out->target)) return false;
    if (!cJSON_IsString(control) || !*control->valuestring ||
        strlen(control->valuestring) >= sizeof out->control)
        return wrong(r, "control", "expected a control's name (--list shows them)");
    strcpy(out->control, control->valuestring);
    return get_number(r, json, "scale", -3600, 3600, &out->scale) &&
           get_number(r, json, "dead", 0, .9, &out->dead) &&
           get_number(r, json, "curve", .2, 5, &out->curve);
}

static bool get_device(struct reader *r, const cJSON *json, uint32_t number,
                       struct device_map *out)
{
    static const char *const words[] = {"vendor", "product", "name", "led", "map", NULL};
    const cJSON *item, *map = cJSON_GetObjectItemCaseSensitive(json, "map");
    *out = (struct device_map){.led = 1};
    snprintf(r->where, sizeof r->where, "devices[%u].", number);
    if (!known_fields(r, json, words) || !get_id(r, json, "vendor", &out->vendor) ||
        !get_id(r, json, "product", &out->product) ||
        !get_number(r, json, "led", 0, 1, &out->led))
        return false;
    if (!cJSON_IsArray(map) || cJSON_GetArraySize(map) > MOST_ENTRIES)
        return wrong(r, "map", "expected a list of at most 32 entries");
    cJSON_ArrayForEach(item, map)
    {
        snprintf(r->where, sizeof r->where, "devices[%u].map[%u].", number, out->n_entry);
        if (!get_entry(r, item, &out->entry[out->n_entry])) return false;
        out->n_entry++;
    }
    return true;
}

static bool get_mapping(struct reader *r, const cJSON *json, struct mapping *out)
{
    static const char *const words[] = {"devices", NULL};
    const cJSON *item, *list = cJSON_GetObjectItemCaseSensitive(json, "devices");
    if (!known_fields(r, json, words)) return false;
    if (!cJSON_IsArray(list) || cJSON_GetArraySize(list) > MOST_DEVICES)
        return wrong(r, "devices", "expected a list of at most 16 devices");
    cJSON_ArrayForEach(item, list)
    {
        struct device_map *d = &out->device[out->n_device];
        if (!get_device(r, item, out->n_device, d)) return false;
        snprintf(r->where, sizeof r->where, "devices[%u]", out->n_device);
        if (mapping_find(out, d->vendor, d->product)) return wrong(r, "", "is there twice");
        out->n_device++;
    }
    return true;
}

static char *read_file(const char *path, char fault[MAPPING_FAULT])
{
    FILE *file = fopen(path, "re");
    char *text = file ? calloc(1, MOST_BYTES + 1) : NULL;
    size_t n = text ? fread(text, 1, MOST_BYTES, file) : 0;
    bool bad = !text || ferror(file) || n == MOST_BYTES;
    if (bad)
        snprintf(fault, MAPPING_FAULT, "%s: %s", path,
                 n == MOST_BYTES ? "more than 1 MiB" : strerror(errno));
    if (file) fclose(file);
    if (!bad) return text;
    free(text);
    return NULL;
}

bool mapping_read(const char *path, struct mapping *out, char fault[MAPPING_FAULT])
{
    char text_fault[MAPPING_FAULT], *text = read_file(path, fault);
    const char *end = NULL;
    if (!text) return false;
    cJSON *json = cJSON_ParseWithOpts(text, &end, 1);
    struct reader r = {.fault = text_fault};
    memset(out, 0, sizeof *out);
    int line = 1;
    for (const char *at = text; !json && end && at < end; at++) line += *at == '\n';
    bool good = json && get_mapping(&r, json, out);
    if (!json) snprintf(fault, MAPPING_FAULT, "%.100s, line %d: no valid JSON", path, line);
    else if (!good) snprintf(fault, MAPPING_FAULT, "%.60s: %.180s", path, text_fault);
    cJSON_Delete(json);
    free(text);
    return good;
}

// ---- writing

static cJSON *device_json(const struct device_map *d)
{
    cJSON *json = cJSON_CreateObject(), *map = cJSON_AddArrayToObject(json, "map");
    char id[8];
    snprintf(id, sizeof id, "%04x", d->vendor);
    cJSON_AddStringToObject(json, "vendor", id);
    snprintf(id, sizeof id, "%04x", d->product);
    cJSON_AddStringToObject(json, "product", id);
    cJSON_AddStringToObject(json, "name", known_find(d->vendor, d->product)->name);
    cJSON_AddNumberToObject(json, "led", d->led);
    for (uint32_t i = 0; i < d->n_entry; i++) {
        const struct map_entry *e = &d->entry[i];
        cJSON *entry = cJSON_CreateObject();
        cJSON_AddStringToObject(entry, "control", e->control);
        cJSON_AddStringToObject(entry, "target", target_word(e->target));
        cJSON_AddNumberToObject(entry, "scale", e->scale);
        cJSON_AddNumberToObject(entry, "dead", e->dead);
        cJSON_AddNumberToObject(entry, "curve", e->curve);
        cJSON_AddItemToArray(map, entry);
    }
    return json;
}

static bool write_whole(const char *path, const char *text, char fault[MAPPING_FAULT])
{
    char temporary[4096];
    int n = snprintf(temporary, sizeof temporary, "%s.%d", path, (int)getpid());
    FILE *file = n < (int)sizeof temporary ? fopen(temporary, "wxe") : NULL;
    bool good = file && fputs(text, file) >= 0 && fputc('\n', file) == '\n';
    if (file) good &= !fclose(file);
    good = good && !rename(temporary, path);
    if (!good) snprintf(fault, MAPPING_FAULT, "%s: %s", path, strerror(errno));
    if (!good && file) unlink(temporary);
    return good;
}

bool mapping_write(const char *path, const struct mapping *m, char fault[MAPPING_FAULT])
{
    cJSON *json = cJSON_CreateObject(), *list = cJSON_AddArrayToObject(json, "devices");
    for (uint32_t i = 0; i < m->n_device; i++)
        cJSON_AddItemToArray(list, device_json(&m->device[i]));
    char *text = cJSON_Print(json);
    cJSON_Delete(json);
    if (!text) {
        snprintf(fault, MAPPING_FAULT, "not enough memory");
        return false;
    }
    bool good = write_whole(path, text, fault);
    free(text);
    return good;
}

// ---- without a file

static void add(struct device_map *m, const char *control, enum target target, double scale,
                double dead, double curve)
{
    struct map_entry *e = &m->entry[m->n_entry];
    if (m->n_entry == MOST_ENTRIES) return;
    *e = (struct map_entry){.target = target, .scale = scale, .dead = dead, .curve = curve};
    snprintf(e->control, sizeof e->control, "%s", control);
    m->n_entry++;
}

// x: to the right, y: towards the user, z: down; rx, ry, rz: about them.
static void spacemouse(struct device_map *m, bool camera)
{
    add(m, "rz", camera ? TARGET_CAMERA_AZIMUTH : TARGET_LIGHT_AZIMUTH, -120, .06, 1.5);
    if (camera) {
        add(m, "rx", TARGET_CAMERA_ELEVATION, 60, .06, 1.5);
        add(m, "y", TARGET_CAMERA_ZOOM, -1.5, .1, 1.5);
    } else {
        add(m, "z", TARGET_LIGHT_GAIN, -2, .1, 1.5);
    }
    add(m, "button1", TARGET_RESET, 1, 0, 1);
    add(m, "button2", TARGET_UNDO, 1, 0, 1);
}

// The first three controls of a device that no list has.
static void other(const struct usb_device *d, bool camera, struct device_map *m)
{
    static const enum target light[] = {TARGET_LIGHT_AZIMUTH, TARGET_LIGHT_GAIN,
                                        TARGET_EXPOSURE},
                             turn[] = {TARGET_CAMERA_AZIMUTH, TARGET_CAMERA_ELEVATION,
                                       TARGET_CAMERA_ZOOM};
    static const double degrees[] = {90, 3, 360}, stops[] = {1, .1, 8};
    uint32_t n = 0;
    for (uint32_t i = 0; i < d->n_control; i++) {
        const struct usb_control *c = &d->control[i];
        if (c->kind == CONTROL_BUTTON || n == 3) continue;
        enum target target = camera ? turn[n] : light[n];
        bool angle = n == 0 || target == TARGET_CAMERA_ELEVATION;
        bool deflection = c->kind == CONTROL_DEFLECTION;
        add(m, c->name, target, (angle ? degrees : stops)[c->kind], deflection ? .08 : 0,
            deflection ? 1.5 : 1);
        n++;
    }
    add(m, "button1", TARGET_RESET, 1, 0, 1);
}

void mapping_default(const struct usb_device *d, bool camera, struct device_map *out)
{
    *out = (struct device_map){.vendor = d->vendor, .product = d->product, .led = 1};
    if (known_find(d->vendor, d->product)->kind == KNOWN_SPACEMOUSE) spacemouse(out, camera);
    else other(d, camera, out);
}
