// SPDX-License-Identifier: MIT
// Review rooms: scenes, actions and states as JSON texts with the fields of relight.proto.
#include "internal.h"
#include "new_file.h"

#include "message_text.h"

#include <errno.h>
#include <stdio.h>
#include <sys/random.h>
#include <time.h>
#include <unistd.h>

static int no_memory(struct relight_error *error)
{
    return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
}

// ---- JSON and messages

static int parse(const char *text, const ProtobufCMessageDescriptor *descriptor,
                 ProtobufCMessage **out, struct relight_error *error)
{
    char fault[MESSAGE_TEXT_ERROR] = "not an object";
    cJSON *json = cJSON_Parse(text);
    ProtobufCMessage *message = message_new(descriptor);
    int failed = !message || !cJSON_IsObject(json) || message_from_json(message, json, fault);
    cJSON_Delete(json);
    if (!failed) {
        *out = message;
        return 0;
    }
    if (!message) return no_memory(error);
    protobuf_c_message_free_unpacked(message, NULL);
    return relight_fail(error, RELIGHT_E_ARGUMENT, "", "%s: %s", descriptor->short_name, fault);
}

static int print(const ProtobufCMessage *message, char **out, struct relight_error *error)
{
    cJSON *json = message ? message_to_json(message) : NULL;
    *out = json ? cJSON_PrintUnformatted(json) : NULL;
    cJSON_Delete(json);
    return *out ? 0 : no_memory(error);
}

// The payload is a packed message of this type.
static int print_payload(const struct answer *answer,
                         const ProtobufCMessageDescriptor *descriptor, char **out,
                         struct relight_error *error)
{
    ProtobufCMessage *message = protobuf_c_message_unpack(
        descriptor, NULL, (size_t)answer->payload_size, answer->payload);
    if (!message)
        return relight_fail(error, RELIGHT_E_PROTOCOL, "update the client",
                            "the daemon's %s does not parse", descriptor->short_name);
    int status = print(message, out, error);
    protobuf_c_message_free_unpacked(message, NULL);
    return status;
}

// ---- requests

int relight_room_create(struct relight_client *client, const char *name, const char *scene,
                        const char *me, char room[RELIGHT_ROOM], struct relight_error *error)
{
    Relight__RoomCreateRequest m = RELIGHT__ROOM_CREATE_REQUEST__INIT;
    struct answer *answer;
    ProtobufCMessage *parsed = NULL;
    int status = scene ? parse(scene, &relight__scene__descriptor, &parsed, error) : 0;
    if (status) return status;
    m.name = relight_text(name);
    m.me = relight_text(me);
    m.scene = (Relight__Scene *)parsed;
    status = relight_call(client, RELIGHT_TYPE_ROOM_CREATE, &m.base, &answer, error);
    if (parsed) protobuf_c_message_free_unpacked(parsed, NULL);
    if (status) return status;
    snprintf(room, RELIGHT_ROOM, "%s", ((Relight__RoomCreateAnswer *)answer->message)->room);
    relight_answer_free(answer);
    return 0;
}

int relight_room_list(struct relight_client *client, char **json, struct relight_error *error)
{
    Relight__RoomListRequest m = RELIGHT__ROOM_LIST_REQUEST__INIT;
    struct answer *answer;
    int status = relight_call(client, RELIGHT_TYPE_ROOM_LIST, &m.base, &answer, error);
    if (status) return status;
    status = print(answer->message, json, error);
    relight_answer_free(answer);
    return status;
}

int relight_room_state(struct relight_client *client, const char *room, char **json,
                       struct relight_room_info *info, struct relight_error *error)
{
    Relight__RoomGetRequest m = RELIGHT__ROOM_GET_REQUEST__INIT;
    struct answer *answer;
    m.room = relight_text(room);
    int status = relight_call(client, RELIGHT_TYPE_ROOM_GET, &m.base, &answer, error);
    if (status) return status;
    const Relight__RoomGetAnswer *a = (Relight__RoomGetAnswer *)answer->message;
    if (info) {
        *info = (struct relight_room_info){.sequence = a->sequence, .role = (int)a->role};
        snprintf(info->hash, sizeof info->hash, "%s", a->hash);
    }
    status = print_payload(answer, &relight__room_state__descriptor, json, error);
    relight_answer_free(answer);
    return status;
}

