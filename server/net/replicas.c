// SPDX-License-Identifier: MIT
// Rendezvous hashing over the addresses of --replicas.
#include "net/replicas.h"

#include "frame.h"

#include <stdio.h>
#include <string.h>

static void weigh(const char *address, size_t n, const char *route, char weight[65])
{
    struct relight_sha256 sha;
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, address, n);
    relight_sha256_add(&sha, "", 1); // no two pairs give the same bytes
    relight_sha256_add(&sha, route, strlen(route));
    relight_sha256_hex(&sha, weight);
}

int replica_choose(const char *list, const char *route, const char *without, char *out,
                   size_t n)
{
    char best[65] = "", weight[65];
    int found = 0;
    for (const char *at = list; *at;) {
        at += strspn(at, ", ");
        size_t size = strcspn(at, ", ");
        bool other = size && !(strlen(without) == size && !strncmp(at, without, size));
        if (other) weigh(at, size, route, weight);
        if (other && size < n && strcmp(weight, best) > 0) {
            memcpy(best, weight, sizeof best);
            snprintf(out, n, "%.*s", (int)size, at);
            found = 1;
        }
        at += size;
    }
    return found;
}
