/* What an emulated Cortex-M asks of its host by semihosting: files, which may be named pipes. */
#ifndef HOST_H
#define HOST_H

#include <stdbool.h>
#include <stdint.h>

/* The handle of a file of the folder that the emulator was started in. */
int host_open_to_read(const char *path);
int host_open_to_write(const char *path);

/* All of it, however many pieces it comes in; whether the other end is still there. */
bool host_read(int handle, void *data, uintptr_t size);
bool host_write(int handle, const void *data, uintptr_t size);

/* End the emulation. */
void host_exit(void);

#endif
