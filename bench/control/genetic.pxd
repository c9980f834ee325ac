cimport cython

from bench.control.agents cimport Agents
from bench.control.boundaries cimport Boundaries
from bench.control.flocking cimport Field, Gains, Neighbours

cdef int _COUNT
cdef double MUTATED, BEYOND

@cython.final
cdef class Situation:
    cdef readonly double X, Y, c, s, v, gamma
    cdef double[::1] targets
    cdef readonly Neighbours neighbours

@cython.final
cdef class Rollout:
    cdef readonly Field field
    cdef readonly Boundaries limits
    cdef readonly double length, step_s
    cdef readonly double position, velocity, speed, yaw, boundary, comfort
    cdef readonly int steps

@cython.final
cdef class Candidate:
    cdef Gains gains
    cdef readonly double cost

@cython.final
cdef class Breeding:
    cdef readonly Gains lower, upper
    cdef readonly int population, generations
    cdef readonly double mutation
    cdef list pool

