#include "core.h"

#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Times that differ by less than this, relative to one second or to the time, are the same time to a master that sums
 * up its steps in its own way; but never by half a step. */
#define TIME_TOLERANCE 1e-9
/* What an importer may ask of the adaptive solver; below this rounding is all there is. */
#define LEAST_TOLERANCE 1e-13
#define FIRST_PROPOSAL 1e-3 /* [s] */

/* ---- value references (core.h says in which order) ---- */

static size_t n_unknowns(const Model *model) { return 2 * model->n_states + model->n_outputs; }

static size_t n_values(const Model *model) { return model->n_states + model->n_inputs + model->n_parameters; }

static size_t first_of_core(const Model *model) { return n_unknowns(model) + model->n_inputs + model->n_parameters; }

enum { TIME, SOLVER_STEP, SOLVER_TOLERANCE, SOLVER, N_OF_CORE };

/* ---- log ---- */

const char *core_category_name(LogCategory category) { return category == LOG_ERRORS ? "logStatusError" : "logEvents"; }

static const char *phase_name(Phase phase) {
    switch (phase) {
        case INSTANTIATED: return "instantiated state";
        case INITIALIZATION: return "initialization mode";
        case EVENT: return "event mode";
        case CONTINUOUS: return "continuous-time mode";
        case STEPPING: return "step mode";
        case INTERMEDIATE: return "intermediate update mode";
        case TERMINATED: return "terminated state";
        case FAILED: return "error state";
    }
    return "unknown";
}

bool core_refuse(const Instance *instance, const Rule *rule, const char *reason, ...) {
    char text[400];
    va_list arguments;
    int length;

    if (!(instance->logged & LOG_ERRORS)) return false;
    length = snprintf(text, sizeof text, "%s: ", rule->name);
    va_start(arguments, reason);
    vsnprintf(text + length, sizeof text - (size_t)length, reason, arguments);
    va_end(arguments);
    instance->sink(instance, LOG_ERRORS, text);
    return false;
}

bool core_allows(const Instance *instance, const Rule *rule) {
    bool exchange;

    if (!instance) return false;
    exchange = instance->kind == MODEL_EXCHANGE;
    if (instance->status.phase & (exchange ? rule->model_exchange : rule->co_simulation)) return true;
    return core_refuse(instance, rule, "not allowed in %s of %s.", phase_name(instance->status.phase),
                       exchange ? "Model Exchange" : "Co-Simulation");
}

bool core_has_places(const Instance *instance, const Rule *rule, size_t n, const void *const places[]) {
    size_t i;

    if (!core_allows(instance, rule)) return false;
    for (i = 0; i < n; i++) {
        if (!places[i]) return core_refuse(instance, rule, "a place for a result is missing.");
    }
    return true;
}

/* Whether an array is there, which may be missing where it has no elements. */
static bool has_array(const Instance *instance, const Rule *rule, size_t n, const void *array) {
    return n == 0 || array || core_refuse(instance, rule, "an array is missing.");
}

bool core_has_arrays(const Instance *instance, const Rule *rule, size_t n, const void *one, const void *other) {
    return core_allows(instance, rule) && has_array(instance, rule, n, one) && has_array(instance, rule, n, other);
}

bool core_set_logging(Instance *instance, const Rule *rule, bool on, size_t n, const char *const categories[]) {
    int chosen = n == 0 ? LOG_ERRORS | LOG_EVENTS : 0;
    size_t i;

    if (!core_allows(instance, rule) || !has_array(instance, rule, n, categories)) return false;
    for (i = 0; i < n; i++) {
        const char *name = categories[i] ? categories[i] : "(none)";
        if (strcmp(name, core_category_name(LOG_ERRORS)) == 0) {
            chosen |= LOG_ERRORS;
        } else if (strcmp(name, core_category_name(LOG_EVENTS)) == 0) {
            chosen |= LOG_EVENTS;
        } else if (strcmp(name, "logAll") == 0) {
            chosen |= LOG_ERRORS | LOG_EVENTS;
        } else {
            return core_refuse(instance, rule, "there is no log category %s; allowed: logStatusError, logEvents, logAll.", name);
        }
    }
    instance->logged = on ? chosen : 0;
    return true;
}

