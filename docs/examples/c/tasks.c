/* The controller node as preemptive tasks of a Cortex-M, scheduled by its interrupts: SysTick puts
 * received frames into a ring, PendSV is the control task, main the background task. With FreeRTOS:
 * a queue (xQueueSendFromISR), and a task that waits for the queue as long as DRIVER_STEP_US.
 */
#include "driver.h"
#include "ecu.h"
#include "host.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define RING 16u

static volatile struct driver_frame ring[RING];
static volatile uint32_t written, taken;
static volatile bool running = true;
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

void sys_tick(void) /* interrupts the control task too */
{
    running = driver_step();
    while (written - taken < RING && driver_receive((struct driver_frame *)&ring[written % RING])) {
        written++;
    }
    REGISTER(0xE000ED04u) = 1u << 28; /* ICSR: the control task is ready */
}

void pend_sv(void)
{
    const uint32_t now_us = driver_now_us; /* all frames until then are in the ring */

    for (; taken != written; taken++) {
        const struct driver_frame frame = ring[taken % RING];

        catch_up(frame.at_us);
        if (ecu_on_frame(&ecu, frame.id, frame.length, frame.data, frame.at_us)) {
            ecu_on_tick(&ecu);
        }
    }
    catch_up(now_us);
}

int main(void)
{
    driver_start();
    if (ecu_init(&ecu)) { /* else the self-test failed: the node stays silent */
        REGISTER(0xE000ED20u) = 0x00E00000u; /* SHPR3: PendSV below SysTick */
        REGISTER(0xE000E014u) = 2499u;       /* SYST_RVR: every 100 us at 25 MHz */
        REGISTER(0xE000E010u) = 7u;          /* SYST_CSR */
        while (running) { /* in a car: feed the watchdog while ecu.alive goes on */
        }
    }
    host_exit();
    return 0;
}
