#include "solver.h"

#include <math.h>
#include <string.h>

double solver_fixed_step(const Model *model, const SolverSettings *settings, double remaining, double *x, const double *dx,
                         const double *u, const double *p, double *work) {
    const size_t n = model->n_states;
    /* The slack makes 0.01 s ten steps of 1 ms, whichever way 0.01/0.001 rounds. */
    const double steps = fmax(1.0, ceil(remaining / settings->step * (1 - 1e-12)));
    const double dt = remaining / steps;
    double *k2 = work, *k3 = k2 + n, *k4 = k3 + n, *at = k4 + n;
    size_t i;

    for (i = 0; i < n; i++) at[i] = x[i] + dt / 2 * dx[i];
    model->derivatives(at, u, p, k2);
    for (i = 0; i < n; i++) at[i] = x[i] + dt / 2 * k2[i];
    model->derivatives(at, u, p, k3);
    for (i = 0; i < n; i++) at[i] = x[i] + dt * k3[i];
    model->derivatives(at, u, p, k4);
    for (i = 0; i < n; i++) x[i] += dt / 6 * (dx[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
    return dt;
}

#define STAGES 7
#define SHORTEST 1e-9 /* [s] */

/* Butcher's table of the pair: the last row is also the solution of order 5, so its stage is the first of the next step. */
static const double STAGE[STAGES][STAGES - 1] = {
    {0},
    {1.0 / 5},
    {3.0 / 40, 9.0 / 40},
    {44.0 / 45, -56.0 / 15, 32.0 / 9},
    {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
    {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
    {35.0 / 384, 0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84},
};
/* Order 5 less order 4. */
static const double ERROR[STAGES] = {71.0 / 57600, 0, -71.0 / 16695, 71.0 / 1920, -17253.0 / 339200, 22.0 / 525, -1.0 / 40};

/* The error estimate relative to the tolerance; up to 1 the step is accepted. */
static double relative_error(const Model *model, const SolverSettings *settings, double dt, const double *x,
                             const double *x_new, const double *const *k) {
    const size_t n = model->n_states;
    double sum = 0;
    size_t i, j;

    for (i = 0; i < n; i++) {
        const double allowed = settings->tolerance * (model->nominals[i] + fmax(fabs(x[i]), fabs(x_new[i])));
        double error = 0;
        for (j = 0; j < STAGES; j++) error += ERROR[j] * k[j][i];
        sum += dt * error / allowed * (dt * error / allowed);
    }
    return sqrt(sum / (double)n);
}

double solver_adaptive_step(const Model *model, const SolverSettings *settings, double remaining, double *proposal, double *x,
                            double *dx, const double *u, const double *p, double *work) {
    const size_t n = model->n_states;
    double *at = work + 6 * n;
    const double *k[STAGES];
    double dt = *proposal;
    size_t i, j, s;

    k[0] = dx;
    for (s = 1; s < STAGES; s++) k[s] = work + (s - 1) * n;
    for (;;) {
        const int is_last = dt >= remaining;
        double error, factor;

        if (is_last) dt = remaining;
        for (s = 1; s < STAGES; s++) {
            for (i = 0; i < n; i++) {
                double slope = 0;
                for (j = 0; j < s; j++) slope += STAGE[s][j] * k[j][i];
                at[i] = x[i] + dt * slope;
            }
            model->derivatives(at, u, p, work + (s - 1) * n);
        }
        error = relative_error(model, settings, dt, x, at, k);
        /* The fourth root instead of the fifth: only square roots round alike on every processor. An error that is NaN
         * requires a much shorter step. */
        factor = error >= 0 ? fmin(5.0, fmax(0.2, 0.9 / sqrt(sqrt(error)))) : 0.1;
        if (error <= 1) {
            memcpy(x, at, n * sizeof *x);
            memcpy(dx, k[STAGES - 1], n * sizeof *dx);
            /* A step shortened by the communication point is no reason against the longer one proposed before. */
            *proposal = is_last ? fmax(*proposal, dt * factor) : dt * factor;
            return dt;
        }
        dt *= factor;
        *proposal = dt;
        if (dt < SHORTEST) return 0;
    }
}
