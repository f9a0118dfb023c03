/* Preloaded into linux.uml where the CPU has more registers than that kernel knows of (AMX).
 *
 * User-mode Linux 6.1 keeps the registers of a process in an area of 2,696 bytes, as far as PKRU. With
 * AMX the XSAVE area is 11,008 bytes long, and PTRACE_SETREGSET takes the whole of it or fails with
 * EFAULT; UML then panics. So this ptrace reads the whole area, lays the kernel's part over it and
 * writes the whole back. The AMX tiles stay as they are; a program in the guest cannot ask for them.
 * Every other request is passed on as it is. */
#define _GNU_SOURCE
#include <errno.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#define NT_X86_XSTATE 0x202

long ptrace(enum __ptrace_request request, ...)
{
    va_list arguments;
    va_start(arguments, request);
    long pid = va_arg(arguments, long);
    long address = va_arg(arguments, long);
    long data = va_arg(arguments, long);
    va_end(arguments);

    if (request == PTRACE_SETREGSET && address == NT_X86_XSTATE) {
        static char area[65536] __attribute__((aligned(64)));
        const struct iovec *part = (const struct iovec *)data;
        struct iovec whole = {area, sizeof area};
        if (syscall(SYS_ptrace, PTRACE_GETREGSET, pid, address, &whole) < 0)
            return -1;
        memcpy(area, part->iov_base, part->iov_len < whole.iov_len ? part->iov_len : whole.iov_len);
        return syscall(SYS_ptrace, PTRACE_SETREGSET, pid, address, &whole);
    }
    if (request >= PTRACE_PEEKTEXT && request <= PTRACE_PEEKUSER) { /* the system call writes the word */
        long word;
        if (syscall(SYS_ptrace, request, pid, address, &word) < 0)
            return -1;
        errno = 0; /* -1 may be the word itself */
        return word;
    }
    return syscall(SYS_ptrace, request, pid, address, data);
}
