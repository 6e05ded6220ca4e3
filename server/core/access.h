/* SPDX-License-Identifier: MIT */
/* access.h owns who may do what: the scopes, the tokens of DATA/tokens.json and of
 * --token-file, the rights of local users, and the delay after wrong tokens.
 * Thread-safety: loop thread only, but for token_store.h's parser and printer. */
#ifndef RELIGHTD_ACCESS_H
#define RELIGHTD_ACCESS_H

#include "core/ledger.h"
#include "core/token_store.h"

#include <stdbool.h>
#include <stdint.h>

struct access;
struct options;

/* A client after its identity was checked. */
struct caller {
    char name[96];     /* the principal: "token:NAME", "uid:1000" or "addr:192.0.2.7" */
    char inviter[96];  /* of a guest: the principal whose limits its work counts to; else "" */
    unsigned scopes;   /* enum access_scope */
    int64_t expires_s; /* seconds since 1970; 0: never */
    uint8_t token[TOKEN_HASH]; /* another may follow under its name; zeros: it showed none */
};

/* The principal that is charged for what the caller does. */
const char *caller_payer(const struct caller *caller);

enum access_verdict {
    ACCESS_GRANTED,
    ACCESS_NO_TOKEN, /* a token is required and none was sent */
    ACCESS_WRONG,    /* the token is unknown or was revoked: counted as a guess */
    ACCESS_EXPIRED,
    ACCESS_LATER, /* too many wrong tokens came from this address: wait retry_ms */
};

/* folder: the data folder; its tokens.json is read. NULL: no tokens. The options must outlive
 * it. 0, or -1 with the error's text in fault: a damaged file is refused, since an empty list
 * might open the daemon to everyone. */
int access_create(const struct options *options, const char *folder, struct access **out,
                  char fault[256]);
void access_destroy(struct access *access);

/* The token of --token-file, named "default", with every scope. "": none. */
void access_set_default(struct access *access, const char *secret);
bool access_has_default(const struct access *access);
/* Whether `secret` is the token of --token-file. */
bool access_is_default(const struct access *access, const char *secret);
/* Whether TCP, HTTP and WebSocket clients need a token: --token-file is set, or a token was
 * created in this data folder (also one that was revoked since). */
bool access_required(const struct access *access);
/* The same for a data folder that no daemon has opened, from its options. */
bool access_configured(const struct options *options);

/* Checks a client. who: "uid:1000" (the peer of a unix socket) or "addr:192.0.2.7".
 * secret: what it sent, "" for nothing. A right token gives its own rights on every carrier.
 * Without a token
 *   the daemon's own user and root have every scope on a unix socket,
 *   other users have --local-scopes there,
 *   loopback addresses have every scope while no token is required,
 *   other addresses (--accept-anyone) have all but admin then.
 * *out is filled when granted; else error has the text and *retry_ms the time to wait. */
enum access_verdict access_check(struct access *access, const char *who, const char *secret,
                                 struct caller *out, char error[256], uint32_t *retry_ms);
/* Whether the caller's token is still valid; true for a caller without a token. */
bool access_is_current(const struct access *access, const struct caller *caller);

/* Guests: clients with an invitation in place of a token (rooms/guests.h). check:
 * ACCESS_NO_TOKEN where the secret is no invitation at all. current: whether a principal's
 * invitation, "guest:ID", is still valid. */
typedef enum access_verdict (*access_guest_fn)(void *user, const char *secret,
                                               struct caller *out, char error[256]);
bool is_guest(const char *principal);
void access_set_guests(struct access *access, access_guest_fn check,
                       bool (*current)(void *user, const char *principal), void *user);

/* Signs a text with the caller's token: HMAC-SHA-256 with the token's hash as its key, in
 * base64url; out has 44 bytes. False: the caller has no token. */
bool access_sign(const struct access *access, const struct caller *caller, const char *text,
                 char out[44]);
/* Whether that is the signature of a text by the token of this name, which is valid. *out is
 * then the token with the scope `view` at most. */
bool access_signature_is(const struct access *access, const char *token, const char *text,
                         const char *signature, struct caller *out);

/* Takes one request from the caller's quota of requests a second. A second's requests may come
 * at once, and ACCESS_BURST of a slower rate. False: none is left, and one is in *retry_ms. */
enum { ACCESS_BURST = 10 };
bool access_take_request(struct access *access, const struct caller *caller,
                         uint32_t *retry_ms);
/* Fills the limits that the principal's token sets; ledger_set_quotas calls it. */
void access_quotas(void *access, const char *principal, uint64_t limit[LEDGER_N]);

/* The list of tokens. A change is in force at once; the caller writes the file. */
struct token_store *access_store(struct access *access);
/* Replaces the list by a text of tokens_print(); what a token may still ask for stays. 0, or -1
 * with the fault's text, and the list is as it was. */
int access_replace(struct access *access, const char *text, size_t n, char fault[256]);
/* A new token's file was written: the token is valid, and access_required() from here on.
 * Returns whether it was not before. */
bool access_commit(struct access *access, struct token *token);
/* DATA/tokens.json; n >= 4096. */
void access_path(const struct access *access, char *path, unsigned n);

/* NULL, or the first scope of `wanted` that `has` lacks, as a word. */
const char *access_missing(unsigned has, unsigned wanted);

#endif
