/* The one interface between a generated model and the FMI core: a table of figures and functions.
 *
 * A model is a smooth, autonomous ODE: dx/dt = f(x, u, p), y = g(x, u, p), x(0) = x0(p). Its variables are reals whose
 * value references count through states x, their derivatives, outputs y that are no states, inputs u and parameters p;
 * of the parameters, the first n_tunable may be changed while simulating, the rest only before.
 * codegen.py writes the only definition of `platoon_model`.
 */
#ifndef PLATOON_MODEL_H
#define PLATOON_MODEL_H

#include <stddef.h>

/* A sparse Jacobian, column by column. Its rows are the unknowns: states, derivatives and outputs. */
typedef struct {
    const int *starts; /* of each column, and the end of the last: where its nonzeros begin */
    const int *rows;   /* of each nonzero */
    void (*evaluate)(const double *x, const double *u, const double *p, double *nonzeros);
} Jacobian;

/* A figure for each setting of the core's solvers, by the name of its variable. */
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
    void (*fastest)(const double *p, double *rate); /* the fastest decay there can be [1/s] */
    Jacobian running;                               /* columns: states and inputs */
    Jacobian beginning;                             /* columns: inputs and parameters, which the states at the start follow */
} Model;

extern const Model platoon_model;

#endif
