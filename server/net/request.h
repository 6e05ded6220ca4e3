/* SPDX-License-Identifier: MIT */
/* request.h owns one request of a client, from its frame to its last answer. */
#ifndef RELIGHTD_REQUEST_H
#define RELIGHTD_REQUEST_H

#include "net/connection.h"
#include "net/errors.h"

struct request {
    struct request *next, *prev; /* of the connection's open requests */
    struct server *server;
    struct connection *conn;
    uint64_t id, arrived_ns;
    uint16_t type;
    int outcome;         /* STATS_OK or an error code once it was answered (core/stats.h) */
    char request_id[65]; /* the client's, or a new one: in the log, and in its children's */
    ProtobufCMessage *message;
    uint8_t *payload;
    size_t payload_size;
    struct principal *principal;              /* that is charged for it */
    enum ledger_resource counted;             /* REQUESTS or LONG_REQUESTS */
    uint64_t payload_charged, header_charged; /* bytes of PAYLOAD */
    struct cache_entry *materials; /* those its message names, where they were parsed on a
                                      worker: render/shared/materials.h. NULL: not yet, or
                                      used already. Held */
    char payload_hash[65]; /* SHA-256 of a large payload, by a worker; "": not computed */
    size_t
        payload_bad; /* with it: 1 + the index of the first float outside [0, 1e9]; 0: none */
    struct loop_timer deadline;
    uint32_t retry_ms;   /* of the ERROR that will end it, for BUSY; 0: unknown */
    uint64_t generation; /* of the ERROR that will end it; 0: none */
    const char *hint;    /* of the ERROR that will end it, static; NULL: that of its code */
    const char *moved;   /* address in the ERROR that will end it, for MOVED; NULL: none */
    /* The state of a long operation, and its clean-up function: called once before the request
     * is freed, unless the operation ended it. A request may have several states one after
     * another (it waits for its material, then it is a view): `abandon` identifies the current
     * one. */
    void *state;
    void (*abandon)(struct request *request);
};

/* The state, if `abandon` is its clean-up function; otherwise NULL. */
void *request_state(const struct request *request, void (*abandon)(struct request *request));

/* Answers and frees the request; takes over the payload (may be NULL). */
void request_answer(struct request *request, const ProtobufCMessage *message,
                    const struct payload *payload);
/* Sends an answer that is not the last one. */
void request_part(struct request *request, const ProtobufCMessage *message,
                  const struct payload *payload);
/* Ends the request with an error; code is a Relight__ErrorCode. */
void request_fail(struct request *request, int code, const char *fmt, ...)
    __attribute__((format(printf, 3, 4)));
/* Ends the request without an answer (its connection closes). */
void request_abandon(struct request *request);
/* Cleans up the request's state and sends the error (cancel, deadline). */
void request_stop(struct request *request, int code, const char *text);

/* Called by dispatch. Takes over the payload. NULL: the request was refused and answered. */
struct request *request_create(struct connection *conn, const struct relight_frame *frame,
                               uint8_t *payload);

/* Called before a frame's payload is stored. False: it must not be stored; conn->refusal has
 * the error, which request_create sends. */
bool request_admit(struct connection *conn, const struct relight_frame *frame);

/* Bytes that a client's requests hold, and the principal that is charged; freed with the last
 * reference. */
struct held_bytes {
    unsigned refs;
    void *bytes;
    size_t size;
    struct principal *principal;
    uint64_t charged;
};
/* Moves the payload and its charge out of the request; NULL without memory or payload. */
struct held_bytes *request_take_payload(struct request *request);
/* Moves them back; the caller's reference is the only one. */
void request_return_payload(struct request *request, struct held_bytes *held);
void held_bytes_hold(struct held_bytes *held);
void held_bytes_release(struct held_bytes *held); /* NULL is fine */
/* Frees the payload before the request ends. */
void request_drop_payload(struct request *request);

/* ERROR_BUSY, or ERROR_LIMIT where the amount exceeds the limit by itself. */
int refusal_code(const struct principal *principal, enum ledger_resource resource,
                 uint64_t amount);

#endif
