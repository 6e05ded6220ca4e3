/* SPDX-License-Identifier: MIT */
/* http_head.h owns the first part of an HTTP request: method, path, query and the headers that
 * the API reads, each checked and bounded. Loop thread only. */
#ifndef RELIGHTD_HTTP_HEAD_H
#define RELIGHTD_HTTP_HEAD_H

#include "net/http.h"

enum {
    HTTP_PATH = 512,
    HTTP_PARAMETERS = 48,       /* in one query */
    HTTP_VALUE = 16 << 10,      /* bytes of one parameter: material JSON is the longest */
    HTTP_REQUEST_ID = 64,       /* characters of X-Request-Id */
    HTTP_HEADER_ROOM = 32 << 10 /* bytes of all headers together */
};

/* Why a request is refused, in the shape of RFC 9457. status 0: it is not. */
struct http_problem {
    int status;
    char code[32];      /* the protocol's word: "not_found" */
    char detail[400];   /* one line: the fault and its subject */
    char hint[200];     /* one line: the remedy; may be empty */
    char parameter[80]; /* the name of the parameter at fault, or empty */
    char unit[32];      /* of minimum and maximum, or empty */
    bool ranged;        /* minimum and maximum are known */
    double minimum, maximum;
    unsigned retry_after_ms; /* 0: no Retry-After */
};
void http_refuse(struct http_problem *problem, int status, const char *code, const char *fmt,
                 ...) __attribute__((format(printf, 4, 5)));

struct http_parameter {
    char *name, *value;
    bool used;
};
struct http_head {
    char method[8]; /* "GET" */
    char path[HTTP_PATH];
    struct http_parameter parameter[HTTP_PARAMETERS];
    unsigned n_parameter;
    char *query; /* the parameters' bytes, malloc()ed */
    char content_type[100], none_match[200], last_event[40], authorization[600];
    char request_id[HTTP_REQUEST_ID + 1]; /* given by the client; "": none */
    bool has_body, expects_continue;
    bool unreadable_authorization;
    bool unframed;      /* no other request can follow on this socket */
    bool chunked;       /* the body is framed by chunks */
    uint64_t body_size; /* Content-Length; of a chunked body UINT64_MAX until it is complete */
};

/* Fills *head from the request that libwebsockets has just read. False: *problem says why. */
bool http_head_read(struct lws *wsi, struct http_head *head, struct http_problem *problem);
void http_head_finish(struct http_head *head);
/* The value of a parameter, marked as used; NULL where there is none. */
const char *http_parameter(struct http_head *head, const char *name);
/* The path that libwebsockets has, without query; "" when it is too long. */
void http_path(struct lws *wsi, char *out, size_t room);

#endif
