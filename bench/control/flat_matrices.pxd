cdef void copy(double* out, double* a) noexcept nogil
cdef void add(double* out, double* a, double factor) noexcept nogil
cdef void add_symmetric(double* out, double* a) noexcept nogil
cdef double trace(double* a) noexcept nogil
cdef void complement(double* out, double* a) noexcept nogil
cdef void multiply(double* out, double* a, double* b) noexcept nogil
cdef void multiply_transposed(double* out, double* a, double* b) noexcept nogil
cdef void transposed_multiply(double* out, double* a, double* b) noexcept nogil
cdef void congruence(double* out, double* a, double* b, double* spare) noexcept nogil
cdef double form(double* x, double* a) noexcept nogil
cdef double invert(double* out, double* a) noexcept nogil
cdef bint cholesky(double* out, double* a) noexcept nogil
cdef void eigen(double* values, double* vectors, double* a, Py_ssize_t n) noexcept nogil
