from bench.control.riccati cimport GameRiccati

cdef class RiccatiProgram:
    cdef public int iterations, evaluations
    cdef GameRiccati _riccati
    cdef Py_ssize_t _count
    cdef Py_ssize_t _rows[6]
    cdef Py_ssize_t _columns[6]
    cdef bint _started, _bent
    cdef double _rho, _value
    cdef double[:, ::1] _H, _N1, _N2
    cdef double _J[9]
    cdef double _tried[9]
    cdef double _P[9]
    cdef double _z[3]
    cdef double _z_bent[3]
    cdef double _slope[6]
    cdef double _other[6]
    cdef double _move[6]
    cdef double _values[6]
    cdef double _pulled[6]
    cdef double _hessian[36]
    cdef double _axes[36]
    cdef double _turned[36]
    cdef double _cost(self, double* J)
    cdef object _search(self)
    cdef bint _start(self) noexcept
    cdef bint _is_near_last(self) noexcept
    cdef bint _descend(self, double decrement, double shortest) noexcept
    cdef void _correct(self, double share) noexcept
    cdef bint _scan(self) noexcept
    cdef void _differentiate(self, double* slope) noexcept
    cdef void _bend(self) noexcept
    cdef double _newton(self) noexcept
    cdef void _go(self, double* out, double share) noexcept
    cdef void _balance(self, double[:, ::1] H, double[:, ::1] N1, double[:, ::1] N2)
    cdef void _set_ellipsoid(self, double[:, ::1] P, double[:, ::1] Y, double[:, ::1] B, double cost)
