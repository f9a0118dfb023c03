#include "host.h"

#include <string.h>

#define SYS_OPEN 0x01
#define SYS_WRITE 0x05
#define SYS_READ 0x06
#define SYS_EXIT 0x18
#define READ_BINARY 1
#define WRITE_BINARY 5
#define APPLICATION_EXIT 0x20026

static int ask(int operation, const void *parameters)
{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = parameters;

    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static int open_file(const char *path, uintptr_t mode)
{
    const uintptr_t parameters[] = {(uintptr_t)path, mode, strlen(path)};

    return ask(SYS_OPEN, parameters);
}

static bool transfer(int operation, int handle, uintptr_t data, uintptr_t size)
{
    uintptr_t left = size;

    while (left > 0) {
        const uintptr_t parameters[] = {(uintptr_t)handle, data + size - left, left};
        const uintptr_t remaining = (uintptr_t)ask(operation, parameters);

        if (remaining >= left) {
            return false;
        }
        left = remaining;
    }
    return true;
}

int host_open_to_read(const char *path)
{
    return open_file(path, READ_BINARY);
}

int host_open_to_write(const char *path)
{
    return open_file(path, WRITE_BINARY);
}

bool host_read(int handle, void *data, uintptr_t size)
{
    return transfer(SYS_READ, handle, (uintptr_t)data, size);
}

bool host_write(int handle, const void *data, uintptr_t size)
{
    return transfer(SYS_WRITE, handle, (uintptr_t)data, size);
}

void host_exit(void)
{
    (void)ask(SYS_EXIT, (const void *)APPLICATION_EXIT);
}
