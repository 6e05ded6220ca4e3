/* SPDX-License-Identifier: MIT */
/* models.h owns the registry: the loaded models, their origins, and the open .prt files that
 * requests lease. received -> preview -> baking -> ready <-> unloaded, or failed. A model's id
 * is the hash of its source's bytes, material and settings, and of the versions of the baker
 * and of the .prt format, so the same load twice is one model, and its bake DATA/bakes/ID.prt
 * is found again after a restart. Until it is baked, its mesh is DATA/previews/ID.prt, a file
 * without light transport. The file of a .prt of --models is its copy (imports.h).
 * Thread-safety: loop thread only; nothing here blocks but models_create. */
#ifndef RELIGHTD_MODELS_H
#define RELIGHTD_MODELS_H

#include "store/cache.h"
#include "store/file_queue.h"
#include "store/imports.h"
#include "prt/raster.h"
#include "prt/transport.h"
#include "core/server.h"

#include <limits.h>

enum { MODEL_ID = 32, MODEL_SHOWN = 16 }; /* hex digits; as many are shown to people */

enum { VARIANT_NAME = 64 }; /* bytes of a variant's name, with the 0 */

/* Known once a model was opened; kept while it is unloaded. */
struct model_facts {
    bool known, baked; /* of a bake: else of the mesh alone */
    uint32_t n_vertex, n_triangle, n_object;
    float mm_per_unit, box[2][3], file_box[2][3]; /* mm; as it is, and in the file */
    uint32_t engine, storage, cube, exit_planes;
    uint64_t bytes, hash; /* of the .prt; hash: prt_file_hash */
    float error_multiple, error_single, error_view, error_total; /* measured relative RMSE,
                                                                  * worst light; 0: unknown */
};

struct gathering; /* relight_pass.c: evaluations that wait for a pass over this model */
struct pose;      /* shape.h: vertices that were moved */

/* A callback on changes of a model's state or shape. */
struct model_watcher {
    struct model_watcher *next;
    void (*changed)(struct model_watcher *watcher);
};

/* A further name of a model, which a principal other than its owner gave it. */
struct model_alias {
    struct model_alias *next;
    char owner[96], name[128];
};

enum mesh_state {
    MESH_NONE,
    MESH_READING,
    MESH_THERE,
    MESH_FAILED
}; /* of the preview's file */

struct model {
    struct model *next;
    struct server *server;
    char id[MODEL_ID + 1], name[128]; /* the name its first owner gave it */
    char owner[96]; /* principal that pays for its files; DISK_NOBODY for those of --models */
    struct model_alias *alias;
    char key[MODEL_ID + 12]; /* begins its cache keys and names its folders: no other struct has
                              * it, not even of the same id, forgotten and loaded again */
    int state;               /* Relight__ModelState; READY and UNLOADED by model_state() */
    uint32_t serial;         /* grows with every new model */
    bool checked;            /* every byte of its bake was read once */
    bool pinned;
    /* Models of files of --models. A model that has been replaced or whose file was removed
     * lives on for its users; no name stands for it. */
    bool replaced;                /* its file has other content: the model `successor` */
    bool removed;                 /* its file was removed, or no version has it any more */
    char successor[MODEL_ID + 1]; /* id, "": found by the name of the file */
    char replaces[MODEL_ID + 1];  /* id of the model whose names it takes once it is ready */
    /* Replicas that share a folder (--store). */
    bool recorded;          /* its record is there, or on its way */
    uint64_t recorded_ns;   /* loop_now_ns() when it was last written */
    int record_err;         /* of the last attempt to write it; -errno */
    char *load;             /* hex digits of the packed LOAD: another replica can repeat it */
    char kin[MODEL_ID + 1]; /* of models that differ only in the versions of baker and format;
                             * "": not known */
    uint32_t bake_version;
    uint64_t away_bytes; /* of a bake that is in the folder, and perhaps not here; 0: unknown */
    char *source;        /* JSON: path, files and settings of the LOAD of a file that is
                          * no .prt (ops/repository.c); NULL: uploads, or a .prt */
    struct import_copy *copy; /* of a .prt of --models; NULL: the model was baked here */
    uint64_t bake_bytes, preview_bytes; /* charged to the owner; 0: no file, or not yet known */
    int64_t used_ns;                    /* wall clock: last opened or loaded */
    bool preparing;                     /* a LOAD lays out its files; others wait in `loads` */
    struct load *loads;
    struct job *job;     /* while it is open */
    struct model *draft; /* answers while this one is baked: READY, with a key of its own, and
                          * in no list; NULL: none */
    char *file;          /* path of a draft's .prt; NULL: this is no draft */
    bool single_follows; /* a draft: the bake has single scattering, too */
    char job_id[32];     /* the last one's; "": none was */
    struct cache_entry *pin;
    struct model_facts facts;
    uint32_t n_variant;               /* of its file, once that was read */
    struct prt_mesh_variant *variant; /* [n_variant] */
    char *warnings;                   /* lines; NULL: none */
    int error_code;
    char error[400];
    uint64_t generation;       /* of the geometry: grows when vertices move */
    uint64_t baked_generation; /* generation of the file's mesh */
    struct pose *pose;         /* NULL: vertices are where the file has them */
    enum mesh_state mesh;
    int mesh_error_code;
    char mesh_error[300];
    bool gone; /* forgotten; alive until its last reference */
    struct model_watcher *watcher;
    struct gathering *gathering;
    unsigned n_contracted; /* row_columns.c: lights since its file was opened */
    bool making_columns;
    unsigned n_turning; /* evaluations whose lights are being turned for a pass */
    unsigned users;     /* references: the registry, requests in progress */
};

