#include "ecu.h"

#include <string.h>

#include "self_test.h"

#define STAGES 5u /* of a tick: the law, three frames, the inputs */
#define ASTRAY 255u

/* Know nothing of the sender; what has been counted stays. */
static void receiver_begin(struct ecu_receiver *receiver, const struct frame *frame)
{
    struct e2e_checker checker;

    e2e_checker_init(&checker, frame->data_id);
    (void)memcpy(checker.counts, receiver->checker.counts, sizeof checker.counts);
    receiver->checker = checker;
    receiver->judged = false;
}

/* Know nothing of the plant, and wait for the first contact. */
static void begin(struct ecu *ecu)
{
    firmware_init(&ecu->state);
    receiver_begin(&ecu->reference, &frame_reference);
    receiver_begin(&ecu->feedback, &frame_feedback);
    ecu->offered = false;
//: if hears
    receiver_begin(&ecu->speed, &frame_speed);
    ecu->speed_offered = false;
//: end
//: if sensors
    for (uint32_t i = 0; i < ECU_SENSORS; i++) {
        receiver_begin(&ecu->sensors[i].receiver, &ecu_sensors[i].frame);
        ecu->sensors[i].offered = false;
        ecu->sensors[i].value = (real)NAN;
    }
//: end
    ecu->running = false;
    ecu->wanted = (real)NAN;
    ecu->measured = (real)NAN;
}

bool ecu_init(struct ecu *ecu)
{
    (void)memset(ecu, 0, sizeof *ecu);
    ecu->is_fit = self_test(&ecu->state);
    e2e_protector_init(&ecu->command_1, frame_command_1.data_id);
    e2e_protector_init(&ecu->command_2, frame_command_2.data_id);
    e2e_protector_init(&ecu->status, frame_status.data_id);
    begin(ecu);
    return ecu->is_fit;
}

void ecu_save(struct ecu *ecu, struct knowledge_saved *saved)
{
    firmware_save(&ecu->state, saved);
}

bool ecu_restore(struct ecu *ecu, const struct knowledge_saved *saved)
{
    return firmware_restore(&ecu->state, saved);
}

/* Whether the content of a frame may be used: intact, in sequence, and of this tick. */
static bool receive(struct ecu_receiver *receiver, uint16_t tick, uint8_t length,
                    const uint8_t *data)
{
    if (length == E2E_BYTES && frame_tick(data) == tick) {
        receiver->judged = true;
        return e2e_check(&receiver->checker, data, length);
    }
    e2e_reject(&receiver->checker, data, length);
    return false;
}

static void end_tick(struct ecu_receiver *receiver)
{
    if (!receiver->judged) {
        e2e_no_new_data(&receiver->checker);
    }
    receiver->judged = false;
}

static void take_reference(struct ecu *ecu, uint8_t length, const uint8_t *data)
{
    if (receive(&ecu->reference, ecu->tick, length, data)) {
        ecu->wanted = frame_value(&frame_reference, data);
        ecu->wanted_tick = frame_tick(data);
    }
}
//: if hears

//: if blends
/* Without a frame that may be used, the law goes on with the last speed. */
static void take_speed(struct ecu *ecu, uint8_t length, const uint8_t *data)
{
    if (receive(&ecu->speed, ecu->tick, length, data)) {
        firmware_change_speed(&ecu->state, frame_value(&frame_speed, data));
    }
}
//: else
/* Judged and counted like any other; the law is for one speed. */
static void take_speed(struct ecu *ecu, uint8_t length, const uint8_t *data)
{
    (void)receive(&ecu->speed, ecu->tick, length, data);
}
//: end
//: end
//: if sensors

/* Note the content of a sample for this tick; an invalid sample has none. */
static void take_sample(struct ecu *ecu, uint32_t at, uint8_t length, const uint8_t *data)
{
    const struct frame *const frame = &ecu_sensors[at].frame;
    struct ecu_sensor *const sensor = &ecu->sensors[at];

    if (receive(&sensor->receiver, ecu->tick, length, data)) {
        const uint32_t sample = (uint32_t)data[4] | (uint32_t)data[5] << 8;
        const uint32_t most = (1u << frame->verdict_bits) - 1u;
        const uint32_t age = (ecu->tick - sample) & most;
        const bool valid = ((uint32_t)data[1] >> frame->mode_shift & 1u) != 0u;

        sensor->value = valid ? frame_value(frame, data) : (real)NAN;
        sensor->age = (real)age;
    }
}

/* Whether 'id' is of a sample, which is noted. */
static bool is_sample(struct ecu *ecu, uint16_t id, uint8_t length, const uint8_t *data)
{
    for (uint32_t i = 0; i < ECU_SENSORS; i++) {
        struct ecu_sensor *const sensor = &ecu->sensors[i];

        if (id == ecu_sensors[i].frame.id) {
            if (ecu->running) {
                take_sample(ecu, i, length, data);
            } else {
                sensor->offered = true;
                sensor->first_length = length;
                (void)memcpy(sensor->first, data, length < 8u ? length : 8u);
            }
            return true;
        }
    }
    return false;
}

static void hear_sensors(struct ecu *ecu)
{
    for (uint32_t i = 0; i < ECU_SENSORS; i++) {
        struct ecu_sensor *const sensor = &ecu->sensors[i];

        if (isnan(sensor->value) == 0) {
            firmware_hear(&ecu->state, (real)ecu_sensors[i].number, sensor->value, sensor->age);
        }
        sensor->value = (real)NAN;
    }
}

