// SPDX-License-Identifier: MIT
// GET_BLOB: sends a range of an upload to a client that may read it.
#include "core/token_store.h"
#include "net/dispatch.h"
#include "net/request_wait.h"
#include "relight.pb-c.h"
#include "store/blobs.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MOST = 4 << 20 }; // bytes of one answer

struct fetch {
    struct request_wait wait; // for the check of the blob, then for the worker
    struct blob_waiter checked;
    struct server *server;
    char hash[BLOB_HASH + 1], path[4096];
    uint64_t size, offset;
    size_t n;
    char *bytes;
};

static void end_fetch(struct fetch *f)
{
    free(f->bytes);
    free(f);
}

static int run_fetch(struct work *work, const struct prt_context *ctx)
{
    struct fetch *f = (struct fetch *)work;
    int fd = open(f->path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    size_t have = 0;
    if (fd < 0) return PRT_IO;
    f->bytes = malloc(f->n ? f->n : 1);
    for (ssize_t k = 1; f->bytes && have < f->n && k > 0;) {
        k = pread(fd, f->bytes + have, f->n - have, (off_t)(f->offset + have));
        if (k < 0 && errno == EINTR) k = 1;
        else if (k > 0) have += (size_t)k;
    }
    close(fd);
    return !f->bytes ? PRT_NOMEM : have < f->n ? PRT_IO : PRT_OK;
}

static void gone(struct request *request, const char *hash)
{
    request_fail(request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                 "blob %.12s: no such upload of this client", hash);
}

static void fetched(struct request_wait *wait, struct request *request)
{
    struct fetch *f = (struct fetch *)wait;
    if (request && wait->work.status == PRT_NOMEM) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
    } else if (request && wait->work.status) {
        gone(request, f->hash); // evicted meanwhile
    } else if (request) {
        Relight__GetBlobAnswer out = RELIGHT__GET_BLOB_ANSWER__INIT;
        struct payload payload = {f->bytes, f->n, f->bytes, free};
        char name[BLOB_NAME + 1];
        blobs_name(f->server->blobs, request->conn->caller.name, f->hash, name, sizeof name);
        out.size = f->size;
        out.name = name;
        f->bytes = NULL;
        request_answer(request, &out.base, &payload);
    }
    end_fetch(f);
}

static void was_checked(struct blob_waiter *waiter)
{
    struct fetch *f = (struct fetch *)((char *)waiter - offsetof(struct fetch, checked));
    struct request *request = request_resume(&f->wait);
    if (!request) {
        end_fetch(f);
    } else if (!blobs_has(f->server->blobs, f->hash)) { // damaged on disk
        gone(request, f->hash);
        end_fetch(f);
    } else {
        request_await_work(request, &f->wait, run_fetch, fetched);
    }
}

void op_get_blob(struct request *request)
{
    const Relight__GetBlobRequest *in = (const Relight__GetBlobRequest *)request->message;
    struct server *server = request->server;
    bool admin = request->conn->caller.scopes & SCOPE_ADMIN;
    uint64_t size;
    char error[256];
    if (!blobs_owned(server->blobs, admin ? NULL : request->conn->caller.name, in->hash,
                     &size)) {
        gone(request, in->hash);
        return;
    }
    if (in->offset > size) {
        int code = range_refuse(error, sizeof error, (double)in->offset, 0, (double)size,
                                "bytes", "offset");
        request_fail(request, code, "%s", error);
        return;
    }
    uint64_t n = size - in->offset;
    if (in->size && in->size < n) n = in->size;
    if (n > MOST) n = MOST;
    if (ledger_take(request->principal, LEDGER_PAYLOAD, n, error)) {
        request_fail(request, refusal_code(request->principal, LEDGER_PAYLOAD, n), "%s", error);
        return;
    }
    request->header_charged += n; // until the answer takes the bytes
    struct fetch *f = calloc(1, sizeof *f);
    if (!f) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    f->server = server;
    f->size = size;
    f->offset = in->offset;
    f->n = (size_t)n;
    memcpy(f->hash, in->hash, sizeof f->hash);
    blobs_path(server->blobs, f->hash, f->path, sizeof f->path);
    blobs_touch(server->blobs, f->hash);
    f->checked.wake = was_checked;
    request_park(request, &f->wait);
    blobs_check(server->blobs, f->hash, &f->checked);
}
