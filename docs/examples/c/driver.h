/* The drivers of the examples: a CAN controller and a clock.
 *
 * Recorded frames take the place of a bus: the files "received" and "sent" of the folder that the
 * program, or the emulator of its board, was started in.
 */
#ifndef DRIVER_H
#define DRIVER_H

#include <stdbool.h>
#include <stdint.h>

#include "frames.h"

#ifndef DRIVER_STEP_US
#define DRIVER_STEP_US 100u
#endif

/* A data frame, as the files have it. */
struct driver_frame {
    uint32_t at_us; /* when it was received */
    uint32_t id;    /* with the flags of frames.h, if any */
    uint8_t length;
    uint8_t data[FRAME_BYTES];
};

void driver_start(void);

/* Go on by DRIVER_STEP_US; whether the recording is not over. */
bool driver_step(void);

/* The next frame that has come until now; whether there is one. */
bool driver_receive(struct driver_frame *frame);

void driver_send(uint32_t id, uint8_t length, const uint8_t *data);

extern volatile uint32_t driver_now_us;

#endif