/* ---- life cycle ---- */

/* Forgets what followed from values that have changed. */
static void outdate(Instance *instance) {
    instance->dx_current = false;
    instance->y_current = false;
    instance->jacobian_current = false;
    /* Until the simulation starts the states follow the start parameters. */
    if (instance->status.phase & (INSTANTIATED | INITIALIZATION)) instance->x_current = false;
}

static const double *states(Instance *instance) {
    if (!instance->x_current) {
        instance->model->initial(instance->p, instance->x);
        instance->x_current = true;
    }
    return instance->x;
}

static const double *derivatives(Instance *instance) {
    if (!instance->dx_current) {
        instance->model->derivatives(states(instance), instance->u, instance->p, instance->dx);
        instance->dx_current = true;
    }
    return instance->dx;
}

static const double *outputs(Instance *instance) {
    if (!instance->y_current) {
        instance->model->outputs(states(instance), instance->u, instance->p, instance->y);
        instance->y_current = true;
    }
    return instance->y;
}

static void start_afresh(Instance *instance) {
    const Model *model = instance->model;
    const Status fresh = {
        .stop_time = INFINITY,
        .experiment_tolerance = INFINITY,
        .step_proposal = FIRST_PROPOSAL,
        .solver = {.step = model->settings_start[0],
                   .tolerance = model->settings_start[1],
                   .method = (SolverMethod)model->settings_start[2]},
        .phase = INSTANTIATED,
    };

    instance->status = fresh;
    memcpy(instance->u, model->inputs_start, model->n_inputs * sizeof(double));
    memcpy(instance->p, model->parameters_start, model->n_parameters * sizeof(double));
    outdate(instance);
}

Instance *core_new(const Model *model, Kind kind, const char *name, LogSink sink, void *host) {
    const size_t n_x = model->n_states;
    const size_t n_known = model->n_inputs + (n_x > model->n_parameters ? n_x : model->n_parameters);
    const size_t n_scratch = n_x + model->n_outputs + model->most_nonzeros + n_known + n_unknowns(model) + SOLVER_WORK(n_x);
    const size_t name_size = strlen(name) + 1;
    Instance *instance = calloc(1, sizeof *instance);

    if (!instance) return NULL;
    instance->x = calloc(n_values(model) + n_scratch, sizeof(double));
    instance->name = malloc(name_size);
    if (!instance->x || !instance->name) {
        core_free(instance);
        return NULL;
    }
    memcpy(instance->name, name, name_size);
    instance->model = model;
    instance->kind = kind;
    instance->host = host;
    instance->sink = sink;
    instance->u = instance->x + n_x;
    instance->p = instance->u + model->n_inputs;
    instance->dx = instance->p + model->n_parameters;
    instance->y = instance->dx + n_x;
    instance->jacobian = instance->y + model->n_outputs;
    instance->seed = instance->jacobian + model->most_nonzeros;
    instance->sensitivity = instance->seed + n_known;
    instance->work = instance->sensitivity + n_unknowns(model);
    start_afresh(instance);
    return instance;
}

void core_free(Instance *instance) {
    if (!instance) return;
    free(instance->x);
    free(instance->name);
    free(instance);
}

bool core_reset(Instance *instance, const Rule *rule) {
    if (!core_allows(instance, rule)) return false;
    start_afresh(instance);
    return true;
}

bool core_set_experiment(Instance *instance, const Rule *rule, double tolerance, double start, double stop) {
    if (!core_allows(instance, rule)) return false;
    if (!isfinite(start)) return core_refuse(instance, rule, "the start time %g is not finite.", start);
    if (!(stop >= start)) return core_refuse(instance, rule, "the stop time %g s is before the start time %g s.", stop, start);
    if (!(tolerance > 0)) return core_refuse(instance, rule, "the tolerance must be greater than 0, not %g.", tolerance);
    instance->status.time = start;
    instance->status.stop_time = stop;
    instance->status.experiment_tolerance = tolerance;
    return true;
}

