/* x' = A x + g B u + E w, y = C x as an FMU of FMI 2 or 3, co-simulation and model exchange in one.

   For what an importer has to get right it has a time event, from switch_s on g is twice the
   parameter gain; a state event, where y reaches wall from below x becomes -x/2; and it fails
   from fail_s on. numbers.h defines FMI, N, A, B, C, E and TOKEN; what FMI wants beside these
   functions, the builder adds. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "numbers.h"

enum { OK = 0, ERROR = 3 };
enum { INPUT_1, INPUT_2, OUTPUT, GAIN, WALL, SWITCH_S, FAIL_S, PUSH, BOUNCES, ON, NAME, STATES };

#if FMI == 2
typedef void (*Log)(void *, const char *, int, const char *, const char *, ...);
#else
typedef void (*Log)(void *, int, const char *, const char *);
#endif

typedef struct {
    double time, real[PUSH + 1], x[N];
    int bounces, on, switched;
    Log log;
} Model;

static void say(const Model *m, const char *message) {
#if FMI == 2
    m->log(NULL, "linear", ERROR, "error", message);
#else
    m->log(NULL, ERROR, "error", message);
#endif
}

static double output(const double *x) {
    double y = 0.0;
    for (int i = 0; i < N; i++) y += C[i] * x[i];
    return y;
}

static int rates(const Model *m, const double *x, double *dx) {
    double gain = m->on * m->real[GAIN] * (m->switched ? 2.0 : 1.0);
    if (m->time >= m->real[FAIL_S]) {
        say(m, "the belt\n is torn");
        return ERROR;
    }
    for (int i = 0; i < N; i++) {
        dx[i] = gain * (B[i][0] * m->real[INPUT_1] + B[i][1] * m->real[INPUT_2]);
        dx[i] += E[i] * m->real[PUSH];
        for (int j = 0; j < N; j++) dx[i] += A[i][j] * x[j];
    }
    return OK;
}

static void bounce(Model *m) {
    double dx[N];
    rates(m, m->x, dx);
    if (output(m->x) < m->real[WALL] * (1.0 - 1e-9) || output(dx) <= 0.0) return;
    for (int i = 0; i < N; i++) m->x[i] *= -0.5;
    m->bounces++;
}

static void *make(const char *token, Log log) {
    Model *m = calloc(1, sizeof *m);
    m->log = log;
    if (strcmp(token, TOKEN) != 0) {
        say(m, "wrong token");
        free(m);
        return NULL;
    }
    m->real[GAIN] = 1.0;
    m->real[WALL] = m->real[SWITCH_S] = m->real[FAIL_S] = 1e9;
    m->on = 1;
    return m;
}

/* Runge and Kutta's fourth order. */
static int integrate(Model *m, double h) {
    double k[4][N], x[N];
    const double at[] = {0.0, 0.5, 0.5, 1.0}, weight[] = {1.0, 2.0, 2.0, 1.0};
    for (int stage = 0; stage < 4; stage++) {
        for (int i = 0; i < N; i++)
            x[i] = m->x[i] + (stage ? at[stage] * h * k[stage - 1][i] : 0.0);
        if (rates(m, x, k[stage]) != OK) return ERROR;
    }
    for (int i = 0; i < N; i++)
        for (int stage = 0; stage < 4; stage++) m->x[i] += h / 6.0 * weight[stage] * k[stage][i];
    m->time += h;
    return OK;
}

static int until(Model *m, double end) {
    while (m->time < end - 1e-12) {
        Model before = *m;
        double h = fmin(1e-4, end - m->time);
        if (!m->switched && m->time + h > m->real[SWITCH_S]) h = m->real[SWITCH_S] - m->time;
        if (h > 1e-12 && integrate(m, h) != OK) return ERROR;
        if (output(m->x) >= m->real[WALL]) {
            double low = 0.0, high = h;
            while (high - low > 1e-14) {
                Model half = before;
                integrate(&half, (low + high) / 2.0);
                if (output(half.x) < m->real[WALL]) low = (low + high) / 2.0;
                else high = (low + high) / 2.0;
            }
            *m = before;
            integrate(m, high);
            bounce(m);
        }
        if (m->time >= m->real[SWITCH_S] - 1e-12) m->switched = 1;
    }
    return OK;
}

static double *real(Model *m, unsigned vr, double *dx) {
    if (vr == OUTPUT) m->real[OUTPUT] = output(m->x);
    if (vr < BOUNCES) return &m->real[vr];
    if (vr < STATES + N) return &m->x[vr - STATES];
    rates(m, m->x, dx);
    return &dx[vr - STATES - N];
}

#if FMI == 2
#define EXTRA
#define NAMED(name) fmi2##name
#define FLOAT(verb) fmi2##verb##Real
#define WHOLE(verb) fmi2##verb##Integer
#define DERIVATIVES fmi2GetDerivatives
typedef int Bool;
#else
#define EXTRA , size_t n_values
#define NAMED(name) fmi3##name
#define FLOAT(verb) fmi3##verb##Float64
#define WHOLE(verb) fmi3##verb##Int32
#define DERIVATIVES fmi3GetContinuousStateDerivatives
typedef _Bool Bool;
#endif

