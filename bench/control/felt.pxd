cimport cython

@cython.final
cdef class Felt:
    cdef double[::1] _x, _y
    cdef long long _known
    cdef int _count
    cdef double _a_x, _a_y, _swing_x, _swing_y
    cpdef void forget(self)
    cpdef bint exceeds(self, double a_x, double a_y)
