// SPDX-License-Identifier: MIT
// Report descriptors of USB HID 1.11, section 6.2.2, and the values of reports.
#include "hid.h"

#include <stdio.h>
#include <string.h>

enum { MOST_USAGES = 256, MOST_DEPTH = 16, MOST_PUSHED = 4 };
enum { TYPE_MAIN, TYPE_GLOBAL, TYPE_LOCAL };
enum { INPUT = 8, OUTPUT = 9, COLLECTION = 10, FEATURE = 11, END_COLLECTION = 12 };

struct globals {
    uint32_t page, size, count;
    int64_t minimum, maximum;
    uint32_t maximum_unsigned;
    uint8_t report;
};
struct parser {
    struct hid_description *out;
    char *fault;
    struct globals now, pushed[MOST_PUSHED];
    uint32_t n_pushed, depth, collection[MOST_DEPTH], n_usage, usage[MOST_USAGES];
    uint32_t first_usage;
    bool has_first;
};

static bool refuse(struct parser *p, const char *text)
{
    snprintf(p->fault, HID_FAULT, "%s", text);
    return false;
}

// ---- names

static void base_name(uint32_t usage, char out[HID_NAME])
{
    static const char *const axes[] = {"x",  "y",      "z",    "rx",   "ry",
                                       "rz", "slider", "dial", "wheel"};
    if (usage >= HID_X && usage <= HID_WHEEL)
        snprintf(out, HID_NAME, "%s", axes[usage - HID_X]);
    else if (usage == HID_VOLUME_UP) snprintf(out, HID_NAME, "volumeup");
    else if (usage == HID_VOLUME_DOWN) snprintf(out, HID_NAME, "volumedown");
    else if (usage >> 16 == HID_PAGE_BUTTON && (usage & 0xffff) - 1 < 999)
        snprintf(out, HID_NAME, "button%u", (usage & 0xffff) % 1000);
    else if (usage >> 16 == HID_PAGE_LED)
        snprintf(out, HID_NAME, "led%u", (usage & 0xffff) % 1000);
    else out[0] = 0;
}

// The second field of a name gets a number: "dial", "dial2".
static void set_name(struct hid_description *d, struct hid_field *f)
{
    char base[HID_NAME];
    uint32_t same = 1;
    base_name(f->usage, base);
    for (uint32_t i = 0; i < d->n_field; i++) same += d->field[i].usage == f->usage;
    if (same == 1) memcpy(f->name, base, sizeof base);
    else
        snprintf(f->name, sizeof f->name, "%.11s%s%u", base, strncmp(base, "b", 1) ? "" : "_",
                 same % 100);
}

// ---- main items

static uint32_t usage_of(const struct parser *p, uint32_t i)
{
    if (!p->n_usage) return 0;
    return p->usage[i < p->n_usage ? i : p->n_usage - 1];
}

static void add_field(struct parser *p, uint32_t usage, uint32_t bit, uint32_t flags,
                      bool output)
{
    struct hid_description *d = p->out;
    char name[HID_NAME];
    base_name(usage, name);
    bool led = usage >> 16 == HID_PAGE_LED;
    int64_t maximum = p->now.minimum < 0 ? p->now.maximum : (int64_t)p->now.maximum_unsigned;
    if (!name[0] || led != output || d->n_field == HID_MOST_FIELDS) return;
    if (p->now.size < 1 || p->now.size > 32 || p->now.minimum >= maximum) return;
    struct hid_field f = {.bit = bit,
                          .usage = usage,
                          .application = p->depth ? p->collection[0] : 0,
                          .minimum = p->now.minimum,
                          .maximum = maximum,
                          .report = p->now.report,
                          .size = (uint8_t)p->now.size,
                          .relative = flags & 4,
                          .output = output};
    set_name(d, &f);
    d->field[d->n_field++] = f;
}

// flags: bit 0 constant, bit 1 variable (else an array of usages), bit 2 relative.
static bool add_data(struct parser *p, uint32_t tag, uint32_t flags)
{
    if (tag == FEATURE) return true;
    uint16_t *bits = (tag == OUTPUT ? p->out->output_bits : p->out->input_bits) + p->now.report;
    const uint32_t most = (HID_MOST_REPORT - 1) * 8;
    if (p->out->numbered && !p->now.report)
        return refuse(p, "a report without an id among others");
    if (p->now.size > most || p->now.count > most || p->now.size * p->now.count > most - *bits)
        return refuse(p, "a report of more than 1023 bytes");
    for (uint32_t i = 0; i < p->now.count && p->now.size && (flags & 3) == 2; i++)
        add_field(p, usage_of(p, i), *bits + i * p->now.size, flags, tag == OUTPUT);
    *bits = (uint16_t)(*bits + p->now.size * p->now.count);
    return true;
}

static bool main_item(struct parser *p, uint32_t tag, uint32_t value)
{
    bool good = true;
    if (tag == INPUT || tag == OUTPUT || tag == FEATURE) good = add_data(p, tag, value);
    else if (tag == COLLECTION) {
        if (p->depth == MOST_DEPTH) return refuse(p, "collections are nested too deeply");
        if (!p->depth && !p->out->application) p->out->application = usage_of(p, 0);
        p->collection[p->depth++] = usage_of(p, 0);
    } else if (tag == END_COLLECTION) {
        if (!p->depth) return refuse(p, "a collection ends that did not begin");
        p->depth--;
    }
    p->n_usage = 0;
    p->has_first = false;
    return good;
}

// ---- global and local items

static bool set_report(struct parser *p, uint32_t value)
{
    if (value < 1 || value > 255) return refuse(p, "a report id out of [1, 255]");
    for (int i = 0; i < 256; i++)
        if (!p->out->numbered && (p->out->input_bits[i] || p->out->output_bits[i]))
            return refuse(p, "a report without an id among others");
    p->out->numbered = true;
    p->now.report = (uint8_t)value;
    return true;
}

