// SPDX-License-Identifier: MIT
// Claims: numbered files of which the highest holds. A claim's file belongs to its owner, who
// alone writes to it; others watch whether it changes.
#include "store/object_store_private.h"

#include "core/loop.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

struct object_claim {
    struct object_store *store;
    char id[OBJECT_ID + 1];
    unsigned generation;
    int fd; // -1: one machine
};

static void path_of(const struct object_store *store, const char *id, unsigned generation,
                    char path[PATH_MAX])
{
    snprintf(path, PATH_MAX, "%s/claims/%s.%06u", store->folder, id, generation);
}

// The highest number of the id's claims; 0: there is none.
static int highest(const struct object_store *store, const char *id, unsigned *generation)
{
    char folder[PATH_MAX];
    size_t n = strlen(id);
    snprintf(folder, sizeof folder, "%s/claims", store->folder);
    DIR *dir = opendir(folder);
    if (!dir) return errno == ENOENT ? -EIO : -errno;
    *generation = 0;
    for (struct dirent *d; (d = readdir(dir));) {
        unsigned g;
        if (strncmp(d->d_name, id, n) || sscanf(d->d_name + n, ".%6u", &g) != 1) continue;
        if (g > *generation) *generation = g;
    }
    closedir(dir);
    return 0;
}

// -ENOENT: it was removed, on NFS perhaps between opening and reading.
static int read_text(const char *path, char text[200])
{
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0) return object_stale(-errno) ? -ENOENT : -errno;
    ssize_t n = read(fd, text, 199);
    int err = n >= 0 ? 0 : object_stale(-errno) ? -ENOENT : -errno;
    close(fd);
    if (err) return err;
    text[n] = 0;
    text[strcspn(text, "\n")] = 0;
    return 0;
}

int object_claim_look(struct object_store *store, const char *id, unsigned *generation,
                      char text[200])
{
    char path[PATH_MAX];
    if (!object_store_shared(store)) return -ENOENT;
    int err = highest(store, id, generation);
    if (err) return err;
    if (!*generation) return -ENOENT;
    path_of(store, id, *generation, path);
    return read_text(path, text);
}

// The whole line in one write: others read the old one or the new one. The count never
// repeats, over all claims of this owner: who sees an old text sees an old claim.
static int write_text(struct object_claim *claim, const char *note)
{
    char text[200], line[200];
    snprintf(text, sizeof text, "%s %" PRIu64 " %.90s", claim->store->owner,
             atomic_fetch_add(&claim->store->last_count, 1) + 1, note);
    int n = snprintf(line, sizeof line, "%-198.198s\n", text);
    errno = EIO; // of a short write
    if (pwrite(claim->fd, line, (size_t)n, 0) == n && !fdatasync(claim->fd)) return 0;
    return object_stale(-errno) ? -ESTALE : -errno;
}

// Creates the file of this number, with its text, unless there is one.
static int create(struct object_claim *claim)
{
    char path[PATH_MAX], temporary[PATH_MAX];
    object_temporary(claim->store, temporary);
    path_of(claim->store, claim->id, claim->generation, path);
    claim->fd = open(temporary, O_CREAT | O_EXCL | O_RDWR | O_CLOEXEC, 0600);
    if (claim->fd < 0) return -errno;
    int err = write_text(claim, "");
    if (!err && link(temporary, path)) err = errno == EEXIST ? -EBUSY : -errno;
    unlink(temporary);
    return err;
}

// Is the file of the claim's number the one that its owner made? After a release the numbers
// begin again at 1.
static bool is_own(const struct object_claim *claim)
{
    char path[PATH_MAX];
    struct stat named, open_one;
    snprintf(path, sizeof path, "%s/claims", claim->store->folder);
    if (!object_refresh_folder(path)) return false;
    path_of(claim->store, claim->id, claim->generation, path);
    return !lstat(path, &named) && !fstat(claim->fd, &open_one) &&
           named.st_ino == open_one.st_ino && named.st_dev == open_one.st_dev;
}

// The stale claim must still be there, and unchanged: else its owner has released it, and
// another may have begun again at its number.
static int confirm(const struct object_claim *claim, const struct object_watch *stale)
{
    char path[PATH_MAX], text[200];
    unsigned now;
    int err = highest(claim->store, claim->id, &now);
    if (err) return err;
    if (now != claim->generation) return -EBUSY;
    if (!stale) return 0;
    path_of(claim->store, claim->id, stale->generation, path);
    return read_text(path, text) || strcmp(text, stale->text) ? -EBUSY : 0;
}

static void remove_own(const struct object_claim *claim)
{
    char path[PATH_MAX];
    path_of(claim->store, claim->id, claim->generation, path);
    if (is_own(claim)) unlink(path);
}

// stale: the claim that is taken over; NULL: there is none.
static int take(struct object_store *store, const char *id, const struct object_watch *stale,
                struct object_claim **out)
{
    struct object_claim *claim = calloc(1, sizeof *claim);
    if (!claim) return -ENOMEM;
    *claim = (struct object_claim){
        .store = store, .generation = stale ? stale->generation + 1 : 1, .fd = -1};
    snprintf(claim->id, sizeof claim->id, "%s", id);
    int err = object_store_shared(store) ? create(claim) : 0;
    if (!err && object_store_shared(store) && (err = confirm(claim, stale))) remove_own(claim);
    if (err) {
        if (claim->fd >= 0) close(claim->fd);
        free(claim);
        return err;
    }
    *out = claim;
    return 0;
}

int object_claim_take(struct object_store *store, const char *id, double stale_s,
                      struct object_watch *watch, struct object_claim **out)
{
    char text[200] = "";
    unsigned generation = 0;
    uint64_t now = loop_now_ns();
    int err = object_claim_look(store, id, &generation, text);
    if (err == -ENOENT && !generation) return take(store, id, NULL, out);
    if (err == -ENOENT) return -EBUSY; // released just now
    if (err) return err;
    if (!watch->since_ns || watch->generation != generation || strcmp(watch->text, text)) {
        watch->generation = generation;
        memcpy(watch->text, text, sizeof text);
        watch->since_ns = now;
        return -EBUSY;
    }
    if ((double)(now - watch->since_ns) < stale_s * 1e9) return -EBUSY;
    return take(store, id, watch, out);
}

int object_claim_beat(struct object_claim *claim, const char *note)
{
    unsigned now;
    if (claim->fd < 0) return 0;
    int err = highest(claim->store, claim->id, &now);
    if (err) return err;
    return now == claim->generation && is_own(claim) ? write_text(claim, note) : -ESTALE;
}

void object_claim_release(struct object_claim *claim)
{
    char path[PATH_MAX];
    if (claim->fd >= 0) {
        // Those before it first: the highest holds until it goes itself.
        for (unsigned g = 1; g < claim->generation && is_own(claim); g++) {
            path_of(claim->store, claim->id, g, path);
            unlink(path);
        }
        remove_own(claim);
        close(claim->fd);
    }
    free(claim);
}
