// SPDX-License-Identifier: MIT
// The shared scene: changes of its parts, undo and redo by person, revisions, variants.
#include "rooms/state.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const uint64_t drag_us = 1000000; // changes that follow each other as fast are one step
static const char *const part_words[ROOM_N_PART] = {"model", "lights", "material",
                                                    "shade", "camera", "picture"};

#define SWAP(a, b)                 \
    do {                           \
        __typeof__(a) kept_ = (a); \
        (a) = (b);                 \
        (b) = kept_;               \
    } while (0)

static void swap_part(Relight__Scene *a, Relight__Scene *b, uint32_t part)
{
    switch (part) {
    case PART_MODEL:
        SWAP(a->model, b->model);
        SWAP(a->pose, b->pose);
        break;
    case PART_LIGHTS:
        SWAP(a->n_lights, b->n_lights);
        SWAP(a->lights, b->lights);
        break;
    case PART_MATERIAL:
        SWAP(a->material, b->material);
        break;
    case PART_SHADE:
        SWAP(a->shade, b->shade);
        break;
    case PART_CAMERA:
        SWAP(a->camera, b->camera);
        break;
    case PART_PICTURE:
        SWAP(a->picture, b->picture);
        break;
    }
}

static Relight__Stamp *copy_stamp(const struct folding *f)
{
    return message_copy(f->event->stamp);
}

int scene_begin(struct folding *f, const Relight__Scene *scene)
{
    static const Relight__Scene none = RELIGHT__SCENE__INIT;
    if (!(f->state->scene = message_copy(scene ? scene : &none))) return fold_no_memory(f);
    for (int i = 0; i < ROOM_N_PART; i++) {
        Relight__RoomPart part = RELIGHT__ROOM_PART__INIT;
        part.stamp = f->event->stamp;
        part.changed = f->event->stamp->sequence;
        if (!list_add(&f->state->parts, &f->state->n_parts, message_copy(&part)))
            return fold_no_memory(f);
    }
    return 0;
}

// ---- undo steps

static bool is_own(const struct folding *f, const Relight__UndoStep *step)
{
    return !strcmp(step->by, f->event->stamp->by) && !strcmp(step->name, f->event->stamp->name);
}

static bool has_stamp(const Relight__RoomPart *part, const Relight__Stamp *stamp)
{
    return part->stamp->sequence == stamp->sequence;
}

// Steps that were undone can not be redone after another change. Each person has a number of
// steps, and all have one together.
static void trim_steps(struct folding *f)
{
    Relight__RoomState *s = f->state;
    size_t own = 0;
    for (size_t i = s->n_undo; i-- > 0;) {
        if (!is_own(f, s->undo[i])) continue;
        if (s->undo[i]->undone || ++own >= ROOM_MAX_UNDO) list_remove(&s->undo, &s->n_undo, i);
    }
    while (s->n_undo >= ROOM_MAX_UNDO_ALL) list_remove(&s->undo, &s->n_undo, 0);
}

static Relight__UndoStep *last_own(const struct folding *f, bool undone)
{
    Relight__UndoStep *found = NULL;
    for (size_t i = f->state->n_undo; i-- > 0;) {
        Relight__UndoStep *step = f->state->undo[i];
        if (!is_own(f, step)) continue;
        if (!undone && !step->undone) return step; // the newest that is in force
        if (undone && !step->undone) return found;
        found = undone ? step : NULL; // the oldest of those undone behind it
    }
    return found;
}

// A drag is one step: the same parts by the same person, within a moment, and nobody between.
static bool continues(const struct folding *f, const Relight__UndoStep *step,
                      const uint32_t *parts, size_t n)
{
    if (!step || step->n_parts != n || memcmp(step->parts, parts, n * sizeof *parts))
        return false;
    if (f->event->stamp->time_us - step->time_us > drag_us) return false;
    for (size_t i = 0; i < n; i++)
        if (!has_stamp(f->state->parts[parts[i]], step->after[i])) return false;
    return true;
}

