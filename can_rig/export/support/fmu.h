/* What FMI 2.0 and FMI 3.0 share: an instance with its variables, and the model's functions.
 *
 * Value references count real numbers first, then whole numbers. No headers of the standard are
 * necessary: functions have their names and arguments.
 */
#ifndef FMU_H
#define FMU_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

//: if car
#include "car.h"
//: else
//: if node
#include "bus_node.h"
//: else
#include "firmware.h"
//: end
//: end

#define EXPORT __attribute__((visibility("default")))

enum { FMI_OK = 0, FMI_ERROR = 3 };
enum { {references} };
enum { FIRST_OUTPUT = {first_output}, REALS = {reals}, FIRST_WHOLE_OUTPUT = {parameters}, VALUES = {values} };

/* Who imports the FMU, and hears its messages: `say` calls `log` in the way of a version. */
struct caller {
    void *environment;
    void (*log)(void);
    void (*say)(const struct caller *caller, const char *message);
};

struct instance {
    struct caller caller;
    bool has_begun, stops;
    double stop_s;
    double reals[REALS];
    int32_t wholes[VALUES - REALS + 1];
//: if car
    struct car car;
//: else
//: if node
    struct bus_node node;
//: else
//: if blends
    struct firmware_memory memory;
//: else
    struct layout_state memory;
//: end
//: end
//: end
};

/* Of the model: whether it works on this machine, the start values of all variables, the outputs
 * at the end of the initialisation, and a tick. `first`: the tick begins a communication step. */
bool model_works(struct instance *self);
void model_start(struct instance *self);
void model_begin(struct instance *self);
void model_tick(struct instance *self, bool first);

struct instance *fmu_new(const struct caller *caller, const char *token);
int fmu_refuse(const struct instance *self, const char *message);
int fmu_reset(struct instance *self);
int fmu_start_at(struct instance *self, double start_s, bool stops, double stop_s);
int fmu_begin(struct instance *self);
int fmu_end(struct instance *self);
int fmu_step(struct instance *self, double point_s, double step_s);
int fmu_get_reals(const struct instance *self, const uint32_t references[], size_t n,
                  double values[]);
int fmu_set_reals(struct instance *self, const uint32_t references[], size_t n,
                  const double values[]);
int fmu_get_wholes(const struct instance *self, const uint32_t references[], size_t n,
                   int32_t values[]);
int fmu_set_wholes(struct instance *self, const uint32_t references[], size_t n,
                   const int32_t values[]);

/* A function that needs what the FMU lacks, or has no effect: further arguments of a caller are
 * left alone. */
#define ANSWERS(name, status)       \
    EXPORT int name(void *instance) \
    {                               \
        (void)instance;             \
        return status;              \
    }

#endif
