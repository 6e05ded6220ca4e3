// SPDX-License-Identifier: MIT
// A report descriptor of a USB device and its reports: the first two bytes are the descriptor's
// length, the rest is reports. Fields lie within their reports, values within their ranges.
#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "hid.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n);

static void check_field(const struct hid_description *d, const struct hid_field *f)
{
    uint32_t bits = (f->output ? d->output_bits : d->input_bits)[f->report];
    assert(f->size >= 1 && f->size <= 32 && f->bit + f->size <= bits);
    assert(bits <= (HID_MOST_REPORT - 1) * 8 && f->minimum < f->maximum);
    assert(f->name[0] && memchr(f->name, 0, HID_NAME) && (f->report || !d->numbered));
}

static void check_report(const struct hid_description *d, const uint8_t *report, size_t n)
{
    uint8_t out[HID_MOST_REPORT];
    for (uint32_t i = 0; i < d->n_field; i++) {
        const struct hid_field *f = &d->field[i];
        int64_t value = f->minimum;
        if (hid_value(d, f, report, n, &value)) assert(!f->output);
        assert(value >= f->minimum && value <= f->maximum);
        size_t size = hid_output(d, f, f->maximum, out, sizeof out);
        assert(!size == !f->output && size <= sizeof out);
        if (!f->output && hid_is_report(d, report, n) &&
            (!d->numbered || report[0] == f->report))
            assert(hid_value(d, f, report, n, &value) || value == f->minimum);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n)
{
    struct hid_description *d = malloc(sizeof *d);
    char fault[HID_FAULT] = "";
    if (n < 2) n = 0;
    size_t size = n ? (size_t)(bytes[0] | bytes[1] << 8) : 0, rest;
    if (n && size > n - 2) size = n - 2;
    rest = n ? n - 2 - size : 0;
    uint8_t *descriptor = malloc(size + 1), *report = malloc(rest + 1);
    if (size) memcpy(descriptor, bytes + 2, size);
    if (rest) memcpy(report, bytes + 2 + size, rest);
    // Exactly as long as it is: a read beyond it shows.
    descriptor = realloc(descriptor, size ? size : 1);
    report = realloc(report, rest ? rest : 1);
    bool good = hid_parse(descriptor, size, d, fault);
    assert(good == !fault[0]);
    for (uint32_t i = 0; good && i < d->n_field; i++) check_field(d, &d->field[i]);
    for (size_t at = 0; good && at <= rest && at < 64; at++)
        check_report(d, report + at, rest - at);
    free(report);
    free(descriptor);
    free(d);
    return 0;
}
