// SPDX-License-Identifier: MIT
// TOKEN_CREATE, TOKEN_LIST and TOKEN_REVOKE. A new token is valid once its file is on disk; a
// revoked one is invalid at once, and its connections are closed.
#include "core/log.h"
#include "net/dispatch.h"
#include "net/request_wait.h"
#include "relight.pb-c.h"
#include "store/file_queue.h"

#include <errno.h>
#include <math.h>
#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static const double most_rate = 1e9;
static const uint64_t most_quota = UINT64_C(1) << 53, most_lifetime_s = UINT64_C(1) << 40;

// ---- the file

// A change of the list while its file is written.
struct change {
    struct request_wait wait; // first
    struct file_task task;
    struct server *server;
    char path[4096];
    char *text;
    bool revoke;
    struct token token; // another of the same name may follow a revoked one
    char secret[TOKEN_SECRET];
    unsigned closed;
};

// On a worker.
static int write_list(struct file_task *task)
{
    const struct change *c = (struct change *)((char *)task - offsetof(struct change, task));
    return tokens_write(c->path, c->text);
}

static bool is_of(const struct change *c, const struct token *t)
{
    return t && !sodium_memcmp(t->hash, c->token.hash, TOKEN_HASH);
}

// Makes the change in a list that does not have it.
static void apply(void *user)
{
    const struct change *c = user;
    struct token_store *store = access_store(c->server->access);
    struct token *t = token_find(store, c->token.name);
    if (!c->revoke && !t) token_add(store, &c->token, (char[256]){0});
    else if (c->revoke && is_of(c, t)) token_remove(store, t);
}

static void stored(void *user, int fault)
{
    struct change *c = user;
    char *text = fault ? NULL : tokens_print(access_store(c->server->access));
    if (text) {
        free(c->text);
        c->text = text;
        file_queue_add(c->server->file_queue, &c->task);
        return;
    }
    c->task.status = fault ? fault : ENOMEM;
    c->task.done(&c->task);
}

// Among replicas the list is shared first; the file is a copy of it then.
static void submit(struct change *c)
{
    struct server *server = c->server;
    if (server->write_tokens) server->write_tokens(server, apply, stored, c);
    else file_queue_add(server->file_queue, &c->task);
}

static void free_change(struct change *c)
{
    sodium_memzero(c->secret, sizeof c->secret);
    free(c->text);
    free(c);
}

static void written(struct file_task *task);

// Writes the list as it is now, after that change. NULL without memory.
static struct change *begin_change(struct server *server, const struct token *token,
                                   bool revoke)
{
    struct change *c = calloc(1, sizeof *c);
    char *text = c ? tokens_print(access_store(server->access)) : NULL;
    if (!text) {
        free(c);
        return NULL;
    }
    c->server = server;
    c->text = text;
    c->revoke = revoke;
    c->token = *token;
    access_path(server->access, c->path, sizeof c->path);
    c->task.run = write_list;
    c->task.done = written;
    return c;
}

// ---- answers

struct info_room {
    Relight__TokenInfo info;
    Relight__TokenQuotas quotas;
    char *scopes[8];
};

static unsigned count_connections(const struct server *server, const char *name)
{
    unsigned n = 0;
    char principal[TOKEN_NAME + 8];
    snprintf(principal, sizeof principal, "token:%s", name);
    for (const struct connection *c = server->connections; c; c = c->next)
        n += !strcmp(c->caller.name, principal);
    return n;
}

