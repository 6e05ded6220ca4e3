// SPDX-License-Identifier: MIT
// Which uploads a principal may list and fetch back.
#include "store/blob_index.h"

#include <stdio.h>
#include <string.h>
#include <strings.h>

static const struct blob_name *name_of(const struct blob *b, const char *principal)
{
    const struct blob_name *n = b->names;
    while (n && strcmp(n->principal, principal)) n = n->next;
    return n;
}

// By its first bytes, or by its name where these were not looked at since the start.
static bool is_image(const struct blob *b, const char *name)
{
    static const char *const endings[] = {".hdr", ".exr", ".dds", ".pfm",
                                          ".pic", ".png", ".jpg", ".jpeg"};
    const char *dot = strrchr(name, '.');
    if (b->format != BLOB_OTHER) return true;
    for (size_t i = 0; dot && i < sizeof endings / sizeof *endings; i++)
        if (!strcasecmp(dot, endings[i])) return true;
    return false;
}

size_t blobs_images(const struct blobs *blobs, const char *principal, struct blob_listed *out,
                    size_t most)
{
    size_t n = 0;
    for (const struct blob *b = blobs->lru.newest; b && n < most; b = b->link[LRU_ALL].older) {
        const struct blob_name *name = name_of(b, principal);
        if (!name && strcmp(b->owner->name, principal)) continue;
        if (!is_image(b, name ? name->name : "")) continue;
        out[n++] = (struct blob_listed){b->hash, name ? name->name : "", b->size};
    }
    return n;
}

// The name with its ending, or without.
static bool is_called(const char *file, const char *name)
{
    const size_t n = strlen(name);
    const char *dot = strrchr(file, '.');
    return !strcmp(file, name) || (dot && (size_t)(dot - file) == n && !strncmp(file, name, n));
}

const char *blobs_image_named(const struct blobs *blobs, const char *principal,
                              const char *name)
{
    const struct blob *found = NULL;
    uint64_t newest_ns = 0;
    for (const struct blob *b = blobs->lru.newest; *name && b; b = b->link[LRU_ALL].older)
        for (const struct blob_name *own = b->names; own; own = own->next) {
            if (own->named_ns <= newest_ns || strcmp(own->principal, principal) ||
                !is_called(own->name, name) || !is_image(b, own->name))
                continue;
            found = b;
            newest_ns = own->named_ns;
        }
    return found ? found->hash : NULL;
}

bool blobs_owned(const struct blobs *blobs, const char *principal, const char *hash,
                 uint64_t *size)
{
    const struct blob *b = relight_hash_valid(hash) ? blob_find(blobs, hash) : NULL;
    if (!b || (principal && strcmp(b->owner->name, principal))) return false;
    *size = b->size;
    return true;
}
