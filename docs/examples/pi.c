#include <stdlib.h>
#include <string.h>

#include "controller.h"

struct pi {
    double tick_s, kp, ki, integral;
};

int controller_abi(void)
{
    return 1;
}

void *controller_new(double tick_s, uint32_t count, const char *const *names, const double *values)
{
    struct pi *made = malloc(sizeof *made);
    if (made) {
        *made = (struct pi){tick_s, 20.0, 100.0, 0.0};
        for (uint32_t i = 0; i < count; i++) {
            if (strcmp(names[i], "kp") == 0)
                made->kp = values[i];
            if (strcmp(names[i], "ki") == 0)
                made->ki = values[i];
        }
    }
    return made;
}

void controller_reset(void *controller, double reference)
{
    struct pi *pi = controller;
    (void)reference;
    pi->integral = 0.0;
}

int controller_step(void *controller, const struct controller_inputs *inputs,
                    struct controller_answer *answer)
{
    struct pi *pi = controller;
    const double error = inputs->reference - inputs->measurement;
    pi->integral += pi->ki * pi->tick_s * error;
    answer->command_1 = pi->kp * error + pi->integral;
    answer->command_2 = 0.0;
    return 0;
}

void controller_free(void *controller)
{
    free(controller);
}
