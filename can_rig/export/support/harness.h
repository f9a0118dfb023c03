/* The controller node for a test bench: one received frame in, the frames that answer it out. */
#ifndef HARNESS_H
#define HARNESS_H

#include <stddef.h>

#include "ecu.h"

#define HARNESS_FRAME_BYTES (5u + FRAME_BYTES) /* identifier, low byte first; length; data */
#define HARNESS_MOST_FRAMES 3
/* The frames that a node receives: reference, feedback, speed and those of further sensors. */
//: if hears
#define HARNESS_ALWAYS 3u
//: else
#define HARNESS_ALWAYS 2u
//: end
//: if sensors
#define HARNESS_RECEIVERS (HARNESS_ALWAYS + ECU_SENSORS)
//: else
#define HARNESS_RECEIVERS HARNESS_ALWAYS
//: end
#define HARNESS_COUNTS (HARNESS_RECEIVERS * E2E_STATUSES)

/* Bytes that a node needs. */
size_t harness_size(void);

/* Restart the node, as after power-up, with its saved state or from nothing; whether it is fit. */
bool harness_restart(struct ecu *ecu, bool state_survives);

/* Hand a node a frame, and let it answer the tick that this completes.
 *
 * sent: room for HARNESS_MOST_FRAMES frames.
 * Returns how many frames it has sent.
 */
uint8_t harness_frame(struct ecu *ecu, uint32_t id, uint8_t length, const uint8_t *data,
                      uint8_t *sent);

/* Let it be 'now_us', for the frames that follow too, and a node miss a feedback that is overdue.
 *
 * In lockstep nobody calls it, and time stands still. 'sent' and what it returns: as above.
 */
uint8_t harness_time(struct ecu *ecu, uint32_t now_us, uint8_t *sent);

/* HARNESS_RECEIVERS, for who has only the library. */
uint8_t harness_receivers(void);

/* How many frames of each receiver, one after the other, had each e2e_status. */
void harness_counts(const struct ecu *ecu, uint32_t counts[HARNESS_COUNTS]);

#endif