int models_create(struct server *server, struct models **out);
/* ops/repository.c. After models_resume_bakes and before models_start: loads by itself what the
 * models folder wants. The end comes after that of the last connection. */
int models_follow_folder(struct server *server);
void models_unfollow_folder(struct server *server);
/* Looks at --models for the first time, and opens the models that are pinned. */
void models_start(struct models *models);
/* Frees the pages of unloaded bakes, and keeps those of the next minute. */
void models_keep_pages(const struct server *server);
void models_destroy(struct models *models);

/* An id, the unique beginning of one (at least 8 digits), or a name with or without its ending.
 * Of several models with the name the principal's own comes first, then that of the file of
 * --models, or the version NAME/VERSION, or the newest version of NAME that can answer; of
 * others there may be one only. asker: a principal's name. NULL with error text,
 * which lists the ids where the name is ambiguous. */
struct model *models_find(struct models *models, const char *asker, const char *text,
                          char error[256]);
/* The name of the model for this principal. */
const char *model_name_for(const struct model *model, const char *asker);
/* Of this id; NULL: none. */
struct model *models_get(const struct models *models, const char *id);
/* The one of this kin to take: one that is baked, by the newest version; NULL: there is none.
 */
struct model *models_kin(const struct models *models, const char *kin);
/* Whether a name may stand for it: its file is there and has its content, and it takes no other
 * model's names only when it is ready. */
bool model_is_named(const struct model *model);
/* One after another; start with NULL. */
struct model *models_next(const struct models *models, const struct model *model);
int model_state(const struct model *model); /* Relight__ModelState */

/* The model whose transport answers for this one: its draft while it is baked, else itself. */
struct model *model_answering(struct model *model);

/* The open file of a baked model, or of its draft, with a lease the caller releases: READY
 * (value is a struct prt_file), or PENDING while it is opened. NULL when there is neither:
 * *code and error say why. */
struct cache_entry *model_open(struct model *model, int *code, char error[256]);

/* The same for the file that has the model's mesh: the bake, else the preview's. */
struct cache_entry *model_mesh_open(struct model *model, int *code, char error[256]);

/* Hashes of an open file: of the mesh that it has, and of its light transport, 16 hex digits
 * each; "": not known, and without light transport. */
struct model_hashes {
    char mesh[17], bake[17];
};
struct model_hashes model_hashes(const struct prt_file *file);

void model_watch(struct model *model, struct model_watcher *watcher);
void model_unwatch(struct model *model, struct model_watcher *watcher);
void model_changed(struct model *model);
void model_wake(struct model *model); /* its watchers alone: a picture of it would differ */
/* Publishes an event of this Relight__EventKind about the model; model_changed, model_add,
 * model_set_state and the removal of a model do so themselves. before: the id of the version
 * that it replaces, "" otherwise. */
void model_publish(const struct model *model, int kind, const char *before);
/* Sets `state` and publishes the change. */
void model_set_state(struct model *model, int state);
/* Vertices go back to where the file has them. */
void model_reset_pose(struct model *model);

/* The model that replaces this one under the name of their file; NULL: none. */
struct model *model_successor(const struct model *model);
/* `next` can answer and takes the names of `model`: views go over to it, requests in progress
 * finish, and `model` is forgotten when nobody uses it. */
void model_supersede(struct model *model, struct model *next);

/* Keeps the struct alive over an unload that forgets it. */
void model_hold(struct model *model);
void model_release(struct model *model);

/* At start, after models_create: the bakes that the daemon's end interrupted go on. */
void models_resume_bakes(struct models *models);
/* Releases memory; `forget` also deletes the bake and the entry. Returns bytes freed. */
uint64_t model_unload(struct model *model, bool forget);

#endif
