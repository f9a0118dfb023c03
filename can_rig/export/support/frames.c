#include "frames.h"

//: if single
#include <string.h>

//: end
#include "rounding.h"

#define NOT_AVAILABLE 0x80000000u /* the lowest number of 32 bits, and of fewer at their top */
//: if single
#define MANTISSA_BITS 23u
#define UNIT_EXPONENT 150u /* of a float whose last bit is worth 1 */

/* |value| in steps of the frame, rounded to even; whole numbers need no arithmetic in double. */
static uint64_t steps_of(const struct frame *frame, uint32_t bits)
{
    const uint32_t exponent = bits >> MANTISSA_BITS & 0xFFu;
    const uint32_t hidden = exponent > 0u ? 1u << MANTISSA_BITS : 0u;
    const uint32_t mantissa = (bits & 0x7FFFFFu) | hidden;
    const uint64_t product = (uint64_t)mantissa * frame->steps_per_unit;

    if (exponent > UNIT_EXPONENT) {
        return UINT64_MAX; /* 2^24 units, more than any frame holds, or infinite */
    }
    const uint32_t shift = UNIT_EXPONENT - exponent;

    if (shift == 0u || shift > 63u) {
        return shift == 0u ? product : 0u;
    }
    const uint64_t whole = product >> shift;
    const uint64_t twice_the_rest = (product & ((UINT64_C(1) << shift) - 1u)) << 1;
    const uint64_t one = UINT64_C(1) << shift;

    return twice_the_rest > one || (twice_the_rest == one && (whole & 1u) != 0u) ? whole + 1u
                                                                                : whole;
}

/* The value as it is sent, above the verdict. */
static uint32_t value_word(const struct frame *frame, real value)
{
    const uint64_t largest = (uint64_t)frame->raw_maximum;
    uint32_t bits;

    if (isnan(value) != 0) {
        return NOT_AVAILABLE;
    }
    (void)memcpy((uint8_t *)&bits, (const uint8_t *)&value, sizeof bits);
    const uint64_t steps = steps_of(frame, bits);
    const uint32_t raw = (uint32_t)(steps < largest ? steps : largest);

    return (bits >> 31 != 0u ? 0u - raw : raw) << frame->verdict_bits;
}
//: else

/* The value as it is sent, above the verdict. */
static uint32_t value_word(const struct frame *frame, real value)
{
    const double maximum = frame->raw_maximum * frame->lsb;
    int32_t raw = value > 0.0 ? frame->raw_maximum : -frame->raw_maximum;

    if (isnan(value) != 0) {
        return NOT_AVAILABLE;
    }
    if (fabs(value) < maximum) {
        raw = (int32_t)rint(value / frame->lsb);
    }
    return (uint32_t)raw << frame->verdict_bits;
}
//: end

void frame_pack(const struct frame *frame, real value, uint16_t tick, uint8_t data[8])
{
    const uint32_t word = value_word(frame, value);

    data[2] = (uint8_t)(tick & 0xFFu);
    data[3] = (uint8_t)(tick >> 8);
    for (uint32_t i = 0; i < 4u; i++) {
        data[4u + i] = (uint8_t)((word >> (8u * i)) & 0xFFu);
    }
}

real frame_value(const struct frame *frame, const uint8_t data[8])
{
    uint32_t word = 0;

    for (int i = 3; i >= 0; i--) {
        word = word << 8 | data[4 + i];
    }
    const bool negative = word >> 31 != 0u;
    const uint32_t positive =
        ((negative ? ~word : word) & 0x7FFFFFFFu) >> frame->verdict_bits;
    const int32_t raw = negative ? -(int32_t)positive - 1 : (int32_t)positive;

    return raw >= -frame->raw_maximum && raw <= frame->raw_maximum
               ? (real)((double)raw * frame->lsb)
               : (real)NAN;
}

uint16_t frame_tick(const uint8_t data[8])
{
    return (uint16_t)(data[2] | data[3] << 8);
}
