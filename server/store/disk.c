// SPDX-License-Identifier: MIT
// The account of bytes on disk: the ledger's numbers under owners' names.
#include "store/disk.h"

#include "core/log.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

enum { BLOCK = 4096 };

uint64_t disk_size(uint64_t file_bytes)
{
    return (file_bytes + BLOCK - 1) / BLOCK * BLOCK;
}

enum ledger_refusal disk_take(struct ledger *ledger, const char *owner, uint64_t bytes,
                              char error[256])
{
    struct principal *principal = ledger_principal(ledger, owner);
    if (!principal) {
        snprintf(error, 256, "not enough memory");
        return LEDGER_ALL_FULL;
    }
    enum ledger_refusal refusal = ledger_take(principal, LEDGER_DISK, bytes, error);
    principal_release(principal);
    return refusal;
}

void disk_charge(struct ledger *ledger, const char *owner, int64_t bytes)
{
    struct principal *principal = bytes ? ledger_principal(ledger, owner) : NULL;
    if (!principal) return;
    if (bytes > 0) {
        ledger_force(principal, LEDGER_DISK, (uint64_t)bytes);
    } else {
        // A file that another program made shorter or longer must not end the daemon.
        uint64_t less = (uint64_t)-bytes, held = principal->held[LEDGER_DISK];
        if (less > held)
            log_line(LOG_WARN, "disk owner=%s gives back %llu bytes and holds %llu", owner,
                     (unsigned long long)less, (unsigned long long)held);
        ledger_give(principal, LEDGER_DISK, less < held ? less : held);
    }
    principal_release(principal);
}

uint64_t disk_bytes(const struct ledger *ledger)
{
    return ledger_total(ledger, LEDGER_DISK);
}

uint64_t disk_bytes_of(const struct ledger *ledger, const char *owner)
{
    for (const struct principal *p = ledger_first(ledger); p; p = p->next)
        if (!strcmp(p->name, owner)) return p->held[LEDGER_DISK];
    return 0;
}

uint64_t disk_limit_of(struct ledger *ledger, const char *owner)
{
    if (!strcmp(owner, DISK_NOBODY)) return 0;
    struct principal *principal = ledger_principal(ledger, owner);
    uint64_t limit = principal ? ledger_limit_client(principal, LEDGER_DISK) : 0;
    principal_release(principal);
    return limit;
}

int disk_owner_write(const char *path, const char *owner)
{
    char name[PATH_MAX + 8];
    snprintf(name, sizeof name, "%s.owner", path);
    int fd = open(name, O_CREAT | O_TRUNC | O_WRONLY | O_CLOEXEC, 0600);
    if (fd < 0) return -errno;
    int err = dprintf(fd, "%s\n", owner) < 0 || fsync(fd) ? -errno : 0;
    close(fd);
    return err;
}

void disk_owner_read(const char *path, char owner[96])
{
    char name[PATH_MAX + 8], line[96] = "";
    snprintf(name, sizeof name, "%s.owner", path);
    int fd = open(name, O_RDONLY | O_CLOEXEC);
    ssize_t n = fd < 0 ? 0 : read(fd, line, sizeof line - 1);
    if (fd >= 0) close(fd);
    line[n > 0 ? n : 0] = 0;
    line[strcspn(line, "\t\n")] = 0;
    snprintf(owner, 96, "%s", line[0] ? line : DISK_NOBODY);
}
