// SPDX-License-Identifier: MIT
// A relightd with libfaults.so in it, a small bake and a room.
#ifndef TESTS_FAULT_FAULTY_ROOM_H
#define TESTS_FAULT_FAULTY_ROOM_H

#include "room_frames.h" // before the daemon, whose name it shadows

#include "faulty_daemon.h"

static char model[ID_SIZE], room[33];

// options must contain --room-idle 0: the room then leaves memory after each request.
static inline void faults_setup_room(const char *const *options, const char *name)
{
    faults_setup();
    daemon_start(&d, options);
    struct relight_client *client = client_open(d.address);
    bake_small(client, &d, model);
    relight_close(client);
    struct frames *f = frames_open(&d);
    room_create(f, name, room);
    frames_close(f);
}

#endif
