// SPDX-License-Identifier: MIT
// The expansion of one triple in chunks of vertices. Included by expand_avx512.c and
// expand_vnni.c inside their regions of base/isa.h, after store_avx512.h.
#ifndef PRT_RELIGHT_CHUNK_AVX512_H
#define PRT_RELIGHT_CHUNK_AVX512_H

// Reading 64 bytes of each of some forty rows in turn is more streams than the hardware
// prefetcher follows. Rows are read in groups of up to eight along CHUNK vertices; the sums
// stay in the L1 cache, and the next group is prefetched meanwhile.
enum { CHUNK = 1024 };

// Prefetches the cache lines that the colours of positions [v, v + n) will be written to, one
// for every four positions: neighbours in the cluster are mostly neighbours in the file.
PRT_INLINE void claim(const struct expand_job *job, uint32_t t, uint32_t v, uint32_t n)
{
    const uint32_t end = job->end < v + n ? job->end : v + n;
    for (; v < end; v += 4) __builtin_prefetch(job->color[t] + 3ull * job->order[v], 1, 3);
}

// Writes the colours of 16 positions to their vertices. row: these are consecutive in the file.
PRT_INLINE void put16(const struct expand_job *job, uint32_t v, uint32_t t, bool row, __m512 r,
                      __m512 g, __m512 b)
{
    float rg[32], blue[16];
    const __m512i lo =
        _mm512_setr_epi32(0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
    const __m512i hi =
        _mm512_setr_epi32(8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
    float *color = job->color[t];
    uint32_t n = job->end - v < 16 ? job->end - v : 16;
    if (row) {
        put_row(color + 3ull * job->order[v], r, g, b, job->add);
        return;
    }
    _mm512_storeu_ps(rg, _mm512_permutex2var_ps(r, lo, g));
    _mm512_storeu_ps(rg + 16, _mm512_permutex2var_ps(r, hi, g));
    _mm512_storeu_ps(blue, b);
    scatter(rg, blue, job->order + v, n, color, job->add);
}

#endif
