#include "core.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "solver.h"

/* Times that differ by less than this, relative to one second or to the time, are the same time to a master that sums
 * up its steps in its own way. */
#define TIME_TOLERANCE 1e-9

static void outdate(Instance *instance) {
    instance->dx_current = false;
    instance->y_current = false;
    /* Until the simulation starts the states follow the start parameters. */
    if (instance->phase & (INSTANTIATED | INITIALIZATION)) instance->x_current = false;
}

Instance *core_new(const Model *model, Kind kind) {
    const size_t n_x = model->n_states;
    const size_t n = n_x + model->n_inputs + model->n_parameters + n_x + model->n_outputs + SOLVER_WORK(n_x);
    Instance *instance = calloc(1, sizeof *instance);
    double *values = calloc(n, sizeof *values);

    if (!instance || !values) {
        free(instance);
        free(values);
        return NULL;
    }
    instance->model = model;
    instance->kind = kind;
    instance->x = values;
    instance->u = instance->x + n_x;
    instance->p = instance->u + model->n_inputs;
    instance->dx = instance->p + model->n_parameters;
    instance->y = instance->dx + n_x;
    instance->work = instance->y + model->n_outputs;
    core_reset(instance);
    return instance;
}

void core_free(Instance *instance) {
    if (!instance) return;
    free(instance->x);
    free(instance);
}

void core_reset(Instance *instance) {
    const Model *model = instance->model;

    instance->phase = INSTANTIATED;
    instance->time = 0;
    instance->stop_time = INFINITY;
    memcpy(instance->u, model->inputs_start, model->n_inputs * sizeof(double));
    memcpy(instance->p, model->parameters_start, model->n_parameters * sizeof(double));
    outdate(instance);
}

const double *core_states(Instance *instance) {
    if (!instance->x_current) {
        instance->model->initial(instance->p, instance->x);
        instance->x_current = true;
    }
    return instance->x;
}

const double *core_derivatives(Instance *instance) {
    if (!instance->dx_current) {
        instance->model->derivatives(core_states(instance), instance->u, instance->p, instance->dx);
        instance->dx_current = true;
    }
    return instance->dx;
}

static const double *outputs(Instance *instance) {
    if (!instance->y_current) {
        instance->model->outputs(core_states(instance), instance->u, instance->p, instance->y);
        instance->y_current = true;
    }
    return instance->y;
}

/* The value a reference stands for, or NULL for none. */
static const double *value_of(Instance *instance, size_t reference) {
    const Model *model = instance->model;

    if (reference < model->n_states) return core_states(instance) + reference;
    reference -= model->n_states;
    if (reference < model->n_states) return core_derivatives(instance) + reference;
    reference -= model->n_states;
    if (reference < model->n_outputs) return outputs(instance) + reference;
    reference -= model->n_outputs;
    /* Inputs and parameters lie one behind the other. */
    if (reference < model->n_inputs + model->n_parameters) return instance->u + reference;
    return NULL;
}

bool core_get(Instance *instance, const unsigned int *references, size_t n, double *values) {
    size_t i;

    for (i = 0; i < n; i++) {
        const double *value = value_of(instance, references[i]);
        if (!value) {
            snprintf(instance->message, sizeof instance->message, "no variable has the value reference %u", references[i]);
            return false;
        }
        values[i] = *value;
    }
    return true;
}

/* Where a settable variable's value lies, or NULL with the reason in the message. */
static double *settable(Instance *instance, size_t reference) {
    const Model *model = instance->model;
    const size_t first = 2 * model->n_states + model->n_outputs;
    const size_t end = first + model->n_inputs + model->n_parameters;
    const char *reason = NULL;

    if (reference >= end) {
        reason = "no variable has the value reference";
    } else if (reference < first) {
        reason = "neither an input nor a parameter and cannot be set: value reference";
    } else if (reference >= first + model->n_inputs) {
        const bool tunable = reference < first + model->n_inputs + model->n_tunable;
        const int phases = INSTANTIATED | INITIALIZATION | (tunable ? EVENT | STEPPING : 0);
        if (!(instance->phase & phases)) reason = "a parameter that cannot be changed now: value reference";
    }
    if (reason) {
        snprintf(instance->message, sizeof instance->message, "%s %lu", reason, (unsigned long)reference);
        return NULL;
    }
    return instance->u + (reference - first);
}

bool core_set(Instance *instance, const unsigned int *references, size_t n, const double *values) {
    size_t i;

    for (i = 0; i < n; i++) {
        if (!settable(instance, references[i])) return false;
        if (!isfinite(values[i])) {
            snprintf(instance->message, sizeof instance->message, "value reference %u cannot be set to %g, which is not finite",
                     references[i], values[i]);
            return false;
        }
    }
    for (i = 0; i < n; i++) *settable(instance, references[i]) = values[i];
    outdate(instance);
    return true;
}

static bool all_finite(const double *x, size_t n) {
    size_t i;

    for (i = 0; i < n; i++) {
        if (!isfinite(x[i])) return false;
    }
    return true;
}

bool core_set_states(Instance *instance, const double *x) {
    const size_t n = instance->model->n_states;

    if (!all_finite(x, n)) {
        snprintf(instance->message, sizeof instance->message, "a continuous state cannot be set to a value that is not finite");
        return false;
    }
    memcpy(instance->x, x, n * sizeof *x);
    instance->x_current = true;
    outdate(instance);
    return true;
}

void core_start(Instance *instance) {
    core_states(instance);
    instance->phase = instance->kind == MODEL_EXCHANGE ? EVENT : STEPPING;
}

bool core_step(Instance *instance, double time, double h) {
    const double tolerance = TIME_TOLERANCE * fmax(1.0, fabs(instance->time));

    if (!(fabs(time - instance->time) <= tolerance)) {
        snprintf(instance->message, sizeof instance->message, "a step must start at %.17g s, where the last one ended, not at %.17g s",
                 instance->time, time);
        return false;
    }
    if (!(h > 0) || !isfinite(h)) {
        snprintf(instance->message, sizeof instance->message, "the step size must be greater than 0 s, not %g s", h);
        return false;
    }
    if (time + h > instance->stop_time + tolerance) {
        snprintf(instance->message, sizeof instance->message, "a step to %.17g s would pass the stop time %.17g s", time + h,
                 instance->stop_time);
        return false;
    }
    solver_advance(instance->model, instance->x, instance->u, instance->p, h, instance->work);
    outdate(instance);
    if (!all_finite(instance->x, instance->model->n_states)) {
        instance->phase = FAILED;
        snprintf(instance->message, sizeof instance->message, "the step from %g s by %g s diverged: a state is not finite", time, h);
        return false;
    }
    instance->time = time + h;
    return true;
}
