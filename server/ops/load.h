/* SPDX-License-Identifier: MIT */
/* load.h owns the state of one LOAD in progress, shared by its files. op_load.c is its course,
 * load_check.c the checks of the request, load_files.c the files of --models, load_bake.c the
 * folders and the settings, bake_job.c the job. Loop thread only. */
#ifndef RELIGHTD_LOAD_H
#define RELIGHTD_LOAD_H

#include "net/request.h"
#include "prt/medium.h"
#include "render/shared/materials.h"
#include "relight.pb-c.h"
#include "store/import_file.h"
#include "store/model_files.h"

enum { MAX_FILES = 64, MAX_OPAQUE = 64, MAX_ARGS = 64 + MAX_OPAQUE + MATERIAL_TEXTS };

// A material of LOAD, as `prt bake` is given it.
struct load_material {
    char *arg;     // of --material: [OBJECT=]NAME or [OBJECT=]FILE
    char file[32]; // of the folders; "": a preset
    char *text;    // the preset's name, or the file's JSON
};

struct load_file {
    char *name; // relative, as the model refers to it; the model itself is the first
    char hash[65];
    struct import_copy *copy; // of a file of --models, held; NULL: an upload
};

// One LOAD under way: its request waits for copies of files of --models, then for its folder to
// be laid out, then for the model to open.
struct load {
    struct file_task task; // first: laying out
    struct import_request import;
    struct cache_waiter waiter;
    struct blob_waiter blob_waiter; // an upload's check
    size_t n_checked;
    char checking[BLOB_HASH + 1]; // hash of the upload whose check is waited for; "": none
    struct load *next;            // of those that wait for the same model
    struct cache_entry *entry;    // the opening waited for
    struct server *server;
    struct request *request; // NULL: the request has ended
    bool importing;
    char owner[96]; // principal's name
    struct load_file file[MAX_FILES];
    size_t n_file;
    char **sibling; // of a .gltf in --models: names of the files it refers to
    size_t n_sibling;
    char source[65]; // hash that names the source
    char name[128];
    char env[96]; // bake.env in its canonical form; "" none
    struct load_material material[MATERIAL_TEXTS];
    unsigned n_material;
    struct model *model; // NULL: not known yet
    // Laying out: the wanted files and the outcome.
    bool find_bake;
    char preview_folder[PATH_MAX], bake_folder[PATH_MAX]; // "": not wanted
    uint64_t bake_bytes;                                  // of a bake that is there; 0: none
    bool away; // that bake is in the folder that replicas share
    int fault; // errno
    const char *fault_name;
};

/* Releases the load; its request was answered or has ended. */
void load_drop(struct load *load);
const Relight__LoadRequest *load_message(const struct load *load);
/* The folder was laid out, or could not be (load->fault); op_load.c continues. */
void load_laid_out(struct file_task *task);
/* The hash that names the source is known; op_load.c continues. */
void load_source_known(struct load *load);
/* Opens the bake of a model that is there, then answers. */
void load_open_and_answer(struct load *load, struct model *m);
/* The uploads are checked one after the other, then the source's hash is made. */
void load_check_next(struct load *load);

/* load_check.c. False, or a text: the request is answered with an error or has to be. */
const char *load_bad_setting(const Relight__LoadRequest *r, char reason[128]);
bool load_check_material(struct load *load);
bool load_check_files(struct load *load);
bool load_check_env(struct load *load);
/* A relative name without "..", control characters or an empty part. */
bool load_safe_name(const char *name);

/* load_files.c */
bool load_add_file(struct load *load, const char *name, const char *hash,
                   struct import_copy *copy);
void load_hash_source(struct load *load);
/* Copies the next file of --models that the model names. */
void load_import_next(struct load *load);
const char *load_file_part(const char *path);
/* struct model's `source` of a LOAD by path, to free(): JSON with its files, and the packed
 * request in hex digits. NULL without memory. */
char *load_source_text(const struct load *load);
/* The packed request in hex digits, to free(); NULL without memory. */
char *load_packed(const struct load *load);

/* load_bake.c */
/* kin: the same where only the versions of baker and format differ, which are part of the id.
 */
void load_name_model(const struct load *load, char id[MODEL_ID + 1], char kin[MODEL_ID + 1]);
/* Links a file under a name, with its folders, below `folder`. 0 or errno. Any thread. */
int load_link_file(const char *from, const char *folder, const char *name);
int load_run_lay_out(struct file_task *task);
void load_fail_lay_out(struct load *load);
void load_order_preview(const struct load *load, struct model *m);
/* An argument of --material for the helper process, which reads its file in the folder; to
 * free(). */
char *load_material_path(const char *arg, const char *folder);
struct load_args {
    char *argv[MAX_ARGS + 1]; // malloc
    size_t n;
};
void load_add_arg(struct load_args *args, const char *fmt, ...)
    __attribute__((format(printf, 2, 3)));
/* Settings in a fixed order, as options of `prt bake`: the command, and what names the model.
 */
void load_add_settings(struct load_args *args, const Relight__LoadRequest *r);

/* Whether a draft comes before the bake: not where the request or the daemon wants none, not
 * for polynomial transport, and not where the bake is nearly as quick. */
bool load_wants_draft(const struct load *load);
bool load_is_joint(const struct load *load); /* of joint transport */
/* The options of its `prt bake --draft`. */
void load_add_draft(struct load_args *args, const struct load *load);

/* bake_job.c. 0, or the protocol's error code with its text: BUSY names the limit that is in
 * the way. */
int load_order_bake(struct load *load, struct model *m, char error[256]);

/* Pins the model where the request says so. False: the caller may not, and the load is gone. */
bool load_pin(struct load *load, struct model *m);

/* Ends the load with an error. */
#define LOAD_FAIL(load, code, ...)                                                     \
    do {                                                                               \
        request_fail((load)->request, RELIGHT__ERROR_CODE__ERROR_##code, __VA_ARGS__); \
        load_drop(load);                                                               \
    } while (0)

#endif
