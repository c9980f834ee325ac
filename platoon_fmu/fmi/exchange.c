/* Model Exchange: the time and the continuous states, which the importer integrates. */
#include "internal.h"

#include <math.h>
#include <string.h>

bool core_set_time(Instance *instance, const Rule *rule, double time) {
    if (!core_allows(instance, rule)) return false;
    if (!isfinite(time)) return core_refuse(instance, rule, "the time is not finite.");
    instance->status.time = time;
    return true;
}

/* Whether the call is allowed and its array has the model's number of states. */
static bool with_states(const Instance *instance, const Rule *rule, const double *values, size_t n) {
    if (!core_allows(instance, rule) || !core_has_array(instance, rule, n, values)) return false;
    if (n == instance->model->n_states) return true;
    return core_refuse(instance, rule, "the model has %lu continuous states, not %lu.",
                       (unsigned long)instance->model->n_states, (unsigned long)n);
}

bool core_set_states(Instance *instance, const Rule *rule, const double *x, size_t n) {
    if (!with_states(instance, rule, x, n)) return false;
    if (!core_all_finite(x, n)) return core_refuse(instance, rule, "a state cannot be set to a value that is not finite.");
    memcpy(instance->x, x, n * sizeof *x);
    instance->x_current = true;
    core_outdate(instance);
    return true;
}

bool core_get_states(Instance *instance, const Rule *rule, double *x, size_t n) {
    if (!with_states(instance, rule, x, n)) return false;
    memcpy(x, core_states(instance), n * sizeof *x);
    return true;
}

bool core_get_derivatives(Instance *instance, const Rule *rule, double *dx, size_t n) {
    if (!with_states(instance, rule, dx, n)) return false;
    memcpy(dx, core_derivatives(instance), n * sizeof *dx);
    return true;
}

bool core_get_nominals(Instance *instance, const Rule *rule, double *nominals, size_t n) {
    if (!with_states(instance, rule, nominals, n)) return false;
    memcpy(nominals, instance->model->nominals, n * sizeof *nominals);
    return true;
}
