cimport cython

from bench.control.agents cimport Agents

cdef int GA, GB, P11, P12, P21, P22
cdef double _QUARTER_TURN

@cython.final
cdef class Gains:
    cdef double[6] values
    cdef double _offset
    cpdef void complete(self) noexcept

@cython.final
cdef class Field:
    cdef readonly double eps, distance, reach, flat
    cdef double _per_eps, _distance_norm, _per_reach_norm

@cython.final
cdef class Neighbours:
    cdef readonly int count
    cdef public double weight
    cdef double[::1] X, Y, W_x, W_y
    cpdef void put(self, int place, double X, double Y, double W_x, double W_y) noexcept
    cpdef int within(self, double X, double Y, double reach) noexcept

cpdef double sigma_norm(double distance, double eps) noexcept
cpdef double bump(double z, double flat) noexcept
cpdef double offset(double Ga, double Gb) noexcept
cpdef double action(double z, double Ga, double Gb, double c) noexcept
cpdef (double, double) acceleration(
    double q_x, double q_y, double p_x, double p_y, Neighbours neighbours,
    double q_hat_x, double q_hat_y, double p_hat_x, double p_hat_y, Gains gains, Field field
) noexcept
cdef void accelerate(
    Agents agents, Neighbours neighbours, double time_s,
    double q_hat_x, double q_hat_y, double p_hat_x, double p_hat_y, Field field
) noexcept
cdef void take_gains(Agents agents, int place, Gains gains) noexcept
