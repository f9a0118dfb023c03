/* The controller node in a super-loop: one endless loop polls the CAN controller and the clock. */
#include "driver.h"
#include "ecu.h"
#include "host.h"

static struct ecu ecu;

void ecu_send(const struct ecu *sender, uint32_t id, uint8_t length, const uint8_t *data)
{
    (void)sender;
    driver_send((uint16_t)id, length, data);
}

int main(void)
{
    struct driver_frame frame;

    driver_start();
    if (!ecu_init(&ecu)) {
        host_exit(); /* the self-test failed: the node stays silent */
    }
    while (driver_step()) { /* on a target: for (;;) */
        while (driver_receive(&frame)) {
            if (ecu_on_frame(&ecu, frame.id, frame.length, frame.data, frame.at_us)) {
                ecu_on_tick(&ecu);
            }
        }
        while (ecu_is_overdue(&ecu, driver_now_us)) {
            ecu_on_tick(&ecu);
        }
    }
    host_exit();
    return 0;
}
