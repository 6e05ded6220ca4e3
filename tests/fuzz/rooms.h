// SPDX-License-Identifier: MIT
// The daemon's rooms inside the fuzzer's process. rooms.c alone uses what is internal to the
// daemon: a carrier whose bytes stay in memory, a runner of bakes that does what it is told,
// and the look at what is left when everybody has gone.
#ifndef TESTS_FUZZ_ROOMS_H
#define TESTS_FUZZ_ROOMS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct connection;

// Limits small enough that a short sequence passes them.
struct rooms_settings {
    const char *data; // folder
    uint32_t threads, requests, queue, bakes, bake_queue;
    uint64_t cache, memory, disk, send_buffer;
    double idle_s, frame_time_s;
};

// A client's end.
struct pipe_end {
    struct connection *conn; // NULL: closed by either side
    bool reading;            // false: the daemon takes no more bytes for now
};

bool rooms_start(const struct rooms_settings *settings);
void rooms_stop(void);

bool rooms_connect(struct pipe_end *end, const char *who);
// A piece of a byte stream, or one whole message as WebSocket brings it, in parts of at most
// `most` bytes.
void rooms_stream(struct pipe_end *end, const void *bytes, size_t n);
void rooms_message(struct pipe_end *end, const void *bytes, size_t n, size_t most);
// Up to n bytes of what the daemon has to say.
size_t rooms_output(struct pipe_end *end, uint8_t *out, size_t n);
void rooms_disconnect(struct pipe_end *end);

// One turn of the loop, waiting up to ms for something to come.
void rooms_turn(int ms);
void rooms_expire(void); // the timer that drops old uploads

// Bakes that run. A bake that is done leaves a copy of `bake` where it was told to.
enum rooms_end { ROOMS_DONE, ROOMS_DONE_NO_FILE, ROOMS_FAILED, ROOMS_CANCELLED };
unsigned rooms_bakes(void);
unsigned rooms_bakes_open(void); // those that wait, too
void rooms_bake_progress(unsigned i, const char *stage, double fraction);
void rooms_bake_line(unsigned i, const char *line);
void rooms_bake_end(unsigned i, enum rooms_end how, const char *bake);
void rooms_refuse_bakes(bool refuse); // the next ones cannot be started

bool rooms_working(void); // a worker has something to do
unsigned rooms_requests(void);
// Requests that end when their client says so: views and watches.
unsigned rooms_long_requests(void);
// NULL when nothing is held for clients that have gone, else what is.
const char *rooms_leftover(void);

#endif
