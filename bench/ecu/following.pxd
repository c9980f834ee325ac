cdef class Following:
    cdef readonly object cause
    cdef object _asked
    cdef int _off, _good, _waiting
    cdef bint _tracker_lost

    cdef object _look(self, object status)
    cdef object _compare(self, double v_x, double yaw_rate)
