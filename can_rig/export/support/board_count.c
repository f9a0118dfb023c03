//: if blends
/* How many instructions each tick takes: reference, measurement and speed of the car from a file,
//: else
/* How many instructions each tick takes: reference and measurement from a file,
//: end
 * counts to another.
 *
 * The emulator gives every instruction 64 ns and SysTick counts 40 ns, so a count times 40/64 is
 * exact to an instruction.
 */
#include "firmware.h"
#include "host.h"

#define SYST_CSR (*(volatile uint32_t *)0xE000E010u)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014u)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018u)
#define LARGEST 0xFFFFFFu

#define MOST_TICKS 65536

//: if blends
static struct firmware_memory state;
static double inputs[MOST_TICKS][3];
//: else
static struct layout_state state;
static double inputs[MOST_TICKS][2];
//: end
static uint32_t counts[MOST_TICKS];

int main(void)
{
    const int from = host_open_to_read("inputs");
    const int to = host_open_to_write("counts");
    uint32_t ticks = 0;

    (void)host_read(from, &ticks, sizeof ticks);
    (void)host_read(from, inputs, ticks * sizeof inputs[0]);
    firmware_init(&state);
    firmware_reset(&state, {zero});
    SYST_RVR = LARGEST;
    SYST_CSR = 5; /* the processor's clock, no interrupt */
    for (uint32_t i = 0; i < ticks; i++) {
        const real reference = (real)inputs[i][0];
        const real measurement = (real)inputs[i][1];

        SYST_CVR = 0; /* starts again from the largest */
        const uint32_t before = SYST_CVR;
//: if blends
        firmware_change_speed(&state, (real)inputs[i][2]);
//: end
        (void)firmware_step(&state, reference, measurement);
        counts[i] = (before - SYST_CVR) & LARGEST;
    }
    (void)host_write(to, counts, ticks * sizeof counts[0]);
    host_exit();
    return 0;
}
