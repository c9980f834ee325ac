cdef class TargetSearch:
    cdef double[::1] _state_unit, _input_unit, _g, _low, _high, _rest, _z, _needed, _per_v_y
    cdef double[:, ::1] _inverse, _H, _box_work

    cpdef bint find(self, double[::1] xi, double[::1] u, double[:, ::1] A, double[:, ::1] B, double[::1] disturbance, double[::1] u_ref, double[::1] lower, double[::1] upper) except -1
    cdef bint _is_exact(self, double[::1] xi, double[::1] u, double[:, ::1] A, double[:, ::1] B, double[::1] disturbance, double[::1] u_ref, double[::1] lower, double[::1] upper) except -1
    cdef bint _is_nearest(self, double[::1] xi, double[::1] u, double[:, ::1] A, double[:, ::1] B, double[::1] disturbance, double[::1] u_ref, double[::1] lower, double[::1] upper) except -1
