/* Derivatives of unknowns, from the model's sparse Jacobian: directional, adjoint, and over time. */
#include "internal.h"

#include <string.h>

bool core_is_unknown(const Instance *instance, unsigned int reference) { return reference < core_n_unknowns(instance->model); }

/* The current phase's Jacobian, with instance->jacobian evaluated. */
static const Jacobian *evaluated_jacobian(Instance *instance) {
    const bool beginning = instance->status.phase == INITIALIZATION;
    const Jacobian *jacobian = beginning ? &instance->model->beginning : &instance->model->running;

    if (!instance->jacobian_current) {
        jacobian->evaluate(core_states(instance), instance->u, instance->p, instance->jacobian);
        instance->jacobian_current = true;
    }
    return jacobian;
}

/* The column of a known in the current phase's Jacobian, or -1. */
static int column_of(const Instance *instance, size_t reference) {
    const Model *model = instance->model;
    const size_t first_input = core_n_unknowns(model);
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

    memset(instance->sensitivity, 0, core_n_unknowns(instance->model) * sizeof(double));
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
        return core_refuse(instance, rule, "value reference %u is not an unknown (a state, a derivative or an output).",
                           unknowns[i]);
    }
    for (i = 0; i < n_known; i++) {
        if (column_of(instance, knowns[i]) >= 0) continue;
        return core_refuse(instance, rule, "value reference %u is not a known now (%s).", knowns[i],
                           beginning ? "an input or a parameter" : "a state or an input");
    }
    jacobian = evaluated_jacobian(instance);
    if (adjoint) {
        memset(instance->sensitivity, 0, core_n_unknowns(model) * sizeof(double));
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

    if (!core_has_arrays(instance, rule, n, unknowns, orders) || !core_has_array(instance, rule, n, values)) {
        return false;
    }
    model = instance->model;
    for (i = 0; i < n; i++) {
        if (orders[i] != 1) return core_refuse(instance, rule, "the order must be 1, not %d.", orders[i]);
        if (!core_is_unknown(instance, unknowns[i])) {
            return core_refuse(instance, rule, "value reference %u is not an output.", unknowns[i]);
        }
    }
    memset(instance->seed, 0, (model->n_states + model->n_inputs) * sizeof(double));
    memcpy(instance->seed, core_derivatives(instance), model->n_states * sizeof(double));
    multiply(instance, evaluated_jacobian(instance), model->n_states);
    for (i = 0; i < n; i++) values[i] = instance->sensitivity[unknowns[i]];
    return true;
}
