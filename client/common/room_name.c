// SPDX-License-Identifier: MIT
#include "common/room_name.h"

#include <cjson/cJSON.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *text_of(const cJSON *object, const char *field)
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(object, field);
    return cJSON_IsString(item) ? item->valuestring : "";
}

// The number of rooms that the word names, and the last one's id.
static unsigned find(const cJSON *rooms, const char *word, char out[RELIGHT_ROOM])
{
    const cJSON *room;
    unsigned n = 0;
    cJSON_ArrayForEach(room, cJSON_GetObjectItemCaseSensitive(rooms, "rooms"))
    {
        const char *id = text_of(room, "room");
        bool begins = strlen(word) >= 4 && !strncmp(id, word, strlen(word));
        if (!*id || (!begins && strcmp(text_of(room, "name"), word))) continue;
        snprintf(out, RELIGHT_ROOM, "%s", id);
        n++;
    }
    return n;
}

bool room_is_id(const char *word)
{
    return strlen(word) == RELIGHT_ROOM - 1 &&
           strspn(word, "0123456789abcdef") == RELIGHT_ROOM - 1;
}

int room_of_word(struct relight_client *client, const char *word, char out[RELIGHT_ROOM],
                 struct relight_error *error)
{
    char *json;
    int status = relight_room_list(client, &json, error);
    if (status) return status;
    cJSON *rooms = cJSON_Parse(json);
    free(json);
    unsigned n = find(rooms, word, out);
    bool more = cJSON_IsTrue(cJSON_GetObjectItemCaseSensitive(rooms, "more"));
    cJSON_Delete(rooms);
    if (n == 1) return 0;
    *error = (struct relight_error){.code = n ? RELIGHT_E_MISMATCH : RELIGHT_E_NOT_FOUND};
    snprintf(error->text, sizeof error->text,
             n ? "%.100s: %u rooms are called so: give the room's id"
             : more
                 ? "%.100s: none of the rooms that changed last is called so: give the room's "
                   "whole id"
                 : "%.100s: no such room: `relight room list` has yours",
             word, n);
    return -(int)error->code;
}
