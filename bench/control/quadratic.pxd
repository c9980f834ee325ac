cpdef bint minimise_in_box(double[::1] x, double[:, ::1] hessian, double[::1] gradient, double[::1] lower, double[::1] upper, double[:, ::1] work)
