/* SPDX-License-Identifier: MIT */
/* ledger.h owns the accounts of the daemon's resources: how much each principal holds, with a
 * limit by principal and a limit in all, checked before anything is allocated. A principal is
 * one client: a token's name, a local user (unix socket), or a network address.
 * Thread-safety: loop thread only. */
#ifndef RELIGHTD_LEDGER_H
#define RELIGHTD_LEDGER_H

#include <stdbool.h>
#include <stdint.h>

struct ledger;
struct options;

/* resource, words of a refusal, unit, option with the limit by principal, option with the limit
 * in all. Options are fields of struct options; 0 stands for no limit. */
#define LEDGER_LIST(X)                                                                      \
    X(CONNECTIONS, "open connections", "", client_connections, connections)                 \
    X(REQUESTS, "open requests", "", client_requests, queue)                                \
    X(LONG_REQUESTS, "open views and watches", "", client_views, views)                     \
    X(PAYLOAD, "bytes held by requests and views", " bytes", client_memory, request_memory) \
    X(POSES, "bytes of poses", " bytes", client_poses, poses)                               \
    X(OUTPUT, "bytes of answers not yet read", " bytes", client_output, output_memory)      \
    X(JOBS, "bakes that wait or run", "", client_jobs, bake_queue)                          \
    X(UPLOADS, "uploads under way", "", client_uploads, uploads)                            \
    X(MODELS, "models", "", client_models, max_models)                                      \
    X(ROOMS, "review rooms", "", client_rooms, max_rooms)                                   \
    X(ROOM_MEMORY, "bytes of review rooms in memory", " bytes", client_room_memory,         \
      room_memory)                                                                          \
    X(DISK, "bytes on disk", " bytes", client_disk, disk)

enum ledger_resource {
#define X(name, words, unit, by_client, in_all) LEDGER_##name,
    LEDGER_LIST(X)
#undef X
        LEDGER_N
};

/* One client of the daemon. `name` is unique while the principal exists: "token:NAME",
 * "uid:1000" or "addr:192.0.2.7". */
struct principal {
    struct principal *next;
    struct ledger *ledger;
    char name[96];
    unsigned refs;
    uint64_t held[LEDGER_N];
    uint64_t limit[LEDGER_N]; /* its own; 0: the option's */
};

/* NULL without memory. The options must outlive the ledger. */
struct ledger *ledger_create(const struct options *options);
/* Every principal must have been released. */
void ledger_destroy(struct ledger *ledger);

/* quotas fills the limits of its own that a principal has, 0 for none; it is called for each
 * new principal, and for all that exist by ledger_update_quotas. NULL: nobody has any. */
typedef void (*ledger_quotas_fn)(void *user, const char *principal, uint64_t limit[LEDGER_N]);
void ledger_set_quotas(struct ledger *ledger, ledger_quotas_fn quotas, void *user);
void ledger_update_quotas(struct ledger *ledger);

/* The principal of this name, created if new, with a reference for the caller. NULL without
 * memory. A principal that holds resources outlives its last reference. */
struct principal *ledger_principal(struct ledger *ledger, const char *name);
void principal_hold(struct principal *principal);
void principal_release(struct principal *principal); /* NULL is fine */

enum ledger_refusal { LEDGER_GRANTED, LEDGER_CLIENT_FULL, LEDGER_ALL_FULL };
/* Charges `amount` to the principal unless a limit would be passed. On refusal nothing is
 * charged and error says which limit, how much is held and which option sets it. */
enum ledger_refusal ledger_take(struct principal *principal, enum ledger_resource resource,
                                uint64_t amount, char error[256]);
/* Charges beyond the limits: for resources in use already (files found at start, queued bytes).
 */
void ledger_force(struct principal *principal, enum ledger_resource resource, uint64_t amount);
/* Gives back what was charged; asserts that the principal holds so much. */
void ledger_give(struct principal *principal, enum ledger_resource resource, uint64_t amount);

/* The sum over all principals, and the limits (0: none). */
uint64_t ledger_total(const struct ledger *ledger, enum ledger_resource resource);
uint64_t ledger_limit_client(const struct principal *principal, enum ledger_resource resource);
/* No principal's limit is below it, but for 0. */
uint64_t ledger_limit_least(const struct ledger *ledger, enum ledger_resource resource);
uint64_t ledger_limit_all(const struct ledger *ledger, enum ledger_resource resource);
/* Whether the principal of this name holds more than its share: the limit in all divided by the
 * number of principals that hold anything. `more` counts as held by `asker` already; NULL: it
 * is not counted. Where all together hold more than the limit, somebody holds more than its
 * share. */
bool ledger_above_share(const struct ledger *ledger, enum ledger_resource resource,
                        const char *name, const char *asker, uint64_t more);
const char *ledger_name(enum ledger_resource resource); /* "connections", for metrics */
/* Calls for every principal, in no order. */
const struct principal *ledger_first(const struct ledger *ledger);

#endif
