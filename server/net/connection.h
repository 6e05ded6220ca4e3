/* SPDX-License-Identifier: MIT */
/* connection.h owns one client: its frames in, its bounded queue of frames out, its requests.
 * A carrier transfers the bytes: TCP, unix socket or WebSocket. */
#ifndef RELIGHTD_CONNECTION_H
#define RELIGHTD_CONNECTION_H

#include "frame.h"
#include "core/access.h"
#include "core/server.h"

#include <sys/uio.h>

struct request;

/* Bytes that several answers may share; released after the last was sent. */
struct payload {
    const void *bytes;
    size_t size;
    void *owner;
    void (*release)(void *owner); /* NULL: nothing to do */
};

/* How bytes are transferred. The carrier owns the connection's carrier_data. */
struct carrier {
    const char *name;
    void (*want_write)(struct connection *conn);           /* there is output */
    void (*set_reading)(struct connection *conn, bool on); /* back pressure */
    void (*close)(struct connection *conn);                /* free carrier_data */
    size_t (*unsent)(const struct connection *conn); /* bytes the kernel holds; may be NULL */
    /* Not NULL: answers are not sent as frames. The carrier is called with each message
     * instead, and queues its own bytes with connection_queue. It takes the payload (may be
     * NULL). */
    void (*answer)(struct connection *conn, uint16_t type, uint8_t flags,
                   const ProtobufCMessage *message, struct payload *payload);
};

struct out_frame {
    struct out_frame *next;
    bool more; /* its message continues in the next frame */
    uint8_t *head;
    size_t head_size, sent;
    struct payload payload;
    size_t size;          /* head + payload */
    uint64_t id, late_ns; /* an answer that is not begun by then is not sent; 0: none */
};

struct connection {
    struct connection *next, *prev;
    struct server *server;
    const struct carrier *carrier;
    void *carrier_data;
    uint64_t number;
    char peer[96];
    char request_id[65];            /* that the client gave its requests (HTTP); "": none */
    struct principal *principal;    /* core/ledger.h: the principal that is charged */
    struct caller caller;           /* core/access.h: who it is; without scopes before HELLO */
    uint64_t end_ns;                /* closed at this time: its token expires; 0: not */
    struct relight_decoder decoder; /* byte streams */
    bool greeted, dead, closing, reading;
    bool owes_goaway;     // while connections_goaway() runs
    uint64_t max_payload; /* the client's limit for one frame */
    struct out_frame *out, **out_last;
    size_t out_bytes;    /* queued and not sent */
    size_t out_charged;  /* of OUTPUT: whole frames until their last byte is sent */
    size_t message_left; /* of them, those of the message that is being sent */
    uint64_t late_ns;    /* deadline of the answer that connection_send is given; 0: none */
    uint64_t full_ns; /* since when more than --send-buffer is queued behind it; 0: not now */
    struct request *requests;
    unsigned n_request, n_long; /* n_long: of them, views and watches */
    uint64_t payload_charged;   /* for the frame that is being read */
    bool prepaid;               /* its requests were taken from the quota already (HTTP) */
    bool own_limit; /* the last refusal was for a limit of its principal, not of all */
    struct {
        int code; /* 0: none */
        char text[320];
        uint32_t retry_ms;       /* for BUSY; 0: unknown */
    } refusal;                   /* of the frame that is being read */
    struct material_wait *waits; /* materials.c: requests about views, in their order */
    struct shared_wait
        *fetches; /* ops/shared_fetch.c: the same, that wait for other replicas */
    struct loop_timer timer;
    bool message_full; /* WebSocket: the current message's frame is complete */
    uint64_t opened_ns;
    uint64_t heard_ns, frame_ns; /* last byte; first byte of the frame being read, 0: none */
    uint64_t sent_ns;            /* the peer last took bytes, or output began to wait */
    size_t unsent;               /* carrier->unsent when it was last called */
};

/* who: the principal's name until HELLO names another ("uid:1000", "addr:192.0.2.7"). NULL
 * without memory, or where the client or the daemon is at its limit of connections. */
struct connection *connection_open(struct server *server, const struct carrier *carrier,
                                   void *carrier_data, const char *peer, const char *who);
/* The client is `caller` from here on: its connection and output are charged to that principal.
 * False: the principal is at its limit, or memory is short; error has the text. */
bool connection_identify(struct connection *conn, const struct caller *caller, char error[256]);
/* Ends the connections whose token is not valid any more: an ERROR frame tells why, and what is
 * not sent within half a second is dropped. anonymous: also those of addresses without a
 * token. */
void connections_recheck(struct server *server, bool anonymous);
/* Everything open is cancelled. The struct stays until the loop's turn ends. */
void connection_close(struct connection *conn, const char *why);
/* Closes after the queued frames were sent; reads nothing more. */
void connection_finish(struct connection *conn, const char *why);
void connections_free_closed(struct server *server);
/* Sends GOAWAY to every connection: it ends in `seconds`, once its requests are answered. The
 * address is where clients should connect instead, "" for here. */
void connections_goaway(struct server *server, double seconds, const char *address,
                        const char *text);
/* While unread answers take more than --output-memory, or those of one client more than
 * --client-output, the connection that holds most of them is closed. Once a turn. */
void connections_shed(struct server *server);

/* Carriers pass received bytes: of a stream, or a part of a message, which holds exactly one
 * frame; `last` ends the message. connection_bytes stops after the frame during which
 * `until_ns` passes, and returns how many bytes it took. */
size_t connection_bytes(struct connection *conn, const void *bytes, size_t n,
                        uint64_t until_ns);
void connection_part(struct connection *conn, const void *bytes, size_t n, bool last);
/* The decoder took `n` bytes by itself (relight_decoder_commit) and returned `status`. */
void connection_committed(struct connection *conn, size_t n, int status);
/* Next bytes to write, and the number of written bytes. connection_written closes a connection
 * that was only waiting to be flushed. */
int connection_output(struct connection *conn, struct iovec *iov, int max);
/* The carrier has taken a copy of the first n bytes and will send that: the answers that they
 * belong to are begun. */
void connection_begun(struct connection *conn, size_t n);
void connection_written(struct connection *conn, size_t n);

/* Queues bytes that are no frame: head (malloc()ed, taken) and the payload (taken, may be
 * NULL). False without memory; the connection then closes. Carriers with `answer` only. */
bool connection_queue(struct connection *conn, uint8_t *head, size_t n,
                      struct payload *payload);
/* Starts the time limit of a part of a request's body (--frame-time), or ends it. */
void connection_part_begins(struct connection *conn);
void connection_part_ends(struct connection *conn, size_t n);

/* Queues a message; the payload is the connection's from here on. message may be NULL. */
void connection_send(struct connection *conn, uint16_t type, uint8_t flags, uint64_t id,
                     const ProtobufCMessage *message, const struct payload *payload);

#endif
