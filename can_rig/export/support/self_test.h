/* The known-answer test of the controller: whether this program, as its compiler made it and as it
 * lies in memory, computes what the control law in Python computes.
 *
 * A CRC-32 (IEEE 802.3) guards the constants. Then the law answers the stored ticks, and another
 * CRC-32 over all answers, and over the whole state after each part, must be that of Python. All
 * not-a-numbers count as equal: their bits depend on the processor. Byte order and padding of a
 * processor are no difference.
 */
#ifndef SELF_TEST_H
#define SELF_TEST_H

#include "firmware.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Whether the test succeeds; false: the controller must not run.
 *
 * memory: any, for the time of the test; firmware_init must follow.
 */
//: if blends
bool self_test(struct firmware_memory *memory);
//: else
bool self_test(struct layout_state *memory);
//: end

/* The inputs of a stored tick. */
struct self_test_tick {
    real reference;
    real measurement;
//: if blends
    real speed;
//: end
};

/* A part of the stored ticks. */
struct self_test_part {
    uint16_t ticks;
    bool is_reset; /* begins with firmware_reset to its first reference; else with firmware_init */
};

/* Numbers of one kind, one after the other in a struct. */
struct self_test_span {
    uint32_t offset;
    uint16_t count;
    bool is_real; /* else int32_t */
};

/* Python's answers; each list ends with an element whose ticks or count are zero. */
struct self_test_data {
    const struct self_test_tick *ticks;
    const struct self_test_part *parts;
    const struct self_test_span *memory; /* the numbers of what self_test gets */
    const struct self_test_span *table;
//: if blends
    const struct self_test_span *schedule;
//: end
    uint32_t crc_of_constants;
    uint32_t fingerprint; /* of the constants and of the layout of a saved state */
    uint32_t crc_of_answers;
};

extern const struct self_test_data self_test_data;

#ifdef __cplusplus
}
#endif

#endif