static bool global_item(struct parser *p, uint32_t tag, uint32_t value, int32_t sign)
{
    struct globals *g = &p->now;
    switch (tag) {
    case 0:
        g->page = value & 0xffff;
        return true;
    case 1:
        g->minimum = sign;
        return true;
    case 2:
        g->maximum = sign;
        g->maximum_unsigned = value;
        return true;
    case 7:
        g->size = value;
        return true;
    case 8:
        return set_report(p, value);
    case 9:
        g->count = value;
        return true;
    case 10:
        if (p->n_pushed == MOST_PUSHED) return refuse(p, "too many pushed states");
        p->pushed[p->n_pushed++] = *g;
        return true;
    case 11:
        if (!p->n_pushed) return refuse(p, "a pop without a push");
        *g = p->pushed[--p->n_pushed];
        return true;
    default: // physical range, unit
        return true;
    }
}

static bool add_usages(struct parser *p, uint32_t first, uint32_t last)
{
    if (last < first) return refuse(p, "a range of usages that runs backwards");
    if (last - first >= MOST_USAGES - p->n_usage) last = first + MOST_USAGES - 1 - p->n_usage;
    if (p->n_usage == MOST_USAGES) return true; // nothing refers to so many
    for (uint32_t u = first; p->n_usage < MOST_USAGES; u++) {
        p->usage[p->n_usage++] = u;
        if (u == last) break;
    }
    return true;
}

static bool local_item(struct parser *p, uint32_t tag, uint32_t value, uint32_t size)
{
    uint32_t usage = size == 4 ? value : p->now.page << 16 | value;
    if (tag == 0) return add_usages(p, usage, usage);
    if (tag == 1) {
        p->first_usage = usage;
        p->has_first = true;
    } else if (tag == 2) {
        if (!p->has_first) return refuse(p, "a range of usages without a beginning");
        p->has_first = false;
        return add_usages(p, p->first_usage, usage);
    }
    return true; // designators, strings, delimiters
}

// ---- the descriptor

static bool item(struct parser *p, uint8_t prefix, const uint8_t *data, uint32_t size)
{
    uint32_t value = 0;
    for (uint32_t i = 0; i < size; i++) value |= (uint32_t)data[i] << 8 * i;
    int32_t sign = size == 1 ? (int8_t)value : size == 2 ? (int16_t)value : (int32_t)value;
    uint32_t tag = prefix >> 4;
    switch (prefix >> 2 & 3) {
    case TYPE_MAIN:
        return main_item(p, tag, value);
    case TYPE_GLOBAL:
        return global_item(p, tag, value, sign);
    case TYPE_LOCAL:
        return local_item(p, tag, value, size);
    default:
        return refuse(p, "an item of a reserved type");
    }
}

bool hid_parse(const uint8_t *bytes, size_t n, struct hid_description *out,
               char fault[HID_FAULT])
{
    struct parser p = {.out = out, .fault = fault};
    memset(out, 0, sizeof *out);
    if (n > HID_MOST_DESCRIPTOR) return refuse(&p, "more than 4096 bytes");
    for (size_t at = 0; at < n;) {
        uint8_t prefix = bytes[at++];
        uint32_t size = (prefix & 3) == 3 ? 4 : prefix & 3;
        if (prefix == 0xfe) { // a long item: its size, its tag, its data
            if (n - at < 2 || n - at - 2 < bytes[at]) return refuse(&p, "an item is cut off");
            at += 2u + bytes[at];
            continue;
        }
        if (n - at < size) return refuse(&p, "an item is cut off");
        if (!item(&p, prefix, bytes + at, size)) return false;
        at += size;
    }
    if (p.depth) return refuse(&p, "a collection does not end");
    return true;
}

// ---- reports

bool hid_is_report(const struct hid_description *d, const uint8_t *report, size_t n)
{
    if (n <= d->numbered) return false;
    uint32_t bits = d->input_bits[d->numbered ? report[0] : 0];
    return bits && n - d->numbered >= (bits + 7) / 8;
}

bool hid_value(const struct hid_description *d, const struct hid_field *field,
               const uint8_t *report, size_t n, int64_t *out)
{
    if (d->numbered) {
        if (!n || report[0] != field->report) return false;
        report++;
        n--;
    }
    if (field->output || ((uint64_t)field->bit + field->size + 7) / 8 > n) return false;
    uint64_t bits = 0;
    uint32_t first = field->bit / 8, last = (field->bit + field->size - 1) / 8;
    for (uint32_t i = first; i <= last; i++) bits |= (uint64_t)report[i] << 8 * (i - first);
    bits = bits >> field->bit % 8 & (((uint64_t)1 << field->size) - 1);
    int64_t value = (int64_t)bits;
    if (field->minimum < 0 && bits >> (field->size - 1)) value -= (int64_t)1 << field->size;
    if (value < field->minimum || value > field->maximum) return false;
    *out = value;
    return true;
}

size_t hid_output(const struct hid_description *d, const struct hid_field *field, int64_t value,
                  uint8_t *report, size_t n)
{
    size_t size = (d->output_bits[field->report] + 7u) / 8 + d->numbered;
    if (!field->output || size > n) return 0;
    memset(report, 0, size);
    if (d->numbered) report[0] = field->report;
    for (uint32_t i = 0; i < field->size; i++) {
        uint32_t at = field->bit + i;
        uint8_t bit = (uint8_t)((uint64_t)value >> i & 1);
        report[d->numbered + at / 8] |= (uint8_t)(bit << at % 8);
    }
    return size;
}
