cimport cython

cdef unsigned long long _MASK, _STEP, _MIX_1, _MIX_2
cdef double _UNIT

@cython.final
cdef class RandomNumbers:
    cdef unsigned long long _state
    cdef double _spare
    cdef bint _has_spare
    cpdef unsigned long long bits(self) noexcept
    cpdef double uniform(self) noexcept
    cpdef int below(self, int count) noexcept
    cpdef double normal(self) noexcept
