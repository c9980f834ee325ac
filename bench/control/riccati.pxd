cdef class GameRiccati:
    cdef double W[9]
    cdef double costate[9]
    cdef double multiplier[9]
    cdef double gradient[9]
    cdef readonly double value
    cdef double rho, S_determinant
    cdef double A[9]
    cdef double H[9]
    cdef double N1[9]
    cdef double BB[9]
    cdef double NB[9]
    cdef double NN[9]
    cdef double HJ[9]
    cdef double M[9]
    cdef double a[9]
    cdef double g[9]
    cdef double w[9]
    cdef double G[9]
    cdef double A_hat[9]
    cdef double closed[9]
    cdef double T[9]
    cdef double X[9]
    cdef double step[9]
    cdef double S_inverse[9]
    cdef double one[9]
    cdef double two[9]
    cdef double three[9]
    cdef void set_model(self, double[:, ::1] A, double[:, ::1] B, double[:, ::1] H, double[:, ::1] N1, double[:, ::1] N2) noexcept
    cdef double cost(self, double* J, double* z) noexcept
    cdef void _set_gradient(self, double* J, double* z, double value) noexcept
    cdef void _subtract_from(self, double* out, double* a, double factor) noexcept
    cdef bint _set_equation(self, double* J) noexcept
    cdef bint _is_proven(self) noexcept
    cdef bint _double(self) noexcept
    cdef bint _invert_loop(self, double* g, double* w) noexcept
    cdef double _grow(self) noexcept
    cdef void _accumulate(self) noexcept
