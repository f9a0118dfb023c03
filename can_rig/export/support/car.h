/* The car of scenario {scenario}, with its actuators and its sensors; see car.c. */
#ifndef CAR_H
#define CAR_H

#include <stdint.h>

enum { ORDER = {order}, SENSORS = {sensors}, STATES = {states} };
enum { LATENCY = {latency}, COMMANDS = {commands}, SAMPLES = {samples}, RING = {ring} };
enum { SOME_SENSORS = SENSORS > 0 ? SENSORS : 1, SOME_STATES = STATES > 0 ? STATES : 1 };

struct car {
    int64_t tick;
    double x[ORDER];
    double truth[SOME_SENSORS]; /* readings of the further sensors without errors */
    double read;                /* reading of the sensor of the measurement, without error */
    double held[2], reached[2];
    int64_t silent[2];          /* ticks without a command */
    double on_the_way[LATENCY + 1][2];
    double commands[COMMANDS][2];
    double samples[SAMPLES];
    double ring[RING][SOME_SENSORS];
};

#endif
