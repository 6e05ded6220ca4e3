// SPDX-License-Identifier: MIT
// Lets User Mode Linux 6.1 run on a processor with AMX. It writes its processes' registers with
// ptrace in a buffer that has no room for AMX's, and the kernel refuses a buffer that is too
// short (EFAULT). This library, preloaded, reads all registers, replaces those in the buffer,
// and writes all.
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/types.h>
#include <sys/uio.h>

enum { STATE = 1 << 16 }; // more bytes than any processor's registers

long ptrace(enum __ptrace_request request, ...)
{
    static long (*next)(enum __ptrace_request, pid_t, void *, void *);
    static unsigned char state[STATE];
    va_list list;
    va_start(list, request);
    pid_t pid = va_arg(list, pid_t);
    void *address = va_arg(list, void *), *data = va_arg(list, void *);
    va_end(list);
    if (!next) *(void **)&next = dlsym(RTLD_NEXT, "ptrace");
    if (request != PTRACE_SETREGSET || address != (void *)NT_X86_XSTATE)
        return next(request, pid, address, data);
    const struct iovec *given = data;
    struct iovec whole = {state, STATE};
    if (next(PTRACE_GETREGSET, pid, address, &whole)) return -1;
    memcpy(state, given->iov_base,
           given->iov_len < whole.iov_len ? given->iov_len : whole.iov_len);
    return next(request, pid, address, &whole);
}
