#include "firmware.h"

#include <string.h>

#include "constants.h"
#include "controller.h"
#include "crc.h"
//: if sensors
#include "further_sensors.h"
//: end
#include "self_test.h"

//: if blends
void firmware_init(struct firmware_memory *memory)
//: else
void firmware_init(struct layout_state *state)
//: end
{
//: if blends
    (void)memset(memory, 0, sizeof *memory);
    memory->table = controller_table;
    controller_start_up(&memory->table, &memory->state);
    memory->state.supervision.takeover.pending = 1;
//: else
    (void)memset(state, 0, sizeof *state);
    controller_start_up(&controller_table, state);
    state->supervision.takeover.pending = 1;
//: end
}

static uint32_t guard_of(const struct knowledge_saved *saved)
{
    const uint32_t own = (uint32_t)sizeof saved->crc;
    const uint8_t *const bytes = (const uint8_t *)saved;

    return crc_32(UINT32_MAX, &bytes[own], (uint32_t)sizeof *saved - own) ^ UINT32_MAX;
}

static void put(int32_t *place, uint32_t bits)
{
    (void)memcpy((uint8_t *)place, (const uint8_t *)&bits, sizeof bits);
}

//: if blends
void firmware_save(struct firmware_memory *memory, struct knowledge_saved *saved)
{
    struct layout_state *const state = &memory->state;
//: else
void firmware_save(struct layout_state *state, struct knowledge_saved *saved)
{
//: end
    const int32_t before = state->supervision.saved.fingerprint;

    knowledge_save(&state->supervision, state->fault_state);
    *saved = state->supervision.saved;
    state->supervision.saved.fingerprint = before;
    put(&saved->fingerprint, self_test_data.fingerprint);
    put(&saved->crc, guard_of(saved));
}

//: if blends
bool firmware_restore(struct firmware_memory *memory, const struct knowledge_saved *saved)
{
    struct layout_state *const state = &memory->state;
//: else
bool firmware_restore(struct layout_state *state, const struct knowledge_saved *saved)
{
//: end
    const bool is_whole = (uint32_t)saved->fingerprint == self_test_data.fingerprint &&
                          (uint32_t)saved->crc == guard_of(saved);

    if (is_whole) {
        state->supervision.saved = *saved;
    }
    return is_whole;
}

//: if blends
void firmware_reset(struct firmware_memory *memory, real reference)
//: else
void firmware_reset(struct layout_state *state, real reference)
//: end
{
//: if blends
    controller_reset(&memory->table, &memory->state, reference);
//: else
    controller_reset(&controller_table, state, reference);
//: end
}

//: if sensors
//: if blends
void firmware_hear(struct firmware_memory *memory, real sensor, real value, real age)
{
    further_sensors_hear(&memory->table, &memory->state, sensor, value, age);
}
//: else
void firmware_hear(struct layout_state *state, real sensor, real value, real age)
{
    further_sensors_hear(&controller_table, state, sensor, value, age);
}
//: end

//: end
//: if blends
void firmware_change_speed(struct firmware_memory *memory, real speed)
//: else
struct firmware_answer firmware_step(struct layout_state *state, real reference, real measurement)
//: end
{
//: if blends
    schedule_change_speed(&controller_schedule, &memory->blending, &memory->table, &memory->state,
                          speed);
}

struct firmware_answer firmware_step(struct firmware_memory *memory, real reference,
                                     real measurement)
{
    struct layout_state *const state = &memory->state;

    controller_step(&memory->table, state, reference, measurement);
//: else
    controller_step(&controller_table, state, reference, measurement);
//: end
    return (struct firmware_answer){
        .command_1 = state->command_1,
        .command_2 = state->command_2,
        .fault_estimate = state->fault_estimate,
        .mode = state->mode,
        .fault_state = state->fault_state,
        .verdict = state->supervision.hypotheses.verdict,
    };
}
