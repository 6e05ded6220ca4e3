// SPDX-License-Identifier: MIT
// Aligned memory, hashing, random numbers.
#include "prt/base.h"

#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#define XXH_INLINE_ALL
#include <xxhash.h>

// Large arrays are written in scattered order (colours to the file's vertices). With pages of 4
// KiB the page table walks take as long as the stores.
enum { HUGE_PAGE = 2 << 20, HUGE_FROM = 2 * HUGE_PAGE };

void *prt_alloc(size_t n, size_t size)
{
    size_t bytes;
    if (prt_mul_overflow(n, size, &bytes) || !bytes || bytes > SIZE_MAX - 64) return NULL;
    bytes = (bytes + 63) & ~(size_t)63;
    if (bytes < HUGE_FROM) return aligned_alloc(64, bytes);
    void *p; // aligned_alloc needs a multiple of the huge page
    if (posix_memalign(&p, HUGE_PAGE, bytes)) return NULL;
    madvise(p, bytes, MADV_HUGEPAGE); // advice; its failure changes speed only
    return p;
}

void *prt_calloc(size_t n, size_t size)
{
    void *p = prt_alloc(n, size);
    if (p) memset(p, 0, n * size);
    return p;
}

void prt_free(void *p)
{
    free(p);
}

uint64_t prt_hash64(const void *bytes, size_t n, uint64_t seed)
{
    return XXH3_64bits_withSeed(bytes, n, seed);
}

// PCG-XSH-RR 64/32 (O'Neill 2014).
void prt_rng_init(struct prt_rng *rng, uint64_t seed, uint64_t stream)
{
    rng->state = 0;
    rng->inc = (stream << 1) | 1;
    prt_rng_u32(rng);
    rng->state += seed;
    prt_rng_u32(rng);
}

uint32_t prt_rng_u32(struct prt_rng *rng)
{
    uint64_t old = rng->state;
    rng->state = old * 6364136223846793005ULL + rng->inc;
    uint32_t x = (uint32_t)(((old >> 18) ^ old) >> 27), rot = (uint32_t)(old >> 59);
    return (x >> rot) | (x << ((32 - rot) & 31));
}

float prt_rng_f32(struct prt_rng *rng)
{
    return (float)(prt_rng_u32(rng) >> 8) * 0x1p-24f;
}
