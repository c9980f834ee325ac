cdef void multiply(double[:, ::1] out, double[:, ::1] a, double[:, ::1] b) noexcept nogil
cdef void multiply_transposed(double[:, ::1] out, double[:, ::1] a, double[:, ::1] b) noexcept nogil
cdef double invert(double[:, ::1] out, double[:, ::1] a) noexcept nogil
