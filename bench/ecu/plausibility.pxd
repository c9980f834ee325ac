cdef class _Trust:
    cdef readonly bint given
    cdef int _agreed
    cpdef bint note(self, bint agrees)


cdef class _Velocity:
    cdef double v_x, v_y, gamma


cdef class _Pose:
    cdef double x, y, yaw


cdef class OwnMotion:
    cdef readonly object state
    cdef readonly object cause
    cdef double _l_r, _M_l_f, _L_C_r, _R_w, _l_t
    cdef bint _complete
    cdef dict _trust
    cdef dict _limits
    cdef _Pose _pose
    cdef _Pose _reckoned
    cdef object _measured_position
    cdef object _measured_yaw
    cdef object _moved
    cdef list _slip_errors
    cdef _Velocity _velocity
    cdef dict _timeouts
    cdef dict _missing
    cdef int _blind
    cdef double _way

    cdef _Velocity _velocities(self, object position, object attitude, object motion, object front, object rear)
    cdef object _yaw_rate(self, object attitude, object motion, object front, object rear)
    cdef tuple _from_positions(self, object position)
    cdef object _wheel_speed(self, double gamma, object front, object rear)
    cdef object _reckon(self, _Velocity velocity, object position, object attitude, double elapsed_s)
    cdef bint _yaw_rate_is_wrong(self, double reckoned, double seen, double v_y) except -1
    cdef object _cause(self, bint known, bint in_range)
