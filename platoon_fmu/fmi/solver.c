#include "solver.h"

#include <math.h>

static void step(const Model *model, double *x, const double *u, const double *p, double dt, double *work) {
    const size_t n = model->n_states;
    double *k1 = work, *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n, *at = k4 + n;
    size_t i;

    model->derivatives(x, u, p, k1);
    for (i = 0; i < n; i++) at[i] = x[i] + dt / 2 * k1[i];
    model->derivatives(at, u, p, k2);
    for (i = 0; i < n; i++) at[i] = x[i] + dt / 2 * k2[i];
    model->derivatives(at, u, p, k3);
    for (i = 0; i < n; i++) at[i] = x[i] + dt * k3[i];
    model->derivatives(at, u, p, k4);
    for (i = 0; i < n; i++) x[i] += dt / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
}

void solver_advance(const Model *model, double *x, const double *u, const double *p, double h, double *work) {
    /* The slack keeps 0.01 s at ten steps of 1 ms, whichever way 0.01/0.001 rounds. */
    const double steps = fmax(1.0, ceil(h / model->solver_step * (1 - 1e-12)));
    const double dt = h / steps;
    double done;

    for (done = 0; done < steps; done++) step(model, x, u, p, dt, work);
}