int relight_room_log(struct relight_client *client, const char *room, uint64_t after,
                     char **json, uint64_t *last, struct relight_error *error)
{
    Relight__RoomGetRequest m = RELIGHT__ROOM_GET_REQUEST__INIT;
    struct answer *answer;
    m.room = relight_text(room);
    m.events = true;
    m.after = after;
    int status = relight_call(client, RELIGHT_TYPE_ROOM_GET, &m.base, &answer, error);
    if (status) return status;
    *last = ((Relight__RoomGetAnswer *)answer->message)->last;
    status = print_payload(answer, &relight__room_events__descriptor, json, error);
    relight_answer_free(answer);
    return status;
}

// ---- edits

// RoomEditRequest.client of this process and its last number; the lock is held from a number to
// the end of its edit, or until it is sent where nobody sends it again.
static pthread_mutex_t edit_lock = PTHREAD_MUTEX_INITIALIZER;
static uint64_t edit_number;
static char edit_author[17];
static pthread_once_t author_once = PTHREAD_ONCE_INIT;

static void make_author(void)
{
    uint64_t random;
    if (getrandom(&random, sizeof random, 0) == sizeof random)
        snprintf(edit_author, sizeof edit_author, "%016llx", (unsigned long long)random);
}

const char *relight_room_author(void)
{
    pthread_once(&author_once, make_author);
    return edit_author;
}

// A connection that was lost while an edit was under way: the same number is done once.
static int edit(struct relight_client *client, Relight__RoomEditRequest *m,
                struct answer **answer, struct relight_error *error)
{
    m->client = relight_text(relight_room_author());
    pthread_mutex_lock(&edit_lock); // one edit of a `client` at a time
    m->number = ++edit_number;
    int status;
    for (int tries = 0;; tries++) {
        struct timespec pause = {0, 100000000};
        struct relight_error fault;
        status = relight_call(client, RELIGHT_TYPE_ROOM_EDIT, &m->base, answer, &fault);
        bool gone = status == -RELIGHT_E_DISCONNECTED || status == -RELIGHT_E_SHUTTING_DOWN;
        if (status && error) *error = fault;
        if (!gone || !relight_reconnects(client) || tries == 100) break;
        nanosleep(&pause, NULL);
    }
    pthread_mutex_unlock(&edit_lock);
    return status;
}

static void get_edited(const struct answer *answer, struct relight_room_edited *out)
{
    const Relight__RoomEditAnswer *a = (Relight__RoomEditAnswer *)answer->message;
    if (!out) return;
    *out = (struct relight_room_edited){
        .sequence = a->sequence, .time_us = a->time_us, .repeated = a->repeated};
    snprintf(out->secret, sizeof out->secret, "%s", a->secret);
}

int relight_room_edit_begin(struct relight_client *client, const char *room, const char *action,
                            const char *me, uint64_t *id, struct relight_error *error)
{
    Relight__RoomEditRequest m = RELIGHT__ROOM_EDIT_REQUEST__INIT;
    ProtobufCMessage *parsed;
    int status = parse(action, &relight__room_action__descriptor, &parsed, error);
    if (status) return status;
    m.room = relight_text(room);
    m.name = relight_text(me);
    m.action = (Relight__RoomAction *)parsed;
    m.client = relight_text(relight_room_author());
    pthread_mutex_lock(&edit_lock);
    m.number = ++edit_number;
    status = relight_start(client, RELIGHT_TYPE_ROOM_EDIT, &m.base, NULL, 0,
                           relight_timeout(client), false, id, error);
    pthread_mutex_unlock(&edit_lock);
    protobuf_c_message_free_unpacked(parsed, NULL);
    return status;
}

