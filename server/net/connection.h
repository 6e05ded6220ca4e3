/* SPDX-License-Identifier: MIT */
/* connection.h owns one client: its frames in, its bounded queue of frames out, its requests.
 * A carrier moves the bytes: TCP, unix socket or WebSocket look the same from here. */
#ifndef RELIGHTD_CONNECTION_H
#define RELIGHTD_CONNECTION_H

#include "frame.h"
#include "core/server.h"

#include <sys/uio.h>

struct request;

/* How bytes travel. Each function is given the connection; its carrier_data is the carrier's.
 */
struct carrier {
    const char *name;
    void (*want_write)(struct connection *conn);           /* there is output */
    void (*set_reading)(struct connection *conn, bool on); /* back pressure */
    void (*close)(struct connection *conn);                /* let go of carrier_data */
    size_t (*unsent)(const struct connection *conn); /* bytes the kernel holds; may be NULL */
};

/* Bytes that several answers may share; released when the last is sent. */
struct payload {
    const void *bytes;
    size_t size;
    void *owner;
    void (*release)(void *owner); /* NULL: nothing to do */
};

struct out_frame {
    struct out_frame *next;
    bool more; /* its message goes on in the next frame */
    uint8_t *head;
    size_t head_size, sent;
    struct payload payload;
    size_t size; /* head + payload */
};

struct connection {
    struct connection *next, *prev;
    struct server *server;
    const struct carrier *carrier;
    void *carrier_data;
    uint64_t number;
    char peer[96];
    struct principal *principal;    /* core/ledger.h: who pays for what this connection holds */
    struct relight_decoder decoder; /* byte streams */
    bool greeted, dead, closing, reading;
    uint64_t max_payload; /* what the client takes in one frame */
    struct out_frame *out, **out_last;
    size_t out_bytes;    /* queued and not sent */
    size_t message_left; /* of them, those of the message that is being sent */
    uint64_t full_ns; /* since when more than --send-buffer waits behind it; 0: it does not */
    struct request *requests;
    unsigned n_request, n_long; /* n_long: of them, views and watches */
    uint64_t payload_charged;   /* for the frame that is being read */
    struct {
        int code; /* 0: none */
        char text[320];
    } refusal;                   /* of the frame that is being read */
    struct material_wait *waits; /* materials.c: what was said of views, in its order */
    struct loop_timer timer;
    bool message_full; /* WebSocket: the current message's frame is complete */
    uint64_t opened_ns;
    uint64_t heard_ns, frame_ns; /* last byte; first byte of the frame being read, 0: none */
    uint64_t sent_ns;            /* the peer took bytes, or output began to wait for it */
    size_t unsent;               /* carrier->unsent when it was last asked */
};

/* who: the principal's name until HELLO says another ("uid:1000", "addr:192.0.2.7"). NULL when
 * there is no memory, or its client or all of them have as many as they may. */
struct connection *connection_open(struct server *server, const struct carrier *carrier,
                                   void *carrier_data, const char *peer, const char *who);
/* Everything open is cancelled. The struct stays until the loop's turn ends. */
void connection_close(struct connection *conn, const char *why);
/* Closes once what is queued was sent; nothing more is read. */
void connection_finish(struct connection *conn, const char *why);
void connections_free_closed(struct server *server);
/* While unread answers take more than --output-memory, or those of one client more than
 * --client-output, the connection that holds most of them is closed. Once a turn. */
void connections_shed(struct server *server);

/* Carriers hand in what they read: a stream's bytes, or a part of a message, which holds
 * exactly one frame; `last` ends the message. */
void connection_bytes(struct connection *conn, const void *bytes, size_t n);
void connection_part(struct connection *conn, const void *bytes, size_t n, bool last);
/* The decoder took `n` bytes by itself (relight_decoder_commit) and returned `status`. */
void connection_committed(struct connection *conn, size_t n, int status);
/* What to write next, and what was written. connection_written closes a connection that was
 * only waiting to be flushed. */
int connection_output(const struct connection *conn, struct iovec *iov, int max);
void connection_written(struct connection *conn, size_t n);

/* Queues a message; the payload is the connection's from here on. message may be NULL. */
void connection_send(struct connection *conn, uint16_t type, uint8_t flags, uint64_t id,
                     const ProtobufCMessage *message, const struct payload *payload);

#endif
