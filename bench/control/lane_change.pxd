cimport cython

cdef int _SAMPLES

@cython.final
cdef class LaneChange:
    cdef readonly double target, duration_s
    cdef double _y, _v, _a, _c3, _c4, _c5
    cpdef (double, double, double) at(self, double time_s)
    cpdef bint keeps(self, double acceleration, double jerk)
