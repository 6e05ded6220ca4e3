// SPDX-License-Identifier: MIT
// Hostile bytes into the frame decoder and the message parsers, as a stream and as one message.
#include "frame.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    const struct relight_frame_limits limits = {1 << 14, 1 << 20};
    struct relight_decoder d;
    struct relight_frame frame;
    int status = 0;
    size_t piece = size % 97 + 1, used;
    relight_decoder_init(&d, &limits);
    for (size_t at = 0; at < size && status >= 0; at += used) {
        status =
            relight_decoder_feed(&d, data + at, size - at < piece ? size - at : piece, &used);
        if (status == 1) protobuf_c_message_free_unpacked(relight_frame_unpack(&d.frame), NULL);
    }
    relight_decoder_finish(&d);
    if (!relight_frame_parse(data, size, &limits, &frame))
        protobuf_c_message_free_unpacked(relight_frame_unpack(&frame), NULL);
    return 0;
}
