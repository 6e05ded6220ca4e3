// SPDX-License-Identifier: MIT
// TLS by OpenSSL: the certificate, and streams that read and write like sockets.
#include "core/tls.h"

#include <errno.h>
#include <openssl/err.h>
#include <openssl/ssl.h>
#include <openssl/x509.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/uio.h>

struct tls {
    SSL_CTX *context;
};

struct tls_stream {
    SSL *ssl;
    bool wants_write;
    char fault[160];
};

// The first error of OpenSSL's queue, which is emptied.
static void take_error(char *out, size_t n)
{
    unsigned long code = ERR_get_error();
    const char *reason = code ? ERR_reason_error_string(code) : NULL;
    snprintf(out, n, "%s", reason ? reason : "unknown error");
    ERR_clear_error();
}

// ---- the certificate

// A key with a password would stop the daemon at a prompt.
static int no_password(char *out, int size, int writing, void *user)
{
    return -1;
}

static void set_versions(SSL_CTX *context)
{
    SSL_CTX_set_min_proto_version(context, TLS1_2_VERSION);
    SSL_CTX_set_options(context, SSL_OP_NO_COMPRESSION | SSL_OP_NO_RENEGOTIATION |
                                     SSL_OP_CIPHER_SERVER_PREFERENCE);
}

static SSL_CTX *read_files(const char *cert, const char *key, char fault[256])
{
    SSL_CTX *context = SSL_CTX_new(TLS_server_method());
    const char *file = NULL;
    char why[160];
    ERR_clear_error();
    if (context) {
        set_versions(context);
        SSL_CTX_set_default_passwd_cb(context, no_password);
        SSL_CTX_set_mode(context, SSL_MODE_ENABLE_PARTIAL_WRITE |
                                      SSL_MODE_ACCEPT_MOVING_WRITE_BUFFER |
                                      SSL_MODE_RELEASE_BUFFERS);
        SSL_CTX_set_session_cache_mode(context, SSL_SESS_CACHE_OFF); // tickets need no memory
        if (SSL_CTX_use_certificate_chain_file(context, cert) != 1) file = cert;
        else if (SSL_CTX_use_PrivateKey_file(context, key, SSL_FILETYPE_PEM) != 1) file = key;
        else if (SSL_CTX_check_private_key(context) != 1) file = key;
        else return context;
    }
    take_error(why, sizeof why);
    snprintf(fault, 256, "%s %.100s: %.100s", file == key ? "--tls-key" : "--tls-cert",
             file ? file : "", why);
    SSL_CTX_free(context);
    return NULL;
}

int tls_create(const char *cert, const char *key, struct tls **out, char fault[256])
{
    struct tls *tls = calloc(1, sizeof *tls);
    if (tls && (tls->context = read_files(cert, key, fault))) {
        *out = tls;
        return 0;
    }
    if (!tls) snprintf(fault, 256, "not enough memory for TLS");
    free(tls);
    return -1;
}

int tls_reload(struct tls *tls, const char *cert, const char *key, char fault[256])
{
    SSL_CTX *fresh = read_files(cert, key, fault);
    if (!fresh) return -1;
    SSL_CTX_free(tls->context); // open streams hold it
    tls->context = fresh;
    return 0;
}

void tls_destroy(struct tls *tls)
{
    if (tls) SSL_CTX_free(tls->context);
    free(tls);
}

void tls_describe(const struct tls *tls, char *out, size_t n)
{
    const X509 *cert = SSL_CTX_get0_certificate(tls->context);
    char name[128] = "?";
    struct tm until = {0};
    X509_NAME_oneline(X509_get_subject_name(cert), name, sizeof name);
    ASN1_TIME_to_tm(X509_get0_notAfter(cert), &until);
    snprintf(out, n, "%s, until %04d-%02d-%02d", name, until.tm_year + 1900, until.tm_mon + 1,
             until.tm_mday);
}

