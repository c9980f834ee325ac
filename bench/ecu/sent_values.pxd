cdef class _Range:
    cdef str signal
    cdef double low, high

cdef class _Message:
    cdef tuple ranges
    cdef bint command, wall_clock

cdef class SentValues:
    cdef readonly long long not_numbers
    cdef object _name, _codecs, _note
    cdef dict _messages, _since
    cdef set _clipped

    cpdef bint are_numbers(self, object sent, long long cycle) except -1
    cdef bint _is_number(self, object sent, _Message message, _Range signal, double value, long long cycle) except -1
    cdef _Message _message(self, object sent)
