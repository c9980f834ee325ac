cimport cython

@cython.final
cdef class Ramp:
    cdef readonly double value
    cdef double[::1] _past
    cdef int _count, _place
    cdef double _swing, _step
    cpdef void reset(self, double value)
    cpdef double towards(self, double wanted)
    cpdef void put(self, double value)
