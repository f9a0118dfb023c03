/* The controller of scenario {scenario} as an FMU of FMI 3.0 for co-simulation.
 *
 * A communication step is {tick}, or a multiple with the inputs held. The functions have the
 * names and arguments of the standard's headers, which these files do not need.
 */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "self_test.h"

#define EXPORT __attribute__((visibility("default")))
#define FMI_OK 0
#define FMI_ERROR 3

static const double tick_s = {tick_s};
static const char token[] = "{token}";

/* Value references of the model description. */
enum { TIME, REFERENCE, MEASUREMENT, SPEED, COMMAND_1, COMMAND_2, FAULT_ESTIMATE, REALS };
enum { MODE = REALS, FAULT_STATE, VERDICT, VALUES };

struct instance {
//: if blends
    struct firmware_memory memory;
//: else
    struct layout_state memory;
//: end
    double reals[REALS];
    int32_t codes[VALUES - REALS];
};

static void start(struct instance *self)
{
    (void)memset(self, 0, sizeof *self);
    self->reals[SPEED] = NAN;
    firmware_init(&self->memory);
    firmware_reset(&self->memory, {zero});
}

static void tick(struct instance *self)
{
//: if blends
    firmware_change_speed(&self->memory, (real)self->reals[SPEED]);
//: end
    const struct firmware_answer answer =
        firmware_step(&self->memory, (real)self->reals[REFERENCE], (real)self->reals[MEASUREMENT]);

    self->reals[COMMAND_1] = (double)answer.command_1;
    self->reals[COMMAND_2] = (double)answer.command_2;
    self->reals[FAULT_ESTIMATE] = (double)answer.fault_estimate;
    self->codes[MODE - REALS] = answer.mode;
    self->codes[FAULT_STATE - REALS] = answer.fault_state;
    self->codes[VERDICT - REALS] = answer.verdict;
}

EXPORT const char *fmi3GetVersion(void)
{
    return "3.0";
}

EXPORT void *fmi3InstantiateCoSimulation(
    const char *name, const char *given_token, const char *resources, bool visible, bool logging,
    bool events, bool early_return, const uint32_t intermediate[], size_t n_intermediate,
    void *environment, void (*log)(void), void (*update)(void))
{
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early_return;
    (void)intermediate, (void)n_intermediate, (void)environment, (void)log, (void)update;
    if (given_token == NULL || strcmp(given_token, token) != 0) {
        return NULL;
    }
    struct instance *const self = malloc(sizeof *self);
    if (self != NULL && !self_test(&self->memory)) {
        free(self);
        return NULL;
    }
    if (self != NULL) {
        start(self);
    }
    return self;
}

EXPORT void *fmi3InstantiateModelExchange(void)
{
    return NULL;
}

EXPORT void *fmi3InstantiateScheduledExecution(void)
{
    return NULL;
}

EXPORT void fmi3FreeInstance(void *instance)
{
    free(instance);
}

EXPORT int fmi3EnterInitializationMode(void *instance, bool tolerance_defined, double tolerance,
                                       double start_time, bool stop_defined, double stop_time)
{
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop_time;
    ((struct instance *)instance)->reals[TIME] = start_time;
    return FMI_OK;
}

EXPORT int fmi3Reset(void *instance)
{
    start(instance);
    return FMI_OK;
}

EXPORT int fmi3DoStep(void *instance, double point, double step, bool no_set_state,
                      bool *event_needed, bool *terminate, bool *early_return, double *reached)
{
    struct instance *const self = instance;
    const double ticks = rint(step / tick_s);

    (void)no_set_state;
    if (!(ticks >= 1.0 && fabs(step / tick_s - ticks) <= 1e-6 * ticks)) {
        return FMI_ERROR;
    }
    for (double done = 0.0; done < ticks; done += 1.0) {
        tick(self);
    }
    self->reals[TIME] = point + step;
    *event_needed = *terminate = *early_return = false;
    *reached = self->reals[TIME];
    return FMI_OK;
}

EXPORT int fmi3GetFloat64(void *instance, const uint32_t references[], size_t n, double values[],
                          size_t n_values)
{
    for (size_t i = 0; i < n; i++) {
        if (references[i] >= REALS || n_values != n) {
            return FMI_ERROR;
        }
        values[i] = ((struct instance *)instance)->reals[references[i]];
    }
    return FMI_OK;
}

EXPORT int fmi3SetFloat64(void *instance, const uint32_t references[], size_t n,
                          const double values[], size_t n_values)
{
    for (size_t i = 0; i < n; i++) {
        if (references[i] < REFERENCE || references[i] > SPEED || n_values != n) {
            return FMI_ERROR;
        }
        ((struct instance *)instance)->reals[references[i]] = values[i];
    }
    return FMI_OK;
}

EXPORT int fmi3GetInt32(void *instance, const uint32_t references[], size_t n, int32_t values[],
                        size_t n_values)
{
    for (size_t i = 0; i < n; i++) {
        if (references[i] < REALS || references[i] >= VALUES || n_values != n) {
            return FMI_ERROR;
        }
        values[i] = ((struct instance *)instance)->codes[references[i] - REALS];
    }
    return FMI_OK;
}

/* Functions without effect here, and functions of what this FMU lacks: further arguments of a
 * caller are left alone. */
#define ANSWERS(name, status)     \
    EXPORT int name(void *instance) \
    {                             \
        (void)instance;           \
        return status;            \
    }
ANSWERS(fmi3SetDebugLogging, FMI_OK)
ANSWERS(fmi3ExitInitializationMode, FMI_OK)
ANSWERS(fmi3Terminate, FMI_OK)
{refused}
