// SPDX-License-Identifier: MIT
// A review room: the controller takes part in it and changes its shared scene. While a control
// moves, the other participants see the change as presence; when the controls rest, one edit
// records it. Edits are sent without waiting for the disk. One thread receives their answers, a
// second one the changes of other participants, a third one sends the edit when the controls
// rest.
#include "control.h"

#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { MOST_OPEN = 16 };
static const uint64_t rest_ns = 250000000;   // without a movement until the edit is sent
static const uint64_t most_ns = 10000000000; // between edits while the controls do not rest

struct room {
    struct destination base; // first
    struct control *control;
    char id[RELIGHT_ROOM];
    uint64_t sequence; // of the room when the program joined
    pthread_t answers, news, keeper;
    pthread_mutex_t sending; // one edit after another
    pthread_mutex_t lock;    // all below
    pthread_cond_t wake;
    cJSON *scene, *first; // first: the scene when the program joined
    uint64_t changes;     // of the scene by this program
    bool stale;           // the scene is to be fetched once no edit is open
    uint64_t open[MOST_OPEN];
    uint32_t n_open;
    bool keeping;     // the edit that records what was held is being sent
    cJSON *held;      // names of the parts that were moved since the last edit; NULL: none
    uint64_t rest_at; // time of the edit that records them, CLOCK_MONOTONIC, ns
    uint64_t keep_at; // the latest time for that edit
    char said[384];   // the last error
};

static void say_once(struct room *r, const struct relight_error *error)
{
    pthread_mutex_lock(&r->lock);
    bool again = !strcmp(r->said, error->text);
    snprintf(r->said, sizeof r->said, "%s", error->text);
    pthread_mutex_unlock(&r->lock);
    if (!again) report(error);
}

// ---- changes of other participants

// Whether the scene has changes of this program that the daemon may not have yet. The caller
// holds the lock.
static bool is_ahead(const struct room *r)
{
    return r->held || r->keeping || r->n_open;
}

// Fetches the scene; it is dropped where this program changed its own meanwhile, or is ahead of
// it. *sequence: that of the state.
static int fetch(struct room *r, uint64_t *sequence, struct relight_error *error)
{
    char *text;
    struct relight_room_info info;
    pthread_mutex_lock(&r->lock);
    uint64_t changes = r->changes;
    pthread_mutex_unlock(&r->lock);
    int status = relight_room_state(r->control->client, r->id, &text, &info, error);
    if (status) return status;
    cJSON *state = cJSON_Parse(text);
    cJSON *scene = cJSON_DetachItemFromObjectCaseSensitive(state, "scene");
    free(text);
    cJSON_Delete(state);
    if (!scene) scene = cJSON_CreateObject();
    pthread_mutex_lock(&r->lock);
    if (r->changes == changes && !is_ahead(r)) {
        cJSON_Delete(r->scene);
        r->scene = scene;
        r->stale = false;
        if (!r->first) r->first = cJSON_Duplicate(scene, 1);
        pthread_cond_broadcast(&r->wake);
    } else {
        cJSON_Delete(scene);
    }
    pthread_mutex_unlock(&r->lock);
    *sequence = info.sequence;
    return 0;
}

static void set_stale(struct room *r)
{
    pthread_mutex_lock(&r->lock);
    r->stale = true;
    pthread_cond_broadcast(&r->wake);
    pthread_mutex_unlock(&r->lock);
}

static void take_parts(struct room *r, const cJSON *change)
{
    const cJSON *scene = cJSON_GetObjectItemCaseSensitive(change, "scene"), *part;
    pthread_mutex_lock(&r->lock);
    cJSON_ArrayForEach(part, cJSON_GetObjectItemCaseSensitive(change, "parts"))
    {
        const char *name = cJSON_IsString(part) ? part->valuestring : "";
        cJSON *value = cJSON_Duplicate(cJSON_GetObjectItemCaseSensitive(scene, name), 1);
        cJSON_DeleteItemFromObjectCaseSensitive(r->scene, name);
        if (value) cJSON_AddItemToObject(r->scene, name, value);
    }
    pthread_mutex_unlock(&r->lock);
}

