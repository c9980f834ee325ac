/* The model-independent and FMI-version-independent core: instances, their values, phases, time and log.
 *
 * The faces (fmi2.c, fmi3.c) translate the standard's functions into these; which call is allowed in which phase is in
 * their tables, because it differs between versions. A function that takes such a rule returns false if it is not allowed
 * now or refuses its arguments; it has then logged the reason and left the instance unchanged. All of them refuse a missing
 * instance (without a log) and missing arrays. Instances share nothing, so different threads may use them.
 *
 * Value references number the model's variables (model.h), then the core's own: time, solver_step, solver_tolerance and
 * solver, the only integer.
 */
#ifndef PLATOON_CORE_H
#define PLATOON_CORE_H

#include <stdbool.h>
#include <stddef.h>

#include "model.h"
#include "solver.h"

typedef enum { MODEL_EXCHANGE, CO_SIMULATION } Kind;

/* One bit each, so that a set of phases is a mask. */
typedef enum {
    INSTANTIATED = 1 << 0,
    INITIALIZATION = 1 << 1,
    EVENT = 1 << 2,        /* model exchange, between steps */
    CONTINUOUS = 1 << 3,   /* model exchange, within steps */
    STEPPING = 1 << 4,     /* co-simulation, between steps */
    INTERMEDIATE = 1 << 5, /* co-simulation, in a callback after a step of the solver */
    TERMINATED = 1 << 6,
    FAILED = 1 << 7
} Phase;

#define ANY_PHASE 0xff

/* A function of the standard, and the phases in which it may be called. */
typedef struct {
    const char *name;
    unsigned int model_exchange, co_simulation; /* masks of phases */
} Rule;

/* The log categories, one bit each; core_category_name gives their names in the modelDescription. */
typedef enum { LOG_ERRORS = 1 << 0, LOG_EVENTS = 1 << 1 } LogCategory;

typedef struct Instance Instance;

/* Longest log message, including its terminator; longer ones are truncated. */
#define LONGEST_MESSAGE 400

/* Hands a message to the importer. */
typedef void (*LogSink)(const Instance *instance, LogCategory category, const char *text);

/* Everything that persists besides the values: with x, u and p it is the state of an instance. */
typedef struct {
    double time;                 /* [s] */
    double stop_time;            /* [s], infinite if none was given */
    double experiment_tolerance; /* infinite if none was given */
    double step_proposal;        /* of the adaptive solver [s] */
    SolverSettings solver;
    Phase phase;
} Status;

struct Instance {
    const Model *model;
    Kind kind;
    char *name;
    void *host; /* the face's own */
    LogSink sink;
    int logged; /* log categories */
    Status status;
    /* States, inputs and parameters, in one block. */
    double *x, *u, *p;
    double *dx, *y, *jacobian, *seed, *sensitivity, *work; /* follow from the above, or are scratch */
    bool x_current, dx_current, y_current, jacobian_current;
};

/* A copy of an instance's state. */
typedef struct State State;

/* A new instance with start values, or NULL if out of memory. Freed by core_free. */
Instance *core_new(const Model *model, Kind kind, const char *name, LogSink sink, void *host);
void core_free(Instance *instance);

/* Whether there is an instance and the function may be called now; logged if not. */
bool core_allows(const Instance *instance, const Rule *rule);

/* Logs "NAME: reason" as an error, and returns false. */
bool core_refuse(const Instance *instance, const Rule *rule, const char *reason, ...);

/* Whether the function may be called and its n pointers for results are present. */
bool core_has_places(const Instance *instance, const Rule *rule, size_t n, const void *const places[]);

/* Whether the function may be called and its arrays of n elements are present. */
bool core_has_arrays(const Instance *instance, const Rule *rule, size_t n, const void *one, const void *other);

/* Which categories are logged, by name; none means all. Refused for an unknown one. */
bool core_set_logging(Instance *instance, const Rule *rule, bool on, size_t n, const char *const categories[]);
const char *core_category_name(LogCategory category);

/* Resets to the state after core_new. */
bool core_reset(Instance *instance, const Rule *rule);

/* The times of the experiment, and a tolerance that tightens the adaptive solver's; stop and tolerance are infinite if
 * absent. Refused if they are invalid. */
