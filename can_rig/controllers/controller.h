/* A controller as a C shared library: controller.kind = "c:FILE.so" of a scenario.
 *
 *     cc -shared -fPIC -O2 -o pi.so pi.c
 *
 * Every function must be there. A run calls them from one thread.
 */
#ifndef CONTROLLER_H
#define CONTROLLER_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What a tick brings. A value that has not come is NaN. */
struct controller_inputs {
    double reference;                 /* the wanted output, in the unit of the measurement */
    double measurement;               /* D* of a car, m/s^2 */
    double speed_mps;                 /* where the scenario has a drive */
    const char *const *witness_names; /* further sensors; the names stay from tick to tick */
    const double *witnesses;
    uint32_t witness_count;
};

/* The answer. Before each step, the last four have the values "not said": NaN and -1. */
struct controller_answer {
    double command_1;      /* torque of the steering motor of a car, N m */
    double command_2;      /* difference of the rear driving forces of a car, N */
    double fault_estimate; /* what the fault takes from the output */
    int32_t mode;          /* 0 STANDBY, 1 RUN, 2 BLIND, 3 SAFE_STOP */
    int32_t fault_state;   /* 0 CLEAR, 1 SUSPECTED, 2 CONFIRMED, 3 CANNOT_TELL */
    int32_t verdict;       /* 0 to 13, as Verdict of the DBC */
};

/* The version of this interface: 1. */
int controller_abi(void);

/* A controller at rest, with the numbers of [controller.parameters]; NULL refuses them. */
void *controller_new(double tick_s, uint32_t count, const char *const *names, const double *values);

/* The steady state that holds the output at reference. */
void controller_reset(void *controller, double reference);

/* One tick; any other answer than 0 ends the run. A tick without reference or measurement has no
 * step: the last commands are held. */
int controller_step(void *controller, const struct controller_inputs *inputs,
                    struct controller_answer *answer);

void controller_free(void *controller);

#ifdef __cplusplus
}
#endif

#endif
