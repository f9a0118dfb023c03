/* host.h on a computer: files of the current folder. */
#include "host.h"

#include <stdio.h>
#include <stdlib.h>

static FILE *opened[8];
static int count;

static int open_file(const char *path, const char *mode)
{
    opened[count] = fopen(path, mode);
    if (opened[count] == NULL) {
        perror(path);
        exit(2);
    }
    return count++;
}

int host_open_to_read(const char *path)
{
    return open_file(path, "rb");
}

int host_open_to_write(const char *path)
{
    return open_file(path, "wb");
}

bool host_read(int handle, void *data, uintptr_t size)
{
    return fread(data, size, 1, opened[handle]) == 1;
}

bool host_write(int handle, const void *data, uintptr_t size)
{
    return fwrite(data, size, 1, opened[handle]) == 1;
}

void host_exit(void)
{
    exit(0);
}
