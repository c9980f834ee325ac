/* The one interface between a generated model and the FMI core: a table of figures and functions.
 *
 * A model is a smooth, autonomous ODE: dx/dt = f(x, u, p), y = g(x, u, p), x(0) = x0(p). Its variables are reals whose
 * value references count through states x, their derivatives, outputs y that are no states, inputs u and parameters p;
 * of the parameters, the first n_tunable may be changed while simulating, the rest only before.
 * build.py writes the only definition of `platoon_model`.
 */
#ifndef PLATOON_MODEL_H
#define PLATOON_MODEL_H

#include <stddef.h>

typedef struct {
    const char *token; /* the modelDescription's guid (FMI 2) or instantiationToken (FMI 3) */
    size_t n_states, n_outputs, n_inputs, n_parameters, n_tunable;
    const double *nominals;        /* of the states */
    const double *inputs_start;    /* start values of u */
    const double *parameters_start; /* start values of p */
    double solver_step;            /* longest step of the co-simulation's solver [s] */
    void (*initial)(const double *p, double *x);
    void (*derivatives)(const double *x, const double *u, const double *p, double *dx);
    void (*outputs)(const double *x, const double *u, const double *p, double *y);
} Model;

extern const Model platoon_model;

#endif
