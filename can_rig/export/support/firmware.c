#include "firmware.h"

#include <string.h>

#include "constants.h"
#include "controller.h"

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
    memory->state.takeover.pending = 1;
//: else
    (void)memset(state, 0, sizeof *state);
    controller_start_up(&controller_table, state);
    state->takeover.pending = 1;
//: end
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
        .verdict = state->hypotheses.verdict,
    };
}