static void fill_info(const struct server *server, const struct token *t,
                      struct info_room *room)
{
    static char *const words[] = {"view", "edit", "upload", "admin"};
    Relight__TokenInfo *out = &room->info;
    Relight__TokenQuotas *q = &room->quotas;
    relight__token_info__init(out);
    relight__token_quotas__init(q);
    out->name = (char *)t->name;
    out->scopes = room->scopes;
    for (size_t i = 0; i < sizeof words / sizeof *words; i++)
        if (t->scopes & 1u << i) room->scopes[out->n_scopes++] = words[i];
    out->created_s = (uint64_t)t->created_s;
    out->expires_s = (uint64_t)t->expires_s;
    out->by = (char *)t->by;
    out->connections = count_connections(server, t->name);
    out->quotas = q;
    q->rate = t->rate;
    q->connections = t->limit[LEDGER_CONNECTIONS];
    q->requests = t->limit[LEDGER_REQUESTS];
    q->views = t->limit[LEDGER_LONG_REQUESTS];
    q->memory = t->limit[LEDGER_PAYLOAD];
    q->output = t->limit[LEDGER_OUTPUT];
    q->bakes = t->limit[LEDGER_JOBS];
    q->uploads = t->limit[LEDGER_UPLOADS];
    q->models = t->limit[LEDGER_MODELS];
    q->disk = t->limit[LEDGER_DISK];
}

static void created(struct change *c, struct request *request)
{
    struct server *server = c->server;
    struct token_store *store = access_store(server->access);
    struct token *t = token_find(store, c->token.name);
    int fault = c->task.status;
    if (!is_of(c, t)) t = NULL;     // revoked, then made anew
    if (t && (fault || !request)) { // without its request nobody has the secret
        token_remove(store, t);
        t = NULL;
        struct change *back = begin_change(server, &c->token, true);
        if (back) submit(back);
    }
    if (!request) return;
    if (!t) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_INTERNAL, "token %s: %s%s",
                     c->token.name,
                     fault ? "its file could not be written: "
                           : "it was revoked, or another of its name was made, meanwhile",
                     fault ? strerror(fault) : "");
        return;
    }
    bool first = access_commit(server->access, t);
    ledger_update_quotas(server->ledger); // an earlier token of this name may still hold things
    struct connection *conn = request->conn;
    struct info_room room;
    char scopes[64];
    Relight__TokenCreateAnswer out = RELIGHT__TOKEN_CREATE_ANSWER__INIT;
    scopes_print(t->scopes, scopes);
    log_line(LOG_EVENT, "audit act=token-create who=%s name=%s scopes=%s expires=%lld",
             conn->caller.name, t->name, scopes, (long long)t->expires_s);
    fill_info(server, t, &room);
    out.token = c->secret;
    out.info = &room.info;
    request_answer(request, &out.base, NULL);
    // From here on TCP and WebSocket need a token; the answer is queued already.
    if (first) connections_recheck(server, true);
}

static void revoked(struct change *c, struct request *request)
{
    if (c->task.status)
        log_line(LOG_ERR, "audit act=token-revoke name=%s: its file could not be written: %s",
                 c->token.name, strerror(c->task.status));
    if (!request) return;
    Relight__TokenRevokeAnswer out = RELIGHT__TOKEN_REVOKE_ANSWER__INIT;
    out.connections = c->closed;
    if (c->task.status)
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_INTERNAL,
                     "token %s is revoked until the daemon restarts: its file could not be "
                     "written: %s",
                     c->token.name, strerror(c->task.status));
    else request_answer(request, &out.base, NULL);
}

static void written(struct file_task *task)
{
    struct change *c = (struct change *)((char *)task - offsetof(struct change, task));
    struct request *request = request_resume(&c->wait);
    if (c->revoke) revoked(c, request);
    else created(c, request);
    free_change(c);
}

// ---- operations

// NULL, or the fault's text; quotas may be NULL.
static const char *read_quotas(const Relight__TokenQuotas *q, struct token *t)
{
    if (!q) return NULL;
    if (!(q->rate >= 0 && q->rate <= most_rate))
        return "quotas.rate: expected [0, 1e9] requests/s";
    t->rate = q->rate;
    t->limit[LEDGER_CONNECTIONS] = q->connections;
    t->limit[LEDGER_REQUESTS] = q->requests;
    t->limit[LEDGER_LONG_REQUESTS] = q->views;
    t->limit[LEDGER_PAYLOAD] = q->memory;
    t->limit[LEDGER_OUTPUT] = q->output;
    t->limit[LEDGER_JOBS] = q->bakes;
    t->limit[LEDGER_UPLOADS] = q->uploads;
    t->limit[LEDGER_MODELS] = q->models;
    t->limit[LEDGER_DISK] = q->disk;
    for (int i = 0; i < LEDGER_N; i++)
        if (t->limit[i] >= most_quota) return "a quota is above 2^53";
    return NULL;
}

