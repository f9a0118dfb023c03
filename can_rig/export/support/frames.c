#include "frames.h"

static int32_t to_raw(const struct frame *frame, double value)
{
    const double minimum = frame->raw_minimum * frame->lsb;
    const double maximum = frame->raw_maximum * frame->lsb;

    if (minimum < value && value < maximum) {
        return (int32_t)rint(value / frame->lsb);
    }
    if (value >= maximum) {
        return frame->raw_maximum;
    }
    return value <= minimum ? frame->raw_minimum : FRAMES_NOT_AVAILABLE;
}

void frame_pack(const struct frame *frame, double value, uint16_t tick, uint8_t data[8])
{
    const uint32_t raw = (uint32_t)to_raw(frame, value);

    data[2] = (uint8_t)(tick & 0xFFu);
    data[3] = (uint8_t)(tick >> 8);
    for (uint32_t i = 0; i < 4u; i++) {
        data[4u + i] = (uint8_t)((raw >> (8u * i)) & 0xFFu);
    }
}

double frame_value(const struct frame *frame, const uint8_t data[8])
{
    uint32_t bits = 0;

    for (int i = 3; i >= 0; i--) {
        bits = bits << 8 | data[4 + i];
    }
    const int64_t raw = bits < 0x80000000u ? (int64_t)bits : (int64_t)bits - INT64_C(4294967296);

    return raw >= frame->raw_minimum && raw <= frame->raw_maximum ? (double)raw * frame->lsb
                                                                  : (double)NAN;
}

uint16_t frame_tick(const uint8_t data[8])
{
    return (uint16_t)(data[2] | data[3] << 8);
}
