/* The frames of a tick: the conversion between their content and their bytes.
 *
 * network.c has the frames, from the DBC: where each signal lies, its steps and its range. A value
 * out of range saturates; not-a-number is sent as a raw value outside the range.
 */
#ifndef FRAMES_H
#define FRAMES_H

#include <stdbool.h>
#include <stdint.h>

#include "real.h"

#ifdef __cplusplus
extern "C" {
#endif

#define FRAME_BYTES {frame_bytes}u /* the most that a frame has */
//: if extended
#define FRAME_EXTENDED 0x80000000u /* in an identifier of 29 bits */
//: end
//: if fd
#define FRAME_FD 0x40000000u /* in the identifier of a frame of CAN FD */
//: end

/* The content of a frame. */
struct frame_content {
    real value; /* in its unit; NAN: none */
    uint32_t tick;
    uint32_t mode; /* of a further sensor: whether the sample is valid */
    uint32_t fault_state;
    uint32_t verdict; /* of a further sensor: the tick of the sample */
};

/* What the DBC says of a frame. */
struct frame {
    uint32_t id;      /* CAN identifier, with its flags if any */
    uint16_t data_id; /* for the CRC, never sent; 0: the frame is not protected */
    uint8_t bytes;
//: if steps
    double lsb; /* resolution of the value, in its unit */
    {word} lowest;   /* the range is -lowest..highest, in steps */
    {word} highest;
    {word} not_available; /* steps that stand for not-a-number */
//: end
//: if whole
    uint32_t steps_per_unit; /* 1/lsb, exactly */
//: end
//: if floats
    double most; /* of a floating-point number: the range is -most..most */
//: end
    /* Write the content into a frame that is all zero; of a frame that is sent. */
    void (*pack)(const struct frame *frame, const struct frame_content *content, uint8_t *data);
    /* Read the content, except what the frame does not have; of a frame that is received. */
    void (*unpack)(const struct frame *frame, const uint8_t *data, struct frame_content *content);
};

extern const struct frame frame_reference;
extern const struct frame frame_feedback;
extern const struct frame frame_command_1;
extern const struct frame frame_command_2;
extern const struct frame frame_status;
//: if hears
extern const struct frame frame_speed;
//: end

//: if steps
/* A value from its steps, a two's complement; NAN for steps outside the range. */
real frame_value(const struct frame *frame, {word} steps);

//: end
//: if divides
/* The steps of a value, a two's complement. */
{word} frame_steps(const struct frame *frame, real value);

//: end
//: if whole
/* The same where steps_per_unit has a number, without arithmetic in double. */
{word} frame_whole_steps(const struct frame *frame, real value);

//: end
#ifdef __cplusplus
}
#endif

#endif
