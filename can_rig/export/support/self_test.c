#include "self_test.h"

#include <string.h>

#include "constants.h"
#include "crc.h"

typedef {bits} bits_of_real;

#define SIGN ((bits_of_real)1 << (8u * sizeof(bits_of_real) - 1u))
#define INFINITE ((bits_of_real){infinite}u << {mantissa})

static uint32_t with_byte(uint32_t crc, uint32_t byte)
{
    const uint8_t low = (uint8_t)byte;

    return crc_32(crc, &low, 1u);
}

static uint32_t with_real(uint32_t crc, real x)
{
    bits_of_real bits;

    (void)memcpy((uint8_t *)&bits, (const uint8_t *)&x, sizeof bits);
    if ((bits & ~SIGN) > INFINITE) {
        bits = INFINITE + 1u; /* any not-a-number */
    }
    for (uint32_t i = 0; i < sizeof bits; i++) {
        const uint32_t places = 8u * i;
        const bits_of_real low = bits >> places & (bits_of_real)0xFFu;

        crc = with_byte(crc, (uint32_t)low);
    }
    return crc;
}

static uint32_t with_int(uint32_t crc, int32_t n)
{
    for (uint32_t i = 0; i < sizeof n; i++) {
        crc = with_byte(crc, ((uint32_t)n >> (8u * i)) & 0xFFu);
    }
    return crc;
}

static uint32_t with_struct(uint32_t crc, const uint8_t *bytes, const struct self_test_span *spans)
{
    for (const struct self_test_span *span = spans; span->count > 0u; span++) {
        for (uint32_t i = 0; i < span->count; i++) {
            real x;
            int32_t n;

            if (span->is_real) {
                (void)memcpy((uint8_t *)&x, &bytes[span->offset + i * sizeof x], sizeof x);
                crc = with_real(crc, x);
            } else {
                (void)memcpy((uint8_t *)&n, &bytes[span->offset + i * sizeof n], sizeof n);
                crc = with_int(crc, n);
            }
        }
    }
    return crc;
}

static bool constants_are_whole(void)
{
    uint32_t crc = with_struct(UINT32_MAX, (const uint8_t *)&controller_table, self_test_data.table);

//: if blends
    crc = with_struct(crc, (const uint8_t *)&controller_schedule, self_test_data.schedule);
//: end
    crc = with_int(crc, (int32_t)self_test_data.fingerprint);
    return (crc ^ UINT32_MAX) == self_test_data.crc_of_constants;
}

/* Whether numbers below the least normal one count: a processor may have been told to take them for
 * zero, as by a program that gcc links with -ffast-math.
 */
static bool subnormals_count(void)
{
    const volatile real largest = {MAX};

    return (real)1 / largest > (real)0;
}

//: if sensors
/* Hear samples that Python heard too, of the answer of the tick before. */
//: if blends
static void hear(struct firmware_memory *memory, struct firmware_answer last, real measurement)
//: else
static void hear(struct layout_state *memory, struct firmware_answer last, real measurement)
//: end
{
    firmware_hear(memory, (real)1, last.command_1, (real)0);
    firmware_hear(memory, (real)2, (real)0.5 * last.command_2, (real)1);
    firmware_hear(memory, (real)3, (real)0.0625 * measurement, (real)2);
    firmware_hear(memory, (real)4, measurement, (real)3);
}

//: end
//: if blends
bool self_test(struct firmware_memory *memory)
//: else
bool self_test(struct layout_state *memory)
//: end
{
    const struct self_test_tick *tick = self_test_data.ticks;
    uint32_t crc = UINT32_MAX;

    if (!constants_are_whole() || !subnormals_count()) {
        return false;
    }
    for (const struct self_test_part *part = self_test_data.parts; part->ticks > 0u; part++) {
        if (part->is_reset) {
            firmware_reset(memory, tick->reference);
        } else {
            firmware_init(memory);
        }
//: if sensors
        struct firmware_answer answer = {0};

//: end
        for (uint32_t i = 0; i < part->ticks; i++) {
//: if blends
            firmware_change_speed(memory, tick->speed);
//: end
//: if sensors
            if (i % 5u == 0u) {
                hear(memory, answer, tick->measurement);
            }
            answer = firmware_step(memory, tick->reference, tick->measurement);
//: else
            const struct firmware_answer answer =
                firmware_step(memory, tick->reference, tick->measurement);
//: end

            crc = with_real(crc, answer.command_1);
            crc = with_real(crc, answer.command_2);
            crc = with_real(crc, answer.fault_estimate);
            crc = with_int(crc, answer.mode);
            crc = with_int(crc, answer.fault_state);
            crc = with_int(crc, answer.verdict);
            tick++;
        }
        crc = with_struct(crc, (const uint8_t *)memory, self_test_data.memory);
    }
    return (crc ^ UINT32_MAX) == self_test_data.crc_of_answers;
}
