/* Loops that call an FMU, or the model inside it, many times: its run times without a scripting language.
 *
 * Compiled together with the FMU's sources, of which `platoon_model` is used. The FMI functions are those of the FMU's
 * own binary, passed by address. Every function returns the mean seconds per unit of work, or -1 if the FMU refused a
 * call or has too many states for the arrays here.
 */
#define _POSIX_C_SOURCE 200809L /* clock_gettime */

#include <stddef.h>
#include <time.h>

#include "fmi2FunctionTypes.h"
#include "fmi3FunctionTypes.h"
#include "model.h"

#define EXPORTED __attribute__((visibility("default")))
#define FAILED (-1.0)
#define MOST_STATES 64

static double now(void) {
    struct timespec t;

    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* A right-hand side without any FMI, at n points in turn; with start values for inputs and parameters. */
EXPORTED double time_model(const double *points, size_t n, size_t calls) {
    double dx[MOST_STATES];
    const double start = now();
    size_t i;

    if (platoon_model.n_states > MOST_STATES) return FAILED;
    for (i = 0; i < calls; i++) {
        platoon_model.derivatives(points + i % n * platoon_model.n_states, platoon_model.inputs_start,
                                  platoon_model.parameters_start, dx);
    }
    return (now() - start) / (double)calls;
}

/* A right-hand side of Model Exchange: states in, derivatives out. */
EXPORTED double time_right_hand_side(fmi2SetContinuousStatesTYPE *set, fmi2GetDerivativesTYPE *get, fmi2Component instance,
                                     const double *points, size_t n, size_t n_states, size_t calls) {
    double dx[MOST_STATES];
    const double start = now();
    size_t i;

    if (n_states > MOST_STATES) return FAILED;
    for (i = 0; i < calls; i++) {
        if (set(instance, points + i % n * n_states, n_states) != fmi2OK) return FAILED;
        if (get(instance, dx, n_states) != fmi2OK) return FAILED;
    }
    return (now() - start) / (double)calls;
}

/* The derivatives' Jacobian with respect to the states, column by column, from directional derivatives. */
EXPORTED double time_directional(fmi2SetContinuousStatesTYPE *set, fmi2GetDirectionalDerivativeTYPE *differentiate,
                                 fmi2Component instance, const fmi2ValueReference *states,
                                 const fmi2ValueReference *derivatives, const double *points, size_t n, size_t n_states,
                                 size_t calls) {
    static const double ONE = 1.0;
    double column[MOST_STATES];
    const double start = now();
    size_t i, k;

    if (n_states > MOST_STATES) return FAILED;
    for (i = 0; i < calls; i++) {
        if (set(instance, points + i % n * n_states, n_states) != fmi2OK) return FAILED;
        for (k = 0; k < n_states; k++) {
            if (differentiate(instance, derivatives, n_states, states + k, 1, &ONE, column) != fmi2OK) return FAILED;
        }
    }
    return (now() - start) / (double)calls;
}

/* The same Jacobian from central differences: two right-hand sides per column. */
EXPORTED double time_differences(fmi2SetContinuousStatesTYPE *set, fmi2GetDerivativesTYPE *get, fmi2Component instance,
                                 const double *points, size_t n, size_t n_states, size_t calls) {
    static const double WIDTH = 1e-6;
    double x[MOST_STATES], before[MOST_STATES], after[MOST_STATES];
    volatile double used = 0;
    const double start = now();
    size_t i, j, k;

    if (n_states > MOST_STATES) return FAILED;
    for (i = 0; i < calls; i++) {
        for (j = 0; j < n_states; j++) x[j] = points[i % n * n_states + j];
        for (k = 0; k < n_states; k++) {
            const double middle = x[k];
            x[k] = middle + WIDTH;
            if (set(instance, x, n_states) != fmi2OK || get(instance, after, n_states) != fmi2OK) return FAILED;
            x[k] = middle - WIDTH;
            if (set(instance, x, n_states) != fmi2OK || get(instance, before, n_states) != fmi2OK) return FAILED;
            x[k] = middle;
            for (j = 0; j < n_states; j++) used = (after[j] - before[j]) / (2 * WIDTH);
        }
    }
    (void)used;
    return (now() - start) / (double)calls;
}

/* Steps of h seconds from `time`, each instance in turn; per step and instance. */
EXPORTED double time_steps_2(fmi2DoStepTYPE *step, const fmi2Component *instances, size_t n, double time, double h,
                             size_t steps) {
    const double start = now();
    size_t i, k;

    for (k = 0; k < steps; k++) {
        for (i = 0; i < n; i++) {
            if (step(instances[i], time + (double)k * h, h, fmi2True) != fmi2OK) return FAILED;
        }
    }
    return (now() - start) / (double)(steps * n);
}

/* The same for FMI 3.0. */
EXPORTED double time_steps_3(fmi3DoStepTYPE *step, const fmi3Instance *instances, size_t n, double time, double h,
                             size_t steps) {
    fmi3Boolean event, end, early;
    fmi3Float64 reached;
    const double start = now();
    size_t i, k;

    for (k = 0; k < steps; k++) {
        for (i = 0; i < n; i++) {
            if (step(instances[i], time + (double)k * h, h, fmi3True, &event, &end, &early, &reached) != fmi3OK) return FAILED;
        }
    }
    return (now() - start) / (double)(steps * n);
}
