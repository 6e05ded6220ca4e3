// SPDX-License-Identifier: MIT
// The files of an animation: checked uploads, linked under the names by which the glTF refers
// to them, read by the decode helper.
#include "ops/pose_animation.h"

#include "net/request_wait.h"
#include "ops/load.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <errno.h>

struct animating {
    struct file_task task;    // first: laying out
    struct request_wait wait; // parks the request
    struct blob_waiter blob_waiter;
    struct server *server;
    pose_animated_fn fn;
    void *user;
    size_t n, n_checked;
    char *name[MAX_FILES], hash[MAX_FILES][BLOB_HASH + 1];
    char folder[PATH_MAX], animation[64];
    double time_s;
    bool up_z;
};

static void end(struct animating *a, struct decoded_pose *decoded, int code, const char *text)
{
    struct request *request = request_resume(&a->wait);
    if (a->folder[0]) file_remove(a->server->file_queue, a->folder);
    if (request && !decoded) request_fail(request, code, "%s", text);
    if (!request) {
        decoded_pose_destroy(decoded);
        decoded = NULL;
    }
    a->fn(a->user, request, decoded);
    for (size_t i = 0; i < a->n; i++) free(a->name[i]);
    free(a);
}

static void decoded(void *user, struct decoded_pose *pose, int status, const char *error)
{
    end(user, pose, pose ? 0 : error_of_status(status), error);
}

static int run_lay_out(struct file_task *task)
{
    struct animating *a = (struct animating *)task;
    char from[PATH_MAX];
    int fault = mkdir(a->folder, 0700) ? errno : 0;
    for (size_t i = 0; i < a->n && !fault; i++) {
        blobs_path(a->server->blobs, a->hash[i], from, sizeof from);
        fault = load_link_file(from, a->folder, a->name[i]);
    }
    return fault;
}

static void laid_out(struct file_task *task)
{
    struct animating *a = (struct animating *)task;
    char path[2 * PATH_MAX];
    if (a->task.status || !a->wait.request) {
        end(a, NULL, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
            "the animation's files cannot be laid out under their names");
        return;
    }
    snprintf(path, sizeof path, "%s/%s", a->folder, a->name[0]);
    decoder_pose(a->server->decoder, path, a->name[0], a->animation, a->time_s, a->up_z,
                 decoded, a);
}

static void lay_out(struct animating *a)
{
    static uint64_t last;
    snprintf(a->folder, sizeof a->folder, "%s/work/pose-%llu", a->server->data,
             (unsigned long long)++last);
    a->task.run = run_lay_out;
    a->task.done = laid_out;
    file_queue_add(a->server->file_queue, &a->task);
}

// Has the uploads checked, one after another.
static void check_next(struct animating *a);

static void blob_checked(struct blob_waiter *waiter)
{
    check_next((struct animating *)((char *)waiter - offsetof(struct animating, blob_waiter)));
}

static void check_next(struct animating *a)
{
    const size_t i = a->n_checked++;
    char text[128];
    if (i && !blobs_has(a->server->blobs, a->hash[i - 1])) {
        snprintf(text, sizeof text, "%.80s: its blob was not uploaded", a->name[i - 1]);
        end(a, NULL, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND, text);
    } else if (i < a->n) {
        a->blob_waiter.wake = blob_checked;
        blobs_touch(a->server->blobs, a->hash[i]);
        blobs_check(a->server->blobs, a->hash[i], &a->blob_waiter);
    } else {
        lay_out(a);
    }
}

// False: the request was answered with what is wrong with its message.
static bool is_fine(struct request *request, const Relight__PutPoseRequest *in)
{
    const char *fault = NULL;
    if (!(in->time_s >= 0 && in->time_s <= 1e9f)) fault = "time_s: allowed range 0 to 1e9 s";
    else if (strlen(in->animation) >= sizeof((struct animating *)0)->animation)
        fault = "animation: the name has more than 63 bytes";
    else if (!in->n_files || in->n_files > MAX_FILES)
        fault = "files: the glTF of the model and its buffers, 1 to 64 files";
    if (fault) request_fail(request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST, "%s", fault);
    for (size_t i = 0; !fault && i < in->n_files; i++) {
        const Relight__FileRef *f = in->files[i];
        int code = 0;
        if (!load_safe_name(f->name)) {
            fault = "the name is not a plain relative path";
            code = RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST;
        } else if (!blobs_has(request->server->blobs, f->blob)) {
            fault = "its blob was not uploaded";
            code = RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
        }
        if (fault) request_fail(request, code, "files[%zu] %.100s: %s", i, f->name, fault);
    }
    return !fault;
}

void pose_animate(struct request *request, pose_animated_fn fn, void *user)
{
    const Relight__PutPoseRequest *in = (const Relight__PutPoseRequest *)request->message;
    const bool fine = is_fine(request, in);
    struct animating *a = fine ? calloc(1, sizeof *a) : NULL;
    if (!a) {
        if (fine)
            request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        fn(user, NULL, NULL);
        return;
    }
    a->server = request->server;
    a->fn = fn;
    a->user = user;
    a->time_s = (double)in->time_s;
    a->up_z = in->up_z;
    snprintf(a->animation, sizeof a->animation, "%s", in->animation);
    request_park(request, &a->wait);
    bool full = false;
    for (a->n = 0; a->n < in->n_files && !full; a->n += !full) {
        snprintf(a->hash[a->n], sizeof a->hash[0], "%s", in->files[a->n]->blob);
        full = !(a->name[a->n] = strdup(in->files[a->n]->name));
    }
    if (full) end(a, NULL, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
    else check_next(a);
}
