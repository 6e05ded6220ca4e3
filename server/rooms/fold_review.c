// SPDX-License-Identifier: MIT
// What people say about the scene: pins with their notes, strokes, decisions.
#include "rooms/state.h"

#include "frame.h"

#include <stdlib.h>
#include <string.h>

static int too_long(struct folding *f)
{
    return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT, "a note has at most %d bytes",
                     ROOM_MAX_TEXT);
}

static int no_pin(struct folding *f, uint64_t pin)
{
    return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND, "the room has no pin %llu",
                     (unsigned long long)pin);
}

// A picture of the client's, if any, and what the daemon filled in.
static int check_seen(struct folding *f, const Relight__Scene *scene, const char *picture,
                      const Relight__Seen *seen)
{
    if (*picture && !relight_hash_valid(picture))
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                         "picture_hash: expected 64 hex digits");
    if (!seen)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                         "the event does not say what was seen");
    return room_scene_check(scene, f->error);
}

// A client that says what its picture was made from decides about that alone.
static int check_drawn(struct folding *f, const Relight__Drawn *drawn,
                       const Relight__Seen *seen)
{
    if (!drawn || (!strcmp(drawn->mesh_hash, seen->mesh_hash) &&
                   !strcmp(drawn->bake_hash, seen->bake_hash)))
        return 0;
    return fold_fail(
        f, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
        "the model has %s since the picture was drawn: look at it again, then decide",
        strcmp(drawn->mesh_hash, seen->mesh_hash) ? "another shape"
        : *seen->bake_hash                        ? "another bake"
                                                  : "no bake any more");
}

// The daemon's record with the numbers that the room gives.
static Relight__Seen *fill_seen(struct folding *f, const Relight__Seen *from,
                                const char *picture, const Relight__Revision *revision)
{
    Relight__Seen m = *from;
    m.revision = revision->number;
    m.scene_hash = revision->hash;
    m.picture_hash = (char *)(uintptr_t)picture;
    return message_copy(&m);
}

// ---- notes

static bool word_byte(char c)
{
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
           c == '_' || c == '-' || c == '.' || (signed char)c < 0;
}

// The words after @, each once.
static int find_mentions(struct folding *f, Relight__Note *note)
{
    const char *text = note->text;
    for (const char *at = text;
         (at = strchr(at, '@')) && note->n_mentions < ROOM_MAX_MENTIONS;) {
        size_t n = 0;
        bool begins = at == text || !word_byte(at[-1]), known = false;
        at++;
        while (word_byte(at[n]) && n < ROOM_MAX_PERSON) n++;
        while (n && at[n - 1] == '.') n--; // the end of a sentence
        for (size_t i = 0; i < note->n_mentions; i++)
            known |= !strncmp(note->mentions[i], at, n) && !note->mentions[i][n];
        if (!begins || !n || known) continue;
        char *word = strndup(at, n);
        char **more = word ? realloc(note->mentions, (note->n_mentions + 1) * sizeof *more) : 0;
        if (!more) {
            free(word);
            return fold_no_memory(f);
        }
        relight_utf8_cut(word);
        note->mentions = more;
        note->mentions[note->n_mentions++] = word;
    }
    return 0;
}

static int add_note(struct folding *f, Relight__Pin *pin, const char *text)
{
    Relight__Note m = RELIGHT__NOTE__INIT;
    m.stamp = f->event->stamp;
    m.text = (char *)(uintptr_t)text;
    Relight__Note *note = message_copy(&m);
    if (!note) return fold_no_memory(f);
    int code = find_mentions(f, note);
    if (code) {
        relight__note__free_unpacked(note, NULL);
        return code;
    }
    return list_add(&pin->notes, &pin->n_notes, note) ? 0 : fold_no_memory(f);
}

int fold_reply(struct folding *f)
{
    const Relight__PutNote *in = f->action->reply;
    Relight__Pin *pin = room_pin(f->state, in->target);
    if (!pin) return no_pin(f, in->target);
    if (strlen(in->text) > ROOM_MAX_TEXT) return too_long(f);
    if (!*in->text)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST, "the reply has no text");
    if (pin->n_notes >= ROOM_MAX_NOTES)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT, "the pin has %d notes",
                         ROOM_MAX_NOTES);
    return add_note(f, pin, in->text);
}