static void end_tick_of_sensors(struct ecu *ecu)
{
    for (uint32_t i = 0; i < ECU_SENSORS; i++) {
        const struct ecu_sensor_frame *const of = &ecu_sensors[i];

        if (ecu->ticks >= of->phase && (ecu->ticks - of->phase) % of->period == 0u) {
            end_tick(&ecu->sensors[i].receiver);
        }
    }
    ecu->ticks++;
}
//: end

/* Whether this is the first feedback: intact, and of the tick of the reference before it.
 *
 * One frame of 256 that another sender makes up has the right CRC, and would do where the tick is
 * still anybody's guess. So two are wanted that agree; until then no checker sees any.
 */
static bool first_contact(struct ecu *ecu, uint16_t id, uint8_t length, const uint8_t *data)
{
    if (id == frame_reference.id) {
        ecu->offered = true;
        ecu->first_length = length;
        (void)memcpy(ecu->first, data, length < 8u ? length : 8u);
        return false;
    }
//: if hears
    if (id == frame_speed.id) {
        ecu->speed_offered = true;
        ecu->first_speed_length = length;
        (void)memcpy(ecu->first_speed, data, length < 8u ? length : 8u);
        return false;
    }
//: end
//: if sensors
    if (is_sample(ecu, id, length, data)) {
        return false;
    }
//: end
    if (id != frame_feedback.id || !ecu->offered ||
        !e2e_intact(&ecu->feedback.checker, data, length) ||
        !e2e_intact(&ecu->reference.checker, ecu->first, ecu->first_length) ||
        frame_tick(data) != frame_tick(ecu->first)) {
        return false;
    }
    ecu->running = true;
    ecu->tick = frame_tick(data);
    take_reference(ecu, ecu->first_length, ecu->first);
//: if hears
    if (ecu->speed_offered) {
        take_speed(ecu, ecu->first_speed_length, ecu->first_speed);
    }
//: end
//: if sensors
    ecu->ticks = ecu->tick;
    for (uint32_t i = 0; i < ECU_SENSORS; i++) {
        if (ecu->sensors[i].offered) {
            take_sample(ecu, i, ecu->sensors[i].first_length, ecu->sensors[i].first);
        }
    }
//: end
    return true;
}

bool ecu_on_frame(struct ecu *ecu, uint16_t id, uint8_t length, const uint8_t *data,
                  uint32_t now_us)
{
    if (!ecu->is_fit || (!ecu->running && !first_contact(ecu, id, length, data))) {
        return false;
    }
    if (id == frame_reference.id) {
        take_reference(ecu, length, data);
//: if hears
    } else if (id == frame_speed.id) {
        take_speed(ecu, length, data);
//: end
//: if sensors
    } else if (is_sample(ecu, id, length, data)) {
        /* noted */
//: end
    } else if (id == frame_feedback.id && receive(&ecu->feedback, ecu->tick, length, data)) {
        ecu->measured = frame_value(&frame_feedback, data);
        ecu->expected_us = now_us;
        return true;
    } else {
        /* a frame of somebody else, or one that must not be used */
    }
    return false;
}

bool ecu_is_overdue(struct ecu *ecu, uint32_t now_us)
{
    const uint32_t late_us = now_us - ecu->expected_us;
    const uint32_t early_us = ecu->expected_us - now_us;

    if (!ecu->running || early_us <= 2u * ecu_tick_us || late_us < ecu_tick_us / 2u) {
        return false;
    }
    if (late_us > ECU_MOST_LATE_TICKS * ecu_tick_us) {
        struct knowledge_saved known;

        ecu->stalls++;
        firmware_save(&ecu->state, &known);
        begin(ecu);
        (void)firmware_restore(&ecu->state, &known);
        return false;
    }
    return true;
}

/* A checkpoint of the program flow: a stage that comes too early, or twice, spoils the tick. */
static void pass(struct ecu *ecu, uint8_t stage)
{
    ecu->flow = ecu->flow == stage ? (uint8_t)(stage + 1u) : (uint8_t)ASTRAY;
}

static void answer(struct ecu *ecu, uint8_t stage, const struct frame *frame,
                   struct e2e_protector *protector, real value, uint8_t status_bits,
                   uint8_t verdict)
{
    uint8_t data[8] = {0};

    data[1] = status_bits;
    frame_pack(frame, value, ecu->tick, data);
    data[4] = (uint8_t)(data[4] | verdict);
    e2e_protect(protector, data);
    if (ecu->is_fit) {
        ecu_send(ecu, frame->id, data);
    }
    pass(ecu, stage);
}

void ecu_on_tick(struct ecu *ecu)
{
    const bool wanted = ecu->wanted_tick == ecu->tick;
    const real reference = wanted ? ecu->wanted : (real)NAN;
//: if sensors

    hear_sensors(ecu);

//: end
    const struct firmware_answer now =
        firmware_step(&ecu->state, reference, ecu->measured);
    const uint8_t bits = (uint8_t)((uint32_t)now.mode << frame_status.mode_shift |
                                   (uint32_t)now.fault_state << frame_status.fault_state_shift);

    pass(ecu, 0);
    answer(ecu, 1, &frame_command_1, &ecu->command_1, now.command_1, 0, 0);
    answer(ecu, 2, &frame_command_2, &ecu->command_2, now.command_2, 0, 0);
    answer(ecu, 3, &frame_status, &ecu->status, now.fault_estimate, bits,
           (uint8_t)now.verdict);
    end_tick(&ecu->reference);
    end_tick(&ecu->feedback);
//: if hears
    end_tick(&ecu->speed);
//: end
//: if sensors
    end_tick_of_sensors(ecu);
//: end
    pass(ecu, 4);
    ecu->measured = (real)NAN;
    ecu->tick++;
    if (ecu->flow == STAGES) {
        ecu->alive++;
    }
    ecu->flow = 0;
    ecu->expected_us += ecu_tick_us;
}
