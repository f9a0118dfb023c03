/* The law on any memory: table and state come from a bench, and each state goes back to it. It takes
 * the place of bench.c. An order is a letter:
 *
 *     'M', table, state   there is no answer
 *     'I'                 start up, from a state that is all zero; the state
 *     'E', sensor, value, age       there is no answer
 *     'Z', reference      reset; the state
 *     'S', reference, measurement   step; the state
//: if blends
 *     'B', schedule, blending       there is no answer
 *     'V', speed                    change of the speed; the state
 *
 * After each state go the table and the blending.
 *
//: else
 *
//: end
 * All as they lie in memory here.
 */
#include <string.h>

#include "bench.h"
#include "controller.h"
#include "further_sensors.h"
#include "layout.h"
//: if blends
#include "schedule.h"
//: end

static struct layout_table table;
static struct layout_state state;
//: if blends
static struct schedule_constants schedule;
static struct schedule_state blending;
//: end

static bool load(void *memory, uint32_t size)
{
    return bench_read(memory, size);
}

static bool obey(uint8_t order)
{
    const uint32_t n = order == 'E' ? 3 : order == 'S' ? 2 : order == 'Z' || order == 'V' ? 1 : 0;
    real inputs[3];

    if (!load(inputs, n * sizeof inputs[0])) {
        return false;
    }
    switch (order) {
    case 'M':
        return load(&table, sizeof table) && load(&state, sizeof state);
    case 'E':
        further_sensors_hear(&table, &state, inputs[0], inputs[1], inputs[2]);
        return true;
    case 'I':
        memset(&state, 0, sizeof state);
        controller_start_up(&table, &state);
        break;
    case 'Z':
        controller_reset(&table, &state, inputs[0]);
        break;
    case 'S':
        controller_step(&table, &state, inputs[0], inputs[1]);
        break;
//: if blends
    case 'B':
        return load(&schedule, sizeof schedule) && load(&blending, sizeof blending);
    case 'V':
        schedule_change_speed(&schedule, &blending, &table, &state, inputs[0]);
        break;
//: end
    default:
        return false;
    }
//: if blends
    return bench_write((const uint8_t *)&state, sizeof state) &&
           bench_write((const uint8_t *)&table, sizeof table) &&
           bench_write((const uint8_t *)&blending, sizeof blending);
//: else
    return bench_write((const uint8_t *)&state, sizeof state);
//: end
}

void bench_run(void)
{
    uint8_t order;

    while (bench_read(&order, 1) && obey(order)) {
    }
}
