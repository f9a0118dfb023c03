/* The whole node for Frama-C's Eva: any frames for ever, at any time. */
#include "__fc_builtin.h"
#include "ecu.h"
#include "self_test.h"

static struct ecu ecu;

/* The self-test computes on its own data alone. */
//: if blends
bool self_test(struct firmware_memory *memory)
//: else
bool self_test(struct layout_state *memory)
//: end
{
    (void)memory;
    return true;
}

/* Eva does not know rint: it is one of the integers around its argument. */
double rint(double x)
{
    return Frama_C_nondet(0, 1) ? floor(x) : ceil(x);
}

float rintf(float x)
{
    return Frama_C_nondet(0, 1) ? floorf(x) : ceilf(x);
}

void ecu_send(const struct ecu *sender, uint32_t id, uint8_t length, const uint8_t *data)
{
    (void)sender;
    (void)id;
    (void)length;
    (void)data;
}

int main(void)
{
    uint8_t data[FRAME_BYTES];

    (void)ecu_init(&ecu);
    while (Frama_C_nondet(0, 1)) {
        const uint32_t id = Frama_C_unsigned_int_interval(0, UINT32_MAX);
        const uint8_t length = (uint8_t)Frama_C_interval(0, FRAME_BYTES);
        const uint32_t now_us = Frama_C_unsigned_int_interval(0, UINT32_MAX);

        Frama_C_make_unknown((char *)data, sizeof data);
        if (ecu_on_frame(&ecu, id, length, data, now_us) || ecu_is_overdue(&ecu, now_us)) {
            ecu_on_tick(&ecu);
        }
    }
    return 0;
}