static Relight__Note *find_note(const Relight__RoomState *s, uint64_t target)
{
    for (size_t i = 0; i < s->n_pins; i++)
        for (size_t j = 0; j < s->pins[i]->n_notes; j++)
            if (s->pins[i]->notes[j]->stamp->sequence == target) return s->pins[i]->notes[j];
    return NULL;
}

static int not_own(struct folding *f)
{
    return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                     "it is another's: its author or an owner of the room can do that");
}

// Replaces the text; mentions follow it.
static int set_note(struct folding *f, Relight__Note *note, const char *text)
{
    Relight__Note m = RELIGHT__NOTE__INIT;
    m.text = (char *)(uintptr_t)text;
    Relight__Note *fresh = message_copy(&m);
    if (!fresh) return fold_no_memory(f);
    int code = find_mentions(f, fresh);
    if (!code) {
        char *kept = note->text, **words = note->mentions;
        size_t n = note->n_mentions;
        note->text = fresh->text;
        note->mentions = fresh->mentions;
        note->n_mentions = fresh->n_mentions;
        note->changed_us = f->event->stamp->time_us;
        fresh->text = kept;
        fresh->mentions = words;
        fresh->n_mentions = n;
    }
    relight__note__free_unpacked(fresh, NULL);
    return code;
}

int fold_change(struct folding *f)
{
    const Relight__PutNote *in = f->action->change;
    Relight__Note *note = find_note(f->state, in->target);
    if (!note || !*note->text)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND, "the room has no note %llu",
                         (unsigned long long)in->target);
    if (!is_author(f, note->stamp)) return not_own(f);
    if (strlen(in->text) > ROOM_MAX_TEXT) return too_long(f);
    if (!*in->text)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                         "the note has no text: erase removes it");
    return set_note(f, note, in->text);
}

// ---- pins

static bool weights_fit(const Relight__SurfacePoint *p)
{
    const float slack = 1e-4f; // of rounding in the client
    return p->b1 >= -slack && p->b2 >= -slack && p->b1 + p->b2 <= 1 + slack;
}

static int bad_point(struct folding *f)
{
    return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE,
                     "a point's weights b1 and b2 are not those of a point in its triangle");
}

int fold_pin(struct folding *f)
{
    const Relight__PutPin *in = f->action->pin;
    const Relight__Scene *scene = in->scene ? in->scene : f->state->scene;
    Relight__Revision *revision;
    Relight__Pin m = RELIGHT__PIN__INIT;
    int code = check_seen(f, scene, in->picture_hash, in->seen);
    if (code) return code;
    if (strlen(in->text) > ROOM_MAX_TEXT) return too_long(f);
    if (!in->at || !weights_fit(in->at)) return bad_point(f);
    if (f->state->n_pins >= ROOM_MAX_PINS)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT, "the room has %d pins",
                         ROOM_MAX_PINS);
    if ((code = scene_revision(f, scene, "", &revision))) return code;
    if (!(m.seen = fill_seen(f, in->seen, in->picture_hash, revision)))
        return fold_no_memory(f);
    m.stamp = f->event->stamp;
    m.at = in->at;
    m.status = f->event->stamp;
    Relight__Pin *pin = message_copy(&m);
    relight__seen__free_unpacked(m.seen, NULL);
    if (!pin || (code = add_note(f, pin, in->text))) {
        if (pin) relight__pin__free_unpacked(pin, NULL);
        return fold_no_memory(f);
    }
    return list_add(&f->state->pins, &f->state->n_pins, pin) ? 0 : fold_no_memory(f);
}

int fold_status(struct folding *f)
{
    const Relight__SetStatus *in = f->action->status;
    Relight__Pin *pin = room_pin(f->state, in->pin);
    if (!pin) return no_pin(f, in->pin);
    if (pin->resolved == in->resolved)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_MISMATCH, "pin %llu is %s already",
                         (unsigned long long)in->pin, in->resolved ? "resolved" : "open");
    Relight__Stamp *stamp = message_copy(f->event->stamp);
    if (!stamp) return fold_no_memory(f);
    relight__stamp__free_unpacked(pin->status, NULL);
    pin->status = stamp;
    pin->resolved = in->resolved;
    return 0;
}

