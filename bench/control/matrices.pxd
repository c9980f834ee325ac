cpdef void copy(double[:, ::1] out, double[:, ::1] a) noexcept nogil
cpdef void add(double[:, ::1] out, double[:, ::1] a, double factor) noexcept nogil
cpdef void add_symmetric(double[:, ::1] out, double[:, ::1] a) noexcept nogil
cpdef void scale(double[:, ::1] out, double[:, ::1] a, double factor) noexcept nogil
cpdef double trace(double[:, ::1] a) noexcept nogil
cpdef void complement(double[:, ::1] out, double[:, ::1] a) noexcept nogil
cpdef void multiply(double[:, ::1] out, double[:, ::1] a, double[:, ::1] b) noexcept nogil
cpdef void multiply_transposed(double[:, ::1] out, double[:, ::1] a, double[:, ::1] b) noexcept nogil
cpdef void transposed_multiply(double[:, ::1] out, double[:, ::1] a, double[:, ::1] b) noexcept nogil
cpdef double invert(double[:, ::1] out, double[:, ::1] a) noexcept nogil
cpdef void congruence(double[:, ::1] out, double[:, ::1] a, double[:, ::1] b, double[:, ::1] spare) noexcept nogil
cpdef double form(double[::1] x, double[:, ::1] a) noexcept nogil
cpdef bint cholesky(double[:, ::1] out, double[:, ::1] a) noexcept nogil
cpdef void eigen(double[::1] values, double[:, ::1] vectors, double[:, ::1] a) noexcept nogil
cpdef bint solve_linear(double[:, ::1] a, double[::1] b, Py_ssize_t n) noexcept nogil
