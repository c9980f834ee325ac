cdef object _FLOAT32
cdef int _WORD_BYTES, _MODULUS

cdef class Replaced:
    cdef public int not_numbers, saturated

cdef class Field:
    cdef readonly str signal
    cdef readonly int shift
    cdef readonly unsigned long long mask, sign
    cdef readonly double scale, offset, low, high, start
    cdef readonly bint is_float

    cpdef double value(self, unsigned long long raw) except? -1.0
    cpdef unsigned long long raw(self, double value, Replaced replaced) except? 0

cdef class Layout:
    cdef readonly str name
    cdef readonly unsigned int can_id
    cdef readonly int length, data_id, crc_of_id
    cdef readonly tuple fields, encoded, states

    cpdef bytes encode(self, object values, int counter, Replaced replaced, bint with_start_values)
    cdef bytes _long_frame(self, object number, int counter)
    cpdef dict decode(self, bytes data)
    cpdef bint is_possible(self, object values) except -1

cdef unsigned long long _word_of(bytes data)
cdef bytes _bytes_of(unsigned long long word, int length)