// ---- strokes

int fold_stroke(struct folding *f)
{
    const Relight__PutStroke *in = f->action->stroke;
    Relight__Stroke m = RELIGHT__STROKE__INIT;
    if (in->n_points < 2 || in->n_points > ROOM_MAX_POINTS)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT, "a stroke has 2 to %d points",
                         ROOM_MAX_POINTS);
    if (!(in->width > 0 && in->width <= 64))
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE,
                         "width: expected (0, 64] pixels");
    for (size_t i = 0; i < in->n_points; i++)
        if (!weights_fit(in->points[i])) return bad_point(f);
    if (in->pin && !room_pin(f->state, in->pin)) return no_pin(f, in->pin);
    if (f->state->n_strokes >= ROOM_MAX_STROKES)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT, "the room has %d strokes",
                         ROOM_MAX_STROKES);
    m.stamp = f->event->stamp;
    m.line = (Relight__PutStroke *)(uintptr_t)in;
    return list_add(&f->state->strokes, &f->state->n_strokes, message_copy(&m))
               ? 0
               : fold_no_memory(f);
}

// ---- erasing

static bool may_erase(const struct folding *f, const Relight__Stamp *stamp)
{
    return is_author(f, stamp) || f->event->role >= RELIGHT__ROOM_ROLE__ROLE_OWNER;
}

// A removed pin takes its notes and strokes with it.
static void remove_pin(Relight__RoomState *s, size_t at)
{
    uint64_t pin = s->pins[at]->stamp->sequence;
    for (size_t i = s->n_strokes; i-- > 0;)
        if (s->strokes[i]->line->pin == pin) list_remove(&s->strokes, &s->n_strokes, i);
    list_remove(&s->pins, &s->n_pins, at);
}

int fold_erase(struct folding *f)
{
    Relight__RoomState *s = f->state;
    uint64_t target = f->action->erase->target;
    for (size_t i = 0; i < s->n_pins; i++) {
        if (s->pins[i]->stamp->sequence != target) continue;
        if (!may_erase(f, s->pins[i]->stamp)) return not_own(f);
        remove_pin(s, i);
        return 0;
    }
    for (size_t i = 0; i < s->n_strokes; i++) {
        if (s->strokes[i]->stamp->sequence != target) continue;
        if (!may_erase(f, s->strokes[i]->stamp)) return not_own(f);
        list_remove(&s->strokes, &s->n_strokes, i);
        return 0;
    }
    Relight__Note *note = find_note(s, target);
    if (!note || !*note->text)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                         "the room has no pin, note or stroke %llu",
                         (unsigned long long)target);
    return may_erase(f, note->stamp) ? set_note(f, note, "") : not_own(f);
}

// ---- decisions

int fold_decide(struct folding *f)
{
    const Relight__Decide *in = f->action->decide;
    const Relight__Scene *scene = in->scene ? in->scene : f->state->scene;
    Relight__Revision *revision;
    Relight__Decision m = RELIGHT__DECISION__INIT;
    char hash[65];
    int code = check_seen(f, scene, in->picture_hash, in->seen);
    if (code || (code = check_drawn(f, in->drawn, in->seen))) return code;
    if (strlen(in->note) > ROOM_MAX_TEXT) return too_long(f);
    if (f->state->n_decisions >= ROOM_MAX_DECISIONS)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT, "the room has %d decisions",
                         ROOM_MAX_DECISIONS);
    if ((code = scene_revision(f, scene, "", &revision))) return code;
    if (!(m.seen = fill_seen(f, in->seen, in->picture_hash, revision)))
        return fold_no_memory(f);
    m.stamp = f->event->stamp;
    m.approve = in->approve;
    m.note = in->note;
    m.hash = room_message_hash(&m.seen->base, hash) ? hash : NULL;
    Relight__Decision *decision = m.hash ? message_copy(&m) : NULL;
    relight__seen__free_unpacked(m.seen, NULL);
    return list_add(&f->state->decisions, &f->state->n_decisions, decision) ? 0
                                                                            : fold_no_memory(f);
}
