//: if blends
/* How many instructions each tick takes: reference, measurement and speed of the car from a file,
//: else
/* How many instructions each tick takes: reference and measurement from a file,
//: end
 * counts to another.
//: if node
 * They are in frames: the whole node is counted, without the driver.
//: end
 *
 * The emulator gives every instruction 64 ns and SysTick counts 40 ns, so a count times 40/64 is
 * exact to an instruction.
 */
//: if node
#include "ecu.h"
//: else
#include "firmware.h"
//: end
#include "host.h"

#define SYST_CSR (*(volatile uint32_t *)0xE000E010u)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014u)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018u)
#define LARGEST 0xFFFFFFu

#define MOST_TICKS 65536

//: if node
static const struct frame *const senders[] = {
    &frame_reference,
    &frame_feedback,
//: if blends
    &frame_speed,
//: end
};

#define SENDERS (sizeof senders / sizeof senders[0])

static uint8_t inputs[MOST_TICKS * 8u / FRAME_BYTES][SENDERS][FRAME_BYTES];
//: else
//: if blends
static double inputs[MOST_TICKS][3];
//: else
static double inputs[MOST_TICKS][2];
//: end
//: end
static uint32_t counts[MOST_TICKS];
//: if node

static struct ecu node;

void ecu_send(const struct ecu *ecu, uint32_t id, uint8_t length, const uint8_t *data)
{
    (void)ecu;
    (void)id;
    (void)length;
    (void)data;
}

static void begin(void)
{
    (void)ecu_init(&node);
}

static bool take(uint32_t tick, uint32_t sender)
{
    const struct frame *const frame = senders[sender];

    return ecu_on_frame(&node, frame->id, frame->bytes, inputs[tick][sender], 0);
}

static void work(uint32_t tick)
{
//: if blends
    (void)take(tick, 2);
//: end
    (void)take(tick, 0);
    if (take(tick, 1)) {
        ecu_on_tick(&node);
    }
}
//: else
//: if blends
static struct firmware_memory state;
//: else
static struct layout_state state;
//: end

static void begin(void)
{
    firmware_init(&state);
    firmware_reset(&state, {zero});
}

static void work(uint32_t tick)
{
//: if blends
    firmware_change_speed(&state, (real)inputs[tick][2]);
//: end
    (void)firmware_step(&state, (real)inputs[tick][0], (real)inputs[tick][1]);
}
//: end

int main(void)
{
    const int from = host_open_to_read("inputs");
    const int to = host_open_to_write("counts");
    uint32_t ticks = 0;

    (void)host_read(from, &ticks, sizeof ticks);
    (void)host_read(from, inputs, ticks * sizeof inputs[0]);
    begin();
    SYST_RVR = LARGEST;
    SYST_CSR = 5; /* the processor's clock, no interrupt */
    for (uint32_t i = 0; i < ticks; i++) {
        SYST_CVR = 0; /* starts again from the largest */
        const uint32_t before = SYST_CVR;
        work(i);
        counts[i] = (before - SYST_CVR) & LARGEST;
    }
    (void)host_write(to, counts, ticks * sizeof counts[0]);
    host_exit();
    return 0;
}