int relight_room_edit_end(struct relight_client *client, uint64_t id,
                          struct relight_room_edited *out, struct relight_error *error)
{
    struct answer *answer;
    int status = relight_end(client, id, RELIGHT_TYPE_ROOM_EDIT, &answer, error);
    if (status) return status;
    get_edited(answer, out);
    relight_answer_free(answer);
    return 0;
}

int relight_room_edit(struct relight_client *client, const char *room, const char *action,
                      const char *me, struct relight_room_edited *out,
                      struct relight_error *error)
{
    Relight__RoomEditRequest m = RELIGHT__ROOM_EDIT_REQUEST__INIT;
    struct answer *answer;
    ProtobufCMessage *parsed;
    int status = parse(action, &relight__room_action__descriptor, &parsed, error);
    if (status) return status;
    m.room = relight_text(room);
    m.name = relight_text(me);
    m.action = (Relight__RoomAction *)parsed;
    status = edit(client, &m, &answer, error);
    protobuf_c_message_free_unpacked(parsed, NULL);
    if (status) return status;
    get_edited(answer, out);
    relight_answer_free(answer);
    return 0;
}

// ---- pictures and copies

int relight_room_picture(struct relight_client *client, const char *room,
                         const struct relight_room_view *view, struct relight_image *out,
                         struct relight_error *error)
{
    Relight__RoomPictureRequest m = RELIGHT__ROOM_PICTURE_REQUEST__INIT;
    struct answer *answer;
    struct relight_image image;
    m.room = relight_text(room);
    m.pin = view->pin;
    m.decision = view->decision;
    m.revision = view->revision;
    m.width = view->width;
    m.height = view->height;
    m.format = (Relight__ImageFormat)view->format;
    int status = relight_call(client, RELIGHT_TYPE_ROOM_PICTURE, &m.base, &answer, error);
    if (status) return status;
    status = relight_get_image((Relight__ImageAnswer *)answer->message, answer->payload,
                               answer->payload_size, &image, error);
    if (status) {
        relight_answer_free(answer);
        return status;
    }
    if (!(image.owner = relight_owner(answer))) return no_memory(error);
    *out = image;
    return 0;
}

static int copy(struct relight_client *client, FILE *file, relight_progress_fn fn, void *user,
                uint64_t *size, struct relight_error *error)
{
    Relight__RoomBackupRequest m = RELIGHT__ROOM_BACKUP_REQUEST__INIT;
    char backup[64] = "";
    double begin_s = relight_now_s();
    int status = 0;
    *size = 1;
    m.backup = backup;
    while (!status && m.offset < *size) {
        struct answer *answer;
        status = relight_call(client, RELIGHT_TYPE_ROOM_BACKUP, &m.base, &answer, error);
        if (status) return status;
        const Relight__RoomBackupAnswer *a = (Relight__RoomBackupAnswer *)answer->message;
        *size = a->size;
        snprintf(backup, sizeof backup, "%s", a->backup);
        if (!answer->payload_size)
            status = relight_fail(error, RELIGHT_E_PROTOCOL, "", "the copy ends early");
        else if (fwrite(answer->payload, 1, answer->payload_size, file) != answer->payload_size)
            status = relight_fail(error, RELIGHT_E_FILE, "", "%s", strerror(errno));
        m.offset += answer->payload_size;
        relight_answer_free(answer);
        struct relight_progress progress = {"copy",
                                            (double)m.offset / (double)(*size ? *size : 1), -1,
                                            relight_now_s() - begin_s, RELIGHT_JOB_RUNNING};
        if (!status && fn && fn(user, &progress))
            status = relight_fail(error, RELIGHT_E_CANCELLED, "", "stopped");
    }
    return status;
}