bool core_set_experiment(Instance *instance, const Rule *rule, double tolerance, double start, double stop);

/* Changes the phase, by kind. At the end of the initialization the states become the integrator's. */
bool core_enter(Instance *instance, const Rule *rule, Phase exchange, Phase simulation);

/* Writes the values of n real variables. Refused for value references of other variables. */
bool core_get(Instance *instance, const Rule *rule, const unsigned int *references, size_t n, double *values);

/* Sets n inputs or parameters: all of them or, if one is refused, none. Refused for value references of other variables,
 * for one that cannot be set (now or ever), for a value that is not finite, and for a parameter's outside its limits. */
bool core_set(Instance *instance, const Rule *rule, const unsigned int *references, size_t n, const double *values);

/* The same for integers, one at a time, after core_has_arrays. */
bool core_get_integer(const Instance *instance, const Rule *rule, unsigned int reference, int *value);
bool core_can_set_integer(const Instance *instance, const Rule *rule, unsigned int reference, double value);
void core_set_integer(Instance *instance, int value); /* there is only one, which core_can_set_integer has let through */

/* Whether n is 0, for items that the model lacks (a type of variable, event indicators). */
bool core_has_none(const Instance *instance, const Rule *rule, size_t n);

/* Model exchange: the time, and the continuous states, their derivatives and nominals; refused if n is not the model's,
 * and for values that are not finite. */
bool core_set_time(Instance *instance, const Rule *rule, double time);
bool core_set_states(Instance *instance, const Rule *rule, const double *x, size_t n);
bool core_get_states(Instance *instance, const Rule *rule, double *x, size_t n);
bool core_get_derivatives(Instance *instance, const Rule *rule, double *dx, size_t n);
bool core_get_nominals(Instance *instance, const Rule *rule, double *nominals, size_t n);

/* Whether the variable is a state, a derivative or an output. */
bool core_is_unknown(const Instance *instance, unsigned int reference);

/* sensitivity = J seed, or seed' J for `adjoint`, where J is the Jacobian of the unknowns (states, derivatives, outputs)
 * with respect to the knowns: states and inputs or, before the simulation, inputs and parameters. Refused for others. */
bool core_differentiate(Instance *instance, const Rule *rule, bool adjoint, const unsigned int *unknowns, size_t n_unknowns,
                        const unsigned int *knowns, size_t n_knowns, const double *seed, double *sensitivity);

/* Time derivatives of unknowns with constant inputs. Refused for orders other than 1. */
bool core_time_derivatives(Instance *instance, const Rule *rule, const unsigned int *unknowns, size_t n, const int *orders,
                           double *values);

/* Called after each step of the solver, in the phase INTERMEDIATE; returns the time at which the step must return:
 * `end` or earlier; a time in the past means now. */
typedef double (*AfterStep)(Instance *instance, double end);

/* Co-simulation: from `time` by h > 0 seconds with constant inputs, or to the time at which `after_step` (may be NULL)
 * requests the return. Refused for a time that is not the instance's, for h <= 0, and past the stop time. If the result
 * is not finite or the tolerance cannot be met, the phase becomes FAILED. */
bool core_step(Instance *instance, const Rule *rule, double time, double h, AfterStep after_step);

/* A copy of the instance's state, into *state or, if that is NULL, into a new one. Refused if out of memory. The faces do
 * not allow it in the phase FAILED, because such a state is useless. */
bool core_save(const Instance *instance, const Rule *rule, State **state);

/* Frees a state and clears the pointer; does nothing if there is none. */
bool core_discard(const Instance *instance, const Rule *rule, State **state);

/* Refused for the state of another model or kind. */
bool core_restore(Instance *instance, const Rule *rule, const State *state);

/* A state as bytes, the same on every platform, and back into *state as core_save does. All states have the same size.
 * Bytes of another model, version or kind, and corrupted bytes, are refused. */
bool core_serialized_size(const Instance *instance, const Rule *rule, size_t *size);
bool core_serialize(const Instance *instance, const Rule *rule, const State *state, unsigned char *bytes, size_t size);
bool core_deserialize(const Instance *instance, const Rule *rule, const unsigned char *bytes, size_t size, State **state);

#endif
