//: if blends
/* The controller of scenario {scenario}, of a car whose speed changes: what an application calls.
//: else
/* The controller of scenario {scenario}: what an application calls.
//: end
 *
 * Timing: firmware_step once every {tick}, with the reference and the measurement of that
//: if blends
 * tick; its commands must be at the actuators {latency}. Before it firmware_change_speed, in
 * a tick that brings the speed of the car.
//: else
 * tick; its commands must be at the actuators {latency}.
//: end
 * Memory: it is the caller's, and static; nothing is allocated, nothing recurses, no other
 * functions of the C library are used than sqrt, fabs, ceil, rint, memset and memcpy.
 * Not for two threads at once with the same memory.
 * At start-up, before firmware_init: self_test of self_test.h.
 */
#ifndef FIRMWARE_H
#define FIRMWARE_H

#include <stdbool.h>

#include "layout.h"
//: if blends
#include "schedule.h"
//: end
#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif
//: if blends

/* Everything that changes: the table too, which is blended between designs. */
struct firmware_memory {
    struct layout_state state;
    struct layout_table table;
    struct schedule_state blending;
};
//: end

/* What a tick answers. */
struct firmware_answer {
    real command_1;       /* {command_1} */
    real command_2;       /* {command_2} */
    real fault_estimate;  /* {estimate} */
    int32_t mode;         /* a MODE_ of status.h */
    int32_t fault_state;  /* a FAULT_STATE_ of status.h */
    int32_t verdict;      /* a VERDICT_ of status.h */
};

//: if blends
/* Begin as after power-up: mode MODE_STANDBY, at the speed of the slowest design. The first step with
 * both inputs takes over a plant that moves. */
void firmware_init(struct firmware_memory *memory);
//: else
/* Begin as after power-up: mode MODE_STANDBY. The first step with both inputs takes over a plant that
 * moves. */
void firmware_init(struct layout_state *state);
//: end

/* Write into 'saved' what is known of the car and of lost actuators, for non-volatile memory. Any
 * time: what is saved and not yet begun with is written again.
 */
//: if blends
void firmware_save(struct firmware_memory *memory, struct knowledge_saved *saved);
//: else
void firmware_save(struct layout_state *state, struct knowledge_saved *saved);
//: end

/* Right after firmware_init: the first step with both inputs begins with what is known. False, and
 * no effect, where 'saved' is damaged, or of another controller: all its bits are guarded.
 */
//: if blends
bool firmware_restore(struct firmware_memory *memory, const struct knowledge_saved *saved);
//: else
bool firmware_restore(struct layout_state *state, const struct knowledge_saved *saved);
//: end

//: if blends
/* Put a memory that firmware_init has seen into the steady state of a healthy loop at a constant
//: else
/* Put a state that firmware_init has seen into the steady state of a healthy loop at a constant
//: end
 * reference: the next step with that reference, and the measurement that settles at it, repeats
 * the commands.
 *
 * reference: {reference}
 *
 * It must be finite: any other is a safe stop until the next reset.
 */
//: if blends
void firmware_reset(struct firmware_memory *memory, real reference);

/* Say the speed of the car: {speed}
 *
 * One that is missing must be NAN, or left out: then it is as it was.
 */
void firmware_change_speed(struct firmware_memory *memory, real speed);
//: else
void firmware_reset(struct layout_state *state, real reference);
//: end

//: if sensors
/* Say what a further sensor reports, before the firmware_step of a tick.
 *
 * sensor: 1 and 2: the output of actuator 1 or 2; 3: yaw rate; 4: lateral acceleration
 * value: an output in the unit of its command, a yaw rate in rad/s, an acceleration in m/s^2
 * age: ticks since the sample; 64 and more are too old to count
 *
 * Another sensor, a value that is not finite and a negative age have no effect.
 */
//: if blends
void firmware_hear(struct firmware_memory *memory, real sensor, real value, real age);
//: else
void firmware_hear(struct layout_state *state, real sensor, real value, real age);
//: end

//: end
/* One tick.
 *
 * reference: {reference}
 * measurement: {measurement}
 *
 * A missing input must be NAN: the mode is MODE_BLIND then. The model's prediction stands in for
 * the measurement; without a reference the commands are held. A tick in which nothing has come
 * needs its step too: the models of the plant go on by a tick with each step.
 */
//: if blends
struct firmware_answer firmware_step(struct firmware_memory *memory, real reference,
                                     real measurement);
//: else
struct firmware_answer firmware_step(struct layout_state *state, real reference, real measurement);
//: end

#ifdef __cplusplus
}
#endif

#endif
