// SPDX-License-Identifier: MIT
// ROOM_BACKUP: a copy of the store, made while it is used, is sent to the client piece by
// piece.
#include "rooms/room_backup.h"

#include "core/log.h"
#include "net/dispatch.h"
#include "rooms/room_private.h"

#include <errno.h>
#include <fcntl.h>
#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { PIECE = 4 << 20, MOST_BACKUPS = 4 };
static const uint64_t keep_ns = 60000000000u;

struct backup {
    struct backup *next;
    struct rooms *rooms;
    char id[33], path[4096];
    uint64_t size;
    bool busy; // it is being written or read
    struct loop_timer timer;
};

static void drop(struct backup *backup)
{
    struct backup **at = &backup->rooms->backups;
    while (*at != backup) at = &(*at)->next;
    *at = backup->next;
    loop_timer_stop(backup->rooms->server->loop, &backup->timer);
    unlink(backup->path);
    free(backup);
}

void backups_drop(struct rooms *rooms)
{
    while (rooms->backups) drop(rooms->backups);
}

static void over(struct loop_timer *timer)
{
    struct backup *b = (struct backup *)((char *)timer - offsetof(struct backup, timer));
    if (b->busy) loop_timer_set(b->rooms->server->loop, timer, loop_now_ns() + keep_ns);
    else drop(b);
}

static struct backup *find(struct rooms *rooms, const char *id)
{
    struct backup *b = rooms->backups;
    while (b && (b->busy || strcmp(b->id, id))) b = b->next;
    return b;
}

static struct backup *new_backup(struct rooms *rooms)
{
    struct backup *b = calloc(1, sizeof *b);
    uint8_t random[16];
    if (!b) return NULL;
    b->rooms = rooms;
    b->busy = true;
    b->timer.fire = over;
    randombytes_buf(random, sizeof random);
    sodium_bin2hex(b->id, sizeof b->id, random, sizeof random);
    snprintf(b->path, sizeof b->path, "%s/work/rooms-%s.sqlite", rooms->server->data, b->id);
    b->next = rooms->backups;
    rooms->backups = b;
    loop_timer_set(rooms->server->loop, &b->timer, loop_now_ns() + keep_ns);
    return b;
}

// ---- a piece

struct piece {
    struct request_wait wait; // first
    struct backup *backup;
    struct room_task task;
    uint64_t offset;
    uint8_t *bytes;
    size_t n;
};

static int read_piece(struct work *work, const struct prt_context *ctx)
{
    struct piece *p = (struct piece *)work;
    int fd = open(p->backup->path, O_RDONLY | O_CLOEXEC);
    ssize_t n = -1;
    if (fd >= 0 && (p->bytes = malloc(PIECE))) n = pread(fd, p->bytes, PIECE, (off_t)p->offset);
    if (n >= 0) p->n = (size_t)n;
    else snprintf(work->error, sizeof work->error, "%s", strerror(errno));
    if (fd >= 0) close(fd);
    return n < 0 ? PRT_IO : PRT_OK;
}

static void piece_read(struct request_wait *wait, struct request *request)
{
    struct piece *p = (struct piece *)wait;
    struct backup *b = p->backup;
    b->busy = false;
    loop_timer_set(b->rooms->server->loop, &b->timer, loop_now_ns() + keep_ns);
    if (request && wait->work.status) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_INTERNAL,
                     "the copy could not be read: %s", wait->work.error);
    } else if (request) {
        Relight__RoomBackupAnswer out = RELIGHT__ROOM_BACKUP_ANSWER__INIT;
        struct payload payload = payload_of(p->bytes, p->n);
        out.backup = b->id;
        out.size = b->size;
        p->bytes = NULL;
        bool last = p->offset + p->n >= b->size;
        request_answer(request, &out.base, &payload);
        if (last) drop(b);
    }
    free(p->bytes);
    free(p);
}

static void begin_piece(struct request *request, struct piece *p, uint64_t offset)
{
    p->backup->busy = true;
    p->offset = offset;
    request_await_work(request, &p->wait, read_piece, piece_read);
}

static void copied(struct room_task *task)
{
    struct piece *p = (struct piece *)((char *)task - offsetof(struct piece, task));
    struct request *request = request_resume(&p->wait);
    struct rooms *rooms = p->backup->rooms;
    p->backup->size = task->stored_bytes;
    p->backup->busy = false;
    if (task->status != ROOM_TASK_DONE) {
        log_line(LOG_ERR, "rooms: no backup could be made: %s", task->error);
        drop(p->backup);
        if (request)
            request_fail(request, RELIGHT__ERROR_CODE__ERROR_INTERNAL,
                         "no copy of the rooms could be made: %s", task->error);
    } else if (!request || rooms->stopping) {
        drop(p->backup);
    } else {
        begin_piece(request, p, 0);
        return;
    }
    free(p);
}

void op_room_backup(struct request *request)
{
    const Relight__RoomBackupRequest *in = (const Relight__RoomBackupRequest *)request->message;
    struct rooms *rooms = request->server->rooms;
    struct backup *b = *in->backup ? find(rooms, in->backup) : NULL;
    unsigned n = 0;
    for (struct backup *at = rooms->backups; at; at = at->next) n++;
    if (*in->backup && (!b || in->offset > b->size)) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                     "%.40s: no such copy of the rooms: begin again", in->backup);
        return;
    }
    if (!b && n >= MOST_BACKUPS) {
        request->retry_ms = 5000;
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BUSY,
                     "%u copies of the rooms are being made already", n);
        return;
    }
    struct piece *p = calloc(1, sizeof *p);
    if (!p || !(p->backup = b ? b : new_backup(rooms))) {
        free(p);
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    if (b) {
        begin_piece(request, p, in->offset);
        return;
    }
    log_line(LOG_EVENT, "audit act=room-backup who=%s", request->conn->caller.name);
    p->task.kind = ROOM_TASK_BACKUP;
    p->task.path = p->backup->path;
    p->task.done = copied;
    request_park(request, &p->wait);
    rooms->store->api->submit(rooms->store, &p->task);
}
