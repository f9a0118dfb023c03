#include "frames.h"

#include <string.h>

#include "rounding.h"
//: if steps

#define SIGN (({word})1 << (8u * sizeof({word}) - 1u))

real frame_value(const struct frame *frame, {word} steps)
{
    const bool negative = (steps & SIGN) != 0u;
    const {word} size = negative ? 0u - steps : steps;

    if (size > (negative ? frame->lowest : frame->highest)) {
        return (real)NAN;
    }
    const double value = (double)size * frame->lsb;

    return (real)(negative ? -value : value);
}
//: end
//: if counts

/* As many steps, within the range, as a two's complement. */
static {word} within(const struct frame *frame, uint64_t size, bool negative)
{
    const {word} most = negative ? frame->lowest : frame->highest;
    const {word} steps = size < most ? ({word})size : most;

    return negative ? 0u - steps : steps;
}
//: end
//: if divides

{word} frame_steps(const struct frame *frame, real value)
{
    const bool negative = value < {zero};
    const double most = (double)(negative ? frame->lowest : frame->highest);
    const double size = fabs((double)value);

    if (isnan(value) != 0) {
        return frame->not_available;
    }
    return within(frame, size < most * frame->lsb ? (uint64_t)rint(size / frame->lsb) : UINT64_MAX,
                  negative);
}
//: end
//: if whole

#define MANTISSA_BITS 23u
#define UNIT_EXPONENT 150u /* of a float whose last bit is worth 1 */

/* A number of steps that are parts of 2^shift, rounded to even. */
static uint64_t rounded(uint64_t parts, uint32_t shift)
{
    const uint64_t whole = parts >> shift;
    const uint64_t twice_the_rest = (parts & ((UINT64_C(1) << shift) - 1u)) << 1;
    const uint64_t one = UINT64_C(1) << shift;

    return twice_the_rest > one || (twice_the_rest == one && (whole & 1u) != 0u) ? whole + 1u
                                                                                : whole;
}

{word} frame_whole_steps(const struct frame *frame, real value)
{
    uint32_t bits;

    if (isnan(value) != 0) {
        return frame->not_available;
    }
    (void)memcpy((uint8_t *)&bits, (const uint8_t *)&value, sizeof bits);
    const uint32_t exponent = bits >> MANTISSA_BITS & 0xFFu;
    const uint32_t hidden = exponent > 0u ? 1u << MANTISSA_BITS : 0u;
    const uint32_t mantissa = (bits & 0x7FFFFFu) | hidden;
    const uint64_t parts = (uint64_t)mantissa * frame->steps_per_unit;
    uint64_t size = UINT64_MAX; /* from 2^24 units on, more than any frame holds, or infinite */

    if (exponent <= UNIT_EXPONENT) {
        const uint32_t shift = UNIT_EXPONENT - exponent;

        size = shift > 63u ? 0u : rounded(parts, shift);
    }
    return within(frame, size, bits >> 31 != 0u);
}
//: end