// The step takes the values that it replaces, by swapping.
static Relight__UndoStep *new_step(const struct folding *f, const Relight__Scene *scene,
                                   const uint32_t *parts, size_t n)
{
    Relight__UndoStep m = RELIGHT__UNDO_STEP__INIT;
    Relight__Stamp *before[ROOM_N_PART], *after[ROOM_N_PART];
    for (size_t i = 0; i < n; i++) {
        before[i] = f->state->parts[parts[i]]->stamp;
        after[i] = f->event->stamp;
    }
    m.by = f->event->stamp->by;
    m.name = f->event->stamp->name;
    m.parts = (uint32_t *)(uintptr_t)parts;
    m.other = (Relight__Scene *)(uintptr_t)scene;
    m.before = before;
    m.after = after;
    m.n_parts = m.n_before = m.n_after = n;
    m.time_us = f->event->stamp->time_us;
    return message_copy(&m);
}

// ---- a change

static int read_parts(struct folding *f, uint32_t parts[ROOM_N_PART], size_t *n)
{
    const Relight__SceneChange *in = f->action->scene;
    bool set[ROOM_N_PART] = {false};
    *n = 0;
    for (size_t i = 0; i < in->n_parts; i++) {
        uint32_t p = 0;
        while (p < ROOM_N_PART && strcmp(part_words[p], in->parts[i])) p++;
        if (p == ROOM_N_PART)
            return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                             "parts: \"%.40s\" is none of model, lights, material, shade, "
                             "camera, picture",
                             in->parts[i]);
        set[p] = true;
    }
    for (uint32_t p = 0; p < ROOM_N_PART; p++)
        if (set[p]) parts[(*n)++] = p;
    if (*n && in->scene) return 0;
    return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                     "the change names no part of the scene");
}

static int check_base(struct folding *f, const uint32_t *parts, size_t n)
{
    uint64_t since = f->action->scene->since;
    for (size_t i = 0; since && i < n; i++) {
        const Relight__RoomPart *part = f->state->parts[parts[i]];
        if (part->changed > since)
            return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
                             "%s was changed meanwhile by %.64s (event %llu)",
                             part_words[parts[i]],
                             *part->stamp->name ? part->stamp->name : part->stamp->by,
                             (unsigned long long)part->changed);
    }
    return 0;
}

static int stamp_parts(struct folding *f, const uint32_t *parts, size_t n)
{
    Relight__Stamp *stamp[ROOM_N_PART];
    for (size_t i = 0; i < n; i++)
        if (!(stamp[i] = copy_stamp(f))) {
            while (i-- > 0) relight__stamp__free_unpacked(stamp[i], NULL);
            return fold_no_memory(f);
        }
    for (size_t i = 0; i < n; i++) {
        Relight__RoomPart *part = f->state->parts[parts[i]];
        relight__stamp__free_unpacked(part->stamp, NULL);
        part->stamp = stamp[i];
        part->changed = stamp[i]->sequence;
    }
    return 0;
}

// A further moment of a drag: the step keeps the values from before it.
static int extend_step(struct folding *f, Relight__UndoStep *step, const uint32_t *parts,
                       size_t n)
{
    Relight__Scene *copy = message_copy(f->action->scene->scene);
    if (!copy) return fold_no_memory(f);
    for (size_t i = 0; i < n; i++) {
        step->after[i]->sequence = f->event->stamp->sequence;
        step->after[i]->time_us = f->event->stamp->time_us;
        swap_part(f->state->scene, copy, parts[i]);
    }
    step->time_us = f->event->stamp->time_us;
    relight__scene__free_unpacked(copy, NULL);
    return stamp_parts(f, parts, n);
}

int fold_scene(struct folding *f)
{
    uint32_t parts[ROOM_N_PART];
    size_t n;
    int code = read_parts(f, parts, &n);
    if (!code) code = room_scene_check(f->action->scene->scene, f->error);
    if (!code) code = check_base(f, parts, n);
    if (code) return code;
    Relight__UndoStep *step = last_own(f, false);
    if (continues(f, step, parts, n)) return extend_step(f, step, parts, n);
    trim_steps(f);
    step = new_step(f, f->action->scene->scene, parts, n);
    if (!list_add(&f->state->undo, &f->state->n_undo, step)) return fold_no_memory(f);
    for (size_t i = 0; i < n; i++) swap_part(f->state->scene, step->other, parts[i]);
    return stamp_parts(f, parts, n);
}

// ---- undo and redo

