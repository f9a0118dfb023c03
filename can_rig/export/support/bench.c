#include "bench.h"

#include "harness.h"

#define ORDER_BYTES (6u + FRAME_BYTES)
#define ORDER_FRAME 'F'
#define ORDER_COUNTS 'C'
#define ORDER_RESTART 'R'
#define ORDER_TIME 'T'

static struct ecu ecu;

static bool is_order(uint8_t letter)
{
    return letter == ORDER_FRAME || letter == ORDER_COUNTS || letter == ORDER_RESTART ||
           letter == ORDER_TIME;
}

static bool read_order(uint8_t order[ORDER_BYTES])
{
    do {
        if (!bench_read(order, 1)) {
            return false;
        }
    } while (!is_order(order[0]));
    return bench_read(&order[1], ORDER_BYTES - 1u);
}

static bool answer_frame(const uint8_t order[ORDER_BYTES])
{
    uint8_t answer[1u + HARNESS_MOST_FRAMES * HARNESS_FRAME_BYTES];
    uint32_t number = 0;

    for (uint32_t i = 0; i < 4u; i++) {
        number |= (uint32_t)order[1u + i] << (8u * i);
    }
    answer[0] = order[0] == ORDER_TIME
                    ? harness_time(&ecu, number, &answer[1])
                    : harness_frame(&ecu, number, order[5], &order[6], &answer[1]);
    return bench_write(answer, 1u + (uint32_t)answer[0] * HARNESS_FRAME_BYTES);
}

static bool answer_counts(void)
{
    uint32_t counts[HARNESS_COUNTS];
    uint8_t answer[4 * HARNESS_COUNTS];

    harness_counts(&ecu, counts);
    for (uint32_t i = 0; i < sizeof answer; i++) {
        answer[i] = (uint8_t)(counts[i / 4u] >> (8u * (i % 4u)) & 0xFFu);
    }
    return bench_write(answer, sizeof answer);
}

static bool restart(bool state_survives)
{
    static const uint8_t identity[8] = {{identity}};
    static const uint8_t unfit[8] = {0};

    return bench_write(harness_restart(&ecu, state_survives) ? identity : unfit, sizeof identity);
}

void bench_run(void)
{
    uint8_t order[ORDER_BYTES];
    bool there = true;

    (void)ecu_init(&ecu);
    while (there && read_order(order)) {
        switch (order[0]) {
        case ORDER_FRAME:
        case ORDER_TIME:
            there = answer_frame(order);
            break;
        case ORDER_COUNTS:
            there = answer_counts();
            break;
        default:
            there = restart(order[1] != 0u);
            break;
        }
    }
}