bool core_enter(Instance *instance, const Rule *rule, Phase exchange, Phase simulation) {
    char text[100];

    if (!core_allows(instance, rule)) return false;
    if (instance->status.phase == INITIALIZATION) {
        states(instance);
        /* From here on it is another Jacobian. */
        instance->jacobian_current = false;
    }
    instance->status.phase = instance->kind == MODEL_EXCHANGE ? exchange : simulation;
    if (instance->logged & LOG_EVENTS) {
        snprintf(text, sizeof text, "%s from %g s on", phase_name(instance->status.phase), instance->status.time);
        instance->sink(instance, LOG_EVENTS, text);
    }
    return true;
}

/* ---- values ---- */

/* The value a reference stands for, or NULL for none. */
static const double *value_of(Instance *instance, size_t reference) {
    const Model *model = instance->model;

    if (reference < model->n_states) return states(instance) + reference;
    reference -= model->n_states;
    if (reference < model->n_states) return derivatives(instance) + reference;
    reference -= model->n_states;
    if (reference < model->n_outputs) return outputs(instance) + reference;
    reference -= model->n_outputs;
    /* Inputs and parameters lie one behind the other. */
    if (reference < model->n_inputs + model->n_parameters) return instance->u + reference;
    switch (reference - model->n_inputs - model->n_parameters) {
        case TIME: return &instance->status.time;
        case SOLVER_STEP: return &instance->status.solver.step;
        case SOLVER_TOLERANCE: return &instance->status.solver.tolerance;
        default: return NULL;
    }
}

/* Refuses a reference that stands for no variable of the type. */
static bool no_such(const Instance *instance, const Rule *rule, const char *type, unsigned int reference) {
    if (reference >= first_of_core(instance->model) + N_OF_CORE) {
        return core_refuse(instance, rule, "no variable has the value reference %u.", reference);
    }
    return core_refuse(instance, rule, "the variable with the value reference %u is not of the type %s.", reference, type);
}

bool core_get(Instance *instance, const Rule *rule, const unsigned int *references, size_t n, double *values) {
    size_t i;

    if (!core_has_arrays(instance, rule, n, references, values)) return false;
    for (i = 0; i < n; i++) {
        const double *value = value_of(instance, references[i]);
        if (!value) return no_such(instance, rule, "Real (Float64)", references[i]);
        values[i] = *value;
    }
    return true;
}

bool core_get_integer(const Instance *instance, const Rule *rule, unsigned int reference, int *value) {
    if (reference != first_of_core(instance->model) + SOLVER) return no_such(instance, rule, "Enumeration", reference);
    *value = (int)instance->status.solver.method;
    return true;
}

/* Refuses a value outside its limits. */
static bool in_range(const Instance *instance, const Rule *rule, unsigned int reference, double value, double minimum,
                     double maximum) {
    if (value >= minimum && value <= maximum) return true;
    return core_refuse(instance, rule, "value reference %u cannot be set to %g; allowed: %g to %g.", reference, value, minimum,
                       maximum);
}

/* The same for a setting of the solver, which counts as settings_start does. */
static bool setting_in_range(const Instance *instance, const Rule *rule, unsigned int reference, int setting, double value) {
    return in_range(instance, rule, reference, value, instance->model->settings_minimum[setting],
                    instance->model->settings_maximum[setting]);
}

/* The same for a parameter of the model. Inputs may leave their limits, as an importer's solver may try such values. */
static bool parameter_in_range(const Instance *instance, const Rule *rule, unsigned int reference, double value) {
    const size_t i = reference - n_unknowns(instance->model) - instance->model->n_inputs;

    return in_range(instance, rule, reference, value, instance->model->parameters_minimum[i],
                    instance->model->parameters_maximum[i]);
}

