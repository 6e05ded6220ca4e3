/* SPDX-License-Identifier: MIT */
/* eviction.h owns the choice of files under --data that are removed when a budget is spent:
 * --disk of all, --client-disk of one principal, --bakes-disk of bakes. Previews go first, then
 * copies of --models, then bakes; all of them can be made again. Among previews and among bakes
 * those of a principal that holds more than its share go before others, and of these the
 * longest unused. A principal that asks for more than its share gets room only from files of
 * principals above their share, itself among them, and from files without an owner. If these
 * are not enough, it is refused. Loop thread only. */
#ifndef RELIGHTD_EVICTION_H
#define RELIGHTD_EVICTION_H

#include <stdbool.h>
#include <stdint.h>

struct server;
struct model;

uint64_t bakes_bytes(const struct server *server);
/* Removes files until the budgets are kept. Kept are pinned models, what rooms need, files that
 * somebody reads (unless nothing else is left), and those of `newest` (may be NULL). `asker`:
 * the principal that is refused if too much stays; beyond its own share it takes nothing from
 * those within theirs. NULL: files of all may go, as for a bake that is ready. */
void evict_for_room(struct server *server, const struct model *newest, const char *asker);
/* The same before an upload of so many bytes. */
void evict_for_upload(struct server *server, const char *owner, uint64_t bytes);
/* Removes files, of whomever they are, until there is room for an event of so many bytes. */
void evict_for_event(struct server *server, uint64_t bytes);
/* Forgets a model that failed, or else a preview, so that the asker may have one more model: of
 * this owner or (NULL) of all; shares are those of --max-models. False: none. */
bool evict_preview(struct server *server, const char *owner, const char *asker);
/* Bytes of files that stay because rooms need them (holds.h), of this owner or (NULL) of all.
 */
uint64_t evict_held(const struct server *server, const char *owner);
/* Adds to an error about spent disk space that rooms hold some of it, and what to do. */
void evict_explain(const struct server *server, const char *owner, char error[256]);
/* Whether more is held than allowed, by this owner or in all; error says which limit it is. */
bool evict_over(const struct server *server, const char *owner, char error[256]);

#endif
