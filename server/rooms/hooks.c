// SPDX-License-Identifier: MIT
// What is told about pins and decisions, and the queue of it.
#include "rooms/hooks.h"

#include "core/log.h"
#include "core/token.h"
#include "rooms/fold.h"
#include "rooms/hook_post.h"

#include <cjson/cJSON.h>
#include <pthread.h>
#include <sodium.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { MOST_WAITING = 1000, TRIES = 6 };

struct delivery {
    struct loop_message message; // first: how it ended
    struct delivery *next;
    struct hooks *hooks;
    char id[64], kind[16], *body;
    char fault[160]; // "": it was taken
    unsigned tries;
};

struct hooks {
    struct server *server;
    struct hook_target target;
    char key[TOKEN_ROOM];
    pthread_t thread;
    pthread_mutex_t lock;
    pthread_cond_t changed;
    struct delivery *first, **last;
    unsigned n; // that wait
    atomic_bool closing;
};

void hook_sign(const char *key, const void *body, size_t n, char out[72])
{
    unsigned char mac[crypto_auth_hmacsha256_BYTES];
    crypto_auth_hmacsha256_state state;
    crypto_auth_hmacsha256_init(&state, (const unsigned char *)key, strlen(key));
    crypto_auth_hmacsha256_update(&state, body, n);
    crypto_auth_hmacsha256_final(&state, mac);
    strcpy(out, "sha256=");
    sodium_bin2hex(out + 7, 65, mac, sizeof mac);
}

// ---- the thread

static struct delivery *take(struct hooks *h)
{
    pthread_mutex_lock(&h->lock);
    while (!h->first && !h->closing) pthread_cond_wait(&h->changed, &h->lock);
    struct delivery *d = h->closing ? NULL : h->first;
    if (d && !(h->first = d->next)) h->last = &h->first;
    pthread_mutex_unlock(&h->lock);
    return d;
}

// 1, 2, 4, … seconds, or until the daemon ends.
static void pause_before(struct hooks *h, unsigned tries)
{
    struct timespec until;
    clock_gettime(CLOCK_REALTIME, &until);
    until.tv_sec += 1 << tries;
    pthread_mutex_lock(&h->lock);
    while (!h->closing && !pthread_cond_timedwait(&h->changed, &h->lock, &until)) continue;
    pthread_mutex_unlock(&h->lock);
}

static void deliver(struct hooks *h, struct delivery *d)
{
    char headers[400], signature[72];
    hook_sign(h->key, d->body, strlen(d->body), signature);
    snprintf(headers, sizeof headers,
             "X-Relight-Event: %s\r\nX-Relight-Delivery: %s\r\nX-Relight-Signature: %s\r\n",
             d->kind, d->id, signature);
    for (d->tries = 1;; d->tries++) {
        enum hook_result r = hook_post(&h->target, headers, d->body, d->fault, &h->closing);
        if (r == HOOK_TAKEN) d->fault[0] = 0;
        if (r != HOOK_LATER || d->tries == TRIES || h->closing) return;
        pause_before(h, d->tries - 1);
        if (h->closing) return;
    }
}

static void *run(void *user)
{
    struct hooks *h = user;
    for (struct delivery *d; (d = take(h));) {
        deliver(h, d);
        loop_post(h->server->loop, &d->message);
    }
    return NULL;
}

static void ended(struct loop_message *message)
{
    struct delivery *d = (struct delivery *)message;
    d->hooks->n--;
    if (d->fault[0])
        log_line(LOG_WARN, "hook event=%s delivery=%s tries=%u: %s", d->kind, d->id, d->tries,
                 d->fault);
    else log_line(LOG_TRACE, "hook event=%s delivery=%s tries=%u", d->kind, d->id, d->tries);
    free(d->body);
    free(d);
}

// ---- what is told

// cJSON writes a large number that ends with a zero as 1.5e+15, which is none for readers of
// whole numbers.
static void add_whole(cJSON *to, const char *field, uint64_t number)
{
    char text[24];
    snprintf(text, sizeof text, "%llu", (unsigned long long)number);
    cJSON_AddRawToObject(to, field, text);
}

static void add_stamp(cJSON *to, const Relight__Stamp *stamp)
{
    add_whole(to, "sequence", stamp->sequence);
    add_whole(to, "time_us", stamp->time_us);
    cJSON_AddStringToObject(to, "by", stamp->by);
    cJSON_AddStringToObject(to, "name", stamp->name);
}

