cpdef void derivative(double[::1] out, double[::1] numbers, double[::1] xi, double[::1] U) noexcept nogil
cpdef void step(double[::1] out, double[::1] numbers, double[::1] xi, double[::1] U) noexcept nogil
cpdef void linearise(double[:, ::1] A, double[:, ::1] B, double[:, ::1] H, double[:, ::1] N1, double[:, ::1] N2, double[::1] numbers, double[::1] xi, double[::1] U) noexcept nogil
cpdef double steady_lateral_velocity(double[::1] numbers, double v_x, double gamma) noexcept nogil
cpdef void multiply(double[:, ::1] out, double[:, ::1] a, double[:, ::1] b) noexcept nogil