int FLOAT(Get)(void *m, const unsigned *vr, size_t n, double *values EXTRA) {
    double dx[N];
    for (size_t i = 0; i < n; i++) values[i] = *real(m, vr[i], dx);
    return OK;
}
int FLOAT(Set)(void *m, const unsigned *vr, size_t n, const double *values EXTRA) {
    double dx[N];
    for (size_t i = 0; i < n; i++) *real(m, vr[i], dx) = values[i];
    return OK;
}
int WHOLE(Get)(Model *m, const unsigned *vr, size_t n, int *values EXTRA) {
    for (size_t i = 0; i < n; i++) values[i] = m->bounces;
    return OK;
}
int WHOLE(Set)(Model *m, const unsigned *vr, size_t n, const int *values EXTRA) {
    for (size_t i = 0; i < n; i++) m->bounces = values[i];
    return OK;
}
int NAMED(GetBoolean)(Model *m, const unsigned *vr, size_t n, Bool *values EXTRA) {
    for (size_t i = 0; i < n; i++) values[i] = m->on;
    return OK;
}
int NAMED(SetBoolean)(Model *m, const unsigned *vr, size_t n, const Bool *values EXTRA) {
    for (size_t i = 0; i < n; i++) m->on = values[i];
    return OK;
}
int NAMED(SetString)(void *m, const unsigned *vr, size_t n, const char **values EXTRA) {
    if (strcmp(values[0], "bad") != 0) return OK;
    say(m, "no such name");
    return ERROR;
}
void NAMED(FreeInstance)(void *m) { free(m); }
int NAMED(ExitInitializationMode)(void *m) { return OK; }
int NAMED(EnterEventMode)(void *m) { return OK; }
int NAMED(EnterContinuousTimeMode)(void *m) { return OK; }
int NAMED(SetTime)(Model *m, double time) { m->time = time; return OK; }
int NAMED(SetContinuousStates)(Model *m, const double *x, size_t n) {
    memcpy(m->x, x, sizeof m->x);
    return OK;
}
int NAMED(GetContinuousStates)(Model *m, double *x, size_t n) {
    memcpy(x, m->x, sizeof m->x);
    return OK;
}
int NAMED(GetNominalsOfContinuousStates)(void *m, double *x, size_t n) {
    for (int i = 0; i < N; i++) x[i] = 1.0;
    return OK;
}
int DERIVATIVES(Model *m, double *dx, size_t n) { return rates(m, m->x, dx); }
int NAMED(GetEventIndicators)(Model *m, double *z, size_t n) {
    z[0] = m->real[WALL] - output(m->x);
    return OK;
}
int NAMED(CompletedIntegratorStep)(void *m, Bool no_set, Bool *event, Bool *ends) {
    *event = *ends = 0;
    return OK;
}

static int discrete(Model *m) {
    bounce(m);
    if (m->time >= m->real[SWITCH_S]) m->switched = 1;
    return !m->switched;
}

#if FMI == 2
typedef struct { Log log; } Callbacks;
typedef struct { int again, ends, nominals, values, is_next; double next; } Event;
void *fmi2Instantiate(const char *name, int type, const char *token, const char *resources,
                      const Callbacks *callbacks, int visible, int logging) {
    return make(token, callbacks->log);
}
int fmi2SetupExperiment(void *m, int has, double tolerance, double start, int ends, double stop) {
    return OK;
}
int fmi2EnterInitializationMode(void *m) { return OK; }
int fmi2NewDiscreteStates(Model *m, Event *event) {
    memset(event, 0, sizeof *event);
    event->is_next = discrete(m);
    event->next = m->real[SWITCH_S];
    return OK;
}
int fmi2DoStep(Model *m, double time, double step, int no_set) { return until(m, time + step); }
#else
void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources,
                                   _Bool visible, _Bool logging, void *environment, Log log) {
    return make(token, log);
}
void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                  _Bool visible, _Bool logging, _Bool events, _Bool early,
                                  const unsigned *vr, size_t n, void *environment, Log log,
                                  void *update) {
    return make(token, log);
}
int fmi3EnterInitializationMode(void *m, _Bool has, double tolerance, double start, _Bool ends,
                                double stop) {
    return OK;
}
int fmi3UpdateDiscreteStates(Model *m, _Bool *again, _Bool *ends, _Bool *nominals, _Bool *values,
                             _Bool *is_next, double *next) {
    *again = *ends = *nominals = *values = 0;
    *is_next = discrete(m);
    *next = m->real[SWITCH_S];
    return OK;
}
int fmi3DoStep(Model *m, double time, double step, _Bool no_set, _Bool *event, _Bool *ends,
               _Bool *early, double *reached) {
    *event = *early = 0;
    *ends = m->on == 0 && m->time > 0.02;
    *reached = time + step;
    return until(m, time + step);
}
#endif
