cdef class PeerWatch:
    cdef readonly object topics, motion, cause, report
    cdef readonly bint heard
    cdef public double braking, crawl
    cdef object _position_limits, _motion_limits, _reckoned
    cdef int _agreed
    cdef bint _lost

    cdef object _listen(self, object status)
    cdef object _slowing(self, object motion)
    cdef object _judge(self, bint plausible, bint lost)
    cdef bint _is_plausible(self, object told, object position, object motion) except -1
