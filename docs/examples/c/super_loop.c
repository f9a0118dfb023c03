/* The controller node in a super-loop: one endless loop polls the CAN controller and the clock. */
#include "driver.h"
#include "ecu.h"
#include "host.h"

static struct ecu ecu;

void ecu_send(const struct ecu *sender, uint32_t id, uint8_t length, const uint8_t *data)
{
    (void)sender;
    driver_send(id, length, data);
}

static void catch_up(uint32_t now_us)
{
    while (ecu_is_overdue(&ecu, now_us)) {
        ecu_on_tick(&ecu);
    }
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
            catch_up(frame.at_us); /* else the node would refuse a frame of the next tick */
            if (ecu_on_frame(&ecu, frame.id, frame.length, frame.data, frame.at_us)) {
                ecu_on_tick(&ecu);
            }
        }
        catch_up(driver_now_us);
    }
    host_exit();
    return 0;
}
