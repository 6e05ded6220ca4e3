/* SPDX-License-Identifier: MIT */
/* http_problem.h owns errors as HTTP answers: a status for each of the protocol's codes, and
 * the JSON document of RFC 9457. */
#ifndef RELIGHTD_HTTP_PROBLEM_H
#define RELIGHTD_HTTP_PROBLEM_H

#include "net/http_head.h"
#include "relight.pb-c.h"

/* Fills *problem from an ERROR of this connection. */
void problem_of_error(const struct connection *conn, const Relight__Error *error,
                      struct http_problem *problem);
/* {"type","title","status","detail","code","hint",…}, malloc()ed; NULL without memory. */
char *problem_json(const struct http_problem *problem, const char *request_id);

#endif