/* Where a real variable's value is set, or NULL where it cannot be set to this, which is logged. */
static double *settable(Instance *instance, const Rule *rule, unsigned int reference, double value) {
    const Model *model = instance->model;
    const size_t first = n_unknowns(model), of_core = first_of_core(model);
    const bool fixed = (reference >= first + model->n_inputs + model->n_tunable && reference < of_core) ||
                       reference == of_core + SOLVER_STEP || reference == of_core + SOLVER_TOLERANCE;
    const bool tunable = !fixed && reference >= first + model->n_inputs && reference < of_core;
    double *place = NULL;

    if (reference == of_core + SOLVER || reference >= of_core + N_OF_CORE) {
        no_such(instance, rule, "Real (Float64)", reference);
    } else if (reference < first || reference == of_core + TIME) {
        core_refuse(instance, rule, "value reference %u is neither an input nor a parameter and cannot be set.", reference);
    } else if ((fixed && !(instance->status.phase & (INSTANTIATED | INITIALIZATION))) ||
               (tunable && instance->status.phase == CONTINUOUS)) {
        core_refuse(instance, rule, "value reference %u is a parameter that cannot be changed now.", reference);
    } else if (!isfinite(value)) {
        core_refuse(instance, rule, "value reference %u cannot be set to %g, which is not finite.", reference, value);
    } else if (reference == of_core + SOLVER_STEP) {
        if (setting_in_range(instance, rule, reference, 0, value)) place = &instance->status.solver.step;
    } else if (reference == of_core + SOLVER_TOLERANCE) {
        if (setting_in_range(instance, rule, reference, 1, value)) place = &instance->status.solver.tolerance;
    } else if (reference < first + model->n_inputs || parameter_in_range(instance, rule, reference, value)) {
        place = instance->u + (reference - first);
    }
    return place;
}

bool core_set(Instance *instance, const Rule *rule, const unsigned int *references, size_t n, const double *values) {
    size_t i;

    if (!core_has_arrays(instance, rule, n, references, values)) return false;
    for (i = 0; i < n; i++) {
        if (!settable(instance, rule, references[i], values[i])) return false;
    }
    for (i = 0; i < n; i++) *settable(instance, rule, references[i], values[i]) = values[i];
    outdate(instance);
    return true;
}

bool core_can_set_integer(const Instance *instance, const Rule *rule, unsigned int reference, double value) {
    if (reference != first_of_core(instance->model) + SOLVER) return no_such(instance, rule, "Enumeration", reference);
    if (!(instance->status.phase & (INSTANTIATED | INITIALIZATION))) {
        return core_refuse(instance, rule, "value reference %u is a parameter that cannot be changed now.", reference);
    }
    return setting_in_range(instance, rule, reference, 2, value);
}

void core_set_integer(Instance *instance, int value) { instance->status.solver.method = (SolverMethod)value; }

static bool all_finite(const double *x, size_t n) {
    size_t i;

    for (i = 0; i < n; i++) {
        if (!isfinite(x[i])) return false;
    }
    return true;
}

bool core_has_none(const Instance *instance, const Rule *rule, size_t n) {
    return core_allows(instance, rule) && (n == 0 || core_refuse(instance, rule, "the model has none of these."));
}

/* ---- Model Exchange ---- */

bool core_set_time(Instance *instance, const Rule *rule, double time) {
    if (!core_allows(instance, rule)) return false;
    if (!isfinite(time)) return core_refuse(instance, rule, "the time is not finite.");
    instance->status.time = time;
    return true;
}

/* Whether the call is allowed and its array has the model's number of states. */
static bool with_states(const Instance *instance, const Rule *rule, const double *values, size_t n) {
    if (!core_allows(instance, rule) || !has_array(instance, rule, n, values)) return false;
    if (n == instance->model->n_states) return true;
    return core_refuse(instance, rule, "the model has %lu continuous states, not %lu.",
                       (unsigned long)instance->model->n_states, (unsigned long)n);
}

