// SPDX-License-Identifier: MIT
// TLS by OpenSSL, always verified.
#include "tls.h"

#include "internal.h"

#include <arpa/inet.h>
#include <errno.h>
#include <openssl/bio.h>
#include <openssl/err.h>
#include <openssl/ssl.h>
#include <openssl/x509v3.h>
#include <poll.h>
#include <stdio.h>
#include <sys/socket.h>

enum { RECORD = 16 << 10 }; // bytes of one TLS record at most

struct relight_tls {
    SSL_CTX *context;
    SSL *ssl;
    BIO_METHOD *method;
    int fd;
    char record[RECORD];
};

// ---- the socket under it: OpenSSL's own would raise SIGPIPE

static int socket_write(BIO *bio, const char *bytes, int n)
{
    const struct relight_tls *tls = BIO_get_data(bio);
    BIO_clear_retry_flags(bio);
    ssize_t done = send(tls->fd, bytes, (size_t)n, MSG_NOSIGNAL);
    if (done < 0 && (errno == EAGAIN || errno == EINTR)) BIO_set_retry_write(bio);
    return (int)done;
}

static int socket_read(BIO *bio, char *out, int n)
{
    const struct relight_tls *tls = BIO_get_data(bio);
    BIO_clear_retry_flags(bio);
    ssize_t done = recv(tls->fd, out, (size_t)n, 0);
    if (done < 0 && (errno == EAGAIN || errno == EINTR)) BIO_set_retry_read(bio);
    return (int)done;
}

static long socket_control(BIO *bio, int command, long number, void *pointer)
{
    return command == BIO_CTRL_FLUSH || command == BIO_CTRL_DUP;
}

static BIO *make_bio(struct relight_tls *tls)
{
    tls->method = BIO_meth_new(BIO_get_new_index() | BIO_TYPE_SOURCE_SINK, "relight socket");
    if (!tls->method) return NULL;
    BIO_meth_set_write(tls->method, socket_write);
    BIO_meth_set_read(tls->method, socket_read);
    BIO_meth_set_ctrl(tls->method, socket_control);
    BIO *bio = BIO_new(tls->method);
    if (!bio) return NULL;
    BIO_set_data(bio, tls);
    BIO_set_init(bio, 1);
    return bio;
}

// ---- opening

static int set_trust(struct relight_tls *tls, const char *host, const char *ca,
                     struct relight_error *error)
{
    unsigned char address[16];
    bool numeric =
        inet_pton(AF_INET, host, address) == 1 || inet_pton(AF_INET6, host, address) == 1;
    SSL_CTX_set_min_proto_version(tls->context, TLS1_2_VERSION);
    SSL_CTX_set_verify(tls->context, SSL_VERIFY_PEER, NULL);
    SSL_CTX_set_mode(tls->context,
                     SSL_MODE_ENABLE_PARTIAL_WRITE | SSL_MODE_ACCEPT_MOVING_WRITE_BUFFER);
    if ((ca ? SSL_CTX_load_verify_file(tls->context, ca)
            : SSL_CTX_set_default_verify_paths(tls->context)) != 1)
        return relight_fail(error, RELIGHT_E_FILE, "name a PEM file with certificates",
                            "%s: its certificates could not be read",
                            ca ? ca : "the system's store");
    if (!(tls->ssl = SSL_new(tls->context)))
        return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
    int named = numeric
                    ? X509_VERIFY_PARAM_set1_ip_asc(SSL_get0_param(tls->ssl), host)
                    : SSL_set1_host(tls->ssl, host) && SSL_set_tlsext_host_name(tls->ssl, host);
    BIO *bio = named ? make_bio(tls) : NULL;
    if (!bio) return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
    SSL_set_bio(tls->ssl, bio, bio);
    SSL_set_connect_state(tls->ssl);
    return 0;
}

static int refused(const struct relight_tls *tls, const char *host, struct relight_error *error)
{
    long verdict = SSL_get_verify_result(tls->ssl);
    unsigned long code = ERR_get_error();
    const char *reason = code ? ERR_reason_error_string(code) : NULL;
    ERR_clear_error();
    if (verdict != X509_V_OK)
        return relight_fail(error, RELIGHT_E_UNREACHABLE,
                            "name the file of the certificate that signed it with --ca",
                            "tls:%s: the server's certificate is not trusted: %s", host,
                            X509_verify_cert_error_string(verdict));
    return relight_fail(error, RELIGHT_E_UNREACHABLE,
                        "does the server speak TLS at this address? Without it: tcp:HOST:PORT",
                        "tls:%s: the TLS handshake failed: %s", host,
                        reason ? reason : "the server closed the connection");
}

