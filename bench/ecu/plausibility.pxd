cdef class _Trust:
    cdef readonly bint given
    cdef int _agreed
    cpdef bint note(self, bint agrees)


cdef class OwnMotion:
    cdef readonly object state
    cdef readonly object cause
    cdef object _vehicle
    cdef dict _trust
    cdef dict _limits
    cdef object _pose
    cdef object _reckoned
    cdef object _measured_position
    cdef object _measured_yaw
    cdef object _moved
    cdef list _slip_errors
    cdef object _velocity
    cdef dict _timeouts
    cdef dict _missing
    cdef int _blind
    cdef double _way
