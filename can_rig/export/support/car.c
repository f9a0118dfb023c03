/* The car of scenario {scenario}: frames of commands, actuators, plant, sensors and their frames.
 *
 * x(k+1) = phi x(k) + gamma u(k - m) + gamma_old u(k - m - 1), exact for held commands. The sums
 * have the order of can-rig's own: the same bits.
 */
#include <math.h>

#include "fmu.h"
#include "rounding.h"

{constants}

/* What arrives of a value in a frame {step, least, most, digits, smallest exponent}. */
static double carried(double value, const double frame[5])
{
    if (isnan(value)) {
        return value;
    }
    double inside = value < frame[1] ? frame[1] : value;
    double step = frame[0];

    inside = inside > frame[2] ? frame[2] : inside;
    if (frame[3] > 0.0) {
        int exponent;

        (void)frexp(inside, &exponent);
        step = ldexp(1.0, (int)(fmax((double)exponent, frame[4]) - frame[3]));
    }
    return step > 0.0 ? rint(inside / step) * step + 0.0 : inside;
}

static double reading(double truth, double error, double resolution)
{
    const double sum = truth + error;

    return resolution > 0.0 ? rint(sum / resolution) * resolution : sum;
}

/* The outputs at the present tick. */
static void measure(struct instance *self)
{
    struct car *const car = &self->car;
    double *const reals = self->reals;
    const int64_t k = car->tick;

    for (int64_t i = 0; i < SENSORS; i++) {
        car->ring[k % RING][i] =
            reading(car->truth[i], reals[MEASUREMENT_ERROR + 1 + i], resolutions[i]);
    }
    for (int64_t i = 0; i < SENSORS; i++) {
        double *const sample = &reals[MEASUREMENT + 1 + 2 * i]; /* value and age */
        const int64_t period = timings[i][0], phase = timings[i][1], delay = timings[i][2];

        sample[1] += sample[1] >= 0.0 ? 1.0 : 0.0;
        if (k >= phase && (k - phase) % period == 0) {
            sample[0] = carried(k >= delay ? car->ring[(k - delay) % RING][i] : 0.0, frames[3 + i]);
            sample[1] = isnan(sample[0]) ? -1.0 : (double)delay;
        }
    }
    reals[MEASUREMENT] = carried(reading(car->read, reals[MEASUREMENT_ERROR], measured_step), frames[2]);
}

/* The values at the inputs of the plant: commands in their frames, held, late and within limits. */
static void act(struct instance *self)
{
    struct car *const car = &self->car;
    const int64_t k = car->tick, latency = self->wholes[LATENCY_TICKS - REALS];

    for (int channel = 0; channel < 2; channel++) {
        const double command = carried(self->reals[COMMAND_1 + channel], frames[channel]);
        const double largest = limits[channel][0], slew = limits[channel][1];
        const double before = car->reached[channel];

        if (!isnan(command)) {
            car->silent[channel] = 0;
            car->held[channel] = command;
        } else if (++car->silent[channel] > hold_ticks) {
            car->held[channel] = 0.0;
        }
        car->on_the_way[k % (LATENCY + 1)][channel] = car->held[channel];
        const double acting =
            k >= latency ? car->on_the_way[(k - latency) % (LATENCY + 1)][channel] : 0.0;
        const double least = fmax(-largest, before - slew), most = fmin(largest, before + slew);
        car->reached[channel] = fmin(fmax(acting, least), most);
        car->commands[k % COMMANDS][channel] = car->reached[channel];
    }
}

/* The plant, from the present tick to the next. */
static void follow(struct instance *self)
{
    struct car *const car = &self->car;
    const int64_t k = car->tick;
    double now[2], after[ORDER], sample = 0.0, output = 0.0;
//: if late
    double old[2];
//: end

    for (int i = 0; i < 2; i++) {
        const int64_t at = k + COMMANDS - dead_ticks[i];

        now[i] = self->reals[LEFT_1 + i] * car->commands[at % COMMANDS][i];
//: if late
        old[i] = self->reals[LEFT_1 + i] * car->commands[(at - 1) % COMMANDS][i];
//: end
    }
//: if within
    sample = looks_back[ORDER] * now[0] + looks_back[ORDER + 1] * now[1];
    sample += looks_back[ORDER + 2] * old[0] + looks_back[ORDER + 3] * old[1];
    for (int i = 0; i < ORDER; i++) {
        sample += looks_back[i] * car->x[i];
    }
//: end
    for (int i = 0; i < ORDER; i++) {
        after[i] = gamma_now[i][0] * now[0] + gamma_now[i][1] * now[1];
        for (int j = 0; j < ORDER; j++) {
            after[i] += phi[i][j] * car->x[j];
        }
    }
    for (int i = 0; i < ORDER; i++) {
        car->x[i] = after[i];
//: if changes
        car->x[i] += gamma_old[i][0] * old[0] + gamma_old[i][1] * old[1];
//: end
        output += sensed[i] * car->x[i];
    }
//: if within
//: else
    for (int i = 0; i < ORDER; i++) {
        sample += c[i] * car->x[i];
    }
//: end
    car->samples[(k + 1) % SAMPLES] = sample;
    car->read = car->samples[(k + 1 + SAMPLES - dead_ticks[2]) % SAMPLES];
    for (int i = 0; i < SENSORS; i++) {
        car->truth[i] = feeds[i][0] * now[0] + feeds[i][1] * now[1];
        for (int j = 0; j < ORDER; j++) {
            car->truth[i] += rows[i][j] * car->x[j];
        }
    }
    self->reals[OUTPUT] = output;
    for (int i = 0; i < STATES; i++) {
        self->reals[OUTPUT + 1 + i] = car->x[states[i]];
    }
    car->tick = k + 1;
}

bool model_works(struct instance *self)
{
    (void)self;
    return true;
}

void model_start(struct instance *self)
{
    self->reals[LEFT_1] = self->reals[LEFT_2] = 1.0;
    self->wholes[LATENCY_TICKS - REALS] = LATENCY;
    for (int i = 0; i < SENSORS; i++) {
        self->reals[MEASUREMENT + 2 + 2 * i] = -1.0;
    }
}

void model_begin(struct instance *self)
{
    measure(self);
}

void model_tick(struct instance *self, bool first)
{
    for (int i = 0; first && i < SENSORS; i++) {
        self->reals[MEASUREMENT + 2 + 2 * i] = -1.0; /* a sample is new once */
    }
    act(self);
    follow(self);
    measure(self);
}
