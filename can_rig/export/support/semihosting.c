/* The controller node on an emulated Cortex-M, which asks its host for frames by semihosting.
 *
 * Two named pipes: 12 bytes come in (an order, two bytes of the identifier, the length, eight of
 * data), a fixed number of bytes goes out for each order.
 */
#include <string.h>

#include "harness.h"

#define SYS_OPEN 0x01
#define SYS_WRITE 0x05
#define SYS_READ 0x06
#define SYS_EXIT 0x18
#define READ_BINARY 1
#define WRITE_BINARY 5

#define ORDER_BYTES 12
#define ANSWER_BYTES (1 + HARNESS_MOST_FRAMES * HARNESS_FRAME_BYTES)
#define ORDER_FRAME 'F'
#define ORDER_COUNTS 'C'

static struct ecu ecu;

static int host(int operation, const void *parameters)
{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = parameters;

    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static int open_pipe(const char *path, uintptr_t mode)
{
    const uintptr_t parameters[] = {(uintptr_t)path, mode, strlen(path)};

    return host(SYS_OPEN, parameters);
}

/* All of it, however many pieces it comes in; whether the other end is still there. */
static bool transfer(int operation, int handle, void *data, uintptr_t size)
{
    uintptr_t left = size;

    while (left > 0) {
        const uintptr_t parameters[] = {(uintptr_t)handle, (uintptr_t)data + size - left, left};
        const uintptr_t remaining = (uintptr_t)host(operation, parameters);

        if (remaining >= left) {
            return false;
        }
        left = remaining;
    }
    return true;
}

int main(void)
{
    const int orders = open_pipe("orders", READ_BINARY);
    const int answers = open_pipe("answers", WRITE_BINARY);
    uint8_t order[ORDER_BYTES];
    uint8_t answer[ANSWER_BYTES];
    uint32_t counts[2 * E2E_STATUSES];

    ecu_init(&ecu);
    while (transfer(SYS_READ, orders, order, sizeof order)) {
        if (order[0] == ORDER_COUNTS) {
            harness_counts(&ecu, counts);
            (void)transfer(SYS_WRITE, answers, counts, sizeof counts);
        } else if (order[0] == ORDER_FRAME) {
            memset(answer, 0, sizeof answer);
            answer[0] = harness_frame(&ecu, (uint16_t)(order[1] | order[2] << 8), order[3],
                                      order + 4, answer + 1);
            (void)transfer(SYS_WRITE, answers, answer, sizeof answer);
        }
    }
    (void)host(SYS_EXIT, (const void *)0x20026); /* ADP_Stopped_ApplicationExit */
    return 0;
}
