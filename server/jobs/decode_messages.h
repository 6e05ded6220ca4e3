/* SPDX-License-Identifier: MIT */
/* decode_messages.h owns the packets between the daemon (decode_helper.c) and its decode helper
 * (decode_process.c); both are the same program, so that structs travel as they are. */
#ifndef RELIGHTD_DECODE_MESSAGES_H
#define RELIGHTD_DECODE_MESSAGES_H

#include "jobs/decode_helper.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

enum {
    PACKET = 64 << 10,
    MAX_AT_ONCE = 4,
    MAX_RUNNING = 64,
    MAX_SIDE = 65536,
    MAX_WORD = 68 + 65
};

#define MAX_FILE ((uint64_t)2 << 30)

enum asked { ASK_ENV, ASK_MODEL, ASK_IMAGE, ASK_POSE, ASK_MATERIAL };

struct ask {
    uint64_t number, memory_bytes, image_bytes;
    uint32_t n_word; // strings that follow: path, name, and for a model the .prt, the materials
                     // and the opaque names, for a pose the animation, for a
                     // material its name
    uint32_t model;  // enum asked
    char request[65]; // id of the request that it is for
    double size_mm, mm_per_unit, time_s;
    uint32_t up_z, flip_v, n_material;
    char variant[64];
};

struct reply {
    uint64_t number;
    int32_t status;
    uint32_t kind, width, height, cube_n, n_negative, n_nonfinite, n_vertex;
    uint32_t crashed; // decoding processes ended by a signal
    float ms;
    char error[400];
    char warnings[2000]; // one a line
};

/* Bytes of an image's pixels: three floats each. */
size_t decode_pixel_bytes(uint32_t kind, uint32_t width, uint32_t height, uint32_t cube_n);
/* A packet, with a descriptor where passed_fd >= 0. False when the other side has gone. */
bool decode_send_packet(int socket_fd, const void *bytes, size_t n, int passed_fd);
/* The next packet's length, 0 when the other side has gone, -1 with errno. *passed_fd: -1, or a
 * descriptor that is the caller's. */
ssize_t decode_receive_packet(int socket_fd, void *bytes, size_t n, int *passed_fd);

#endif