bool core_set_states(Instance *instance, const Rule *rule, const double *x, size_t n) {
    if (!with_states(instance, rule, x, n)) return false;
    if (!all_finite(x, n)) return core_refuse(instance, rule, "a state cannot be set to a value that is not finite.");
    memcpy(instance->x, x, n * sizeof *x);
    instance->x_current = true;
    outdate(instance);
    return true;
}

bool core_get_states(Instance *instance, const Rule *rule, double *x, size_t n) {
    if (!with_states(instance, rule, x, n)) return false;
    memcpy(x, states(instance), n * sizeof *x);
    return true;
}

bool core_get_derivatives(Instance *instance, const Rule *rule, double *dx, size_t n) {
    if (!with_states(instance, rule, dx, n)) return false;
    memcpy(dx, derivatives(instance), n * sizeof *dx);
    return true;
}

bool core_get_nominals(Instance *instance, const Rule *rule, double *nominals, size_t n) {
    if (!with_states(instance, rule, nominals, n)) return false;
    memcpy(nominals, instance->model->nominals, n * sizeof *nominals);
    return true;
}

/* ---- derivatives of derivatives and outputs ---- */

bool core_is_unknown(const Instance *instance, unsigned int reference) { return reference < n_unknowns(instance->model); }

/* The Jacobian that holds now, with instance->jacobian evaluated. */
static const Jacobian *evaluated_jacobian(Instance *instance) {
    const bool beginning = instance->status.phase == INITIALIZATION;
    const Jacobian *jacobian = beginning ? &instance->model->beginning : &instance->model->running;

    if (!instance->jacobian_current) {
        jacobian->evaluate(states(instance), instance->u, instance->p, instance->jacobian);
        instance->jacobian_current = true;
    }
    return jacobian;
}

/* The column of a known in the Jacobian that holds now, or -1. */
static int column_of(const Instance *instance, size_t reference) {
    const Model *model = instance->model;
    const size_t first_input = n_unknowns(model);
    const bool beginning = instance->status.phase == INITIALIZATION;

    if (!beginning && reference < model->n_states) return (int)reference;
    if (reference < first_input) return -1;
    reference -= first_input;
    if (beginning) return reference < model->n_inputs + model->n_parameters ? (int)reference : -1;
    return reference < model->n_inputs ? (int)(model->n_states + reference) : -1;
}

/* sensitivity = J seed, both dense. */
static void multiply(Instance *instance, const Jacobian *jacobian, size_t n_columns) {
    size_t column;
    int k;

    memset(instance->sensitivity, 0, n_unknowns(instance->model) * sizeof(double));
    for (column = 0; column < n_columns; column++) {
        const double seed = instance->seed[column];
        if (seed == 0) continue;
        for (k = jacobian->starts[column]; k < jacobian->starts[column + 1]; k++) {
            instance->sensitivity[jacobian->rows[k]] += instance->jacobian[k] * seed;
        }
    }
}

