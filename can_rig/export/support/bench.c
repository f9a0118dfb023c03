#include "bench.h"

#include "harness.h"

#define ORDER_BYTES 12
#define ORDER_FRAME 'F'
#define ORDER_COUNTS 'C'
#define ORDER_RESTART 'R'
#define COUNTS (2 * E2E_STATUSES)

static const uint8_t identity[8] = {{identity}};

static struct ecu ecu;

static bool read_order(uint8_t order[ORDER_BYTES])
{
    do {
        if (!bench_read(order, 1)) {
            return false;
        }
    } while (order[0] != ORDER_FRAME && order[0] != ORDER_COUNTS && order[0] != ORDER_RESTART);
    return bench_read(order + 1, ORDER_BYTES - 1);
}

static bool answer_frame(const uint8_t order[ORDER_BYTES])
{
    uint8_t answer[1 + HARNESS_MOST_FRAMES * HARNESS_FRAME_BYTES];
    const uint16_t id = (uint16_t)(order[1] | order[2] << 8);

    answer[0] = harness_frame(&ecu, id, order[3], order + 4, answer + 1);
    return bench_write(answer, 1 + (uint32_t)answer[0] * HARNESS_FRAME_BYTES);
}

static bool answer_counts(void)
{
    uint32_t counts[COUNTS];
    uint8_t answer[4 * COUNTS];

    harness_counts(&ecu, counts);
    for (int i = 0; i < 4 * COUNTS; i++) {
        answer[i] = (uint8_t)(counts[i / 4] >> (8 * (i % 4)) & 0xFFu);
    }
    return bench_write(answer, sizeof answer);
}

static bool restart(void)
{
    ecu_init(&ecu);
    return bench_write(identity, sizeof identity);
}

void bench_run(void)
{
    uint8_t order[ORDER_BYTES];
    bool there = true;

    ecu_init(&ecu);
    while (there && read_order(order)) {
        switch (order[0]) {
        case ORDER_FRAME:
            there = answer_frame(order);
            break;
        case ORDER_COUNTS:
            there = answer_counts();
            break;
        default:
            there = restart();
            break;
        }
    }
}
