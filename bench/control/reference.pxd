cdef int STATES, INPUTS, REAL_INPUTS

cdef class ReferenceSearch:
    cdef double[::1] _numbers, _limit, _Q, _R, _z, _lower, _upper, _better, _gradient
    cdef double[:, ::1] _matrix, _hessian, _box_work, _spare

    cpdef bint find(self, double[::1] u, double[::1] residual, double[::1] xi, double[::1] xi_next, double[::1] start, int passes) except -1