static void take_event(struct room *r, const cJSON *event)
{
    const cJSON *action = cJSON_GetObjectItemCaseSensitive(event, "action");
    const cJSON *author = cJSON_GetObjectItemCaseSensitive(event, "client");
    const cJSON *change = cJSON_GetObjectItemCaseSensitive(action, "scene");
    bool own = cJSON_IsString(author) && !strcmp(author->valuestring, relight_room_author());
    if (change && !own) take_parts(r, change);
    if (cJSON_HasObjectItem(action, "undo") || cJSON_HasObjectItem(action, "redo"))
        set_stale(r);
}

static int take_news(void *user, enum relight_room_news news, const char *json)
{
    struct room *r = user;
    if (news == RELIGHT_ROOM_PRESENCE) return 0;
    cJSON *message = cJSON_Parse(json);
    const cJSON *event;
    if (news == RELIGHT_ROOM_STATE) set_stale(r);
    cJSON_ArrayForEach(event, cJSON_GetObjectItemCaseSensitive(message, "events"))
        take_event(r, event);
    cJSON_Delete(message);
    show_connected(r->control, true);
    return 0;
}

static void *follow(void *user)
{
    struct room *r = user;
    uint64_t after = r->sequence;
    for (;;) {
        struct relight_error error = {0};
        struct timespec pause = {1, 0};
        int status = relight_room_follow(r->control->client, r->id, r->control->me, &after, -1,
                                         take_news, r, &error);
        show_connected(r->control, false);
        if (status) say_once(r, &error);
        // A room that was deleted, or that refuses this client, will not answer again.
        if (status == -RELIGHT_E_FORBIDDEN || status == -RELIGHT_E_NOT_FOUND) exit(EXIT_FAILED);
        nanosleep(&pause, NULL);
    }
    return NULL;
}

// ---- edits

// Waits for an open edit, and returns the oldest; 0: none is open, the scene is stale, and the
// hand holds none of its parts.
static uint64_t next_open(struct room *r)
{
    pthread_mutex_lock(&r->lock);
    while (!r->n_open && (!r->stale || is_ahead(r))) pthread_cond_wait(&r->wake, &r->lock);
    uint64_t id = r->n_open ? r->open[0] : 0;
    pthread_mutex_unlock(&r->lock);
    return id;
}

static bool present(struct room *r);

// Takes the answer of an edit. Returns false where the connection is lost.
static bool take_answer(struct room *r, uint64_t id)
{
    struct relight_error error;
    int status = relight_room_edit_end(r->control->client, id, NULL, &error);
    pthread_mutex_lock(&r->lock);
    memmove(r->open, r->open + 1, --r->n_open * sizeof *r->open);
    if (!status) r->said[0] = 0;
    else r->stale = true; // the change was refused
    pthread_cond_broadcast(&r->wake);
    pthread_mutex_unlock(&r->lock);
    if (status) say_once(r, &error);
    else present(r); // without the parts that the edit recorded
    return status != -RELIGHT_E_DISCONNECTED;
}

static void *take_answers(void *user)
{
    struct room *r = user;
    for (;;) {
        struct relight_error error;
        struct timespec pause = {0, 200000000};
        uint64_t id = next_open(r), sequence;
        int status = id ? 0 : fetch(r, &sequence, &error);
        if (status) say_once(r, &error);
        if (id ? take_answer(r, id) : !status) continue;
        show_connected(r->control, false);
        nanosleep(&pause, NULL);
    }
    return NULL;
}

