/* The frames of a tick: the conversion between a value and the 8 bytes of its frame.
 *
 * Bytes 0 and 1 are those of e2e.h, with mode and fault state in the high nibble of byte 1 of the
 * status; then 16 bits of the tick and 32 bits of the value, both with the low byte first. The
 * low four bits of the status's value are the verdict.
 * A value out of range saturates; not-a-number is sent as the one raw value outside every range.
 */
#ifndef FRAMES_H
#define FRAMES_H

#include <stdbool.h>
#include <stdint.h>

#include "real.h"

/* What the DBC says of a frame. */
struct frame {
    uint16_t id;      /* 11-bit CAN identifier */
    uint16_t data_id; /* for the CRC, never sent */
    double lsb;       /* resolution of the value, in its unit */
    uint32_t steps_per_unit; /* 1/lsb, exactly */
    int32_t raw_maximum;     /* the range is -raw_maximum..raw_maximum */
    uint8_t mode_shift; /* where mode and fault state are in byte 1; 0: not in this frame */
    uint8_t fault_state_shift;
    uint8_t verdict_bits; /* below the value; 0: not in this frame */
};

extern const struct frame frame_reference;
extern const struct frame frame_feedback;
extern const struct frame frame_command_1;
extern const struct frame frame_command_2;
extern const struct frame frame_status;
//: if hears
extern const struct frame frame_speed;
//: end

/* Write value and tick into a frame that is all zero. */
void frame_pack(const struct frame *frame, real value, uint16_t tick, uint8_t data[8]);

/* The value of a frame, in its unit; NAN for a raw value outside the range. */
real frame_value(const struct frame *frame, const uint8_t data[8]);

/* The tick of a frame. */
uint16_t frame_tick(const uint8_t data[8]);

#endif
