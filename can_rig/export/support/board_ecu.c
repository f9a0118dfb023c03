/* The controller node on an emulated Cortex-M.
 *
 * Two named pipes: 12 bytes come in (an order, two bytes of the identifier, the length, eight of
 * data), a fixed number of bytes goes out for each order.
 */
#include <string.h>

#include "harness.h"
#include "host.h"

#define ORDER_BYTES 12
#define ANSWER_BYTES (1 + HARNESS_MOST_FRAMES * HARNESS_FRAME_BYTES)
#define ORDER_FRAME 'F'
#define ORDER_COUNTS 'C'

static struct ecu ecu;

int main(void)
{
    const int orders = host_open_to_read("orders");
    const int answers = host_open_to_write("answers");
    uint8_t order[ORDER_BYTES];
    uint8_t answer[ANSWER_BYTES];
    uint32_t counts[2 * E2E_STATUSES];

    ecu_init(&ecu);
    while (host_read(orders, order, sizeof order)) {
        if (order[0] == ORDER_COUNTS) {
            harness_counts(&ecu, counts);
            (void)host_write(answers, counts, sizeof counts);
        } else if (order[0] == ORDER_FRAME) {
            memset(answer, 0, sizeof answer);
            answer[0] = harness_frame(&ecu, (uint16_t)(order[1] | order[2] << 8), order[3],
                                      order + 4, answer + 1);
            (void)host_write(answers, answer, sizeof answer);
        }
    }
    host_exit();
    return 0;
}
