/* SPDX-License-Identifier: MIT */
/* shape.h owns what image-space engines work on: a model's geometry as it is now, with its
 * scene and the engines' state, one for each generation; and vertices that were moved. */
#ifndef RELIGHTD_SHAPE_H
#define RELIGHTD_SHAPE_H

#include "store/models.h"
#include "prt/screen.h"

#include <pthread.h>

/* Moved vertices. Shared: whoever finds another user makes a copy before it changes one. Loop
 * thread, but for reading while it is held. */
struct pose {
    unsigned refs;
    uint32_t n;
    float (*position)[3];        /* [n] mm */
    float (*normal)[3];          /* [n] unit; 0,0,0: to be made */
    struct principal *principal; /* who moved them, and pays for the bytes */
    uint64_t charged;
};
void pose_release(struct pose *pose); /* NULL is fine */

/* The engine's own state, used by one worker at a time: whoever comes while it is busy waits.
 */
struct screen_slot {
    struct prt_screen *screen;
    int engine;              /* 1 + the one chosen last; 0: none was */
    struct screen_job *busy; /* under way; NULL: none */
    struct screen_job *first, **last;
};
enum { SHAPE_SLOTS = 5 }; /* of the engine chosen by the daemon, and of each that was named */

struct shape {
    struct cache_entry *file; /* the open .prt whose mesh it is */
    struct pose *pose;        /* NULL: as in the file */
    struct prt_mesh mesh;
    float (*normal)[3]; /* own, with a pose */
    const struct prt_material *material;
    pthread_mutex_t lock; /* of scene's making */
    struct prt_scene *scene;
    struct screen_slot slot[SHAPE_SLOTS];
};
/* The model's geometry as it is now, with a reference for the caller: value is a struct shape.
 * NULL when there is none: *code and error say why. */
struct cache_entry *shape_get(struct model *model, int *code, char error[256]);
/* Any thread. Builds the scene at its first use. */
int shape_scene(const struct prt_context *ctx, struct shape *shape,
                const struct prt_scene **scene);
/* The same ahead of need, on a worker. */
void shape_prepare(struct model *model, struct cache_entry *entry);

#endif
