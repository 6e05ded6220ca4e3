// SPDX-License-Identifier: MIT
// The daemon's events, and uploads that come back.
#include "internal.h"
#include "new_file.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <unistd.h>

_Static_assert((int)RELIGHT_EVENT_ENVIRONMENT_ADDED ==
                   RELIGHT__EVENT_KIND__EVENT_ENVIRONMENT_ADDED,
               "events");

const char *relight_event_name(int kind)
{
    static const char *const names[] = {
        "note",          "model added", "model changed",    "model replaced",
        "model removed", "bake",        "environment added"};
    return kind >= 0 && kind < (int)(sizeof names / sizeof *names) ? names[kind] : "event";
}

static void get_event(const Relight__Event *m, struct relight_event *out)
{
    const Relight__Progress *p = m->progress;
    const Relight__Error *e = p && p->error ? p->error : m->error;
    *out = (struct relight_event){.kind = (int)m->kind,
                                  .lost = m->lost,
                                  .time_us = m->time_us,
                                  .model = m->model,
                                  .before = m->before,
                                  .name = m->name,
                                  .env = m->env,
                                  .job = p ? p->job : "",
                                  .stage = p ? p->stage : "",
                                  .failure = e ? e->text : "",
                                  .state = (enum relight_model_state)m->state,
                                  .generation = m->generation,
                                  .eta_s = -1};
    if (!p) return;
    out->job_state = (enum relight_job_state)p->state;
    out->fraction = p->fraction;
    out->eta_s = p->eta_s;
}

// Until fn ends it (1), wait_s passes (0), or the connection or the daemon ends (an error).
static int follow(struct relight_client *client, struct relight_cursor *cursor, double wait_s,
                  relight_event_fn fn, void *user, struct relight_error *error)
{
    Relight__SubscribeRequest m = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    uint64_t id;
    m.run = cursor->run;
    m.after = cursor->sequence;
    int status =
        relight_start(client, RELIGHT_TYPE_SUBSCRIBE, &m.base, NULL, 0, 0, false, &id, error);
    if (status) return status;
    for (;;) {
        struct answer *answer;
        struct relight_event event;
        status = relight_next(client, id, wait_s < 0 ? 1e9 : wait_s, &answer, error);
        if (status == -RELIGHT_E_TIMEOUT) {
            relight_forget(client, id);
            return 0;
        }
        if (status) return status;
        if (answer->type != (RELIGHT_TYPE_SUBSCRIBE | RELIGHT_TYPE_ANSWER)) {
            relight_answer_free(answer);
            relight_forget(client, id);
            return relight_fail(error, RELIGHT_E_PROTOCOL, "",
                                "unexpected answer to SUBSCRIBE");
        }
        const Relight__Event *e = (Relight__Event *)answer->message;
        snprintf(cursor->run, sizeof cursor->run, "%s", e->run);
        cursor->sequence = e->sequence;
        get_event(e, &event);
        int stop = fn(user, &event);
        relight_answer_free(answer);
        if (!stop) continue;
        relight_forget(client, id);
        return 1;
    }
}

int relight_events(struct relight_client *client, struct relight_cursor *cursor, double wait_s,
                   relight_event_fn fn, void *user, struct relight_error *error)
{
    struct relight_cursor own = {"", 0};
    struct relight_error fault;
    if (!cursor) cursor = &own;
    for (;;) {
        int status = follow(client, cursor, wait_s, fn, user, &fault);
        bool gone = status == -RELIGHT_E_DISCONNECTED || status == -RELIGHT_E_SHUTTING_DOWN;
        if (status >= 0) return 0;
        if (gone && relight_reconnects(client)) {
            struct timespec pause = {0, 100000000}; // a daemon that stops still answers
            nanosleep(&pause, NULL);
            continue;
        }
        if (error) *error = fault;
        return status;
    }
}

// ---- uploads that come back

static int fetch(struct relight_client *client, Relight__GetBlobRequest *m, FILE *file,
                 struct relight_sha256 *sha, uint64_t *size, struct relight_error *error)
{
    struct answer *answer;
    int status = relight_call(client, RELIGHT_TYPE_GET_BLOB, &m->base, &answer, error);
    if (status) return status;
    const Relight__GetBlobAnswer *a = (Relight__GetBlobAnswer *)answer->message;
    *size = a->size;
    if (answer->payload_size > a->size - m->offset ||
        (!answer->payload_size && m->offset < a->size))
        status =
            relight_fail(error, RELIGHT_E_PROTOCOL, "", "GET_BLOB: %llu bytes at %llu of %llu",
                         (unsigned long long)answer->payload_size,
                         (unsigned long long)m->offset, (unsigned long long)a->size);
    else if (fwrite(answer->payload, 1, answer->payload_size, file) != answer->payload_size)
        status = relight_fail(error, RELIGHT_E_FILE, "", "%s", strerror(errno));
    else relight_sha256_add(sha, answer->payload, answer->payload_size);
    m->offset += answer->payload_size;
    relight_answer_free(answer);
    return status;
}

int relight_download(struct relight_client *client, const char *hash, const char *path,
                     relight_progress_fn fn, void *user, uint64_t *size,
                     struct relight_error *error)
{
    Relight__GetBlobRequest m = RELIGHT__GET_BLOB_REQUEST__INIT;
    struct relight_sha256 sha;
    uint64_t total = UINT64_MAX;
    char hex[65];
    struct new_file file;
    if (!strncmp(hash, "env:", 4)) hash += 4;
    if (!relight_hash_valid(hash))
        return relight_fail(error, RELIGHT_E_ARGUMENT, "", "%.80s: not 64 hex digits", hash);
    int status = relight_new_file(&file, path, error);
    if (status) return status;
    relight_sha256_init(&sha);
    m.hash = relight_text(hash);
    double begin_s = relight_now_s();
    while (!status && m.offset < total) {
        status = fetch(client, &m, file.file, &sha, &total, error);
        double share = total ? (double)m.offset / (double)total : 1;
        struct relight_progress progress = {"download", share, -1, relight_now_s() - begin_s,
                                            RELIGHT_JOB_RUNNING};
        if (!status && fn && fn(user, &progress))
            status = relight_fail(error, RELIGHT_E_CANCELLED, "", "stopped");
    }
    relight_sha256_hex(&sha, hex);
    if (!status && strcmp(hex, hash))
        status = relight_fail(error, RELIGHT_E_HASH, "", "%.12s: the bytes are damaged", hash);
    status = relight_new_file_end(&file, status, error);
    if (!status && size) *size = total;
    return status;
}
