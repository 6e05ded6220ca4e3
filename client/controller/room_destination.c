// SPDX-License-Identifier: MIT
// A review room: the controller sits in it as a participant and changes its shared scene. Edits
// are sent without waiting for the disk, a few at a time; a thread takes their answers, another
// one follows what others change.
#include "control.h"

#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { MOST_OPEN = 16 };

struct room {
    struct destination base; // first
    struct control *control;
    char id[RELIGHT_ROOM];
    uint64_t sequence; // of the room when the program joined
    pthread_t answers, news;
    pthread_mutex_t lock; // all below
    pthread_cond_t wake;
    cJSON *scene, *first; // first: as it was when the program joined
    uint64_t changes;     // of the scene by this program
    bool stale;           // the scene is to be fetched once no edit is open
    uint64_t open[MOST_OPEN];
    uint32_t n_open;
    char said[384]; // the last error
};

static void say_once(struct room *r, const struct relight_error *error)
{
    pthread_mutex_lock(&r->lock);
    bool again = !strcmp(r->said, error->text);
    snprintf(r->said, sizeof r->said, "%s", error->text);
    pthread_mutex_unlock(&r->lock);
    if (!again) report(error);
}

// ---- what others change

// Fetches the scene, unless it is changed meanwhile. *sequence: of the state.
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
    if (r->changes == changes) {
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
        // A room that is gone or closed to this client does not come back.
        if (status == -RELIGHT_E_FORBIDDEN || status == -RELIGHT_E_NOT_FOUND) exit(EXIT_FAILED);
        nanosleep(&pause, NULL);
    }
    return NULL;
}

// ---- what the controls change

// The oldest open edit; 0: none is open, and the scene is stale.
static uint64_t next_open(struct room *r)
{
    pthread_mutex_lock(&r->lock);
    while (!r->n_open && !r->stale) pthread_cond_wait(&r->wake, &r->lock);
    uint64_t id = r->n_open ? r->open[0] : 0;
    pthread_mutex_unlock(&r->lock);
    return id;
}

// false: the connection is lost.
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
    r->open[r->n_open++] = id; // one thread sends
    pthread_cond_broadcast(&r->wake);
    pthread_mutex_unlock(&r->lock);
    return true;
}

static void in_a_second(struct timespec *out)
{
    clock_gettime(CLOCK_REALTIME, out);
    out->tv_sec++;
}

// Undo or redo; the next change begins at what it brought back.
static bool begin_plain(struct room *r, const char *what)
{
    struct timespec end;
    cJSON *action = cJSON_CreateObject();
    cJSON_AddObjectToObject(action, what);
    if (!begin(r, action)) return false;
    set_stale(r);
    in_a_second(&end);
    pthread_mutex_lock(&r->lock);
    while (r->stale && !pthread_cond_timedwait(&r->wake, &r->lock, &end)) continue;
    pthread_mutex_unlock(&r->lock);
    return true;
}

// The action that sends the parts that changed; NULL: nothing did.
static cJSON *scene_action(struct room *r, const struct change *c)
{
    cJSON *parts = cJSON_CreateArray(), *part;
    pthread_mutex_lock(&r->lock);
    bool any = scene_change(r->scene, r->first, c, r->control->options.light, parts);
    r->changes += any;
    cJSON *action = any ? cJSON_CreateObject() : NULL;
    cJSON *change = cJSON_AddObjectToObject(action, "scene");
    cJSON *scene = cJSON_AddObjectToObject(change, "scene");
    cJSON_ArrayForEach(part, parts)
    {
        const cJSON *value = cJSON_GetObjectItemCaseSensitive(r->scene, part->valuestring);
        if (value && any)
            cJSON_AddItemToObject(scene, part->valuestring, cJSON_Duplicate(value, 1));
    }
    pthread_mutex_unlock(&r->lock);
    if (any) cJSON_AddItemToObject(change, "parts", parts);
    else cJSON_Delete(parts);
    return action;
}

static bool send(void *user, const struct change *c)
{
    struct room *r = user;
    bool sent = false;
    cJSON *action = scene_action(r, c);
    if (action) sent = begin(r, action);
    if (c->undo) sent |= begin_plain(r, "undo");
    if (c->redo) sent |= begin_plain(r, "redo");
    return sent;
}

// Waits until the last edits are on the disk.
static void stop(struct destination *base)
{
    struct room *r = (struct room *)base;
    struct timespec end;
    in_a_second(&end);
    pthread_mutex_lock(&r->lock);
    while (r->n_open && !pthread_cond_timedwait(&r->wake, &r->lock, &end)) continue;
    pthread_mutex_unlock(&r->lock);
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
    pthread_mutex_init(&r->lock, NULL);
    pthread_cond_init(&r->wake, NULL);
    // The client closes when the program ends: the threads end with it.
    if (!fetch(r, &r->sequence, &error) &&
        !pthread_create(&r->answers, NULL, take_answers, r) &&
        !pthread_create(&r->news, NULL, follow, r)) {
        pthread_detach(r->answers);
        pthread_detach(r->news);
        return &r->base;
    }
    *status = report(&error);
    cJSON_Delete(r->scene);
    cJSON_Delete(r->first);
    free(r);
    return NULL;
}
