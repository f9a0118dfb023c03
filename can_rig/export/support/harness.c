#include "harness.h"

#include <string.h>

static uint8_t *sent_frames;
static uint8_t frames;
static uint32_t now;

void ecu_send(const struct ecu *ecu, uint32_t id, uint8_t length, const uint8_t *data)
{
    uint8_t *const place = &sent_frames[HARNESS_FRAME_BYTES * frames];

    (void)ecu;
    for (uint32_t i = 0; i < 4u; i++) {
        place[i] = (uint8_t)(id >> (8u * i) & 0xFFu);
    }
    place[4] = length;
    (void)memcpy(&place[5], data, length);
    frames++;
}

bool harness_restart(struct ecu *ecu, bool state_survives)
{
    struct knowledge_saved saved;

    ecu_save(ecu, &saved);
    return ecu_init(ecu) && (!state_survives || ecu_restore(ecu, &saved));
}

size_t harness_size(void)
{
    return sizeof(struct ecu);
}

uint8_t harness_frame(struct ecu *ecu, uint32_t id, uint8_t length, const uint8_t *data,
                      uint8_t *sent)
{
    sent_frames = sent;
    frames = 0;
    if (ecu_on_frame(ecu, id, length, data, now)) {
        ecu_on_tick(ecu);
    }
    return frames;
}

uint8_t harness_time(struct ecu *ecu, uint32_t now_us, uint8_t *sent)
{
    sent_frames = sent;
    frames = 0;
    now = now_us;
    if (ecu_is_overdue(ecu, now)) {
        ecu_on_tick(ecu);
    }
    return frames;
}

uint8_t harness_receivers(void)
{
    return HARNESS_RECEIVERS;
}

void harness_counts(const struct ecu *ecu, uint32_t counts[HARNESS_COUNTS])
{
    const struct ecu_receiver *receivers[HARNESS_RECEIVERS] = {
//: if hears
        &ecu->reference, &ecu->feedback, &ecu->speed};
//: else
        &ecu->reference, &ecu->feedback};
//: end

//: if sensors
    for (uint32_t i = 0; i < ECU_SENSORS; i++) {
        receivers[HARNESS_ALWAYS + i] = &ecu->sensors[i].receiver;
    }
//: end
    for (uint32_t i = 0; i < HARNESS_RECEIVERS; i++) {
        const struct e2e_checker *const checker = &receivers[i]->checker;

        (void)memcpy(&counts[E2E_STATUSES * i], checker->counts, sizeof checker->counts);
    }
}
