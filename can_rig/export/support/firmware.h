/* The controller of scenario {scenario}: what an application calls.
 *
 * Timing: firmware_step once every {tick}, with the reference and the measurement of that
 * tick; its commands must be at the actuators {latency}.
 * Memory: the state is the caller's, and static; nothing is allocated, nothing recurses, no other
 * functions of the C library are used than sqrt, fabs, ceil, rint and memset.
 * Not for two threads at once with the same state.
 */
#ifndef FIRMWARE_H
#define FIRMWARE_H

#include "layout.h"
#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What a tick answers. */
struct firmware_answer {
    real command_1;       /* {command_1} */
    real command_2;       /* {command_2} */
    real fault_estimate;  /* {estimate} */
    int32_t mode;         /* an enum status_mode */
    int32_t fault_state;  /* an enum status_fault_state */
    int32_t verdict;      /* an enum status_verdict */
};

/* Put a state at rest, as after power-up: every memory zero, mode MODE_INIT. */
void firmware_init(struct layout_state *state);

/* Put a state that firmware_init has seen into the steady state of a healthy loop at a constant
 * reference: the next step with that reference, and the measurement that settles at it, repeats
 * the commands.
 *
 * reference: {reference}
 */
void firmware_reset(struct layout_state *state, real reference);

/* One tick.
 *
 * reference: {reference}
 * measurement: {measurement}
 *
 * An input that is missing must be NAN: then the last good commands are held, the models follow
 * them, and the mode is MODE_HOLD.
 */
struct firmware_answer firmware_step(struct layout_state *state, real reference, real measurement);

#ifdef __cplusplus
}
#endif

#endif
