cdef class DisturbanceObserver:
    cdef double[:, ::1] _gain
    cdef double[::1] _state, _error, _previous, _disturbance, _next
    cdef double _step_s
    cdef bint _started

    cdef void set_disturbance(self, double[::1] out, double[::1] xi) noexcept
    cpdef object predict(self, double[:, ::1] A, double[:, ::1] B, double[::1] xi_ref, double[::1] u_dev, double[::1] drift)
