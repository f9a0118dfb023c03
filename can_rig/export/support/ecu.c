#include "ecu.h"

#include <string.h>

#include "crc.h"
#include "self_test.h"

#define STAGES 5u /* of a tick: the law, three frames, the inputs */
#define ASTRAY 255u

/* Know nothing of the sender; what has been counted stays. */
static void receiver_begin(struct ecu_receiver *receiver, const struct frame *frame)
{
    struct e2e_checker checker;

    e2e_checker_init(&checker, frame->data_id, frame->bytes);
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
    ecu->first.there = false;
//: if hears
    receiver_begin(&ecu->speed, &frame_speed);
    ecu->first_speed.there = false;
//: end
//: if sensors
    for (uint32_t i = 0; i < ECU_SENSORS; i++) {
        receiver_begin(&ecu->sensors[i].receiver, &ecu_sensors[i].frame);
        ecu->sensors[i].first.there = false;
        ecu->sensors[i].value = (real)NAN;
    }
//: end
    ecu->running = false;
    ecu->wanted = (real)NAN;
    ecu->measured = (real)NAN;
}

static uint32_t with_number(uint32_t crc, uint64_t number)
{
    uint8_t bytes[sizeof number];

    for (uint32_t i = 0; i < sizeof bytes; i++) {
        const uint32_t places = 8u * i;

        bytes[i] = (uint8_t)((number >> places) & 0xFFu);
    }
    return crc_32(crc, bytes, sizeof bytes);
}

static uint64_t bits_of(double number)
{
    uint64_t bits;

    (void)memcpy((uint8_t *)&bits, (const uint8_t *)&number, sizeof bits);
    return bits;
}

static uint32_t with_frame(uint32_t before, const struct frame *frame)
{
    uint32_t crc = with_number(before, frame->id);

    crc = with_number(crc, frame->data_id);
    crc = with_number(crc, frame->bytes);
//: if steps
    crc = with_number(crc, bits_of(frame->lsb));
    crc = with_number(crc, frame->lowest);
    crc = with_number(crc, frame->highest);
    crc = with_number(crc, frame->not_available);
//: end
//: if whole
    crc = with_number(crc, frame->steps_per_unit);
//: end
//: if floats
    crc = with_number(crc, bits_of(frame->most));
//: end
    return crc;
}

/* Whether the numbers of network.c and the table of crc_8 are those of Python: a compiler that gives
 * double literals single precision changes them too, and no answer of the law.
 */
static bool frames_are_whole(void)
{
    uint32_t crc = with_number(UINT32_MAX, ecu_tick_us);

    crc = with_frame(crc, &frame_reference);
    crc = with_frame(crc, &frame_feedback);
    crc = with_frame(crc, &frame_command_1);
    crc = with_frame(crc, &frame_command_2);
    crc = with_frame(crc, &frame_status);
//: if hears
    crc = with_frame(crc, &frame_speed);
//: end
//: if sensors
    for (uint32_t i = 0; i < ECU_SENSORS; i++) {
        crc = with_frame(crc, &ecu_sensors[i].frame);
        crc = with_number(crc, ecu_sensors[i].number);
        crc = with_number(crc, ecu_sensors[i].period);
        crc = with_number(crc, ecu_sensors[i].phase);
        crc = with_number(crc, ecu_sensors[i].valid);
        crc = with_number(crc, ecu_sensors[i].largest);
    }
//: end
    for (uint32_t i = 0; i < 256u; i++) {
        const uint8_t byte = (uint8_t)i;

        crc = with_number(crc, crc_8(0, &byte, 1u));
    }
    return (crc ^ UINT32_MAX) == ecu_crc_of_frames;
}

