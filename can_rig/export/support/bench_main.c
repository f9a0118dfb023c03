/* The controller node on a test bench: orders from standard input, answers to standard output. On a
 * board, bench_read and bench_write are those of its serial port, and main sets that up first.
 */
#include <stdio.h>

#include "bench.h"

bool bench_read(uint8_t *data, uint32_t size)
{
    return fread(data, 1, size, stdin) == size;
}

bool bench_write(const uint8_t *data, uint32_t size)
{
    return fwrite(data, 1, size, stdout) == size && fflush(stdout) == 0;
}

int main(void)
{
    (void)setvbuf(stdin, NULL, _IONBF, 0); /* reads no more than it needs now */
    bench_run();
    return 0;
}
