cimport cython

from bench.control.agents cimport Agents

cdef double YAW_SHARE
cdef int _NONE, _YAW_RATE, _ACCELERATION, _FRICTION_CIRCLE, _SPEED

@cython.final
cdef class Boundaries:
    cdef readonly double mu_g, lift_front, lift_rear, share, acceleration_max, yaw_acceleration_max, speed_min, speed_max, lateral_max
    cdef double _grip, _lowest, _highest

cpdef double yaw_rate_max(double v_x, double mu_g) noexcept
cpdef double largest_acceleration(double gamma, double v, Boundaries limits) noexcept
cpdef double speed_reach(double v, bint accelerating, double step_s, Boundaries limits) noexcept
cpdef (double, double, int) admissible(
    double v, double gamma, double v_rate, double gamma_rate, double step_s, Boundaries limits
) noexcept
cdef void limit(Agents agents, double step_s, Boundaries limits) noexcept
cdef void set_yaw_rates_max(Agents agents, Boundaries limits) noexcept
cdef void set_speeds_reach(Agents agents, double step_s, Boundaries limits) noexcept
