#include "frames.h"

#include "rounding.h"

#define NOT_AVAILABLE 0x80000000u /* the lowest number of 32 bits, and of fewer at their top */

static uint32_t to_word(const struct frame *frame, int32_t raw)
{
    return (uint32_t)raw << frame->verdict_bits;
}

/* The value as it is sent, above the verdict. */
static uint32_t value_word(const struct frame *frame, double value)
{
    const double minimum = frame->raw_minimum * frame->lsb;
    const double maximum = frame->raw_maximum * frame->lsb;

    if (minimum < value && value < maximum) {
        return to_word(frame, (int32_t)rint(value / frame->lsb));
    }
    if (value >= maximum) {
        return to_word(frame, frame->raw_maximum);
    }
    return value <= minimum ? to_word(frame, frame->raw_minimum) : NOT_AVAILABLE;
}

void frame_pack(const struct frame *frame, double value, uint16_t tick, uint8_t data[8])
{
    const uint32_t word = value_word(frame, value);

    data[2] = (uint8_t)(tick & 0xFFu);
    data[3] = (uint8_t)(tick >> 8);
    for (uint32_t i = 0; i < 4u; i++) {
        data[4u + i] = (uint8_t)((word >> (8u * i)) & 0xFFu);
    }
}

double frame_value(const struct frame *frame, const uint8_t data[8])
{
    uint32_t bits = 0;

    for (int i = 3; i >= 0; i--) {
        bits = bits << 8 | data[4 + i];
    }
    bits &= UINT32_MAX << frame->verdict_bits; /* so that the division leaves nothing */
    const int64_t word = bits < 0x80000000u ? (int64_t)bits : (int64_t)bits - INT64_C(4294967296);
    const int64_t raw = word / (INT64_C(1) << frame->verdict_bits);

    return raw >= frame->raw_minimum && raw <= frame->raw_maximum ? (double)raw * frame->lsb
                                                                  : (double)NAN;
}

uint16_t frame_tick(const uint8_t data[8])
{
    return (uint16_t)(data[2] | data[3] << 8);
}
