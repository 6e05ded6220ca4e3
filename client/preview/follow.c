// SPDX-License-Identifier: MIT
// --follow: a thread takes the room's news; this one has the daemon draw the scene whenever it
// changed, and writes files or a film.
#include "follow.h"

#include "common/picture_ending.h"
#include "common/room_name.h"
#include "scene_request.h"
#include "video.h"

#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <time.h>

struct follow {
    struct relight_client *client;
    const struct options *options;
    char room[RELIGHT_ROOM];
    pthread_mutex_t lock; // all of these
    pthread_cond_t wake;
    cJSON *scene;  // JSON of Scene; NULL: not here yet
    cJSON *people; // array of Participant
    bool changed;  // since the last picture began
    bool stale;    // the scene has to be fetched: somebody undid something
    int ended;     // status of the thread of news, with its error
    struct relight_error error;
};

static volatile sig_atomic_t interrupted;

static void interrupt(int signal)
{
    (void)signal;
    interrupted = 1;
}

static const cJSON *field(const cJSON *object, const char *name)
{
    return cJSON_GetObjectItemCaseSensitive(object, name);
}

static bool holds(const cJSON *person)
{
    return cJSON_GetArraySize(field(person, "hand_parts")) > 0;
}

// ---- news
// ------------------------------------------------------------------------------------

// Replaces the named parts of a scene; a part that `from` lacks goes back to its default.
static void take_parts(cJSON *scene, const cJSON *from, const cJSON *parts)
{
    const cJSON *part;
    cJSON_ArrayForEach(part, parts)
    {
        const char *name = cJSON_IsString(part) ? part->valuestring : "";
        cJSON *value = cJSON_Duplicate(field(from, name), 1);
        cJSON_DeleteItemFromObjectCaseSensitive(scene, name);
        if (value) cJSON_AddItemToObject(scene, name, value);
    }
}

static void take_state(struct follow *f, const cJSON *state)
{
    cJSON *scene = cJSON_Duplicate(field(state, "scene"), 1);
    cJSON_Delete(f->scene);
    f->scene = scene ? scene : cJSON_CreateObject();
    f->changed = true;
}

static void take_event(struct follow *f, const cJSON *event)
{
    const cJSON *action = field(event, "action"), *change = field(action, "scene");
    if (change && f->scene)
        take_parts(f->scene, field(change, "scene"), field(change, "parts"));
    if (field(action, "undo") || field(action, "redo")) f->stale = true;
    if (change || f->stale) f->changed = true;
}

// Adds, replaces or removes a participant. A change that a participant is making, and has not
// finished, is part of the picture: where there is one, before or after, it is drawn again.
static void take_person(struct follow *f, const cJSON *person)
{
    cJSON *old, *next;
    for (old = f->people->child; old; old = next) {
        next = old->next;
        if (!cJSON_Compare(field(old, "key"), field(person, "key"), 1)) continue;
        if (holds(old)) f->changed = true;
        cJSON_Delete(cJSON_DetachItemViaPointer(f->people, old));
    }
    if (cJSON_IsTrue(field(person, "gone"))) return;
    if (holds(person)) f->changed = true;
    cJSON_AddItemToArray(f->people, cJSON_Duplicate(person, 1));
}

static int take_news(void *user, enum relight_room_news news, const char *json)
{
    struct follow *f = user;
    cJSON *message = cJSON_Parse(json);
    const cJSON *item;
    pthread_mutex_lock(&f->lock);
    if (news == RELIGHT_ROOM_STATE) take_state(f, message);
    cJSON_ArrayForEach(item, field(message, "events")) take_event(f, item);
    cJSON_ArrayForEach(item, field(message, "participants")) take_person(f, item);
    if (f->changed) pthread_cond_signal(&f->wake);
    pthread_mutex_unlock(&f->lock);
    cJSON_Delete(message);
    return 0;
}

static void *listen_to_room(void *user)
{
    struct follow *f = user;
    struct relight_error error = {0};
    int status = relight_room_follow(f->client, f->room, "relight-preview", NULL, -1, take_news,
                                     f, &error);
    pthread_mutex_lock(&f->lock);
    f->ended = status ? status : -RELIGHT_E_DISCONNECTED;
    f->error = error;
    pthread_cond_signal(&f->wake);
    pthread_mutex_unlock(&f->lock);
    return NULL;
}

// ---- pictures
// --------------------------------------------------------------------------------

// The scene as the people in the room see it now, the caller's: with the parts that hands hold.
// NULL: nothing changed for a fifth of a second, or the news ended.
static cJSON *next_scene(struct follow *f, bool *stale)
{
    struct timespec until;
    const cJSON *person;
    clock_gettime(CLOCK_REALTIME, &until);
    until.tv_nsec += 200000000;
    if (until.tv_nsec >= 1000000000) until.tv_sec++, until.tv_nsec -= 1000000000;
    pthread_mutex_lock(&f->lock);
    while (!f->ended && (!f->changed || !f->scene))
        if (pthread_cond_timedwait(&f->wake, &f->lock, &until)) break;
    cJSON *scene = NULL;
    if (f->changed && f->scene) {
        scene = cJSON_Duplicate(f->scene, 1);
        cJSON_ArrayForEach(person, f->people)
            take_parts(scene, field(person, "hand"), field(person, "hand_parts"));
        f->changed = false;
        *stale = f->stale;
        f->stale = false;
    }
    pthread_mutex_unlock(&f->lock);
    return scene;
}

