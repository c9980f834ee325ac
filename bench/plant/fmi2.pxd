# The functions of FMI 2.0.4 that are called in each cycle (sections 2.1.7 and 4.2.2); each returns an fmi2Status.

ctypedef int (*AccessReal)(void *component, const unsigned int *references, size_t count, double *values)
ctypedef int (*DoStep)(void *component, double time, double length, int no_set_prior)
