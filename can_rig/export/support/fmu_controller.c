/* The controller of scenario {scenario}: a communication step is {tick}, or a multiple with the
 * inputs held. */
#include <math.h>
#include <string.h>

#include "fmu.h"
#include "self_test.h"

//: if sensors
enum { SENSORS = {sensors}, FIRST_SAMPLE = {first_sample} };

static const real numbers[SENSORS] = {{numbers}};

static void hear(struct instance *self)
{
    for (uint32_t i = 0; i < SENSORS; i++) {
        const double value = self->reals[FIRST_SAMPLE + 2u * i];
        const double age = self->reals[FIRST_SAMPLE + 2u * i + 1u];

        if (!isnan(value)) {
            firmware_hear(&self->memory, numbers[i], (real)value, isnan(age) ? {zero} : (real)age);
        }
    }
}

//: end
bool model_works(struct instance *self)
{
    return self_test(&self->memory);
}

void model_start(struct instance *self)
{
//: if hears
    self->reals[SPEED_MPS] = {speed_mps};
//: end
//: if sensors
    for (uint32_t i = 0; i < SENSORS; i++) {
        self->reals[FIRST_SAMPLE + 2u * i + 1u] = -1.0;
    }
//: end
    firmware_init(&self->memory);
    firmware_reset(&self->memory, {zero});
}

void model_begin(struct instance *self)
{
    (void)self;
}

void model_tick(struct instance *self, bool first)
{
//: if blends
    firmware_change_speed(&self->memory, (real)self->reals[SPEED_MPS]);
//: end
//: if sensors
    if (first) { /* a sample is new once */
        hear(self);
    }
//: else
    (void)first;
//: end
    const struct firmware_answer answer =
        firmware_step(&self->memory, (real)self->reals[REFERENCE], (real)self->reals[MEASUREMENT]);

    self->reals[COMMAND_1] = (double)answer.command_1;
    self->reals[COMMAND_2] = (double)answer.command_2;
    self->reals[FAULT_ESTIMATE] = (double)answer.fault_estimate;
    self->wholes[MODE - REALS] = answer.mode;
    self->wholes[FAULT_STATE - REALS] = answer.fault_state;
    self->wholes[VERDICT - REALS] = answer.verdict;
}
