#include "harness.h"

#include <string.h>

static uint8_t *place;
static uint8_t frames;

void ecu_send(uint16_t id, const uint8_t data[8])
{
    place[0] = (uint8_t)(id & 0xFFu);
    place[1] = (uint8_t)(id >> 8);
    memcpy(place + 2, data, 8);
    place += HARNESS_FRAME_BYTES;
    frames++;
}

size_t harness_size(void)
{
    return sizeof(struct ecu);
}

uint8_t harness_frame(struct ecu *ecu, uint16_t id, uint8_t length, const uint8_t *data,
                      uint8_t *sent)
{
    place = sent;
    frames = 0;
    if (ecu_on_frame(ecu, id, length, data, 0)) { /* time stands still until the feedback comes */
        ecu_on_tick(ecu);
    }
    return frames;
}

void harness_counts(const struct ecu *ecu, uint32_t counts[2 * E2E_STATUSES])
{
    memcpy(counts, ecu->reference.checker.counts, sizeof ecu->reference.checker.counts);
    memcpy(counts + E2E_STATUSES, ecu->feedback.checker.counts,
           sizeof ecu->feedback.checker.counts);
}