static bool begin(struct room *r, cJSON *action)
{
    struct relight_error error;
    uint64_t id;
    char *text = cJSON_PrintUnformatted(action);
    cJSON_Delete(action);
    pthread_mutex_lock(&r->lock);
    while (r->n_open == MOST_OPEN) pthread_cond_wait(&r->wake, &r->lock);
    pthread_mutex_unlock(&r->lock);
    int status = relight_room_edit_begin(r->control->client, r->id, text ? text : "",
                                         r->control->me, &id, &error);
    free(text);
    if (status) {
        say_once(r, &error);
        return false;
    }
    pthread_mutex_lock(&r->lock);
    r->open[r->n_open++] = id;
    pthread_cond_broadcast(&r->wake);
    pthread_mutex_unlock(&r->lock);
    return true;
}

static void in_a_second(struct timespec *out)
{
    clock_gettime(CLOCK_REALTIME, out);
    out->tv_sec++;
}

// Undo or redo. Waits for the scene after it, from which the next change begins.
static bool begin_plain(struct room *r, const char *what)
{
    struct timespec end;
    cJSON *action = cJSON_CreateObject();
    cJSON_AddObjectToObject(action, what);
    pthread_mutex_lock(&r->sending);
    bool begun = begin(r, action);
    pthread_mutex_unlock(&r->sending);
    if (!begun) return false;
    set_stale(r);
    in_a_second(&end);
    pthread_mutex_lock(&r->lock);
    while (r->stale && !pthread_cond_timedwait(&r->wake, &r->lock, &end)) continue;
    pthread_mutex_unlock(&r->lock);
    return true;
}

static uint64_t monotonic_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000 + (uint64_t)t.tv_nsec;
}

// ---- movements: presence while they last, one edit when the controls rest

// The named parts of the scene. The caller holds the lock.
static cJSON *scene_of(const struct room *r, const cJSON *parts)
{
    cJSON *scene = cJSON_CreateObject();
    const cJSON *part;
    cJSON_ArrayForEach(part, parts)
    {
        const cJSON *value = cJSON_GetObjectItemCaseSensitive(r->scene, part->valuestring);
        if (value) cJSON_AddItemToObject(scene, part->valuestring, cJSON_Duplicate(value, 1));
    }
    return scene;
}

// Sends the moved parts, or none, as presence. NOT_FOUND is no error: the program has no seat
// in the room yet.
static bool present(struct room *r)
{
    struct relight_error error;
    cJSON *me = cJSON_CreateObject();
    cJSON_AddStringToObject(me, "name", r->control->me);
    pthread_mutex_lock(&r->lock);
    if (r->held) {
        cJSON_AddItemToObject(me, "hand", scene_of(r, r->held));
        cJSON_AddItemToObject(me, "hand_parts", cJSON_Duplicate(r->held, 1));
    }
    pthread_mutex_unlock(&r->lock);
    char *text = cJSON_PrintUnformatted(me);
    int status = relight_room_present(r->control->client, r->id, text ? text : "", &error);
    cJSON_Delete(me);
    free(text);
    if (status && status != -RELIGHT_E_NOT_FOUND) say_once(r, &error);
    return !status || status == -RELIGHT_E_NOT_FOUND;
}

static void hold(struct room *r, const cJSON *parts)
{
    const cJSON *part, *held;
    uint64_t now = monotonic_ns();
    if (!r->held) {
        r->held = cJSON_CreateArray();
        r->keep_at = now + most_ns;
    }
    r->rest_at = now + rest_ns < r->keep_at ? now + rest_ns : r->keep_at;
    cJSON_ArrayForEach(part, parts)
    {
        bool known = false;
        cJSON_ArrayForEach(held, r->held) known |=
            !strcmp(held->valuestring, part->valuestring);
        if (!known) cJSON_AddItemToArray(r->held, cJSON_CreateString(part->valuestring));
    }
    pthread_cond_broadcast(&r->wake);
}

// Sends the moved parts as an edit, before any later edit.
static void keep(struct room *r)
{
    cJSON *action = NULL;
    pthread_mutex_lock(&r->sending);
    pthread_mutex_lock(&r->lock);
    if (r->held) {
        action = cJSON_CreateObject();
        cJSON *change = cJSON_AddObjectToObject(action, "scene");
        cJSON_AddItemToObject(change, "scene", scene_of(r, r->held));
        cJSON_AddItemToObject(change, "parts", r->held);
        r->held = NULL;
        r->keeping = true;
    }
    pthread_mutex_unlock(&r->lock);
    if (action) begin(r, action);
    pthread_mutex_lock(&r->lock);
    r->keeping = false;
    pthread_cond_broadcast(&r->wake);
    pthread_mutex_unlock(&r->lock);
    pthread_mutex_unlock(&r->sending);
}

