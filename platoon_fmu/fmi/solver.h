/* The solvers of the co-simulation; one call is one solver step, with constant inputs. */
#ifndef PLATOON_SOLVER_H
#define PLATOON_SOLVER_H

#include "model.h"

/* Numbered as in the modelDescription's enumeration. */
typedef enum { RUNGE_KUTTA_4 = 1, DORMAND_PRINCE_5 = 2 } SolverMethod;

typedef struct {
    SolverMethod method;
    double step;      /* longest step of the fixed-step method [s] */
    double tolerance; /* of the adaptive one: relative, and absolute to the states' nominals */
} SolverSettings;

/* Number of doubles of work space for either. */
#define SOLVER_WORK(n_states) (7 * (n_states))

/* Longest step of the method of order 4 relative to the shortest time constant; its stability limit is 2.785. */
#define SOLVER_STABLE 2.5

/* The classical Runge-Kutta method of order 4: from x, where the derivatives are dx, by `remaining` seconds in steps of
 * equal length not above settings->step. Performs the first of them and returns its length. */
double solver_fixed_step(const Model *model, const SolverSettings *settings, double remaining, double *x, const double *dx,
                         const double *u, const double *p, double *work);

/* The pair of orders 5 and 4 of Dormand and Prince (J. Comput. Appl. Math. 6, 1980), with error-controlled step
 * size: advances x, where the derivatives are dx, by at most `remaining` seconds, and writes the derivatives at the new x
 * to dx. `proposal` is the step to try, and then the next one. Returns the step taken, or 0 if even the shortest step
 * violates the tolerance; x and dx are then unchanged. */
double solver_adaptive_step(const Model *model, const SolverSettings *settings, double remaining, double *proposal, double *x,
                            double *dx, const double *u, const double *p, double *work);

#endif
