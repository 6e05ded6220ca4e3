// SPDX-License-Identifier: MIT
// Memory that a test and the daemon under it share: which call fails next. libfaults.so, which
// LD_PRELOAD puts into the daemon, reads it; children of the daemon run without it.
#ifndef TESTS_FAULT_FAULTS_H
#define TESTS_FAULT_FAULTS_H

#include <stdint.h>

enum fault_kind {
    FAULT_OPEN = 1,
    FAULT_WRITE = 2,
    FAULT_SYNC = 4,
    FAULT_NAME = 8,  // rename, link, mkdir
    FAULT_SIZE = 16, // ftruncate
    FAULT_FILES = 31,
};

struct faults {
    // The allocations of relightd's own code and of the parsers it links: the n-th from now
    // fails, then all go well again. 0: none fails.
    _Atomic int64_t allocation;
    _Atomic int64_t n_allocation; // seen since the start
    // The same for calls on paths and descriptors below `folder`.
    _Atomic int64_t call;
    _Atomic int64_t n_call;
    _Atomic int32_t kinds;   // enum fault_kind: those that are counted and fail
    _Atomic int32_t error;   // errno; 0: a write writes half of its bytes
    _Atomic int32_t lasting; // all from the n-th on fail
    _Atomic int64_t n_failed;
    char folder[160];
};

#endif