static void *keep_always(void *user)
{
    struct room *r = user;
    pthread_mutex_lock(&r->lock);
    for (;;) {
        uint64_t now = monotonic_ns();
        if (!r->held) {
            pthread_cond_wait(&r->wake, &r->lock);
        } else if (now < r->rest_at) {
            struct timespec end;
            clock_gettime(CLOCK_REALTIME, &end);
            uint64_t ns = (uint64_t)end.tv_nsec + r->rest_at - now;
            end.tv_sec += (time_t)(ns / 1000000000);
            end.tv_nsec = (long)(ns % 1000000000);
            pthread_cond_timedwait(&r->wake, &r->lock, &end);
        } else {
            pthread_mutex_unlock(&r->lock);
            keep(r);
            pthread_mutex_lock(&r->lock);
        }
    }
    return NULL;
}

// Applies a change to the scene. Returns false where the scene stays as it is.
static bool move(struct room *r, const struct change *c)
{
    cJSON *parts = cJSON_CreateArray();
    pthread_mutex_lock(&r->lock);
    bool any = scene_change(r->scene, r->first, c, r->control->options.light, parts);
    r->changes += any;
    if (any) hold(r, parts);
    pthread_mutex_unlock(&r->lock);
    cJSON_Delete(parts);
    return any;
}

static bool send(void *user, const struct change *c)
{
    struct room *r = user;
    bool sent = move(r, c) && present(r);
    if (c->undo || c->redo) keep(r);
    if (c->undo) sent |= begin_plain(r, "undo");
    if (c->redo) sent |= begin_plain(r, "redo");
    return sent;
}

// Waits until the last edits are on the disk.
static void stop(struct destination *base)
{
    struct room *r = (struct room *)base;
    struct timespec end;
    keep(r);
    in_a_second(&end);
    pthread_mutex_lock(&r->lock);
    while (r->n_open && !pthread_cond_timedwait(&r->wake, &r->lock, &end)) continue;
    pthread_mutex_unlock(&r->lock);
}

// Lights come and go while the room is open: a note.
static void note_light(const struct room *r)
{
    int n = cJSON_GetArraySize(cJSON_GetObjectItemCaseSensitive(r->first, "lights"));
    if (r->control->options.light >= n)
        say("--light %d: the room has %d %s now", r->control->options.light + 1, n,
            n == 1 ? "light" : "lights");
}

struct destination *open_room(struct control *control, const char *id, int *status)
{
    struct room *r = calloc(1, sizeof *r);
    struct relight_error error = {.code = RELIGHT_E_NO_MEMORY, .text = "not enough memory"};
    if (!r) {
        *status = report(&error);
        return NULL;
    }
    *r = (struct room){.base = {send, stop}, .control = control};
    snprintf(r->id, sizeof r->id, "%s", id);
    pthread_mutex_init(&r->sending, NULL);
    pthread_mutex_init(&r->lock, NULL);
    pthread_cond_init(&r->wake, NULL);
    // The client closes when the program ends: the threads end with it.
    if (!fetch(r, &r->sequence, &error) &&
        !pthread_create(&r->answers, NULL, take_answers, r) &&
        !pthread_create(&r->news, NULL, follow, r) &&
        !pthread_create(&r->keeper, NULL, keep_always, r)) {
        pthread_detach(r->answers);
        pthread_detach(r->keeper);
        pthread_detach(r->news);
        note_light(r);
        return &r->base;
    }
    *status = report(&error);
    cJSON_Delete(r->scene);
    cJSON_Delete(r->first);
    free(r);
    return NULL;
}
