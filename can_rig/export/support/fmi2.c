/* FMI 2.0 for co-simulation. */
#include <stdlib.h>

#include "fmu.h"

enum { CO_SIMULATION = 1 };

struct callbacks {
    void (*log)(void);
    void *(*allocate)(size_t n, size_t bytes);
    void (*release)(void *memory);
    void (*finished)(void *environment, int status);
    void *environment;
};

static void say(const struct caller *caller, const char *message)
{
    typedef void hears(void *, const char *, int, const char *, const char *, ...);

    if (caller->log != NULL) {
        ((hears *)caller->log)(caller->environment, "{model}", FMI_ERROR, "logStatusError",
                               message);
    }
}

EXPORT const char *fmi2GetVersion(void)
{
    return "2.0";
}

EXPORT const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

EXPORT void *fmi2Instantiate(const char *name, int type, const char *token, const char *resources,
                             const struct callbacks *functions, int visible, int logging)
{
    const struct caller caller = {functions->environment, functions->log, say};

    (void)name, (void)resources, (void)visible, (void)logging;
    return type == CO_SIMULATION ? fmu_new(&caller, token) : NULL;
}

EXPORT void fmi2FreeInstance(void *instance)
{
    free(instance);
}

EXPORT int fmi2SetupExperiment(void *instance, int tolerance_defined, double tolerance,
                               double start_time, int stop_defined, double stop_time)
{
    (void)tolerance_defined, (void)tolerance;
    return fmu_start_at(instance, start_time, stop_defined != 0, stop_time);
}

EXPORT int fmi2ExitInitializationMode(void *instance)
{
    return fmu_begin(instance);
}

EXPORT int fmi2Terminate(void *instance)
{
    return fmu_end(instance);
}

EXPORT int fmi2Reset(void *instance)
{
    return fmu_reset(instance);
}

EXPORT int fmi2DoStep(void *instance, double point, double step, int no_set_state)
{
    (void)no_set_state;
    return fmu_step(instance, point, step);
}

EXPORT int fmi2GetReal(void *instance, const uint32_t references[], size_t n, double values[])
{
    return fmu_get_reals(instance, references, n, values);
}

EXPORT int fmi2SetReal(void *instance, const uint32_t references[], size_t n,
                       const double values[])
{
    return fmu_set_reals(instance, references, n, values);
}

EXPORT int fmi2GetInteger(void *instance, const uint32_t references[], size_t n, int32_t values[])
{
    return fmu_get_wholes(instance, references, n, values);
}

EXPORT int fmi2SetInteger(void *instance, const uint32_t references[], size_t n,
                          const int32_t values[])
{
    return fmu_set_wholes(instance, references, n, values);
}

ANSWERS(fmi2SetDebugLogging, FMI_OK)
ANSWERS(fmi2EnterInitializationMode, FMI_OK)
{refused_2}
