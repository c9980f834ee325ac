/* The co-simulation's solver: classical Runge-Kutta of order 4 with a fixed step. */
#ifndef PLATOON_SOLVER_H
#define PLATOON_SOLVER_H

#include "model.h"

/* Doubles of work space that solver_advance needs for a model of n states. */
#define SOLVER_WORK(n) (5 * (n))

/* Advances x by h seconds in equal steps no longer than the model's solver_step, inputs and parameters constant. */
void solver_advance(const Model *model, double *x, const double *u, const double *p, double h, double *work);

#endif
