/* What the core's own files share. The faces see core.h only. */
#ifndef PLATOON_INTERNAL_H
#define PLATOON_INTERNAL_H

#include "core.h"

/* How many variables are unknowns: states, derivatives and outputs, which have the first value references. */
size_t core_n_unknowns(const Model *model);

/* How many values are an instance's own: x, u and p, in one block. */
size_t core_n_values(const Model *model);

const char *core_phase_name(Phase phase);

/* Whether an array is there, which may be missing where it has no elements; logged where it is not. */
bool core_has_array(const Instance *instance, const Rule *rule, size_t n, const void *array);

bool core_all_finite(const double *values, size_t n);

/* Forgets what followed from values that have changed. */
void core_outdate(Instance *instance);

/* What follows from the values, evaluated where it is not yet. */
const double *core_states(Instance *instance);
const double *core_derivatives(Instance *instance);
const double *core_outputs(Instance *instance);

#endif
