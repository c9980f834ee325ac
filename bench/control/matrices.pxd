cpdef double invert(double[:, ::1] out, double[:, ::1] a) noexcept nogil
cpdef bint solve_linear(double[:, ::1] a, double[::1] b, Py_ssize_t n) noexcept nogil
