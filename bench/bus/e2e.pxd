cdef bytes _TABLE
cdef int _MODULUS, _COUNTER_MASK, _NO_COUNTER
cdef object _OK, _REPEATED, _WRONG_SEQUENCE, _ERROR, _NONE

cpdef int crc_from(int start, bytes data) except -1
cpdef bint is_whole(bytes data, int start) except -1

cdef class Receiver:
    cdef readonly object status
    cdef readonly int age, errors
    cdef int _crc_of_id, _max_step, _allowed_step, _counter

    cpdef object check(self, object data)
    cpdef object missed(self)
    cdef object _status_of(self, bytes data)
