#include "firmware.h"

#include <string.h>

#include "constants.h"
#include "controller.h"

void firmware_init(struct layout_state *state)
{
    (void)memset(state, 0, sizeof *state);
    controller_start_up(&controller_table, state);
}

void firmware_reset(struct layout_state *state, real reference)
{
    controller_reset(&controller_table, state, reference);
}

struct firmware_answer firmware_step(struct layout_state *state, real reference, real measurement)
{
    controller_step(&controller_table, state, reference, measurement);
    return (struct firmware_answer){
        .command_1 = state->command_1,
        .command_2 = state->command_2,
        .fault_estimate = state->fault_estimate,
        .mode = state->mode,
        .fault_state = state->fault_state,
        .verdict = state->hypotheses.verdict,
    };
}
