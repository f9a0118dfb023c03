/* The drivers of the examples, with recorded frames in the place of a bus. */
#include "driver.h"

#include <string.h>

#include "host.h"

#define LAST_US 1000u /* go on so long after the last frame */

static int received;
static int sent;
static struct driver_frame next;
static bool is_over;
volatile uint32_t driver_now_us;

void driver_start(void)
{
    received = host_open_to_read("received");
    sent = host_open_to_write("sent");
    is_over = !host_read(received, &next, sizeof next);
}

bool driver_step(void)
{
    driver_now_us += DRIVER_STEP_US;
    return !is_over || driver_now_us < next.at_us + LAST_US;
}

bool driver_receive(struct driver_frame *frame)
{
    if (is_over || next.at_us > driver_now_us) {
        return false;
    }
    *frame = next;
    is_over = !host_read(received, &next, sizeof next);
    return true;
}

void driver_send(uint32_t id, uint8_t length, const uint8_t *data)
{
    struct driver_frame frame = {.at_us = driver_now_us, .id = id, .length = length};

    (void)memcpy(frame.data, data, length);
    (void)host_write(sent, &frame, sizeof frame);
}
