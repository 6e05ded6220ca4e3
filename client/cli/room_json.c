// SPDX-License-Identifier: MIT
// Fields of a room's JSON.
#include "room.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

const char *text_of(const cJSON *json, const char *field)
{
    const char *text = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(json, field));
    return text ? text : "";
}

double number_of(const cJSON *json, const char *field)
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(json, field);
    return cJSON_IsNumber(item) ? item->valuedouble : 0;
}

const cJSON *list_of(const cJSON *json, const char *field)
{
    return cJSON_GetObjectItemCaseSensitive(json, field);
}

static void print_as(char out[32], double time_us, const char *format, bool local)
{
    time_t t = (time_t)(time_us * 1e-6);
    struct tm when;
    out[0] = 0;
    if (local ? localtime_r(&t, &when) : gmtime_r(&t, &when)) strftime(out, 32, format, &when);
}

void print_time(char out[32], double time_us)
{
    print_as(out, time_us, "%Y-%m-%d %H:%M", true);
}

void print_utc(char out[32], double time_us)
{
    print_as(out, time_us, "%Y-%m-%dT%H:%M:%SZ", false);
}

const char *author_of(const cJSON *stamp)
{
    const char *name = text_of(stamp, "name");
    return *name ? name : text_of(stamp, "by");
}

const cJSON *item_of(const cJSON *list, double sequence)
{
    const cJSON *item;
    cJSON_ArrayForEach(item, list) if (number_of(list_of(item, "stamp"), "sequence") ==
                                       sequence) return item;
    return NULL;
}

bool whole_word(const char *word, uint64_t *out)
{
    char *end;
    errno = 0;
    unsigned long long x = strtoull(word, &end, 10);
    if (end == word || *end || errno || strchr(word, '-')) return false;
    *out = x;
    return true;
}