bool ecu_init(struct ecu *ecu)
{
    (void)memset(ecu, 0, sizeof *ecu);
    ecu->is_fit = self_test(&ecu->state) && frames_are_whole();
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

/* The content of a frame; of one of the wrong length nothing. A frame without a tick is of 'tick'. */
static struct frame_content content_of(const struct frame *frame, uint32_t tick, uint8_t length,
                                       const uint8_t *data)
{
    struct frame_content content = {.tick = tick};

    if (length == frame->bytes) {
        frame->unpack(frame, data, &content);
    }
    return content;
}

/* Whether the content of a frame may be used: intact, in sequence, and of this tick. */
static bool receive(struct ecu_receiver *receiver, const struct frame *frame, uint16_t tick,
                    uint8_t length, const uint8_t *data, struct frame_content *content)
{
    *content = content_of(frame, tick, length, data);
    if (length == frame->bytes && content->tick == tick) {
        receiver->judged = true;
        return e2e_check(&receiver->checker, data, length);
    }
    e2e_reject(&receiver->checker, data, length);
    return false;
}

static void keep(struct ecu_offer *first, uint8_t length, const uint8_t *data)
{
    first->there = true;
    first->length = length;
    (void)memcpy(first->data, data, length < FRAME_BYTES ? length : FRAME_BYTES);
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
    struct frame_content content;

    if (receive(&ecu->reference, &frame_reference, ecu->tick, length, data, &content)) {
        ecu->wanted = content.value;
    }
}
//: if hears

//: if blends
/* Without a frame that may be used, the law goes on with the last speed. */
//: else
/* Judged and counted like any other; the law is for one speed. */
//: end
static void take_speed(struct ecu *ecu, uint8_t length, const uint8_t *data)
{
    struct frame_content content;

//: if blends
    if (receive(&ecu->speed, &frame_speed, ecu->tick, length, data, &content)) {
        firmware_change_speed(&ecu->state, content.value);
    }
//: else
    (void)receive(&ecu->speed, &frame_speed, ecu->tick, length, data, &content);
//: end
}
//: end
//: if sensors

/* Note the content of a sample for this tick; an invalid sample has none. */
static void take_sample(struct ecu *ecu, uint32_t at, uint8_t length, const uint8_t *data)
{
    const struct ecu_sensor_frame *const of = &ecu_sensors[at];
    struct ecu_sensor *const sensor = &ecu->sensors[at];
    struct frame_content content;

    if (receive(&sensor->receiver, &of->frame, ecu->tick, length, data, &content)) {
        const uint32_t age = (ecu->tick - content.verdict) & of->largest;

        sensor->value = content.mode == of->valid ? content.value : (real)NAN;
        sensor->age = (real)age;
    }
}

/* Whether 'id' is of samples, which are noted. */
static bool is_sample(struct ecu *ecu, uint32_t id, uint8_t length, const uint8_t *data)
{
    bool found = false;

    for (uint32_t i = 0; i < ECU_SENSORS; i++) {
        if (id == ecu_sensors[i].frame.id) {
            found = true;
            if (ecu->running) {
                take_sample(ecu, i, length, data);
            } else {
                keep(&ecu->sensors[i].first, length, data);
            }
        }
    }
    return found;
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
static bool first_contact(struct ecu *ecu, uint32_t id, uint8_t length, const uint8_t *data)
{
    if (id == frame_reference.id) {
        if (e2e_intact(&ecu->reference.checker, data, length)) {
            keep(&ecu->first, length, data);
        }
        return false;
    }
//: if hears
    if (id == frame_speed.id) {
        keep(&ecu->first_speed, length, data);
        return false;
    }
//: end
//: if sensors
    if (is_sample(ecu, id, length, data)) {
        return false;
    }
//: end
    if (id != frame_feedback.id || !ecu->first.there ||
        !e2e_intact(&ecu->feedback.checker, data, length) ||
        content_of(&frame_feedback, 0, length, data).tick !=
            content_of(&frame_reference, 0, ecu->first.length, ecu->first.data).tick) {
        return false;
    }
    ecu->running = true;
    ecu->tick = (uint16_t)content_of(&frame_feedback, 0, length, data).tick;
    take_reference(ecu, ecu->first.length, ecu->first.data);
//: if hears
    if (ecu->first_speed.there) {
        take_speed(ecu, ecu->first_speed.length, ecu->first_speed.data);
    }
//: end
//: if sensors
    ecu->ticks = ecu->tick;
    for (uint32_t i = 0; i < ECU_SENSORS; i++) {
        if (ecu->sensors[i].first.there) {
            take_sample(ecu, i, ecu->sensors[i].first.length, ecu->sensors[i].first.data);
        }
    }
//: end
    return true;
}

bool ecu_on_frame(struct ecu *ecu, uint32_t id, uint8_t length, const uint8_t *data,
                  uint32_t now_us)
{
    struct frame_content content;

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
    } else if (id == frame_feedback.id &&
               receive(&ecu->feedback, &frame_feedback, ecu->tick, length, data, &content)) {
        ecu->measured = content.value;
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
                   struct e2e_protector *protector, const struct frame_content *content)
{
    uint8_t data[FRAME_BYTES] = {0};

    frame->pack(frame, content, data);
    e2e_protect(protector, data, frame->bytes);
    if (ecu->is_fit) {
        ecu_send(ecu, frame->id, frame->bytes, data);
    }
    pass(ecu, stage);
}

void ecu_on_tick(struct ecu *ecu)
{
//: if sensors
    hear_sensors(ecu);

//: end
    const struct firmware_answer now = firmware_step(&ecu->state, ecu->wanted, ecu->measured);
    struct frame_content content = {.tick = ecu->tick};

    pass(ecu, 0);
    content.value = now.command_1;
    answer(ecu, 1, &frame_command_1, &ecu->command_1, &content);
    content.value = now.command_2;
    answer(ecu, 2, &frame_command_2, &ecu->command_2, &content);
    content.value = now.fault_estimate;
    content.mode = (uint32_t)now.mode;
    content.fault_state = (uint32_t)now.fault_state;
    content.verdict = (uint32_t)now.verdict;
    answer(ecu, 3, &frame_status, &ecu->status, &content);
    end_tick(&ecu->reference);
    end_tick(&ecu->feedback);
//: if hears
    end_tick(&ecu->speed);
//: end
//: if sensors
    end_tick_of_sensors(ecu);
//: end
    pass(ecu, 4);
    ecu->wanted = (real)NAN;
    ecu->measured = (real)NAN;
    ecu->tick++;
    if (ecu->flow == STAGES) {
        ecu->alive++;
    }
    ecu->flow = 0;
    ecu->expected_us += ecu_tick_us;
}
