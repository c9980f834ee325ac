/* Values by value reference (core.h says in which order): get and set. */
#include "internal.h"

#include <math.h>

/* The core's own variables, in the order of their value references. */
enum { TIME, SOLVER_STEP, SOLVER_TOLERANCE, SOLVER, N_OF_CORE };

static size_t first_own(const Model *model) { return core_n_unknowns(model) + model->n_inputs + model->n_parameters; }

/* The value of a reference, or NULL if there is none. */
static const double *value_of(Instance *instance, size_t reference) {
    const Model *model = instance->model;

    if (reference < model->n_states) return core_states(instance) + reference;
    reference -= model->n_states;
    if (reference < model->n_states) return core_derivatives(instance) + reference;
    reference -= model->n_states;
    if (reference < model->n_outputs) return core_outputs(instance) + reference;
    reference -= model->n_outputs;
    /* Inputs and parameters are contiguous. */
    if (reference < model->n_inputs + model->n_parameters) return instance->u + reference;
    switch (reference - model->n_inputs - model->n_parameters) {
        case TIME: return &instance->status.time;
        case SOLVER_STEP: return &instance->status.solver.step;
        case SOLVER_TOLERANCE: return &instance->status.solver.tolerance;
        default: return NULL;
    }
}

/* Refuses a reference that is not a variable of the type. */
static bool no_such(const Instance *instance, const Rule *rule, const char *type, unsigned int reference) {
    if (reference >= first_own(instance->model) + N_OF_CORE) {
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
    if (reference != first_own(instance->model) + SOLVER) return no_such(instance, rule, "Enumeration", reference);
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

/* The same for a parameter of the model. Inputs may exceed their limits, because an importer's solver may try such values. */
static bool parameter_in_range(const Instance *instance, const Rule *rule, unsigned int reference, double value) {
    const size_t i = reference - core_n_unknowns(instance->model) - instance->model->n_inputs;

    return in_range(instance, rule, reference, value, instance->model->parameters_minimum[i],
                    instance->model->parameters_maximum[i]);
}

/* The location of a real variable's value, or NULL (logged) if it cannot be set to this value. */
static double *settable(Instance *instance, const Rule *rule, unsigned int reference, double value) {
    const Model *model = instance->model;
    const Settings *least = &model->settings_minimum, *most = &model->settings_maximum;
    const size_t first = core_n_unknowns(model), of_core = first_own(model);
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
        if (in_range(instance, rule, reference, value, least->solver_step, most->solver_step)) {
            place = &instance->status.solver.step;
        }
    } else if (reference == of_core + SOLVER_TOLERANCE) {
        if (in_range(instance, rule, reference, value, least->solver_tolerance, most->solver_tolerance)) {
            place = &instance->status.solver.tolerance;
        }
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
    core_outdate(instance);
    return true;
}

bool core_can_set_integer(const Instance *instance, const Rule *rule, unsigned int reference, double value) {
    if (reference != first_own(instance->model) + SOLVER) return no_such(instance, rule, "Enumeration", reference);
    if (!(instance->status.phase & (INSTANTIATED | INITIALIZATION))) {
        return core_refuse(instance, rule, "value reference %u is a parameter that cannot be changed now.", reference);
    }
    return in_range(instance, rule, reference, value, instance->model->settings_minimum.solver,
                    instance->model->settings_maximum.solver);
}

void core_set_integer(Instance *instance, int value) { instance->status.solver.method = (SolverMethod)value; }
