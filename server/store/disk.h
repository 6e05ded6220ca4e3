/* SPDX-License-Identifier: MIT */
/* disk.h owns the account of bytes under --data by owner: uploads and their parts, previews,
 * bakes, work folders. The numbers are the ledger's LEDGER_DISK; an owner is a principal's name
 * ("uid:1000"), or DISK_NOBODY for files whose owner is not known.
 *   before a file is written:   disk_take(ledger, owner, disk_size(bytes), error)
 *   a file that exists already: disk_charge(ledger, owner, +(int64_t)disk_size(bytes))
 *   a file that was removed:    disk_charge(ledger, owner, -(int64_t)disk_size(bytes))
 * The caller stores the charge of each file and gives the same amount back.
 * Thread-safety: the account on the loop thread only; disk_owner_* and disk_size on any. */
#ifndef RELIGHTD_DISK_H
#define RELIGHTD_DISK_H

#include "core/ledger.h"

#include <stddef.h>
#include <stdint.h>

#define DISK_NOBODY "daemon" /* pays for files without a recorded owner */

/* Bytes that a file of this size takes: whole blocks of 4 KiB. */
uint64_t disk_size(uint64_t file_bytes);

/* Charges `bytes` to the owner unless --client-disk or --disk would be passed. On refusal
 * nothing is charged and error says which limit. No memory counts as LEDGER_ALL_FULL. */
enum ledger_refusal disk_take(struct ledger *ledger, const char *owner, uint64_t bytes,
                              char error[256]);
/* Charges beyond limits (bytes > 0: files that exist already) or gives back (bytes < 0). */
void disk_charge(struct ledger *ledger, const char *owner, int64_t bytes);
/* Bytes charged to all owners; to one of them. */
uint64_t disk_bytes(const struct ledger *ledger);
uint64_t disk_bytes_of(const struct ledger *ledger, const char *owner);
/* The limit of one owner, its token's or --client-disk; 0: none, as for DISK_NOBODY. */
uint64_t disk_limit_of(struct ledger *ledger, const char *owner);

/* The owner of a file survives a restart in PATH.owner: its first line, up to a tab. Writing
 * replaces the file; 0 or -errno. Reading gives DISK_NOBODY where there is no such file. */
int disk_owner_write(const char *path, const char *owner);
void disk_owner_read(const char *path, char owner[96]);

#endif
