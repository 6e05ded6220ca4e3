/* SPDX-License-Identifier: MIT */
/* shared_models.h owns what this replica knows of the models of the others (--store DIR):
 *
 *     every --store-poll seconds -> a worker lists DIR/records and reads those that changed
 *       a bake that is ready     -> a model here; its file is fetched when somebody asks
 *       a model without a bake   -> remembered; its LOAD is repeated here when somebody asks
 *       one of another version   -> the same: this replica bakes one of its own, and answers
 *                                   with it also under the other's id
 *       one whose replica died   -> its LOAD is repeated here: the bake goes on
 *       a record that is gone    -> somebody unloaded the model: it goes here, too, when the
 *                                   record is missing for as long as the poll, at least 1 s
 *
 * shared_fetch.c holds requests back that name what is not here. Loop thread only. */
#ifndef RELIGHTD_SHARED_MODELS_H
#define RELIGHTD_SHARED_MODELS_H

#include "net/request.h"

/* After models_start. 0 or an enum prt_status; does nothing with one machine. */
int shared_models_create(struct server *server, struct shared_models **out);
/* After the last connection. */
void shared_models_destroy(struct shared_models *shared);

/* Waits for a model of another replica. `wake` is called, later, when a look at the folder has
 * ended that began after this, and the LOAD that it caused was answered. */
struct shared_model_waiter {
    struct shared_model_waiter *next;
    char name[128];   /* id, beginning of one, or name */
    char asker[96];   /* principal */
    uint64_t look;    /* private */
    char loading[40]; /* private: id of the LOAD waited for */
    void (*wake)(struct shared_model_waiter *waiter);
};
void shared_models_wait(struct shared_models *shared, struct shared_model_waiter *waiter);

/* Models of other replicas that are not here, because they have no bake yet: from number `from`
 * on, at most `most`. Returns their number; the texts live until the loop goes on. */
struct shared_listed {
    const char *id, *name;
    bool baking;
};
size_t shared_models_list(const struct shared_models *shared, size_t from,
                          struct shared_listed *out, size_t most);

struct model;
/* Somebody unloads the model for good: the same of other versions goes, too. NULL: nothing. */
void shared_models_forget_kin(struct shared_models *shared, const struct model *model);

/* shared_fetch.c: server->fetch_then. */
void shared_fetch_then(struct request *request, const ProtobufCMessage *message, bool ordered,
                       void (*run)(struct request *request));
/* The connection closes: its requests wait no longer. */
void shared_fetch_drop(struct connection *conn);

#endif
