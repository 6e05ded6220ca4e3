// SPDX-License-Identifier: MIT
// The ERROR message: its code, hint and range.
#include "net/errors.h"

#include "prt/base.h"

#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char *error_hint(int code)
{
    switch (code) {
    case RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST:
        return "PROTOCOL.md lists the parameters of this operation";
    case RELIGHT__ERROR_CODE__ERROR_VERSION:
        return "update the client or the daemon";
    case RELIGHT__ERROR_CODE__ERROR_FORBIDDEN:
        return "an administrator of the daemon can give you a token with this right: "
               "`relight token create`";
    case RELIGHT__ERROR_CODE__ERROR_NOT_FOUND:
        return "`relight models` lists the models; an upload has to be complete before it is "
               "used";
    case RELIGHT__ERROR_CODE__ERROR_BUSY:
        return "repeat the request after retry_after_ms";
    case RELIGHT__ERROR_CODE__ERROR_DEADLINE:
        return "set a longer deadline, or request less";
    case RELIGHT__ERROR_CODE__ERROR_FORMAT:
        return "check the file with another program; `prt info FILE` prints details";
    case RELIGHT__ERROR_CODE__ERROR_NOT_READY:
        return "watch its job until the bake is done";
    case RELIGHT__ERROR_CODE__ERROR_HASH:
        return "upload it again from offset 0";
    case RELIGHT__ERROR_CODE__ERROR_SHUTTING_DOWN:
        return "connect again in a moment";
    case RELIGHT__ERROR_CODE__ERROR_MOVED:
        return "connect to the address that the error names";
    case RELIGHT__ERROR_CODE__ERROR_LIMIT:
        return "the daemon's configuration or its machine sets this limit";
    case RELIGHT__ERROR_CODE__ERROR_MISMATCH:
        return "the request does not fit what the daemon has now";
    case RELIGHT__ERROR_CODE__ERROR_JOB_FAILED:
        return "correct the named cause and load the model again";
    default:
        return "";
    }
}

int error_of_status(int status)
{
    switch (status) {
    case PRT_ARG:
        return RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
    case PRT_NOMEM:
        return RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
    case PRT_IO:
        return RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
    case PRT_FORMAT:
        return RELIGHT__ERROR_CODE__ERROR_FORMAT;
    case PRT_LIMIT:
        return RELIGHT__ERROR_CODE__ERROR_LIMIT;
    case PRT_CANCELLED:
        return RELIGHT__ERROR_CODE__ERROR_CANCELLED;
    case PRT_UNSUPPORTED:
        return RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED;
    case PRT_MISMATCH:
        return RELIGHT__ERROR_CODE__ERROR_MISMATCH;
    default:
        return RELIGHT__ERROR_CODE__ERROR_INTERNAL;
    }
}

// ---- ranges

// Copies the last word before `end` as the parameter's name; false where there is none.
static bool read_parameter(const char *text, const char *end, char *out, size_t n)
{
    const char *begin = end;
    while (begin > text && begin[-1] != ' ' && begin[-1] != ':') begin--;
    if (begin == end || (size_t)(end - begin) >= n) return false;
    snprintf(out, n, "%.*s", (int)(end - begin), begin);
    return true;
}

static const char *skip_excluded(const char *at)
{
    static const char word[] = " (excluded)";
    return strncmp(at, word, sizeof word - 1) ? at : at + sizeof word - 1;
}

// A unit is one word after the number; remarks follow in parentheses or behind a punctuation
// mark.
static void read_unit(const char *at, char *out, size_t n)
{
    out[0] = 0;
    if (at[0] != ' ' || at[1] == '(') return;
    snprintf(out, n, "%.*s", (int)strcspn(at + 1, " ,:;()"), at + 1);
}

static void read_range(const char *text, Relight__Error *out, struct error_fields *fields)
{
    static const char allowed[] = ", allowed range ", covers[] = ", this bake covers ";
    const char *at = strstr(text, allowed), *is, *from;
    if (at) from = at + sizeof allowed - 1;
    else if ((at = strstr(text, covers))) from = at + sizeof covers - 1;
    else return;
    char *end;
    for (is = at; is > text && strncmp(is, " is ", 4); is--) continue;
    double low = strtod(from, &end);
    if (end == from || strncmp(skip_excluded(end), " to ", 4)) return;
    from = skip_excluded(end) + 4;
    double high = strtod(from, &end);
    if (end == from) return;
    read_unit(skip_excluded(end), fields->unit, sizeof fields->unit);
    if (read_parameter(text, is, fields->parameter, sizeof fields->parameter))
        out->parameter = fields->parameter;
    out->unit = fields->unit;
    out->has_range = true;
    out->minimum = low;
    out->maximum = high;
}

void error_fill(Relight__Error *out, int code, const char *text, struct error_fields *fields)
{
    if (!code) code = RELIGHT__ERROR_CODE__ERROR_INTERNAL;
    if (!text || !text[0]) {
        const ProtobufCEnumValue *value =
            protobuf_c_enum_descriptor_get_value(&relight__error_code__descriptor, code);
        text = value ? value->name : "unknown error";
    }
    relight__error__init(out);
    out->code = (Relight__ErrorCode)code;
    out->text = (char *)text;
    out->hint = (char *)error_hint(code);
    if (code == RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE ||
        code == RELIGHT__ERROR_CODE__ERROR_LIMIT)
        read_range(text, out, fields);
}

int range_refuse(char *error, size_t n, double value, double low, double high, const char *unit,
                 const char *fmt, ...)
{
    char parameter[80];
    va_list args;
    va_start(args, fmt);
    vsnprintf(parameter, sizeof parameter, fmt, args);
    va_end(args);
    snprintf(error, n, "%s is %.9g, allowed range %.9g to %.9g%s%s", parameter, value, low,
             high, unit[0] ? " " : "", unit);
    return RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
}