int relight_room_backup(struct relight_client *client, const char *path, relight_progress_fn fn,
                        void *user, uint64_t *size, struct relight_error *error)
{
    uint64_t total = 0;
    struct new_file file;
    int status = relight_new_file(&file, path, error);
    if (status) return status;
    status = copy(client, file.file, fn, user, &total, error);
    status = relight_new_file_end(&file, status, error);
    if (!status && size) *size = total;
    return status;
}

// ---- the medium

static int ask_medium(struct relight_client *client, const Relight__MaterialRequest *m,
                      struct relight_medium *out, struct relight_error *error)
{
    struct answer *answer;
    int status = relight_call(client, RELIGHT_TYPE_MATERIAL, &m->base, &answer, error);
    if (status) return status;
    const Relight__MaterialAnswer *a = (Relight__MaterialAnswer *)answer->message;
    const Relight__Vec3 *from[] = {a->reflectance, a->mean_free_path, a->sigma_t, a->g};
    struct owner *owner = relight_owner(answer);
    if (!owner) return no_memory(error);
    *out = (struct relight_medium){.owner = owner,
                                   .profile = a->profile,
                                   .eta = a->eta,
                                   .roughness = a->roughness,
                                   .json = a->json,
                                   .n_warning = a->n_warnings,
                                   .warning = (const char *const *)a->warnings};
    float *to[] = {out->reflectance, out->mean_free_path_mm, out->sigma_t, out->g};
    for (int i = 0; i < 4 && from[i]; i++) {
        to[i][0] = from[i]->x;
        to[i][1] = from[i]->y;
        to[i][2] = from[i]->z;
    }
    return 0;
}

int relight_material(struct relight_client *client, const char *material,
                     struct relight_medium *out, struct relight_error *error)
{
    Relight__MaterialRequest m = RELIGHT__MATERIAL_REQUEST__INIT;
    m.material = relight_text(material);
    return ask_medium(client, &m, out, error);
}

int relight_material_file(struct relight_client *client, const char *path, const char *name,
                          struct relight_medium *out, struct relight_error *error)
{
    Relight__MaterialRequest m = RELIGHT__MATERIAL_REQUEST__INIT;
    char hash[65];
    int status = relight_upload_file(client, path, NULL, NULL, hash, NULL, error);
    m.material = relight_text(name);
    m.blob = hash;
    return status ? status : ask_medium(client, &m, out, error);
}

void relight_medium_finish(struct relight_medium *medium)
{
    relight_owner_free(medium->owner);
    *medium = (struct relight_medium){0};
}

// ---- following a room

static int take_news(const struct answer *answer, uint64_t *after, relight_room_fn fn,
                     void *user, struct relight_error *error)
{
    static const struct {
        int kind;
        const ProtobufCMessageDescriptor *descriptor;
    } kinds[] = {
        {RELIGHT__EVENT_KIND__EVENT_ROOM_STATE, &relight__room_state__descriptor},
        {RELIGHT__EVENT_KIND__EVENT_ROOM_EVENTS, &relight__room_events__descriptor},
        {RELIGHT__EVENT_KIND__EVENT_ROOM_PRESENCE, &relight__presence__descriptor},
    };
    const Relight__Event *e = (Relight__Event *)answer->message;
    for (int i = 0; i < 3; i++) {
        char *json;
        if ((int)e->kind != kinds[i].kind) continue;
        int status = print_payload(answer, kinds[i].descriptor, &json, error);
        if (status) return status;
        int stop = fn(user, (enum relight_room_news)i, json);
        free(json);
        if (i < 2) *after = e->sequence;
        return stop ? 1 : 0;
    }
    return 0;
}

// Seats that threads of this process have: ROOM_PRESENCE names the SUBSCRIBE of its connection.
struct seat {
    struct seat *next;
    const struct relight_client *client;
    const char *room;
    uint64_t id;
};
static pthread_mutex_t seat_lock = PTHREAD_MUTEX_INITIALIZER;
static struct seat *seats;

static void sit(struct seat *seat)
{
    pthread_mutex_lock(&seat_lock);
    seat->next = seats;
    seats = seat;
    pthread_mutex_unlock(&seat_lock);
}