bool core_differentiate(Instance *instance, const Rule *rule, bool adjoint, const unsigned int *unknowns, size_t n_unknown,
                        const unsigned int *knowns, size_t n_known, const double *seed, double *sensitivity) {
    const Model *model;
    const Jacobian *jacobian;
    bool beginning;
    size_t i;
    int k;

    if (!core_has_arrays(instance, rule, n_unknown, unknowns, adjoint ? seed : sensitivity) ||
        !core_has_arrays(instance, rule, n_known, knowns, adjoint ? sensitivity : seed)) {
        return false;
    }
    model = instance->model;
    beginning = instance->status.phase == INITIALIZATION;
    for (i = 0; i < n_unknown; i++) {
        if (core_is_unknown(instance, unknowns[i])) continue;
        return core_refuse(instance, rule, "value reference %u is no unknown (a state, a derivative or an output).", unknowns[i]);
    }
    for (i = 0; i < n_known; i++) {
        if (column_of(instance, knowns[i]) >= 0) continue;
        return core_refuse(instance, rule, "value reference %u is no known now (%s).", knowns[i],
                           beginning ? "an input or a parameter" : "a state or an input");
    }
    jacobian = evaluated_jacobian(instance);
    if (adjoint) {
        memset(instance->sensitivity, 0, n_unknowns(model) * sizeof(double));
        for (i = 0; i < n_unknown; i++) instance->sensitivity[unknowns[i]] += seed[i];
        for (i = 0; i < n_known; i++) {
            const int column = column_of(instance, knowns[i]);
            sensitivity[i] = 0;
            for (k = jacobian->starts[column]; k < jacobian->starts[column + 1]; k++) {
                sensitivity[i] += instance->sensitivity[jacobian->rows[k]] * instance->jacobian[k];
            }
        }
    } else {
        const size_t n_columns = model->n_inputs + (beginning ? model->n_parameters : model->n_states);
        memset(instance->seed, 0, n_columns * sizeof(double));
        for (i = 0; i < n_known; i++) instance->seed[column_of(instance, knowns[i])] += seed[i];
        multiply(instance, jacobian, n_columns);
        for (i = 0; i < n_unknown; i++) sensitivity[i] = instance->sensitivity[unknowns[i]];
    }
    return true;
}

bool core_time_derivatives(Instance *instance, const Rule *rule, const unsigned int *unknowns, size_t n, const int *orders,
                           double *values) {
    const Model *model;
    size_t i;

    if (!core_has_arrays(instance, rule, n, unknowns, orders) ||
        !has_array(instance, rule, n, values)) {
        return false;
    }
    model = instance->model;
    for (i = 0; i < n; i++) {
        if (orders[i] != 1) return core_refuse(instance, rule, "the order must be 1, not %d.", orders[i]);
        if (!core_is_unknown(instance, unknowns[i])) {
            return core_refuse(instance, rule, "value reference %u is no output.", unknowns[i]);
        }
    }
    memset(instance->seed, 0, (model->n_states + model->n_inputs) * sizeof(double));
    memcpy(instance->seed, derivatives(instance), model->n_states * sizeof(double));
    multiply(instance, evaluated_jacobian(instance), model->n_states);
    for (i = 0; i < n; i++) values[i] = instance->sensitivity[unknowns[i]];
    return true;
}

/* ---- steps ---- */

/* The solver's settings for a step: those of the parameters, within what the model and the experiment ask for. */
static SolverSettings settings_of_step(const Instance *instance) {
    SolverSettings settings = instance->status.solver;
    double rate;

    /* Beyond this the fixed-step method is unstable where the model is fastest, and nothing else would show it. */
    instance->model->fastest(instance->p, &rate);
    settings.step = fmin(settings.step, SOLVER_STABLE / rate);
    settings.tolerance = fmax(fmin(settings.tolerance, instance->status.experiment_tolerance), LEAST_TOLERANCE);
    return settings;
}

/* One step of the solver; its length, or 0 where it could do none. */
static double advance(Instance *instance, const SolverSettings *settings, double remaining) {
    double length;

    derivatives(instance);
    if (settings->method == RUNGE_KUTTA_4) {
        length = solver_fixed_step(instance->model, settings, remaining, instance->x, instance->dx, instance->u, instance->p,
                                   instance->work);
    } else {
        length = solver_adaptive_step(instance->model, settings, remaining, &instance->status.step_proposal, instance->x,
                                      instance->dx, instance->u, instance->p, instance->work);
    }
    outdate(instance);
    /* The adaptive method has left the derivatives at the new states. */
    instance->dx_current = settings->method == DORMAND_PRINCE_5;
    return length;
}

static bool fail(Instance *instance, const Rule *rule, double since, const char *reason) {
    const double time = instance->status.time;

    instance->status.phase = FAILED;
    return core_refuse(instance, rule, "the step from %g s failed at %g s: %s.", since, time, reason);
}

