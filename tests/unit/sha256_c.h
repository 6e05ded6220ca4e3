/* SPDX-License-Identifier: MIT */
/* sha256_c.h owns the names under which tests call proto/sha256.c in plain C. */
#ifndef UNIT_SHA256_C_H
#define UNIT_SHA256_C_H

#include "frame.h"

void sha256_c_init(struct relight_sha256 *sha);
void sha256_c_add(struct relight_sha256 *sha, const void *bytes, size_t n);
void sha256_c_hex(struct relight_sha256 *sha, char out[65]);
bool sha256_c_hash_valid(const char *text);

#endif
