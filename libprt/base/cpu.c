// SPDX-License-Identifier: MIT
// Which instruction sets this machine has, and the words for them.
#include "base/isa.h"

#if PRT_ISA_X86
#include <cpuid.h>
#endif
#include <string.h>

#if PRT_ISA_X86
// clang 14 has no word for it in __builtin_cpu_supports.
static bool has_f16c(void)
{
    unsigned a, b, c, d;
    return __get_cpuid(1, &a, &b, &c, &d) && c & bit_F16C;
}
#endif

static unsigned detect(void)
{
    unsigned mask = PRT_CPU_C;
#if PRT_ISA_X86
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && has_f16c())
        mask |= PRT_CPU_AVX2;
    if ((mask & PRT_CPU_AVX2) && __builtin_cpu_supports("avx512f") &&
        __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512vl"))
        mask |= PRT_CPU_AVX512;
    if ((mask & PRT_CPU_AVX512) && __builtin_cpu_supports("avx512vnni"))
        mask |= PRT_CPU_AVX512VNNI;
#endif
#if PRT_ISA_ARM64
    mask |= PRT_CPU_NEON;
#endif
    return mask;
}

// CPUID leaves a virtual machine's guest, which takes tens of microseconds, so that it runs
// once.
unsigned prt_cpu_detect(void)
{
    static const unsigned known = 1u << 31; // no bit of enum prt_cpu
    static _Atomic unsigned found;
    unsigned mask = found;
    if (!mask) found = mask = detect() | known;
    return mask & ~known;
}

static const struct {
    const char *word;
    unsigned bit, allowed;
} words[] = {
#define X(word, bit, allowed) {word, bit, allowed},
    PRT_CPU_WORD_LIST(X)
#undef X
};
enum { N_WORD = sizeof words / sizeof *words };

int prt_cpu_parse(const char *word, unsigned *mask)
{
    for (int i = 0; i < N_WORD; i++)
        if (!strcmp(word, words[i].word)) {
            *mask = prt_cpu_detect() & words[i].allowed;
            return PRT_OK;
        }
    return PRT_ARG;
}

const char *prt_cpu_word(unsigned mask)
{
    int best = 0;
    for (int i = 1; i < N_WORD; i++)
        if (mask & words[i].bit) best = i;
    return words[best].word;
}
