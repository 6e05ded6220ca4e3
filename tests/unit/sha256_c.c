// SPDX-License-Identifier: MIT
// proto/sha256.c as processors without SHA instructions run it.
#include "sha256_c.h"

#include <string.h>

#undef __x86_64__
#define relight_sha256_init sha256_c_init
#define relight_sha256_add sha256_c_add
#define relight_sha256_hex sha256_c_hex
#define relight_hash_valid sha256_c_hash_valid
#include "../../proto/sha256.c"
