// SPDX-License-Identifier: MIT
// Incremental decoder: fixed part, then header and padding, then payload, each into its own
// buffer, so that payloads can be read from a socket to their place without a copy.
#include "frame_private.h"

#include <stdlib.h>
#include <string.h>

void relight_decoder_init(struct relight_decoder *decoder,
                          const struct relight_frame_limits *limits)
{
    *decoder = (struct relight_decoder){.limits = *limits};
}

void relight_decoder_finish(struct relight_decoder *decoder)
{
    free(decoder->head);
    free(decoder->frame.payload);
    decoder->head = NULL;
    decoder->frame.payload = NULL;
}

static int fail(struct relight_decoder *d, int fault)
{
    free(d->frame.payload);
    d->frame.payload = NULL;
    d->ready = false;
    return d->fault = fault;
}

// One large header does not keep its memory.
enum { HEAD_KEPT = 4096 };

// Where refused payloads are read to. Nobody reads it.
static uint8_t dropped[64 << 10];

static void next_frame(struct relight_decoder *d)
{
    free(d->frame.payload);
    memset(&d->frame, 0, sizeof d->frame);
    d->ready = d->refused = false;
    if (d->head_room > HEAD_KEPT) {
        free(d->head);
        d->head = NULL;
        d->head_room = 0;
    }
    d->have = 0;
    d->head_size = 0;
}

// The fixed part is complete: check it, then make room for the rest.
static int begin_frame(struct relight_decoder *d)
{
    struct relight_frame frame;
    int fault = relight_frame_get_fixed(d->fixed, &d->limits, &frame);
    if (fault) return fail(d, fault);
    d->frame = frame;
    d->head_size =
        relight_frame_prefix_size(frame.header_size, frame.payload_size) - RELIGHT_FRAME_FIXED;
    if (d->head_size > d->head_room) {
        uint8_t *head = realloc(d->head, d->head_size);
        if (!head) return fail(d, RELIGHT_FAULT_MEMORY);
        d->head = head;
        d->head_room = d->head_size;
    }
    if (!frame.payload_size) return 0;
    void *payload;
    if (d->admit && !d->admit(d->admit_user, &d->frame)) {
        d->refused = true;
        return 0;
    }
    if (posix_memalign(&payload, RELIGHT_FRAME_ALIGN, (size_t)frame.payload_size))
        return fail(d, RELIGHT_FAULT_MEMORY);
    d->frame.payload = payload;
    return 0;
}

uint8_t *relight_decoder_space(struct relight_decoder *d, size_t *n)
{
    if (d->fault || d->ready) return NULL;
    uint64_t have = d->have;
    if (have < RELIGHT_FRAME_FIXED) {
        *n = RELIGHT_FRAME_FIXED - (size_t)have;
        return d->fixed + have;
    }
    have -= RELIGHT_FRAME_FIXED;
    if (have < d->head_size) {
        *n = d->head_size - (size_t)have;
        return d->head + have;
    }
    have -= d->head_size;
    *n = (size_t)(d->frame.payload_size - have);
    if (d->refused) {
        if (*n > sizeof dropped) *n = sizeof dropped;
        return dropped;
    }
    return d->frame.payload + have;
}

int relight_decoder_commit(struct relight_decoder *d, size_t n)
{
    if (d->fault) return d->fault;
    if (d->ready) next_frame(d);
    d->have += n;
    if (d->have < RELIGHT_FRAME_FIXED) return 0;
    if (d->have == RELIGHT_FRAME_FIXED && n && begin_frame(d)) return d->fault;
    size_t prefix = RELIGHT_FRAME_FIXED + d->head_size;
    if (d->have < prefix) return 0;
    if (d->have == prefix &&
        relight_frame_check_padding(d->head, d->frame.header_size, d->head_size))
        return fail(d, RELIGHT_FAULT_PADDING);
    if (d->have < prefix + d->frame.payload_size) return 0;
    d->frame.header = d->head;
    d->ready = true;
    return 1;
}

int relight_decoder_feed(struct relight_decoder *d, const void *data, size_t n, size_t *used)
{
    const uint8_t *bytes = data;
    *used = 0;
    int status = d->ready ? relight_decoder_commit(d, 0) : d->fault;
    while (status == 0 && *used < n) {
        size_t room;
        uint8_t *to = relight_decoder_space(d, &room);
        if (room > n - *used) room = n - *used;
        memcpy(to, bytes + *used, room);
        *used += room;
        status = relight_decoder_commit(d, room);
    }
    return status;
}

uint8_t *relight_decoder_take(struct relight_decoder *d)
{
    if (!d->ready) return NULL;
    uint8_t *payload = d->frame.payload;
    d->frame.payload = NULL;
    return payload;
}
