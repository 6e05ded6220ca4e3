/* SPDX-License-Identifier: MIT */
/* signed_url.h owns links that expire: a path and its parameters, signed with a token. Such a
 * link needs no token, and is good for one picture. PROTOCOL.md, SIGN, has the text that is
 * signed. Loop thread only. */
#ifndef RELIGHTD_SIGNED_URL_H
#define RELIGHTD_SIGNED_URL_H

#include "core/access.h"
#include "net/http_head.h"

enum {
    SIGNATURE = 44,              /* base64url of HMAC-SHA-256, with the end */
    SIGNED_TEXT = 16 << 10,      /* bytes of the text that is signed */
    SIGNED_MOST_S = 366 * 86400, /* longest life of a link */
};

/* The text to sign: the path and the parameters without `sig`, decoded, in the order of their
 * names. False: it is longer than SIGNED_TEXT. */
bool signed_url_text(const struct http_head *head, char out[SIGNED_TEXT]);

/* Reads path and query ("/v1/models/bunny/image.jpg?rotate=30") as a request's are. head is to
 * be finished either way. NULL, or the fault. */
const char *signed_url_read(const char *url, struct http_head *head);

/* Fills *out with the link's rights: those of its token, `view` at most. Else *problem says why
 * it is refused: 403, with the same text for a wrong signature and an unknown token. */
bool signed_url_caller(struct access *access, struct http_head *head, struct caller *out,
                       struct http_problem *problem);

#endif