// Fetches the room's state; next_scene draws it.
static int fetch(struct follow *f)
{
    char *text;
    struct relight_error error;
    if (relight_room_state(f->client, f->room, &text, NULL, &error)) return report(&error);
    cJSON *state = cJSON_Parse(text);
    free(text);
    pthread_mutex_lock(&f->lock);
    take_state(f, state);
    pthread_mutex_unlock(&f->lock);
    cJSON_Delete(state);
    return EXIT_DONE;
}

static enum relight_image_format format_of(const struct options *o)
{
    enum relight_image_format format;
    const bool is_picture = picture_ending(o->output, &format); // options.c refuses others
    return is_picture ? format : RELIGHT_IMAGE_RGB8;            // a film is made of pixels
}

static int keep(const struct options *o, uint32_t frame, const struct relight_image *image,
                struct video *video)
{
    char path[4096];
    const char *dot = strrchr(o->output, '.');
    if (video && image->n_byte < 3 * (uint64_t)image->width * image->height) return EXIT_FAILED;
    if (video) return video_add(video, image->data) ? EXIT_DONE : EXIT_FAILED;
    snprintf(path, sizeof path, "%.*s-%04u%s", (int)(dot - o->output), o->output, frame, dot);
    FILE *file = fopen(path, "wb");
    bool good = file && fwrite(image->data, 1, image->n_byte, file) == image->n_byte;
    if (file) good = !fclose(file) && good;
    if (!good) {
        fprintf(stderr, "relight-preview: %s: ", path);
        perror(NULL);
        return EXIT_FAILED;
    }
    print_written(o, path, image->width, image->height);
    fflush(stdout);
    return EXIT_DONE;
}

// Whether the daemon draws other scenes, if not this one.
static bool is_refused(int status)
{
    switch (-status) {
    case RELIGHT_E_BAD_REQUEST:
    case RELIGHT_E_NOT_FOUND:
    case RELIGHT_E_BUSY:
    case RELIGHT_E_LIMIT:
    case RELIGHT_E_MISMATCH:
    case RELIGHT_E_NOT_READY:
    case RELIGHT_E_UNSUPPORTED:
    case RELIGHT_E_OUT_OF_RANGE:
    case RELIGHT_E_JOB_FAILED:
        return true;
    default:
        return false;
    }
}

// The room's picture in the size of the options.
static int draw(struct follow *f, const cJSON *scene, uint32_t *n_frame, struct video *video)
{
    const struct options *o = f->options;
    struct scene_request r;
    struct relight_image image;
    struct relight_error error;
    if (scene_request_make(scene, &r, &error)) return report(&error);
    r.request.picture.width = o->width, r.request.picture.height = o->height;
    r.request.picture.format = format_of(o);
    r.request.picture.quality = (uint32_t)o->quality;
    if (video) r.request.picture.transparent = false;
    int status = relight_image(f->client, &r.request, &image, &error);
    scene_request_finish(&r);
    if (status) {
        int failed = report(&error);
        return is_refused(status) ? EXIT_DONE : failed;
    }
    status = keep(o, ++*n_frame, &image, video);
    relight_image_finish(&image);
    return status;
}

static bool has_lights_and_model(const cJSON *scene)
{
    const cJSON *model = field(scene, "model");
    return cJSON_IsString(model) && *model->valuestring &&
           cJSON_GetArraySize(field(scene, "lights")) > 0;
}

static bool has_ended(struct follow *f)
{
    pthread_mutex_lock(&f->lock);
    bool ended = f->ended != 0;
    pthread_mutex_unlock(&f->lock);
    return ended;
}

static int draw_changes(struct follow *f, struct video *video, uint32_t *n_frame)
{
    const struct options *o = f->options;
    int status = EXIT_DONE;
    while (!status && !interrupted && !has_ended(f) && (!o->n_frame || *n_frame < o->n_frame)) {
        bool stale = false;
        cJSON *scene = next_scene(f, &stale);
        if (stale) status = fetch(f); // the next turn draws it
        else if (has_lights_and_model(scene)) status = draw(f, scene, n_frame, video);
        cJSON_Delete(scene);
    }
    if (!status && !interrupted && has_ended(f)) status = report(&f->error);
    return status;
}

int follow_room(struct relight_client *client, const struct options *o)
{
    struct follow f = {.client = client,
                       .options = o,
                       .lock = PTHREAD_MUTEX_INITIALIZER,
                       .wake = PTHREAD_COND_INITIALIZER};
    struct video *video = NULL;
    pthread_t news;
    uint32_t n_frame = 0;
    if (room_is_id(o->follow)) strcpy(f.room, o->follow);
    else if (room_of_word(client, o->follow, f.room, &f.error)) return report(&f.error);
    if (video_is_name(o->output) &&
        !(video = video_open(o->output, o->width, o->height, o->fps)))
        return EXIT_FAILED;
    signal(SIGINT, interrupt);
    signal(SIGTERM, interrupt);
    f.people = cJSON_CreateArray();
    if (!f.people || pthread_create(&news, NULL, listen_to_room, &f)) return EXIT_FAILED;
    int status = draw_changes(&f, video, &n_frame);
    int closed = video ? video_close(video) : EXIT_DONE;
    if (video && !closed) printf("%s: %u pictures\n", o->output, n_frame);
    fflush(stdout);
    exit(status ? status : closed); // the thread of news uses the connection until then
}
