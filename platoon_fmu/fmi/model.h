/* The interface between a generated model and the FMI core: a table of values and functions.
 *
 * A model is a smooth, autonomous ODE: dx/dt = f(x, u, p), y = g(x, u, p), x(0) = x0(p). Its variables are reals whose
 * value references number states x, their derivatives, outputs y that are not states, inputs u and parameters p; the first
 * n_tunable parameters may be changed during the simulation, the others only before.
 * codegen.py writes the only definition of `platoon_model`.
 */
#ifndef PLATOON_MODEL_H
#define PLATOON_MODEL_H

#include <stddef.h>

/* A sparse Jacobian, column by column. Its rows are the unknowns: states, derivatives and outputs. */
typedef struct {
    const int *starts; /* index of each column's first nonzero, and the end of the last column */
    const int *rows;   /* of each nonzero */
    void (*evaluate)(const double *x, const double *u, const double *p, double *nonzeros);
} Jacobian;

/* A value for each setting of the core's solvers, by the name of its variable. */
typedef struct {
    double solver_step; /* [s] */
    double solver_tolerance;
    double solver; /* the item of the enumeration */
} Settings;

typedef struct {
    const char *token; /* the modelDescription's guid (FMI 2) or instantiationToken (FMI 3) */
    size_t n_states, n_outputs, n_inputs, n_parameters, n_tunable;
    size_t most_nonzeros;           /* of the two Jacobians */
    const double *nominals;         /* of the states */
    const double *inputs_start;     /* start values of u */
    const double *parameters_start; /* start values of p */
    const double *parameters_minimum, *parameters_maximum;
    Settings settings_start, settings_minimum, settings_maximum;
    void (*initial)(const double *p, double *x);
    void (*derivatives)(const double *x, const double *u, const double *p, double *dx);
    void (*outputs)(const double *x, const double *u, const double *p, double *y);
    void (*fastest)(const double *p, double *rate); /* upper bound of the decay rates [1/s] */
    Jacobian running;                               /* columns: states and inputs */
    Jacobian beginning;                             /* columns: inputs and parameters, which determine the initial states */
} Model;

extern const Model platoon_model;

#endif