// Parts that others changed since stay as they are.
int fold_undo(struct folding *f, bool undo)
{
    Relight__UndoStep *step = last_own(f, !undo);
    const Relight__RoomPart *other = NULL;
    bool any = false;
    if (!step)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                         "there is no change of yours to %s", undo ? "undo" : "redo");
    for (size_t i = 0; i < step->n_parts; i++) {
        Relight__RoomPart *part = f->state->parts[step->parts[i]];
        const Relight__Stamp *now = undo ? step->after[i] : step->before[i];
        if (!has_stamp(part, now)) other = part;
        else any = true;
    }
    if (!any)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
                         "%.64s changed the same part since: your change can not be %s",
                         *other->stamp->name ? other->stamp->name : other->stamp->by,
                         undo ? "undone" : "redone");
    for (size_t i = 0; i < step->n_parts; i++) {
        Relight__RoomPart *part = f->state->parts[step->parts[i]];
        const Relight__Stamp *now = undo ? step->after[i] : step->before[i];
        if (!has_stamp(part, now)) continue;
        Relight__Stamp *stamp = message_copy(undo ? step->before[i] : step->after[i]);
        if (!stamp) return fold_no_memory(f);
        relight__stamp__free_unpacked(part->stamp, NULL);
        part->stamp = stamp;
        part->changed = f->event->stamp->sequence;
        swap_part(f->state->scene, step->other, step->parts[i]);
    }
    step->undone = undo;
    step->time_us = 0; // a drag does not go on after it
    return 0;
}

// ---- revisions and variants

static uint32_t material_number(const Relight__RoomState *s, const Relight__Scene *scene)
{
    uint32_t most = 0;
    for (size_t i = 0; i < s->n_revisions; i++) {
        const Relight__Revision *r = s->revisions[i];
        if (!strcmp(r->scene->material, scene->material)) return r->material;
        if (r->material > most) most = r->material;
    }
    return most + 1;
}

int scene_revision(struct folding *f, const Relight__Scene *scene, const char *note,
                   Relight__Revision **out)
{
    Relight__RoomState *s = f->state;
    Relight__Revision m = RELIGHT__REVISION__INIT;
    char hash[65];
    if (!room_message_hash(&scene->base, hash)) return fold_no_memory(f);
    for (size_t i = s->n_revisions; i-- > 0;)
        if (!strcmp(s->revisions[i]->hash, hash)) {
            *out = s->revisions[i];
            return 0;
        }
    if (s->n_revisions >= ROOM_MAX_REVISIONS)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT,
                         "the room has %u revisions, and no more are kept: begin another room",
                         (unsigned)s->n_revisions);
    m.number = (uint32_t)s->n_revisions + 1;
    m.stamp = f->event->stamp;
    m.note = (char *)(uintptr_t)note;
    m.scene = (Relight__Scene *)(uintptr_t)scene;
    m.hash = hash;
    m.material = material_number(s, scene);
    *out = list_add(&s->revisions, &s->n_revisions, message_copy(&m));
    return *out ? 0 : fold_no_memory(f);
}

int fold_save(struct folding *f)
{
    Relight__Revision *revision;
    if (strlen(f->action->save->note) > ROOM_MAX_TEXT)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT, "a note has at most %d bytes",
                         ROOM_MAX_TEXT);
    size_t before = f->state->n_revisions;
    int code = scene_revision(f, f->state->scene, f->action->save->note, &revision);
    if (!code && f->state->n_revisions == before)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
                         "nothing to save: the scene is revision %u", revision->number);
    return code;
}

int fold_variant(struct folding *f)
{
    const Relight__PutVariant *in = f->action->variant;
    Relight__RoomState *s = f->state;
    Relight__Variant m = RELIGHT__VARIANT__INIT;
    size_t at = 0;
    if (!*in->name || strlen(in->name) > ROOM_MAX_NAME ||
        strlen(in->material) > ROOM_MAX_MATERIAL)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT,
                         "a variant has a name of 1 to %d bytes and a material of at most %d",
                         ROOM_MAX_NAME, ROOM_MAX_MATERIAL);
    while (at < s->n_variants && strcmp(s->variants[at]->name, in->name)) at++;
    if (at == s->n_variants && !*in->material)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                         "%.120s: the room has no such variant", in->name);
    if (at == s->n_variants && at >= ROOM_MAX_VARIANTS)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT, "the room has %d variants",
                         ROOM_MAX_VARIANTS);
    m.name = in->name;
    m.material = in->material;
    m.stamp = f->event->stamp;
    if (*in->material && !list_add(&s->variants, &s->n_variants, message_copy(&m)))
        return fold_no_memory(f);
    // The new one is appended; an earlier one of its name is removed.
    if (at + (*in->material != 0) < s->n_variants || !*in->material)
        list_remove(&s->variants, &s->n_variants, at);
    return 0;
}
