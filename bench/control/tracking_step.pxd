from bench.control.observer cimport DisturbanceObserver
from bench.control.reference cimport ReferenceSearch
from bench.control.target cimport TargetSearch

cdef class TrackingStep:
    cdef object _allocation
    cdef DisturbanceObserver _observer
    cdef ReferenceSearch _search
    cdef TargetSearch _target_search
    cdef bint _offset_free, _has_model
    cdef double _T
    cdef double[:, :, ::1] _model
    cdef double[:, ::1] _of_virtual, _real_B, _real_N2
    cdef double[::1] _numbers, _limit, _rate, _reference, _reference_u, _drift, _u, _target_u
    cdef double[::1] _xi, _next, _u_dev, _residual, _known, _lower, _upper

    cdef object _measure(self, double[::1] disturbance, double[::1] xi, object applied)
    cdef void _set_reference_state(self, double[::1] xi, double v_x, double gamma) noexcept
    cdef void _linearise(self, double[::1] xi, double[::1] U) noexcept
    cdef object _set_target(self, double[::1] target, double[::1] disturbance, double[::1] reference_u)
