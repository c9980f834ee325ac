cdef class GameRiccati:
    cdef public double[:, ::1] W, costate, multiplier, gradient
    cdef public double value
    cdef double rho, S_determinant
    cdef double[:, ::1] A, H, N1, BB, NB, NN
    cdef double[:, ::1] HJ, M, a, g, w, G, A_hat, closed, T, X, step, S_inverse, one, two, three
    cdef void set_model(self, double[:, ::1] A, double[:, ::1] B, double[:, ::1] H, double[:, ::1] N1, double[:, ::1] N2) noexcept
    cdef double cost(self, double[:, ::1] J, double[::1] z) noexcept
    cdef bint _set_equation(self, double[:, ::1] J) noexcept
    cdef bint _is_proven(self) noexcept
    cdef bint _double(self) noexcept
    cdef bint _invert_loop(self, double[:, ::1] g, double[:, ::1] w) noexcept
    cdef double _grow(self) noexcept
    cdef void _accumulate(self) noexcept
