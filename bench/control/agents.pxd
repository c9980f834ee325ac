cimport cython

cdef enum:
    LANES = 8

@cython.final
cdef class Agents:
    cdef double[8] X, Y, c, s, v, gamma
    cdef double[8] q_x, q_y, p_x, p_y, u_x, u_y, v_rate, gamma_rate, gamma_max
    cdef double[8] Ga, Gb, C, P11, P12, P21, P22
    cdef double[8] v_before, v_reach, cost
