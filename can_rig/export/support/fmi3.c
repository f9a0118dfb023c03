/* FMI 3.0 for co-simulation. */
#include <stdlib.h>

#include "fmu.h"

static void say(const struct caller *caller, const char *message)
{
    typedef void hears(void *, int, const char *, const char *);

    if (caller->log != NULL) {
        ((hears *)caller->log)(caller->environment, FMI_ERROR, "logStatusError", message);
    }
}

EXPORT const char *fmi3GetVersion(void)
{
    return "3.0";
}

EXPORT void *fmi3InstantiateCoSimulation(
    const char *name, const char *token, const char *resources, bool visible, bool logging,
    bool events, bool early_return, const uint32_t intermediate[], size_t n_intermediate,
    void *environment, void (*log)(void), void (*update)(void))
{
    const struct caller caller = {environment, log, say};

    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early_return;
    (void)intermediate, (void)n_intermediate, (void)update;
//: if node
    if (!events) {
        say(&caller, "eventModeUsed must be true: frames come and go in events");
        return NULL;
    }
//: end
    return fmu_new(&caller, token);
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
    (void)tolerance_defined, (void)tolerance;
    return fmu_start_at(instance, start_time, stop_defined, stop_time);
}

EXPORT int fmi3ExitInitializationMode(void *instance)
{
    return fmu_begin(instance);
}

EXPORT int fmi3Terminate(void *instance)
{
    return fmu_end(instance);
}

EXPORT int fmi3Reset(void *instance)
{
    return fmu_reset(instance);
}

EXPORT int fmi3DoStep(void *instance, double point, double step, bool no_set_state,
                      bool *event_needed, bool *terminate, bool *early_return, double *reached)
{
    const int status = fmu_step(instance, point, step);

    (void)no_set_state;
    *event_needed = *terminate = *early_return = false;
//: if node
    *event_needed = ((struct instance *)instance)->node.waiting > 0;
//: end
    *reached = ((struct instance *)instance)->reals[TIME];
    return status;
}

EXPORT int fmi3GetFloat64(void *instance, const uint32_t references[], size_t n, double values[],
                          size_t n_values)
{
    return n == n_values ? fmu_get_reals(instance, references, n, values) : FMI_ERROR;
}

EXPORT int fmi3SetFloat64(void *instance, const uint32_t references[], size_t n,
                          const double values[], size_t n_values)
{
    return n == n_values ? fmu_set_reals(instance, references, n, values) : FMI_ERROR;
}

EXPORT int fmi3GetInt32(void *instance, const uint32_t references[], size_t n, int32_t values[],
                        size_t n_values)
{
    return n == n_values ? fmu_get_wholes(instance, references, n, values) : FMI_ERROR;
}

EXPORT int fmi3SetInt32(void *instance, const uint32_t references[], size_t n,
                        const int32_t values[], size_t n_values)
{
    return n == n_values ? fmu_set_wholes(instance, references, n, values) : FMI_ERROR;
}

ANSWERS(fmi3SetDebugLogging, FMI_OK)
{refused_3}
