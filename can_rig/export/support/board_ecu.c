/* The controller node on an emulated Cortex-M: two named pipes by semihosting. */
#include "bench.h"
#include "host.h"

static int orders;
static int answers;

bool bench_read(uint8_t *data, uint32_t size)
{
    return host_read(orders, data, size);
}

bool bench_write(const uint8_t *data, uint32_t size)
{
    return host_write(answers, data, size);
}

int main(void)
{
    orders = host_open_to_read("orders");
    answers = host_open_to_write("answers");
    bench_run();
    host_exit();
    return 0;
}