static bool is_after(double time, double other, double h) {
    return time - other > fmin(TIME_TOLERANCE * fmax(1.0, fabs(other)), h / 2);
}

bool core_step(Instance *instance, const Rule *rule, double time, double h, AfterStep after_step) {
    /* What is done and what is to be done count from the beginning of the step: the same at any time. */
    double done = 0, wanted = h, end = time + h;
    SolverSettings settings;
    Status *status;

    if (!core_allows(instance, rule)) return false;
    status = &instance->status;
    if (!(h > 0) || !isfinite(h)) {
        return core_refuse(instance, rule, "the step size must be greater than 0 s and finite, not %g s.", h);
    }
    if (end == time) return core_refuse(instance, rule, "the step size %g s vanishes beside the time %g s.", h, time);
    if (!isfinite(time) || is_after(time, status->time, h) || is_after(status->time, time, h)) {
        return core_refuse(instance, rule, "a step must start at %.17g s, where the last one ended, not at %.17g s.",
                           status->time, time);
    }
    if (is_after(end, status->stop_time, h)) {
        return core_refuse(instance, rule, "a step to %.17g s would pass the stop time %.17g s.", end, status->stop_time);
    }
    status->time = time;
    settings = settings_of_step(instance);
    while (done < wanted) {
        const double remaining = wanted - done;
        const double length = advance(instance, &settings, remaining);

        if (length == 0) return fail(instance, rule, time, "no step of the adaptive solver is short enough for the tolerance");
        if (!all_finite(instance->x, instance->model->n_states)) return fail(instance, rule, time, "a state is not finite");
        done = length == remaining ? wanted : done + length;
        status->time = done == wanted ? end : time + done;
        if (after_step) {
            double wish;

            status->phase = INTERMEDIATE;
            wish = after_step(instance, end);
            status->phase = STEPPING;
            if (wish < end) {
                end = fmax(wish, status->time);
                wanted = end > status->time ? end - time : done;
            }
        }
    }
    return true;
}

/* ---- states ---- */

struct State {
    const Model *model;
    Kind kind;
    Status status;
    double values[]; /* x, u, p */
};

bool core_save(const Instance *instance, const Rule *rule, State **state) {
    size_t size;

    if (!core_has_places(instance, rule, 1, (const void *[]){state})) return false;
    size = n_values(instance->model) * sizeof(double);
    if (!*state) *state = malloc(sizeof **state + size);
    if (!*state) return core_refuse(instance, rule, "out of memory.");
    (*state)->model = instance->model;
    (*state)->kind = instance->kind;
    (*state)->status = instance->status;
    memcpy((*state)->values, instance->x, size);
    return true;
}

bool core_discard(const Instance *instance, const Rule *rule, State **state) {
    if (!core_allows(instance, rule)) return false;
    if (!state) return true;
    free(*state);
    *state = NULL;
    return true;
}

bool core_restore(Instance *instance, const Rule *rule, const State *state) {
    if (!core_allows(instance, rule)) return false;
    if (!state) return core_refuse(instance, rule, "the state is missing.");
    if (state->model != instance->model || state->kind != instance->kind) {
        return core_refuse(instance, rule, "the state is of another model or interface type.");
    }
    instance->status = state->status;
    memcpy(instance->x, state->values, n_values(instance->model) * sizeof(double));
    instance->x_current = true;
    outdate(instance);
    return true;
}

/* Layout: token, then eight bytes each, little end first: kind, phase, solver, six figures, values, and a checksum. */
#define N_INTEGERS 3
#define N_FIGURES 6

static size_t n_serialized(const Model *model) { return N_INTEGERS + N_FIGURES + n_values(model) + 1; }

static size_t serialized_size(const Model *model) { return strlen(model->token) + n_serialized(model) * sizeof(uint64_t); }

bool core_serialized_size(const Instance *instance, const Rule *rule, size_t *size) {
    if (!core_has_places(instance, rule, 1, (const void *[]){size})) return false;
    *size = serialized_size(instance->model);
    return true;
}

