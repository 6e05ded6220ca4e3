/* SPDX-License-Identifier: MIT */
/* state.h owns what the files of the fold share: copies and lists of messages. All memory is
 * malloc()'s, so that protobuf_c_message_free_unpacked frees a state. */
#ifndef RELIGHTD_ROOMS_STATE_H
#define RELIGHTD_ROOMS_STATE_H

#include "rooms/fold.h"

/* An event on its way into a state. */
struct folding {
    Relight__RoomState *state;
    const Relight__RoomEvent *event;
    const Relight__RoomAction *action;
    char *error; /* [ROOM_ERROR] */
};

/* Bytes of memory that a message takes with all that it holds, those of the allocator
 * included. NULL: 0. */
size_t message_memory(const void *message);
/* Bytes that an event adds to a state at most. */
size_t event_memory(const Relight__RoomState *state, const Relight__RoomEvent *event);
/* Copies; NULL without memory (or for NULL). */
void *message_copy(const void *message);
/* Empty stands for the default of texts, which is not freed. */
void text_free(char *text);
/* A copy in *to, whose old text is freed. 0 or ERROR_NO_MEMORY. */
int text_set(char **to, const char *text);
/* Appends a message to a repeated field, which takes it. NULL (frees the message then) without
 * memory. */
void *list_add(void *list, size_t *n, void *message);
/* Frees the entry and closes the gap. */
void list_remove(void *list, size_t *n, size_t at);

/* Bytes that an event of n bytes takes at most in a packed RoomEvents; puts it there and
 * returns how many it took. */
size_t events_room(size_t n);
size_t events_put(uint8_t *to, const uint8_t *event, size_t n);

/* Writes the error and returns the code. */
int fold_fail(struct folding *f, int code, const char *fmt, ...)
    __attribute__((format(printf, 3, 4)));
int fold_no_memory(struct folding *f);
/* Whether the stamp is of the event's author: principal and display name. */
bool is_author(const struct folding *f, const Relight__Stamp *stamp);

/* fold_scene.c */
int fold_scene(struct folding *f);
int fold_undo(struct folding *f, bool undo);
int fold_save(struct folding *f);
int fold_variant(struct folding *f);
/* The revision that has this scene; the newest one when it is the same, else a new one. */
int scene_revision(struct folding *f, const Relight__Scene *scene, const char *note,
                   Relight__Revision **out);
/* Allocates the parts that every state has. */
int scene_begin(struct folding *f, const Relight__Scene *scene);

/* fold_review.c */
int fold_pin(struct folding *f);
int fold_reply(struct folding *f);
int fold_change(struct folding *f);
int fold_status(struct folding *f);
int fold_stroke(struct folding *f);
int fold_erase(struct folding *f);
int fold_decide(struct folding *f);

#endif
