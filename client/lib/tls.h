/* SPDX-License-Identifier: MIT */
/* tls.h owns the client's side of TLS on a connected socket. One thread at a time. */
#ifndef RELIGHT_TLS_H
#define RELIGHT_TLS_H

#include "relight/relight.h"

#include <sys/types.h>
#include <sys/uio.h>

struct relight_tls;

/* Shakes hands on a non-blocking socket and checks that the certificate is host's (a name or an
 * address), signed by one in ca (a PEM file; NULL: the system's store), and of today. 0, or
 * -RELIGHT_E_UNREACHABLE, -RELIGHT_E_FILE with the reason. */
int relight_tls_open(int fd, const char *host, const char *ca, double timeout_s,
                     struct relight_tls **out, struct relight_error *error);
/* As recv and sendmsg without SIGPIPE: bytes, 0 at the end, or -1 with errno. */
ssize_t relight_tls_read(struct relight_tls *tls, void *out, size_t n);
ssize_t relight_tls_write(struct relight_tls *tls, const struct iovec *iov, int n);
/* Whether received bytes wait that the socket will not report. */
bool relight_tls_pending(const struct relight_tls *tls);
void relight_tls_close(struct relight_tls *tls); /* NULL is fine; the socket stays open */

#endif
