/* SPDX-License-Identifier: MIT */
/* upload.h owns the bodies of HTTP requests. A file is written to the store of uploads as it
 * arrives, in chunks that are charged before they are allocated (PUT_BLOB); the socket is not
 * read while two of them wait for the disk. Its hash is computed on the way. JSON is kept until
 * it is complete, and charged, too. Loop thread only. */
#ifndef RELIGHTD_UPLOAD_H
#define RELIGHTD_UPLOAD_H

#include "net/exchange.h"
#include "relight.pb-c.h"

/* Checks type and size of the body before any of it is read. */
bool upload_check(struct exchange *x, struct http_problem *problem);
void upload_begin(struct exchange *x);
void upload_receive(struct exchange *x, const void *bytes, size_t n);
/* Bytes of a chunked body, with its framing. Its size is known at its end only: it is kept
 * until then, up to UPLOAD_KEPT bytes. False: the socket is to be closed. */
enum { UPLOAD_KEPT = 48 << 20 };
bool upload_receive_chunked(struct exchange *x, const char *bytes, size_t n);
/* A chunk was written. */
void upload_answered(struct exchange *x, const Relight__PutBlobAnswer *answer);
/* Reads from the socket, or not. */
void upload_pace(struct exchange *x);
/* Before x->conn ends: removes the unfinished upload from the store. No client knows its name.
 */
void upload_forget(struct exchange *x);
/* Drops what there is of an unfinished body, here and in the store. */
void upload_end(struct exchange *x);

/* exchange.c: sends a message; header and payload are charged as any request's. */
void exchange_dispatch(struct exchange *x, uint16_t type, const ProtobufCMessage *message,
                       uint8_t *payload, size_t n);
/* exchange.c: the body is complete: runs the operation. */
void exchange_run(struct exchange *x);

#endif