static int shake_hands(const struct relight_tls *tls, const char *host, double timeout_s,
                       struct relight_error *error)
{
    double end = relight_now_s() + timeout_s;
    for (;;) {
        ERR_clear_error();
        int result = SSL_do_handshake(tls->ssl);
        int want = result == 1 ? 0 : SSL_get_error(tls->ssl, result);
        if (!want) return 0;
        if (want != SSL_ERROR_WANT_READ && want != SSL_ERROR_WANT_WRITE)
            return refused(tls, host, error);
        struct pollfd p = {.fd = tls->fd,
                           .events = want == SSL_ERROR_WANT_READ ? POLLIN : POLLOUT};
        double left = end - relight_now_s();
        if (left <= 0)
            return relight_fail(error, RELIGHT_E_UNREACHABLE, "",
                                "tls:%s: the TLS handshake took too long", host);
        poll(&p, 1, (int)(left * 1e3) + 1);
    }
}

int relight_tls_open(int fd, const char *host, const char *ca, double timeout_s,
                     struct relight_tls **out, struct relight_error *error)
{
    struct relight_tls *tls = calloc(1, sizeof *tls);
    if (!tls || !(tls->context = SSL_CTX_new(TLS_client_method()))) {
        free(tls);
        return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
    }
    tls->fd = fd;
    int status = set_trust(tls, host, ca, error);
    if (!status) status = shake_hands(tls, host, timeout_s, error);
    ERR_clear_error();
    if (status) relight_tls_close(tls);
    else *out = tls;
    return status;
}

void relight_tls_close(struct relight_tls *tls)
{
    if (!tls) return;
    ERR_clear_error();
    if (tls->ssl && SSL_is_init_finished(tls->ssl)) SSL_shutdown(tls->ssl);
    SSL_free(tls->ssl);
    BIO_meth_free(tls->method);
    SSL_CTX_free(tls->context);
    ERR_clear_error();
    free(tls);
}

// ---- bytes

static ssize_t no_bytes(const struct relight_tls *tls, int result)
{
    int fault = errno;
    switch (SSL_get_error(tls->ssl, result)) {
    case SSL_ERROR_ZERO_RETURN:
        return 0;
    case SSL_ERROR_WANT_READ:
    case SSL_ERROR_WANT_WRITE:
        errno = EAGAIN;
        return -1;
    case SSL_ERROR_SYSCALL:
        ERR_clear_error();
        errno = fault ? fault : ECONNRESET;
        return -1;
    default:
        // An end without goodbye may be cut short by somebody between: it is an error.
        ERR_clear_error();
        errno = EPROTO;
        return -1;
    }
}

ssize_t relight_tls_read(struct relight_tls *tls, void *out, size_t n)
{
    size_t done = 0;
    ERR_clear_error();
    errno = 0;
    int result = SSL_read_ex(tls->ssl, out, n, &done);
    return result == 1 ? (ssize_t)done : no_bytes(tls, result);
}

// Small pieces share a record, a large one is not copied. A call after EAGAIN begins with the
// same bytes, as OpenSSL wants.
ssize_t relight_tls_write(struct relight_tls *tls, const struct iovec *iov, int n)
{
    size_t have = 0, done = 0;
    const void *from = tls->record;
    for (int i = 0; i < n && have < RECORD && iov->iov_len < RECORD; i++) {
        size_t take = iov[i].iov_len < RECORD - have ? iov[i].iov_len : RECORD - have;
        memcpy(tls->record + have, iov[i].iov_base, take);
        have += take;
    }
    if (!have) from = iov->iov_base, have = iov->iov_len;
    ERR_clear_error();
    errno = 0;
    int result = SSL_write_ex(tls->ssl, from, have, &done);
    if (result == 1) return (ssize_t)done;
    ssize_t status = no_bytes(tls, result);
    if (!status) errno = EPIPE;
    return -1;
}

bool relight_tls_pending(const struct relight_tls *tls)
{
    return SSL_has_pending(tls->ssl) == 1;
}
