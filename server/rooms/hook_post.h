/* SPDX-License-Identifier: MIT */
/* hook_post.h owns one HTTPS POST. It blocks, five seconds at most for each step. */
#ifndef RELIGHTD_ROOMS_HOOK_POST_H
#define RELIGHTD_ROOMS_HOOK_POST_H

#include <openssl/ssl.h>

#include <stdatomic.h>
#include <stdbool.h>

struct hook_target {
    char host[256], port[8]; /* an IPv6 address without its brackets */
    char authority[272];     /* host and port as the URL has them */
    char path[1024];
    SSL_CTX *tls; /* certificates of the system's store, or of SSL_CERT_FILE */
};
/* "https://HOST[:PORT][/PATH]". 0, or -1 with the fault's text. */
int hook_target_parse(const char *url, struct hook_target *out, char fault[256]);
void hook_target_finish(struct hook_target *target);

enum hook_result {
    HOOK_TAKEN,   /* 2xx */
    HOOK_REFUSED, /* another answer: it would not change */
    HOOK_LATER,   /* no connection, no answer, 408, 429 or 5xx */
};
/* headers: lines that end in CR LF. fault gets the reason unless it was taken. closing: ends
 * waiting early where it is set. */
enum hook_result hook_post(const struct hook_target *target, const char *headers,
                           const char *body, char fault[160], const atomic_bool *closing);

#endif
