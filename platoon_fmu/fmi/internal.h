/* Shared by the core's own files. The faces only use core.h. */
#ifndef PLATOON_INTERNAL_H
#define PLATOON_INTERNAL_H

#include "core.h"

/* Number of unknowns: states, derivatives and outputs, which have the first value references. */
size_t core_n_unknowns(const Model *model);

/* Number of values of an instance: x, u and p, in one block. */
size_t core_n_values(const Model *model);

const char *core_phase_name(Phase phase);

/* Whether an array is present or has no elements; logged if not. */
bool core_has_array(const Instance *instance, const Rule *rule, size_t n, const void *array);

bool core_all_finite(const double *values, size_t n);

/* Invalidates what followed from changed values. */
void core_outdate(Instance *instance);

/* What follows from the values, evaluated if outdated. */
const double *core_states(Instance *instance);
const double *core_derivatives(Instance *instance);
const double *core_outputs(Instance *instance);

#endif
