// SPDX-License-Identifier: MIT
// Many connections to relightd from one thread: frames are pipelined, and each answer calls
// back. For the figures of `prt-bench serve`; librelight waits for each answer.
#ifndef PRT_BENCH_SERVE_CLIENT_H
#define PRT_BENCH_SERVE_CLIENT_H

#include "daemon.h"

#include "frame.h"
#include "relight.pb-c.h"

struct serve_crowd;
enum { SERVE_DEPTH = 64 }; // most open requests of a client whose times are measured

struct serve_client {
    struct serve_crowd *crowd;
    unsigned number; // of the crowd
    int fd;
    struct relight_decoder decoder;
    uint8_t *out; // bytes to send: [out_sent, out_size)
    size_t out_size, out_sent, out_room;
    bool writing, gone;
    uint64_t last_id;
    unsigned open;              // requests without their last answer
    double sent_s[SERVE_DEPTH]; // by id modulo SERVE_DEPTH
    unsigned turn;              // for the figure's own use
};

// An answer: an ERROR, or the answer to a request. The frame is valid during the call.
typedef void (*serve_fn)(struct serve_client *client, const struct relight_frame *frame);

struct serve_crowd {
    struct bench_env *env;
    struct serve_client *client;
    unsigned n, n_gone;
    int epoll_fd;
    serve_fn answer;
    void *user;
};

// Connects n clients to one of the daemon's addresses ("unix:PATH", "tcp:127.0.0.1:PORT") and
// sends HELLO. from: the loopback address to connect from, NULL for the default; the daemon
// takes each for another principal. serve_close() also after a failure.
int serve_open(struct bench_env *env, const char *address, const char *from, unsigned n,
               serve_fn answer, void *user, struct serve_crowd *out);
void serve_close(struct serve_crowd *crowd);

// Queues one request; it is sent by the next serve_turn(). Returns its id.
uint64_t serve_send(struct serve_client *client, uint16_t type, const ProtobufCMessage *message,
                    const void *payload, size_t n_payload, uint32_t deadline_ms);
// Sends, receives and calls back, once; waits at most timeout_ms for something to happen.
void serve_turn(struct serve_crowd *crowd, int timeout_ms);
// Turns until no request of the crowd is open, or the time is over: PRT_IO.
int serve_settle(struct serve_crowd *crowd, double seconds);

#endif
