#include "fmu.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

static const double tick_s = {tick_s};
static const char right_token[] = "{token}";

struct instance *fmu_new(const struct caller *caller, const char *token)
{
    if (token == NULL || strcmp(token, right_token) != 0) {
        caller->say(caller, "the token must be that of modelDescription.xml: "
                            "the library belongs to another description");
        return NULL;
    }
    struct instance *const self = calloc(1, sizeof *self);
    if (self == NULL) {
        caller->say(caller, "no memory is left");
        return NULL;
    }
    self->caller = *caller;
    if (!model_works(self)) {
        caller->say(caller, "the self-test fails: this machine computes other bits");
        free(self);
        return NULL;
    }
    model_start(self);
    return self;
}

int fmu_refuse(const struct instance *self, const char *message)
{
    self->caller.say(&self->caller, message);
    return FMI_ERROR;
}

int fmu_reset(struct instance *self)
{
    const struct caller caller = self->caller;

    (void)memset(self, 0, sizeof *self);
    self->caller = caller;
    model_start(self);
    return FMI_OK;
}

int fmu_start_at(struct instance *self, double start_s, bool stops, double stop_s)
{
    if (self->has_begun || !(fabs(start_s) <= DBL_MAX)) {
        return fmu_refuse(self, "a start time must be a number, before the initialisation ends");
    }
    self->reals[TIME] = start_s;
    self->stops = stops;
    self->stop_s = stop_s;
    return FMI_OK;
}

int fmu_begin(struct instance *self)
{
    if (self->has_begun) {
        return fmu_refuse(self, "an initialisation must end once");
    }
    self->has_begun = true;
    model_begin(self);
    return FMI_OK;
}

int fmu_end(struct instance *self)
{
    self->has_begun = false;
    return FMI_OK;
}

int fmu_step(struct instance *self, double point_s, double step_s)
{
    const double end_s = point_s + step_s, near_s = tick_s / 2.0;

    if (!self->has_begun) {
        return fmu_refuse(self, "a communication step must be between initialisation and end");
    }
    if (!(fabs(point_s - self->reals[TIME]) < near_s)) {
        return fmu_refuse(self, "a communication step must begin where the one before has ended");
    }
    if (self->stops && end_s > self->stop_s + near_s) {
        return fmu_refuse(self, "a communication step must end by the stop time");
    }
//: if node
    if (!(step_s > 0.0 && step_s <= INT32_MAX * tick_s)) {
        return fmu_refuse(self, "a communication step must be more than 0 s and at most 2147483647 "
                                "ticks of {tick_s} s");
    }
    self->reals[TIME] = end_s;
    model_tick(self, true);
//: else
    const double ticks = rint(step_s / tick_s);
    const bool whole = ticks >= 1.0 && ticks <= INT32_MAX;

    if (!(whole && fabs(step_s / tick_s - ticks) <= 1e-6 * ticks)) {
        return fmu_refuse(self, "a communication step must be 1 to 2147483647 ticks of {tick_s} s");
    }
    for (int32_t done = 0; done < (int32_t) ticks; done++) {
        model_tick(self, done == 0);
    }
    self->reals[TIME] = end_s;
//: end
    return FMI_OK;
}

int fmu_get_reals(const struct instance *self, const uint32_t references[], size_t n,
                  double values[])
{
    for (size_t i = 0; i < n; i++) {
        if (references[i] >= REALS) {
            return fmu_refuse(self, "a value reference must be that of a real number");
        }
        values[i] = self->reals[references[i]];
    }
    return FMI_OK;
}

int fmu_set_reals(struct instance *self, const uint32_t references[], size_t n,
                  const double values[])
{
    for (size_t i = 0; i < n; i++) {
        if (references[i] == TIME || references[i] >= FIRST_OUTPUT) {
            return fmu_refuse(self, "a value reference to set must be that of a real input");
        }
        self->reals[references[i]] = values[i];
    }
    return FMI_OK;
}

int fmu_get_wholes(const struct instance *self, const uint32_t references[], size_t n,
                   int32_t values[])
{
    for (size_t i = 0; i < n; i++) {
        if (references[i] < REALS || references[i] >= VALUES) {
            return fmu_refuse(self, "a value reference must be that of a whole number");
        }
        values[i] = self->wholes[references[i] - REALS];
    }
    return FMI_OK;
}

int fmu_set_wholes(struct instance *self, const uint32_t references[], size_t n,
                   const int32_t values[])
{
    for (size_t i = 0; i < n; i++) {
        if (self->has_begun || references[i] < REALS || references[i] >= FIRST_WHOLE_OUTPUT) {
            return fmu_refuse(self, "a whole number to set must be a parameter, before the start");
        }
//: if car
        if (values[i] < 0 || values[i] > LATENCY) {
            return fmu_refuse(self, "latency_ticks must be 0 to {latency}");
        }
        self->wholes[references[i] - REALS] = values[i];
//: else
        (void)values;
//: end
    }
    return FMI_OK;
}