static void stand_up(const struct seat *seat)
{
    struct seat **at = &seats;
    pthread_mutex_lock(&seat_lock);
    while (*at != seat) at = &(*at)->next;
    *at = seat->next;
    pthread_mutex_unlock(&seat_lock);
}

// 0: nobody sits there.
static uint64_t seat_of(const struct relight_client *client, const char *room)
{
    uint64_t id = 0;
    pthread_mutex_lock(&seat_lock);
    for (const struct seat *s = seats; s && !id; s = s->next)
        if (s->client == client && !strcmp(s->room, room)) id = s->id;
    pthread_mutex_unlock(&seat_lock);
    return id;
}

int relight_room_present(struct relight_client *client, const char *room,
                         const char *participant, struct relight_error *error)
{
    Relight__RoomPresenceRequest m = RELIGHT__ROOM_PRESENCE_REQUEST__INIT;
    ProtobufCMessage *parsed;
    int status = parse(participant, &relight__participant__descriptor, &parsed, error);
    if (status) return status;
    m.subscription = seat_of(client, room);
    m.me = (Relight__Participant *)parsed;
    if (m.subscription)
        status = relight_start(client, RELIGHT_TYPE_ROOM_PRESENCE, &m.base, NULL, 0, 0, true,
                               NULL, error);
    else
        status = relight_fail(error, RELIGHT_E_NOT_FOUND, "relight_room_follow takes a seat",
                              "nobody of this process sits in the room");
    protobuf_c_message_free_unpacked(parsed, NULL);
    return status;
}

// Takes what comes until fn or the time ends it.
static int take_all(struct relight_client *client, uint64_t id, uint64_t *after, double wait_s,
                    relight_room_fn fn, void *user, struct relight_error *error)
{
    int status = 0;
    while (!status) {
        struct answer *answer;
        status = relight_next(client, id, wait_s < 0 ? 1e9 : wait_s, &answer, error);
        if (status == -RELIGHT_E_TIMEOUT) {
            relight_forget(client, id);
            return 0;
        }
        if (status) return status;
        status = answer->type == (RELIGHT_TYPE_SUBSCRIBE | RELIGHT_TYPE_ANSWER)
                     ? take_news(answer, after, fn, user, error)
                     : relight_fail(error, RELIGHT_E_PROTOCOL, "", "unexpected answer");
        relight_answer_free(answer);
        if (status) relight_forget(client, id);
    }
    return status;
}

static int follow(struct relight_client *client, const char *room, const char *me,
                  uint64_t *after, double wait_s, relight_room_fn fn, void *user,
                  struct relight_error *error)
{
    Relight__SubscribeRequest m = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    Relight__Participant self = RELIGHT__PARTICIPANT__INIT;
    uint64_t id;
    self.name = relight_text(me);
    m.room = relight_text(room);
    m.after = *after;
    m.me = &self;
    int status =
        relight_start(client, RELIGHT_TYPE_SUBSCRIBE, &m.base, NULL, 0, 0, false, &id, error);
    if (status) return status;
    struct seat seat = {.client = client, .room = room, .id = id};
    sit(&seat);
    status = take_all(client, id, after, wait_s, fn, user, error);
    stand_up(&seat);
    return status;
}

int relight_room_follow(struct relight_client *client, const char *room, const char *me,
                        uint64_t *after, double wait_s, relight_room_fn fn, void *user,
                        struct relight_error *error)
{
    uint64_t own = 0;
    struct relight_error fault;
    if (!after) after = &own;
    for (;;) {
        int status = follow(client, room, me, after, wait_s, fn, user, &fault);
        bool gone = status == -RELIGHT_E_DISCONNECTED || status == -RELIGHT_E_SHUTTING_DOWN;
        if (status >= 0) return 0;
        if (gone && relight_reconnects(client)) {
            struct timespec pause = {0, 100000000};
            nanosleep(&pause, NULL);
            continue;
        }
        if (error) *error = fault;
        return status;
    }
}
