from bench.control.agents cimport Agents

cdef double SMALL

cpdef (double, double) point(double X, double Y, double c, double s, double length) noexcept
cpdef (double, double) velocity(double c, double s, double v, double gamma, double length) noexcept
cpdef (double, double) input_rates(double c, double s, double v, double gamma, double length, double eta_x, double eta_y) noexcept
cpdef (double, double) turned(double c, double s, double angle) noexcept
cdef void locate(Agents agents, double length) noexcept
cdef void request(Agents agents, double length) noexcept
cdef void move(Agents agents, double step_s) noexcept
