/* SPDX-License-Identifier: MIT */
/* geometry.h owns the input of the image-space engines: a model's current geometry with its ray
 * tracing scene and the engines' state, one for each generation; and moved vertices. */
#ifndef RELIGHTD_SHAPE_H
#define RELIGHTD_SHAPE_H

#include "store/models.h"
#include "prt/screen.h"
#include "prt/variant.h"

#include <pthread.h>

/* Moved vertices. Shared: copied before a change where refs > 1. Loop thread, except for
 * reading while it is held. */
struct pose {
    unsigned refs;
    uint32_t n;
    float (*position)[3];        /* [n] mm */
    float (*normal)[3];          /* [n] unit; 0,0,0: computed from the triangles */
    struct principal *principal; /* that moved them and is charged for the bytes */
    enum ledger_resource resource;
    uint64_t charged;
    /* Of a named pose (poses.h), which never changes; "" and 0 otherwise. */
    char name[65];
    uint64_t generation;
};
void pose_release(struct pose *pose); /* NULL is fine */

/* An engine's state, used by one worker at a time; other jobs queue. */
struct screen_slot {
    struct prt_screen *screen;
    int engine;              /* 1 + the one that was chosen last; 0: none */
    struct screen_job *busy; /* running; NULL: none */
    struct screen_job *first, **last;
};
enum { SHAPE_SLOTS = 5 }; /* one for the daemon's choice, and one for each engine */

struct shape {
    struct cache_entry *file;    /* the open .prt whose mesh it is */
    uint64_t generation;         /* of its vertices */
    struct pose *pose;           /* NULL: as in the file */
    struct prt_variant *variant; /* NULL: as in the file */
    struct prt_mesh mesh;
    float (*normal)[3];            /* owned; with a pose */
    const struct prt_media *media; /* of the file, or of its variant */
    pthread_mutex_t lock;          /* guards creating `scene` */
    struct prt_scene *scene;
    struct screen_slot slot[SHAPE_SLOTS];
    struct cache_entry *ratio; /* held: the last walk ratio of walk_ratio.c; NULL: none yet */
    bool ratio_runs, ratio_failed; /* one is computed; none can be */
};
/* The model's current geometry, with a reference for the caller; value is a struct shape. pose:
 * a named one of the model; NULL: none. variant: as Shade.variant, "" for none; the entry fails
 * where the file has none of this name. NULL with *code and error where there is no geometry.
 */
struct cache_entry *shape_get(struct model *model, struct pose *pose, const char *variant,
                              int *code, char error[256]);
/* Any thread. Builds the scene at its first use. */
int shape_scene(const struct prt_context *ctx, struct shape *shape,
                const struct prt_scene **scene);
/* Builds the scene in advance, on a worker. */
void shape_prepare(struct model *model, struct cache_entry *entry);

#endif
