/* Co-Simulation: steps of the core's own solvers. */
#include "internal.h"

#include <math.h>

/* Times that differ by less than this, relative to one second or to the time, are equal, since importers sum their steps
 * differently; but never times that differ by half a step. */
#define TIME_TOLERANCE 1e-9
/* Smallest tolerance of the adaptive solver; below it, rounding dominates. */
#define LEAST_TOLERANCE 1e-13

/* The solver's settings for a step: those of the parameters, limited by the model and the experiment. */
static SolverSettings settings_of_step(const Instance *instance) {
    SolverSettings settings = instance->status.solver;
    double rate;

    /* A longer fixed step would be unstable at the fastest decay, without any other sign of it. */
    instance->model->fastest(instance->p, &rate);
    settings.step = fmin(settings.step, SOLVER_STABLE / rate);
    settings.tolerance = fmax(fmin(settings.tolerance, instance->status.experiment_tolerance), LEAST_TOLERANCE);
    return settings;
}

/* One step of the solver; returns its length, or 0 if it failed. */
static double advance(Instance *instance, const SolverSettings *settings, double remaining) {
    double length;

    core_derivatives(instance);
    if (settings->method == RUNGE_KUTTA_4) {
        length = solver_fixed_step(instance->model, settings, remaining, instance->x, instance->dx, instance->u, instance->p,
                                   instance->work);
    } else {
        length = solver_adaptive_step(instance->model, settings, remaining, &instance->status.step_proposal, instance->x,
                                      instance->dx, instance->u, instance->p, instance->work);
    }
    core_outdate(instance);
    /* The adaptive method has written the derivatives at the new states. */
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
    /* Elapsed and remaining time are relative to the start of the step, so that rounding does not depend on the time. */
    double done = 0, wanted = h, end = time + h;
    SolverSettings settings;
    Status *status;

    if (!core_allows(instance, rule)) return false;
    status = &instance->status;
    if (!(h > 0) || !isfinite(h)) {
        return core_refuse(instance, rule, "the step size must be greater than 0 s and finite, not %g s.", h);
    }
    if (end == time) return core_refuse(instance, rule, "the step size %g s vanishes in rounding at the time %g s.", h, time);
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
        if (!core_all_finite(instance->x, instance->model->n_states))
            return fail(instance, rule, time, "a state is not finite");
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
