// SPDX-License-Identifier: MIT
// Errors as HTTP answers.
#include "net/http_problem.h"

#include "message_text.h"

#include <cjson/cJSON.h>
#include <stdio.h>
#include <string.h>

enum { TRY_LATER_MS = 1000 };

// A client over its own limit is told so (429); 503 says that the daemon is full.
static int status_of(const struct connection *conn, int code)
{
    switch (code) {
    case RELIGHT__ERROR_CODE__ERROR_FORBIDDEN:
        return 403;
    case RELIGHT__ERROR_CODE__ERROR_NOT_FOUND:
        return 404;
    case RELIGHT__ERROR_CODE__ERROR_BUSY:
        return conn->own_limit ? 429 : 503;
    case RELIGHT__ERROR_CODE__ERROR_DEADLINE:
        return 504;
    case RELIGHT__ERROR_CODE__ERROR_LIMIT:
        return 413;
    case RELIGHT__ERROR_CODE__ERROR_FORMAT:
    case RELIGHT__ERROR_CODE__ERROR_MISMATCH:
    case RELIGHT__ERROR_CODE__ERROR_HASH:
    case RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED:
        return 422;
    case RELIGHT__ERROR_CODE__ERROR_NOT_READY:
    case RELIGHT__ERROR_CODE__ERROR_JOB_FAILED:
        return 409;
    case RELIGHT__ERROR_CODE__ERROR_NO_MEMORY:
    case RELIGHT__ERROR_CODE__ERROR_MOVED:
    case RELIGHT__ERROR_CODE__ERROR_SHUTTING_DOWN:
    case RELIGHT__ERROR_CODE__ERROR_CANCELLED:
        return 503;
    case RELIGHT__ERROR_CODE__ERROR_INTERNAL:
        return 500;
    default: // BAD_REQUEST, OUT_OF_RANGE, and codes of later versions
        return 400;
    }
}

static const char *title_of(int status)
{
    static const struct {
        int status;
        const char *title;
    } titles[] = {{400, "Bad Request"},
                  {401, "Unauthorized"},
                  {403, "Forbidden"},
                  {404, "Not Found"},
                  {405, "Method Not Allowed"},
                  {409, "Conflict"},
                  {413, "Content Too Large"},
                  {415, "Unsupported Media Type"},
                  {422, "Unprocessable Content"},
                  {429, "Too Many Requests"},
                  {500, "Internal Server Error"},
                  {501, "Not Implemented"},
                  {503, "Service Unavailable"},
                  {504, "Gateway Timeout"}};
    for (size_t i = 0; i < sizeof titles / sizeof *titles; i++)
        if (titles[i].status == status) return titles[i].title;
    return "Error";
}

void problem_of_error(const struct connection *conn, const Relight__Error *error,
                      struct http_problem *problem)
{
    char word[40];
    message_enum_word(&relight__error_code__descriptor, error->code, word);
    http_refuse(problem, status_of(conn, error->code), word, "%s", error->text);
    snprintf(problem->hint, sizeof problem->hint, "%s", error->hint);
    problem->retry_after_ms = error->retry_after_ms;
    snprintf(problem->parameter, sizeof problem->parameter, "%s", error->parameter);
    relight_utf8_cut(problem->parameter);
    snprintf(problem->unit, sizeof problem->unit, "%s", error->unit);
    problem->ranged = error->has_range;
    problem->minimum = error->minimum;
    problem->maximum = error->maximum;
    if (problem->status == 503 && !problem->retry_after_ms)
        problem->retry_after_ms = TRY_LATER_MS;
}

char *problem_json(const struct http_problem *problem, const char *request_id)
{
    cJSON *json = cJSON_CreateObject();
    if (!json) return NULL;
    cJSON_AddStringToObject(json, "type", "about:blank");
    cJSON_AddStringToObject(json, "title", title_of(problem->status));
    cJSON_AddNumberToObject(json, "status", problem->status);
    cJSON_AddStringToObject(json, "detail", problem->detail);
    cJSON_AddStringToObject(json, "code", problem->code);
    if (problem->hint[0]) cJSON_AddStringToObject(json, "hint", problem->hint);
    if (problem->parameter[0]) cJSON_AddStringToObject(json, "parameter", problem->parameter);
    if (problem->ranged) {
        cJSON_AddNumberToObject(json, "minimum", problem->minimum);
        cJSON_AddNumberToObject(json, "maximum", problem->maximum);
    }
    if (problem->unit[0]) cJSON_AddStringToObject(json, "unit", problem->unit);
    if (problem->retry_after_ms)
        cJSON_AddNumberToObject(json, "retry_after_ms", problem->retry_after_ms);
    cJSON_AddStringToObject(json, "request_id", request_id);
    char *text = cJSON_PrintUnformatted(json);
    cJSON_Delete(json);
    return text;
}
