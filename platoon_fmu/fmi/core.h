/* The model-independent and FMI-version-independent core: instances, their values, phases and time.
 *
 * The faces (fmi2.c, ...) translate the standard's functions into these; which call is allowed in which phase is the
 * faces' business, as it differs between versions. Functions that can be refused return false, change nothing and
 * leave the reason in `message`. Instances share nothing, so they may live in different threads.
 */
#ifndef PLATOON_CORE_H
#define PLATOON_CORE_H

#include <stdbool.h>
#include <stddef.h>

#include "model.h"

typedef enum { MODEL_EXCHANGE, CO_SIMULATION } Kind;

/* One bit each, so that a set of phases is a mask. */
typedef enum {
    INSTANTIATED = 1 << 0,
    INITIALIZATION = 1 << 1,
    EVENT = 1 << 2,      /* model exchange, between steps */
    CONTINUOUS = 1 << 3, /* model exchange, within steps */
    STEPPING = 1 << 4,   /* co-simulation, between steps */
    TERMINATED = 1 << 5,
    FAILED = 1 << 6
} Phase;

typedef struct {
    const Model *model;
    Kind kind;
    Phase phase;
    double time;                /* [s] */
    double stop_time;           /* [s], infinite where none was given */
    double *x, *u, *p;          /* all that persists, besides time and phase: states, inputs, parameters */
    double *dx, *y, *work;      /* follow from the above */
    bool x_current, dx_current, y_current;
    char message[200];
} Instance;

/* A new instance with start values, or NULL where memory is short. Freed by core_free. */
Instance *core_new(const Model *model, Kind kind);
void core_free(Instance *instance);

/* Back to what core_new gave. */
void core_reset(Instance *instance);

/* Writes the values of n variables. Refused for an unknown value reference. */
bool core_get(Instance *instance, const unsigned int *references, size_t n, double *values);

/* Sets n inputs or parameters: all of them or, where one is refused, none. Refused for an unknown value reference, for
 * one that cannot be set (now or ever), and for a value that is not finite. */
bool core_set(Instance *instance, const unsigned int *references, size_t n, const double *values);

/* The continuous states and their derivatives, n_states values each; setting is refused for non-finite values. */
const double *core_states(Instance *instance);
const double *core_derivatives(Instance *instance);
bool core_set_states(Instance *instance, const double *x);

/* Leaves the initialization: from here on the states are the integrator's. */
void core_start(Instance *instance);

/* Co-simulation: from `time` by h > 0 seconds with constant inputs. Refused for a time that is not the instance's, for
 * h <= 0, and past the stop time. Where the result is not finite the phase becomes FAILED. */
bool core_step(Instance *instance, double time, double h);

#endif
