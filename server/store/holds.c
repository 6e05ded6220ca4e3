// SPDX-License-Identifier: MIT
// Two tables: rooms with their names, and names with the number of rooms that need them.
#include "store/holds.h"

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { BUCKETS = 4096 };

struct entry {
    struct entry *next;
    char *names;   // of a room
    size_t n_room; // of a name
    char key[];
};

struct holds {
    struct entry *room[BUCKETS], *name[BUCKETS];
    bool known;
    FILE *fresh; // NULL: no name is
    char *fresh_text;
    size_t n_fresh;
};

struct holds *holds_create(void)
{
    return calloc(1, sizeof(struct holds));
}

void holds_destroy(struct holds *holds)
{
    if (holds) free(holds_take_fresh(holds));
    for (size_t i = 0; holds && i < BUCKETS; i++)
        for (int kind = 0; kind < 2; kind++)
            for (struct entry *e = kind ? holds->name[i] : holds->room[i], *next; e; e = next) {
                next = e->next;
                free(e->names);
                free(e);
            }
    free(holds);
}

// The entry's place, or that of a new one.
static struct entry **place(struct entry *const *table, const char *key, size_t n)
{
    size_t hash = 5381;
    for (size_t i = 0; i < n; i++) hash = hash * 33 ^ (unsigned char)key[i];
    struct entry **at = (struct entry **)(uintptr_t)&table[hash % BUCKETS];
    while (*at && (strncmp((*at)->key, key, n) || (*at)->key[n])) at = &(*at)->next;
    return at;
}

static struct entry *find_or_add(struct entry **table, const char *key, size_t n)
{
    struct entry **at = place(table, key, n);
    if (*at || !(*at = calloc(1, sizeof **at + n + 1))) return *at;
    memcpy((*at)->key, key, n);
    return *at;
}

static void remove_entry(struct entry **at)
{
    struct entry *e = *at;
    *at = e->next;
    free(e->names);
    free(e);
}

static void note_fresh(struct holds *holds, const char *name)
{
    if (!holds->fresh) holds->fresh = open_memstream(&holds->fresh_text, &holds->n_fresh);
    if (holds->fresh) fprintf(holds->fresh, "%s\n", name);
}

char *holds_take_fresh(struct holds *holds)
{
    if (!holds->fresh) return NULL;
    fclose(holds->fresh);
    holds->fresh = NULL;
    char *text = holds->fresh_text;
    holds->fresh_text = NULL;
    return text;
}

// False without memory: some were not counted.
static bool add_names(struct holds *holds, const char *names)
{
    for (const char *line = names, *end; *line && (end = strchr(line + 1, '\n')); line = end) {
        struct entry *e = find_or_add(holds->name, line + 1, (size_t)(end - line - 1));
        if (!e) return false;
        if (!e->n_room++) note_fresh(holds, e->key);
    }
    return true;
}

static void drop_names(struct holds *holds, const char *names)
{
    for (const char *line = names, *end; *line && (end = strchr(line + 1, '\n')); line = end) {
        struct entry **at = place(holds->name, line + 1, (size_t)(end - line - 1));
        if (*at && !--(*at)->n_room) remove_entry(at);
    }
}

void holds_set(struct holds *holds, const char *room, const char *names)
{
    size_t n = strlen(room);
    struct entry *e = find_or_add(holds->room, room, n);
    char *copy = e ? strdup(names) : NULL;
    if (!copy || !add_names(holds, copy)) {
        free(copy);
        holds->known = false; // what was counted stays so
        if (e && !e->names) remove_entry(place(holds->room, room, n));
        return;
    }
    if (e->names) drop_names(holds, e->names);
    free(e->names);
    e->names = copy;
    if (!*copy) remove_entry(place(holds->room, room, n));
}

void holds_retain(struct holds *holds, bool (*is_there)(void *user, const char *room),
                  void *user)
{
    for (size_t i = 0; i < BUCKETS; i++)
        for (struct entry **at = &holds->room[i], *e; (e = *at);) {
            if (is_there(user, e->key)) {
                at = &e->next;
                continue;
            }
            drop_names(holds, e->names);
            remove_entry(at);
        }
}

const char *holds_of(const struct holds *holds, const char *room)
{
    const struct entry *e = *place(holds->room, room, strlen(room));
    return e && e->names ? e->names : "";
}

bool holds_among(const char *names, const char *name)
{
    size_t n = strlen(name);
    for (const char *at = names; (at = strstr(at, name)); at++)
        if (at > names && at[-1] == '\n' && at[n] == '\n') return true;
    return false;
}

void holds_know(struct holds *holds, bool known)
{
    holds->known = known;
}

bool holds_known(const struct holds *holds)
{
    return holds->known;
}

bool holds_has(const struct holds *holds, const char *name)
{
    if (!holds) return false;
    return !holds->known || *place(holds->name, name, strlen(name));
}

unsigned holds_rooms(const struct holds *holds, const char *name, char *ids, size_t n_ids)
{
    enum { SHOWN = 3 };
    unsigned n = 0;
    size_t at = 0;
    *ids = 0;
    for (size_t i = 0; i < BUCKETS; i++)
        for (const struct entry *e = holds->room[i]; e; e = e->next) {
            if (!e->names || !holds_among(e->names, name) || n++ >= SHOWN || at >= n_ids)
                continue;
            at += (size_t)snprintf(ids + at, n_ids - at, "%s%s", n > 1 ? ", " : "", e->key);
        }
    if (n > SHOWN && at < n_ids) snprintf(ids + at, n_ids - at, " and %u more", n - SHOWN);
    return n;
}

char *holds_list(const struct holds *holds)
{
    char *text = NULL;
    size_t n = 0;
    FILE *out = holds->known ? open_memstream(&text, &n) : NULL;
    if (!out) return NULL;
    for (size_t i = 0; i < BUCKETS; i++)
        for (const struct entry *e = holds->name[i]; e; e = e->next)
            fprintf(out, "%s\n", e->key);
    bool bad = ferror(out);
    if (!fclose(out) && !bad) return text;
    free(text);
    return NULL;
}
