cpdef double proven_cost(double[:, ::1] K, double[:, ::1] P, double rho, double[:, :, ::1] A, double[:, :, ::1] B, double[::1] z, double[::1] room)
