/* An instance's life cycle: creation, start, phases, release; and the lazy evaluation of what follows from its values. */
#include "internal.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FIRST_PROPOSAL 1e-3 /* [s] */

size_t core_n_unknowns(const Model *model) { return 2 * model->n_states + model->n_outputs; }

size_t core_n_values(const Model *model) { return model->n_states + model->n_inputs + model->n_parameters; }

bool core_all_finite(const double *values, size_t n) {
    size_t i;

    for (i = 0; i < n; i++) {
        if (!isfinite(values[i])) return false;
    }
    return true;
}

void core_outdate(Instance *instance) {
    instance->dx_current = false;
    instance->y_current = false;
    instance->jacobian_current = false;
    /* Until the simulation starts the states follow the start parameters. */
    if (instance->status.phase & (INSTANTIATED | INITIALIZATION)) instance->x_current = false;
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

const double *core_outputs(Instance *instance) {
    if (!instance->y_current) {
        instance->model->outputs(core_states(instance), instance->u, instance->p, instance->y);
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
        .solver = {.step = model->settings_start.solver_step,
                   .tolerance = model->settings_start.solver_tolerance,
                   .method = (SolverMethod)model->settings_start.solver},
        .phase = INSTANTIATED,
    };

    instance->status = fresh;
    memcpy(instance->u, model->inputs_start, model->n_inputs * sizeof(double));
    memcpy(instance->p, model->parameters_start, model->n_parameters * sizeof(double));
    core_outdate(instance);
}

Instance *core_new(const Model *model, Kind kind, const char *name, LogSink sink, void *host) {
    const size_t n_x = model->n_states;
    const size_t n_known = model->n_inputs + (n_x > model->n_parameters ? n_x : model->n_parameters);
    const size_t n_scratch =
        n_x + model->n_outputs + model->most_nonzeros + n_known + core_n_unknowns(model) + SOLVER_WORK(n_x);
    const size_t name_size = strlen(name) + 1;
    Instance *instance = calloc(1, sizeof *instance);

    if (!instance) return NULL;
    instance->x = calloc(core_n_values(model) + n_scratch, sizeof(double));
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
    instance->work = instance->sensitivity + core_n_unknowns(model);
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
    char text[LONGEST_MESSAGE];

    if (!core_allows(instance, rule)) return false;
    if (instance->status.phase == INITIALIZATION) {
        core_states(instance);
        /* From here on another Jacobian applies. */
        instance->jacobian_current = false;
    }
    instance->status.phase = instance->kind == MODEL_EXCHANGE ? exchange : simulation;
    if (instance->logged & LOG_EVENTS) {
        snprintf(text, sizeof text, "%s from %g s on", core_phase_name(instance->status.phase), instance->status.time);
        instance->sink(instance, LOG_EVENTS, text);
    }
    return true;
}
