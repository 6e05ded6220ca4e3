/* SPDX-License-Identifier: MIT */
/* server.h owns struct server, the state that the rooms share. Loop thread only, except for the
 * functions that work.h and loop.h declare thread-safe. */
#ifndef RELIGHTD_SERVER_H
#define RELIGHTD_SERVER_H

#include "store/blobs.h"
#include "core/drain.h"
#include "core/ledger.h"
#include "jobs/decode_helper.h"
#include "jobs/jobs.h"
#include "core/loop.h"
#include "store/cache.h"
#include "core/options.h"
#include "core/stats.h"
#include "core/work.h"

struct connection;
struct models;
struct repository;
struct versions;
struct imports;
struct file_queue;
struct access;
struct tls;
struct events;
struct poses;
struct rooms;
struct holds;
struct shared_models;
struct object_store;
struct request;

enum {
    SERVER_HELLO_HEADER = 4096, /* before HELLO; no payload then */
    SERVER_MAX_HEADER = 1 << 20,
    SERVER_MAX_PAYLOAD = 48 << 20, /* sixteen 128-cubes of floats are 18 MB */
    SERVER_CHUNK = 1 << 20,
    SERVER_MAX_ITEMS = 16384,      /* messages and strings in one header */
    SERVER_MAX_UNPACKED = 4 << 20, /* bytes a header may take once it is unpacked */
    SERVER_MAX_ANSWER_HEADER = 16 << 20,
    SERVER_MAX_PING = 64 << 10,
    SERVER_MAX_WINDOW = 256, /* unacknowledged frames of a view */
    SERVER_EVENTS = 1024,    /* events that a client may be behind */
};

struct server {
    struct options options;
    struct loop *loop;
    struct work_pool *work;
    struct cache *cache; /* decoded and computed results, --cache */
    struct cache *files; /* open .prt files, --memory */
    struct blobs *blobs;
    struct holds *holds; /* what rooms need: store/holds.h */
    struct decoder *decoder;
    struct jobs *jobs;
    struct object_store *objects; /* what replicas share; with one machine: nothing */
    struct models *models;
    struct shared_models *shared_models; /* ops/shared_models.h; NULL: one machine */
    struct imports *imports;             /* the folder --models */
    struct versions *versions;           /* its folders NAME/VERSION */
    struct repository *repository;       /* the LOADs that they stand for */
    struct file_queue *file_queue;       /* file operations, one after another on a worker */
    struct poses *poses;                 /* render/shared/poses.h */
    struct events *events;               /* core/events.h */
    struct rooms *rooms;                 /* rooms/rooms.h */
    char run[17];                        /* hex digits that differ at every start */
    struct stats stats;
    struct ledger *ledger; /* resources by principal; checks every limit */
    char data[4000];       /* absolute path of the data folder */
    struct tls *tls;       /* NULL: no TLS */
    struct access *access; /* tokens, scopes and local rights */
    bool data_temporary;
    unsigned n_core;
    struct connection *connections, *closed;
    unsigned n_connection, n_request;
    uint64_t last_connection;
    bool leaving;     /* SIGTERM came: /readyz says so, and clients are told to leave */
    bool draining;    /* no new requests; those that are open end */
    int access_level; /* enum log_level of the line about each request (--log-access) */
    /* Whether a guest of a room (a principal "guest:ID") may use the model of this id. */
    bool (*guest_may_see)(const struct server *server, const char *guest, const char *model);
    /* The kin (struct model) of a model that a replica of another version baked; "": there is
     * none of this id. NULL: one machine. */
    const char *(*kin_of)(const struct server *server, const char *id);
    /* Shares a change of the list of tokens with other replicas, after earlier ones;
     * done(user, 0 or an errno). apply(user) makes it once more, in a list of theirs that was
     * read meanwhile. NULL: this daemon's list is its own. */
    void (*write_tokens)(struct server *server, void (*apply)(void *user),
                         void (*done)(void *user, int fault), void *user);
    /* Calls run(request) once the uploads and the model that the message names are here, which
     * other replicas may have, and poses that rooms keep on the disk are in memory; the message
     * is not kept. ordered: in the order of the connection's requests about views. NULL before
     * the start. */
    void (*fetch_then)(struct request *request, const ProtobufCMessage *message, bool ordered,
                       void (*run)(struct request *request));
    /* The connection closes: its requests wait for other replicas no longer. */
    void (*fetch_drop)(struct connection *conn);
    /* Whether clients may be sent here; else why not, in one line. store/readiness.h */
    bool (*is_ready)(const struct server *server, char why[200]);
    /* The pace of answers while requests wait, for retry_after_ms: the last one, 0 where none
     * waited then, and the running mean of the gaps. */
    uint64_t answered_ns, answer_gap_ns;
    struct drain drain;       /* of evaluations */
    struct loop_timer pinned; /* a model was pinned: store/model_open.c */
};

#endif
