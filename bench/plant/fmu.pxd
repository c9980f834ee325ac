from bench.plant.fmi2 cimport AccessReal, DoStep

cdef int _WARNING, _TRUE

cdef class _Values:
    cdef readonly object references, values
    cdef unsigned int *first_reference
    cdef double *first
    cdef size_t count

cdef class FmuInstance:
    cdef readonly str name
    cdef object _component
    cdef _Values _outputs, _inputs
    cdef void *_handle
    cdef AccessReal _get_real, _set_real
    cdef DoStep _do_step

    cdef object _get(self, _Values of)
    cdef object _check(self, str function, int status)
