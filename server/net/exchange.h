/* SPDX-License-Identifier: MIT */
/* exchange.h owns one HTTP request and its answer. A request of the API becomes a message of
 * the protocol, which net/dispatch.c runs like any other: a connection with a carrier of its
 * own is opened for it, so that limits, deadlines and cancellation are those of all carriers.
 * Pages that need no operation (/healthz, /metrics) are answered without a connection. Loop
 * thread only. */
#ifndef RELIGHTD_EXCHANGE_H
#define RELIGHTD_EXCHANGE_H

#include "core/work.h"
#include "net/chunked.h"
#include "net/http_head.h"
#include "net/request.h"

enum { EXCHANGE_ID = 256, EXCHANGE_FIELDS = 2000, EXCHANGE_JSON = 64 << 10 };

struct exchange;

/* The bodies that a request may have. */
enum exchange_body {
    BODY_NONE,
    BODY_FILE,        /* written to the store of uploads */
    BODY_FILE_OR_JSON /* or, as application/json, it is the operation's message */
};

/* One operation of the API (net/routes.c): which requests it takes and how it translates them.
 */
struct route {
    const char *method, *pattern; /* "*" in the pattern is x->id, ".*" at its end x->ending */
    enum exchange_body body;
    uint16_t type; /* of the protocol's request; 0: prepare answers by itself */
    /* Fills x->message from the parameters. False: *problem says why not. */
    bool (*prepare)(struct exchange *x, struct http_problem *problem);
    /* Adds the uploaded file, x->blob, to the message. NULL: bodies of files are the answer. */
    void (*add_file)(struct exchange *x);
    /* The operation's answer, of several each; it takes the payload. */
    void (*answer)(struct exchange *x, const ProtobufCMessage *message, bool last,
                   struct payload *payload);
    bool open;      /* answered without a token */
    bool any_query; /* parameters that it does not know are ignored: links get marks of mailers
                     */
    bool signable;  /* a signed link may name it */
};

struct exchange {
    struct lws *wsi;
    struct server *server;
    struct connection *conn; /* NULL before it is opened, and after it was closed */
    struct http_head head;
    const struct route *route;
    char id[EXCHANGE_ID], ending[16];
    char request_id[HTTP_REQUEST_ID + 1];
    uint64_t begun_ns, last_id;
    uint32_t deadline_ms;
    ProtobufCMessage *message; /* that will be sent */
    int format;                /* of colours: routes.h */
    struct work_of_exchange *work;

    /* The body: a file's chunk that is being filled, or JSON. */
    char upload[65], blob[65]; /* the upload's handle; the hash of the file */
    char file_name[201];
    uint64_t blob_offset,
        blob_size; /* a part of a file of this size; 0: the body is all of it */
    char *json;
    uint64_t json_charged, body_at; /* bytes of the body that came */
    uint8_t *chunk;
    size_t chunk_at, chunk_size;
    struct chunked
        framing; /* of a chunked body, which is kept in `chunk` until it is complete */
    uint64_t kept_charged; /* of PAYLOAD, for it */
    unsigned n_flying;     /* chunks without an answer */
    bool storing, reading, broken;
    bool received; /* libwebsockets said that the request is complete */

    /* The answer. */
    int status; /* 0: none yet */
    char type[64];
    char fields[EXCHANGE_FIELDS]; /* "name:\0value\0" pairs */
    size_t n_fields;
    uint64_t length, sent;
    bool streaming, complete, head_sent, close_after;
    struct payload plain;   /* what there is to send without a connection */
    unsigned n_event;       /* of a stream of events */
    uint64_t link_s;        /* a signed link: how long it is still valid */
    struct loop_watch peer; /* fd 0: not watched */
    struct loop_timer beat; /* of a stream: keeps proxies and finds dead peers */
};

/* Answers the request that libwebsockets has just read. NULL: the socket is to be closed. The
 * exchange may be answered already; its bytes go out in exchange_write. */
struct exchange *exchange_begin(struct lws *wsi, struct server *server);
/* A part of the body; false: the socket is to be closed. */
bool exchange_receive(struct exchange *x, const void *bytes, size_t n);
/* All of the request is there: its operations are cancelled when the client closes. False, when
 * it is said again: the socket is to be closed. */
bool exchange_received(struct exchange *x);
/* The socket can be written: sends a piece. */
enum exchange_next {
    EXCHANGE_GOES_ON, /* called again when there is more */
    EXCHANGE_DONE,    /* another request may follow */
    EXCHANGE_CLOSE    /* the answer is complete, and the socket is to be closed */
};
enum exchange_next exchange_write(struct exchange *x);
/* Frees it; where it is not answered, its requests are cancelled. */
void exchange_end(struct exchange *x);

/* ---- for routes */

/* A header of the answer, before exchange_answer. Values are checked for control characters. */
void exchange_field(struct exchange *x, const char *name, const char *fmt, ...)
    __attribute__((format(printf, 3, 4)));
/* The whole answer: head (malloc()ed, taken, may be NULL) and then the payload (taken). */
void exchange_answer(struct exchange *x, int status, const char *type, char *head, size_t n,
                     struct payload *payload);
/* The same of a text, malloc()ed and taken; NULL: there was no memory for it, 503. */
void exchange_text(struct exchange *x, int status, const char *type, char *text);
void exchange_refuse(struct exchange *x, const struct http_problem *problem);
/* Of a stream: the answer's beginning, a piece of it (text, copied; without memory for it the
 * connection is closed), and its end. */
void exchange_stream(struct exchange *x, const char *type);
void exchange_piece(struct exchange *x, const char *text);
void exchange_stream_end(struct exchange *x);
/* A message's JSON as the answer. */
void exchange_json(struct exchange *x, int status, const ProtobufCMessage *message);

/* Runs on a worker, with the payload, and answers with what `run` wrote: for formats that are
 * made of an answer's payload. */
struct work_of_exchange {
    struct work work;   /* first */
    struct exchange *x; /* NULL: it ended */
    struct server *server;
    struct payload payload;
    uint32_t n_vertex;
    int format;
    char *bytes; /* the result, malloc()ed */
    size_t n;
    const char *type;
};
void exchange_work(struct exchange *x, struct payload *payload, uint32_t n_vertex, int format,
                   const char *type,
                   int (*run)(struct work *work, const struct prt_context *ctx));

/* ---- between exchange.c and exchange_admit.c */

/* Finds the route and the caller, opens the connection of an operation and makes its message,
 * or answers a page. False with *problem, or with an answer set (x->status). */
bool exchange_admit(struct exchange *x, struct http_problem *problem);
/* Opens x->conn for the caller, charged to its limits. */
bool exchange_connect(struct exchange *x, const struct caller *caller,
                      struct http_problem *problem);

/* ---- routes.c */

/* The route of a method and path, with x->id and x->ending filled. NULL with *problem: 404, or
 * 405 with the Allow field. */
const struct route *route_find(struct exchange *x, struct http_problem *problem);

#endif
