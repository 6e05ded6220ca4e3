/* SPDX-License-Identifier: MIT */
/* request.h owns one operation a client asked for, from its frame to its last answer. */
#ifndef RELIGHTD_REQUEST_H
#define RELIGHTD_REQUEST_H

#include "net/connection.h"

struct request {
    struct request *next, *prev; /* of the connection's open requests */
    struct server *server;
    struct connection *conn;
    uint64_t id, arrived_ns;
    uint16_t type;
    ProtobufCMessage *message;
    uint8_t *payload;
    size_t payload_size;
    struct principal *principal;              /* who pays for it */
    enum ledger_resource counted;             /* REQUESTS or LONG_REQUESTS */
    uint64_t payload_charged, header_charged; /* bytes of PAYLOAD */
    struct loop_timer deadline;
    /* Where a long operation keeps its state, and how it is told that nobody waits any more:
     * called once, before the request is freed, unless the operation ended it itself. A request
     * may hold several states one after another (it waits for its material, then it is a view):
     * `abandon` tells which one it is. */
    void *state;
    void (*abandon)(struct request *request);
};

/* The state that was kept with this function; NULL while the request keeps another or none. */
void *request_state(const struct request *request, void (*abandon)(struct request *request));

/* Answers and frees the request. The payload (may be NULL) is taken. */
void request_answer(struct request *request, const ProtobufCMessage *message,
                    const struct payload *payload);
/* An answer that others follow. */
void request_part(struct request *request, const ProtobufCMessage *message,
                  const struct payload *payload);
/* Ends the request with an error; code is a Relight__ErrorCode. */
void request_fail(struct request *request, int code, const char *fmt, ...)
    __attribute__((format(printf, 3, 4)));
/* Ends the request with nobody to tell (its connection closes). */
void request_abandon(struct request *request);
/* A failed request's state is told so and the client gets the error (cancel, deadline). */
void request_stop(struct request *request, int code, const char *text);

/* Made by dispatch. Takes the payload. Returns NULL when answered already. */
struct request *request_create(struct connection *conn, const struct relight_frame *frame,
                               uint8_t *payload);

/* Before a frame's payload is stored: false when it is not to be; conn->refusal says why, and
 * request_create answers so. */
bool request_admit(struct connection *conn, const struct relight_frame *frame);

/* Bytes that a client's requests hold, and who pays: released with the last holder. */
struct held_bytes {
    unsigned refs;
    void *bytes;
    size_t size;
    struct principal *principal;
    uint64_t charged;
};
/* The request's payload, moved out of it with what was charged for it; NULL when there is no
 * memory or no payload. */
struct held_bytes *request_take_payload(struct request *request);
void held_bytes_hold(struct held_bytes *held);
void held_bytes_release(struct held_bytes *held); /* NULL is fine */
/* Frees the payload before the request ends. */
void request_drop_payload(struct request *request);

/* ERROR_BUSY, or ERROR_LIMIT where waiting would not help. */
int refusal_code(const struct principal *principal, enum ledger_resource resource,
                 uint64_t amount);

/* What a user can do about an error. */
const char *error_hint(int code);
/* The protocol's error for a library status. */
int error_of_status(int status);

#endif
