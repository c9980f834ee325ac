cimport cython

cdef double _LENGTH, _HALF_WIDTH

@cython.final
cdef class Separation:
    cdef readonly double clearance, response_s, braking, rate, aside
    cpdef double excess(self, double distance, double v_follower, double v_leader) noexcept
    cpdef double acceleration(self, double distance, double v_follower, double v_leader, double a_leader) noexcept
    cpdef double needed(self, double distance, double v_follower, double v_leader, double a_leader) noexcept
    cpdef bint meet(self, double one_from, double one_to, double other_from, double other_to) noexcept
