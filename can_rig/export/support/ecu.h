/* The whole controller node: receive rules, the law, and the frames that answer.
 *
 * An application calls ecu_init once, ecu_on_frame for every data frame that it receives, and
 * ecu_on_tick once a tick: when ecu_on_frame has said that the tick is complete, or while
 * ecu_is_overdue says that its feedback does not come. It provides ecu_send.
 *
 * It asks ecu_is_overdue before each frame, with the time of the frame, and at least every half
 * tick, after all frames that have come: until an overdue tick is computed, the node refuses the
 * frames of the next one.
 *
 * Times are those of any clock of microseconds that goes on and wraps after 2^32.
 * Memory: the struct ecu is the caller's. No function keeps a pointer: 'data' is needed during the
 * call alone, and ecu_send must copy what it sends later.
 * Not for two threads, or a thread and an interrupt, at once with the same struct ecu: an interrupt
 * puts frames and their times into a queue. Two nodes share nothing that changes.
 */
#ifndef ECU_H
#define ECU_H

#include "e2e.h"
#include "firmware.h"
#include "frames.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The receiving end of one frame. */
struct ecu_receiver {
    struct e2e_checker checker;
    bool judged; /* whether the checker has judged a frame of this tick */
};

/* A frame that came before the first contact. */
struct ecu_offer {
    bool there;
    uint8_t length;
    uint8_t data[FRAME_BYTES];
};

//: if sensors
/* What the DBC and the scenario say of a further sensor. */
struct ecu_sensor_frame {
    struct frame frame;
    uint8_t number;
    uint32_t period; /* in ticks, from tick 'phase' on */
    uint32_t phase;
    uint32_t valid;   /* the mode of a valid sample */
    uint32_t largest; /* of the age of a sample in ticks; 0: the frame does not say it */
};

#define ECU_SENSORS {sensors}u
extern const struct ecu_sensor_frame ecu_sensors[ECU_SENSORS];

/* The receiving end of a sample. */
struct ecu_sensor {
    struct ecu_receiver receiver;
    struct ecu_offer first;
    real value; /* of this tick; NAN until one is accepted */
    real age;   /* ticks since its sample */
};

//: end
/* Everything that a controller node remembers. */
struct ecu {
//: if blends
    struct firmware_memory state;
//: else
    struct layout_state state;
//: end
    struct ecu_receiver reference;
    struct ecu_receiver feedback;
    struct e2e_protector command_1;
    struct e2e_protector command_2;
    struct e2e_protector status;
//: if hears
    struct ecu_receiver speed;
    struct ecu_offer first_speed;
//: end
//: if sensors
    struct ecu_sensor sensors[ECU_SENSORS];
    uint32_t ticks; /* the next tick, counted on beyond 16 bits */
//: end
    bool is_fit;          /* whether the self-test succeeded; else the node takes in no frame */
    bool running;         /* whether the first contact has said which tick it is */
    uint16_t tick;        /* the next one, modulo 65536 */
    real wanted;        /* the reference of this tick; NAN until it is accepted */
    real measured;      /* the feedback, likewise */
    uint32_t expected_us; /* when that should come */
    struct ecu_offer first; /* a reference */
    uint8_t flow;    /* stages of this tick that were passed in order */
    uint32_t alive;  /* ticks with all stages in order since power-up, for a watchdog */
    uint32_t stalls; /* standstills of more than ECU_MOST_LATE_TICKS since power-up */
};

/* Longest standstill of the node whose ticks are made up for, one after the other. */
#define ECU_MOST_LATE_TICKS 16u

/* Start, as after power-up; whether the self-test of self_test.h succeeds, and the numbers of the
 * frames are whole. Another node stays silent.
 */
bool ecu_init(struct ecu *ecu);

/* What is known of the car and of lost actuators, for non-volatile memory: see firmware_save. */
void ecu_save(struct ecu *ecu, struct knowledge_saved *saved);

/* Right after ecu_init: begin with what ecu_save has written. False, and no effect, where a bit of
 * 'saved' is wrong, or another controller has written it.
 */
bool ecu_restore(struct ecu *ecu, const struct knowledge_saved *saved);

/* Take in a frame that came at 'now_us'; whether it completes the tick, so that ecu_on_tick is due
 * at once. 'id' is that of a struct frame, and 'data' has 'length' bytes: no length code of CAN FD,
 * and never NULL. A frame of another identifier has no effect; the checkers count the others.
 */
bool ecu_on_frame(struct ecu *ecu, uint32_t id, uint8_t length, const uint8_t *data,
                  uint32_t now_us);

/* Whether the feedback is half a tick late: never before the first contact.
 *
 * After a standstill of more than ECU_MOST_LATE_TICKS the node makes up for nothing: it counts a
 * stall, waits for the next first contact, and takes over a plant that moves, as after power-up but
 * with what it knew.
 */
bool ecu_is_overdue(struct ecu *ecu, uint32_t now_us);

/* Compute a tick and send its answer; inputs that have not come are held. */
void ecu_on_tick(struct ecu *ecu);

/* How long a tick is. */
extern const uint32_t ecu_tick_us;

/* CRC-32 of all numbers of network.c. */
extern const uint32_t ecu_crc_of_frames;

/* Put a frame of a node on its bus: to be provided by the application. 'id' is that
 * of a struct frame. Called by ecu_on_tick alone, three times; it calls no function of this header.
 */
void ecu_send(const struct ecu *ecu, uint32_t id, uint8_t length, const uint8_t *data);

#ifdef __cplusplus
}
#endif

#endif
