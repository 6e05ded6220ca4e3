/* SPDX-License-Identifier: MIT */
/* tls.h owns the daemon's certificate: reading --tls-cert and --tls-key, replacing them while
 * connections are open, and TLS streams over sockets. TLS 1.2 and 1.3, no compression, no
 * renegotiation. Loop thread only. */
#ifndef RELIGHTD_TLS_H
#define RELIGHTD_TLS_H

#include <stdbool.h>
#include <stddef.h>
#include <sys/types.h>

struct tls;
struct tls_stream;
struct iovec;

/* cert: a PEM file with the certificate and then those that sign it. key: its private key, PEM,
 * without a password. 0, or -1 with the error's text in fault: files that do not parse or do
 * not belong together. */
int tls_create(const char *cert, const char *key, struct tls **out, char fault[256]);
/* Reads the files again, for connections from here on; those that are open keep theirs. -1 with
 * the error's text: the old certificate stays. */
int tls_reload(struct tls *tls, const char *cert, const char *key, char fault[256]);
void tls_destroy(struct tls *tls); /* NULL is fine; streams may outlive it */
/* "CN=host, until 2026-12-31": what is served now, for the log. */
void tls_describe(const struct tls *tls, char *out, size_t n);

/* The server's side of a connection on a non-blocking socket; NULL without memory. The
 * handshake runs as bytes come. */
struct tls_stream *tls_stream_open(struct tls *tls, int fd);
/* Says goodbye, without waiting, and frees it. The descriptor stays open. */
void tls_stream_close(struct tls_stream *stream);
enum { TLS_RECORD = 16 << 10 }; /* bytes of one record at most */
/* As recv and sendmsg: bytes, 0 at the end, or -1 with errno; EAGAIN: call again when the
 * socket is ready. After EPROTO tls_stream_fault has the reason. A write takes TLS_RECORD bytes
 * at most; after EAGAIN it has encrypted them, and the next write has to begin with the same.
 */
ssize_t tls_stream_read(struct tls_stream *stream, void *out, size_t n);
ssize_t tls_stream_write(struct tls_stream *stream, const struct iovec *iov, int n);
/* Whether the handshake is over; whether decrypted or received bytes wait that the socket will
 * not report; whether reading waits until the socket can be written. */
bool tls_stream_ready(const struct tls_stream *stream);
bool tls_stream_pending(const struct tls_stream *stream);
bool tls_stream_wants_write(const struct tls_stream *stream);
const char *tls_stream_fault(const struct tls_stream *stream);

/* Makes another library's context (SSL_CTX *) serve this certificate and its later versions. */
void tls_attach(struct tls *tls, void *ssl_ctx);

#endif
