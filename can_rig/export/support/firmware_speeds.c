#include "firmware.h"

#include <string.h>

#include "constants.h"
#include "controller.h"

void firmware_init(struct firmware_memory *memory)
{
    (void)memset(memory, 0, sizeof *memory);
    memory->table = controller_table;
    controller_start_up(&memory->table, &memory->state);
}

void firmware_reset(struct firmware_memory *memory, real reference)
{
    controller_reset(&memory->table, &memory->state, reference);
}

void firmware_change_speed(struct firmware_memory *memory, real speed)
{
    schedule_change_speed(&controller_schedule, &memory->blending, &memory->table, &memory->state,
                          speed);
}

struct firmware_answer firmware_step(struct firmware_memory *memory, real reference,
                                     real measurement)
{
    struct layout_state *const state = &memory->state;

    controller_step(&memory->table, state, reference, measurement);
    return (struct firmware_answer){
        .command_1 = state->command_1,
        .command_2 = state->command_2,
        .fault_estimate = state->fault_estimate,
        .mode = state->mode,
        .fault_state = state->fault_state,
        .verdict = state->hypotheses.verdict,
    };
}
