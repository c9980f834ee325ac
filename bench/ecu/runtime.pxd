cdef class _Due:
    cdef object topic
    cdef long long can_id, period, asked, sent
    cdef bint protected, reported
