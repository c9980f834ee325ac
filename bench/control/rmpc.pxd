cdef class RobustController:
    cdef readonly tuple _programs
    cdef double _rho
    cdef double[::1] _x, _u
    cdef double[:, ::1] _corners
    cdef double[:, :, ::1] _A, _B
    cdef tuple _certify(self, answer, z, room)
    cdef object _scaled(self, model)
    cdef void _set_vertices(self, double[:, :, ::1] A_H_N1, double[:, :, ::1] B_N2) noexcept