// Chosen at each handshake, so that a reload needs no new context.
static int choose_certificate(SSL *ssl, void *user)
{
    const struct tls *tls = user;
    STACK_OF(X509) *chain = NULL;
    SSL_CTX_get0_chain_certs(tls->context, &chain);
    return SSL_use_cert_and_key(ssl, SSL_CTX_get0_certificate(tls->context),
                                SSL_CTX_get0_privatekey(tls->context), chain, 1);
}

void tls_attach(struct tls *tls, void *ssl_ctx)
{
    set_versions(ssl_ctx);
    SSL_CTX_set_cert_cb(ssl_ctx, choose_certificate, tls);
}

// ---- streams

struct tls_stream *tls_stream_open(struct tls *tls, int fd)
{
    struct tls_stream *stream = calloc(1, sizeof *stream);
    if (!stream || !(stream->ssl = SSL_new(tls->context)) || SSL_set_fd(stream->ssl, fd) != 1) {
        if (stream) SSL_free(stream->ssl);
        free(stream);
        ERR_clear_error();
        return NULL;
    }
    SSL_set_accept_state(stream->ssl);
    return stream;
}

void tls_stream_close(struct tls_stream *stream)
{
    ERR_clear_error();
    if (SSL_is_init_finished(stream->ssl) && !stream->fault[0]) SSL_shutdown(stream->ssl);
    ERR_clear_error();
    SSL_free(stream->ssl);
    free(stream);
}

// The result of a call that did not pass bytes: 0, or -1 with errno.
static ssize_t no_bytes(struct tls_stream *stream, int result)
{
    int fault = errno;
    switch (SSL_get_error(stream->ssl, result)) {
    case SSL_ERROR_ZERO_RETURN:
        return 0;
    case SSL_ERROR_WANT_READ:
        errno = EAGAIN;
        return -1;
    case SSL_ERROR_WANT_WRITE:
        stream->wants_write = true;
        errno = EAGAIN;
        return -1;
    case SSL_ERROR_SYSCALL:
        snprintf(stream->fault, sizeof stream->fault, "TLS: the connection broke off");
        ERR_clear_error();
        errno = fault;
        return fault ? -1 : 0;
    default:
        memcpy(stream->fault, "TLS: ", 5);
        take_error(stream->fault + 5, sizeof stream->fault - 5);
        errno = EPROTO;
        return -1;
    }
}

ssize_t tls_stream_read(struct tls_stream *stream, void *out, size_t n)
{
    size_t done = 0;
    ERR_clear_error();
    errno = 0;
    stream->wants_write = false;
    int result = SSL_read_ex(stream->ssl, out, n, &done);
    return result == 1 ? (ssize_t)done : no_bytes(stream, result);
}

// One record of the pieces: small frames share it. A call after EAGAIN begins with the same
// bytes, which OpenSSL has encrypted already.
ssize_t tls_stream_write(struct tls_stream *stream, const struct iovec *iov, int n)
{
    static char record[TLS_RECORD];
    size_t have = 0, done = 0;
    for (int i = 0; i < n && have < TLS_RECORD; i++) {
        size_t take = iov[i].iov_len < TLS_RECORD - have ? iov[i].iov_len : TLS_RECORD - have;
        memcpy(record + have, iov[i].iov_base, take);
        have += take;
    }
    ERR_clear_error();
    errno = 0;
    int result = SSL_write_ex(stream->ssl, record, have, &done);
    if (result == 1) return (ssize_t)done;
    bool wanted = stream->wants_write; // that is about reading
    ssize_t status = no_bytes(stream, result);
    stream->wants_write = wanted;
    if (!status) errno = EPIPE;
    return -1;
}

bool tls_stream_ready(const struct tls_stream *stream)
{
    return SSL_is_init_finished(stream->ssl);
}

bool tls_stream_pending(const struct tls_stream *stream)
{
    return SSL_has_pending(stream->ssl) == 1;
}

bool tls_stream_wants_write(const struct tls_stream *stream)
{
    return stream->wants_write;
}

const char *tls_stream_fault(const struct tls_stream *stream)
{
    return stream->fault;
}