// Fills the token; false: the request was answered.
static bool read_request(struct request *request, struct token *t)
{
    const Relight__TokenCreateRequest *in =
        (const Relight__TokenCreateRequest *)request->message;
    const struct caller *caller = &request->conn->caller;
    const char *why = token_name_fault(in->name);
    *t = (struct token){.created_s = (int64_t)time(NULL), .pending = true};
    for (size_t i = 0; !why && i < in->n_scopes; i++) {
        unsigned one = 0;
        if (!scopes_parse(in->scopes[i], &one) || !one)
            why = "scopes: expected view, edit, upload or admin";
        t->scopes |= one;
    }
    if (!why && !t->scopes) why = "scopes: expected one at least of view, edit, upload, admin";
    if (!why && in->lifetime_s > most_lifetime_s) why = "lifetime_s: expected at most 2^40 s";
    if (!why) why = read_quotas(in->quotas, t);
    if (why) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE, "token %.64s: %s",
                     in->name, why);
        return false;
    }
    const char *missing = access_missing(caller->scopes, t->scopes);
    if (missing) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                     "token %s: the scope %s cannot be given by %s, which lacks it", in->name,
                     missing, caller->name);
        return false;
    }
    snprintf(t->name, sizeof t->name, "%s", in->name);
    snprintf(t->by, sizeof t->by, "%s", caller->name);
    if (in->lifetime_s) t->expires_s = t->created_s + (int64_t)in->lifetime_s;
    return true;
}

void op_token_create(struct request *request)
{
    struct server *server = request->server;
    struct token_store *store = access_store(server->access);
    struct token t, *added;
    char secret[TOKEN_SECRET], fault[256];
    if (!read_request(request, &t)) return;
    token_generate(secret);
    token_hash(secret, t.hash);
    if (!(added = token_add(store, &t, fault))) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST, "%s", fault);
        return;
    }
    struct change *c = begin_change(server, &t, false);
    if (!c) {
        token_remove(store, added);
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    memcpy(c->secret, secret, sizeof secret);
    sodium_memzero(secret, sizeof secret);
    request_park(request, &c->wait);
    submit(c);
}

void op_token_list(struct request *request)
{
    const struct token_store *store = access_store(request->server->access);
    struct info_room *room = calloc(store->n + 1, sizeof *room);
    Relight__TokenInfo **list = calloc(store->n + 1, sizeof *list);
    Relight__TokenListAnswer out = RELIGHT__TOKEN_LIST_ANSWER__INIT;
    out.tokens = list;
    for (size_t i = 0; room && list && i < store->n; i++) {
        if (store->token[i].pending) continue;
        fill_info(request->server, &store->token[i], &room[i]);
        list[out.n_tokens++] = &room[i].info;
    }
    if (room && list) request_answer(request, &out.base, NULL);
    else request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
    free(room);
    free(list);
}

void op_token_revoke(struct request *request)
{
    const char *name = ((const Relight__TokenRevokeRequest *)request->message)->name;
    struct server *server = request->server;
    struct token_store *store = access_store(server->access);
    struct token *t = token_find(store, name);
    if (!t) {
        request->hint = "`relight token list` lists the tokens";
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                     strcmp(name, "default") ? "%.64s: no such token"
                                             : "%s is the token of --token-file: change the "
                                               "file and send SIGHUP",
                     name);
        return;
    }
    struct token before = *t;
    token_remove(store, t);
    struct change *c = begin_change(server, &before, true);
    if (!c) {
        token_add(store, &before, (char[256]){0});
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    c->closed = count_connections(server, before.name);
    log_line(LOG_EVENT, "audit act=token-revoke who=%s name=%s connections=%u",
             request->conn->caller.name, before.name, c->closed);
    request_park(request, &c->wait);
    ledger_update_quotas(server->ledger);
    connections_recheck(server, false); // may end this request, too
    submit(c);
}