static void add_seen(cJSON *to, const Relight__Seen *seen)
{
    cJSON_AddNumberToObject(to, "revision", seen->revision);
    cJSON_AddStringToObject(to, "model", seen->model);
    cJSON_AddStringToObject(to, "bake_hash", seen->bake_hash);
    cJSON_AddStringToObject(to, "picture_hash", seen->picture_hash);
}

// NULL: nobody is told of such an event.
static const char *kind_of(const Relight__RoomEvent *event)
{
    return event->action->pin ? "pin" : event->action->decide ? "decision" : NULL;
}

char *hooks_describe(const struct hooks *h, const Relight__RoomState *state,
                     const Relight__RoomEvent *event)
{
    const char *kind = kind_of(event);
    const Relight__Stamp *stamp = event->stamp;
    if (!h || !kind) return NULL;
    const Relight__Pin *pin = room_pin(state, stamp->sequence);
    const Relight__Decision *decision = room_decision(state, stamp->sequence);
    cJSON *json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, "event", kind);
    cJSON_AddStringToObject(json, "room", state->room);
    cJSON_AddStringToObject(json, "room_name", state->name);
    add_stamp(json, stamp);
    if (pin) {
        cJSON_AddStringToObject(json, "text", pin->notes[0]->text);
        add_seen(json, pin->seen);
    }
    if (decision) {
        cJSON_AddStringToObject(json, "verdict", decision->approve ? "approved" : "rejected");
        cJSON_AddStringToObject(json, "note", decision->note);
        cJSON_AddStringToObject(json, "hash", decision->hash);
        add_seen(json, decision->seen);
    }
    char *text = cJSON_PrintUnformatted(json);
    cJSON_Delete(json);
    return text;
}

void hooks_event(struct hooks *h, const char *room, const Relight__RoomEvent *event, char *body)
{
    const char *kind = kind_of(event);
    if (!h || !kind) return;
    struct delivery *d = body && h->n < MOST_WAITING ? calloc(1, sizeof *d) : NULL;
    if (!d) {
        free(body);
        log_line(LOG_WARN, "hook event=%s room=%s: %u others wait, it is not sent", kind, room,
                 h->n);
        return;
    }
    d->body = body;
    d->message.handle = ended;
    d->hooks = h;
    snprintf(d->kind, sizeof d->kind, "%s", kind);
    snprintf(d->id, sizeof d->id, "%.32s-%llu", room,
             (unsigned long long)event->stamp->sequence);
    h->n++;
    pthread_mutex_lock(&h->lock);
    *h->last = d;
    h->last = &d->next;
    pthread_cond_signal(&h->changed);
    pthread_mutex_unlock(&h->lock);
}

// ---- start and end

int hooks_create(struct server *server, struct hooks **out, char fault[256])
{
    const struct options *o = &server->options;
    *out = NULL;
    if (!o->room_hook[0]) return 0;
    struct hooks *h = calloc(1, sizeof *h);
    if (!h) {
        snprintf(fault, 256, "not enough memory");
        return -1;
    }
    h->server = server;
    h->last = &h->first;
    pthread_mutex_init(&h->lock, NULL);
    pthread_cond_init(&h->changed, NULL);
    int failed = hook_target_parse(o->room_hook, &h->target, fault);
    if (!failed && !o->room_hook_key[0]) {
        snprintf(fault, 256,
                 "--room-hook needs --room-hook-key: a file with the key that signs");
        failed = -1;
    }
    if (!failed) failed = token_read(o->room_hook_key, h->key, fault);
    if (!failed && pthread_create(&h->thread, NULL, run, h)) {
        snprintf(fault, 256, "no thread could be started");
        failed = -1;
    }
    if (!failed) {
        *out = h;
        return 0;
    }
    hook_target_finish(&h->target);
    free(h);
    return -1;
}

void hooks_destroy(struct hooks *h)
{
    if (!h) return;
    pthread_mutex_lock(&h->lock);
    h->closing = true;
    pthread_cond_signal(&h->changed);
    pthread_mutex_unlock(&h->lock);
    pthread_join(h->thread, NULL);
    loop_turn(h->server->loop, 0); // the end of the last one
    for (struct delivery *d = h->first, *next; d; d = next) {
        next = d->next;
        free(d->body);
        free(d);
    }
    hook_target_finish(&h->target);
    sodium_memzero(h->key, sizeof h->key);
    pthread_mutex_destroy(&h->lock);
    pthread_cond_destroy(&h->changed);
    free(h);
}