static unsigned char *put(unsigned char *bytes, uint64_t value) {
    size_t i;

    for (i = 0; i < sizeof value; i++) *bytes++ = (unsigned char)(value >> (8 * i));
    return bytes;
}

static uint64_t take(const unsigned char **bytes) {
    uint64_t value = 0;
    size_t i;

    for (i = 0; i < sizeof value; i++) {
        const uint64_t byte = *(*bytes)++;
        value |= byte << (8 * i);
    }
    return value;
}

static uint64_t bits_of(double value) {
    uint64_t bits;

    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static double double_of(uint64_t bits) {
    double value;

    memcpy(&value, &bits, sizeof value);
    return value;
}

/* FNV-1a. */
static uint64_t checksum(const unsigned char *bytes, size_t size) {
    uint64_t sum = 14695981039346656037u;
    size_t i;

    for (i = 0; i < size; i++) sum = (sum ^ bytes[i]) * 1099511628211u;
    return sum;
}

bool core_serialize(const Instance *instance, const Rule *rule, const State *state, unsigned char *bytes, size_t size) {
    unsigned char *end = bytes;
    size_t token_size, n, i;

    if (!core_allows(instance, rule)) return false;
    if (!state || !bytes) return core_refuse(instance, rule, "the state or the place for its bytes is missing.");
    if (size < serialized_size(instance->model)) {
        return core_refuse(instance, rule, "the state needs %lu bytes, not %lu.",
                           (unsigned long)serialized_size(instance->model), (unsigned long)size);
    }
    token_size = strlen(instance->model->token);
    n = n_values(instance->model);
    if (state->model != instance->model) return core_refuse(instance, rule, "the state is of another model.");
    memcpy(end, instance->model->token, token_size);
    end = put(end + token_size, state->kind);
    end = put(end, state->status.phase);
    end = put(end, state->status.solver.method);
    end = put(end, bits_of(state->status.solver.step));
    end = put(end, bits_of(state->status.solver.tolerance));
    end = put(end, bits_of(state->status.time));
    end = put(end, bits_of(state->status.stop_time));
    end = put(end, bits_of(state->status.experiment_tolerance));
    end = put(end, bits_of(state->status.step_proposal));
    for (i = 0; i < n; i++) end = put(end, bits_of(state->values[i]));
    put(end, checksum(bytes, (size_t)(end - bytes)));
    return true;
}

bool core_deserialize(const Instance *instance, const Rule *rule, const unsigned char *bytes, size_t size, State **state) {
    const unsigned char *next;
    size_t token_size, n, i;

    if (!core_allows(instance, rule)) return false;
    if (!bytes) return core_refuse(instance, rule, "the bytes are missing.");
    token_size = strlen(instance->model->token);
    n = n_values(instance->model);
    if (size != serialized_size(instance->model) || memcmp(bytes, instance->model->token, token_size) != 0) {
        return core_refuse(instance, rule, "the bytes are no state of this FMU.");
    }
    next = bytes + size - sizeof(uint64_t);
    if (take(&next) != checksum(bytes, size - sizeof(uint64_t))) return core_refuse(instance, rule, "the bytes were changed.");
    next = bytes + token_size;
    if (take(&next) != (uint64_t)instance->kind) {
        return core_refuse(instance, rule, "the bytes are a state of the other interface type.");
    }
    if (!core_save(instance, rule, state)) return false;
    (*state)->status.phase = (Phase)take(&next);
    (*state)->status.solver.method = (SolverMethod)take(&next);
    (*state)->status.solver.step = double_of(take(&next));
    (*state)->status.solver.tolerance = double_of(take(&next));
    (*state)->status.time = double_of(take(&next));
    (*state)->status.stop_time = double_of(take(&next));
    (*state)->status.experiment_tolerance = double_of(take(&next));
    (*state)->status.step_proposal = double_of(take(&next));
    for (i = 0; i < n; i++) (*state)->values[i] = double_of(take(&next));
    return true;
}
