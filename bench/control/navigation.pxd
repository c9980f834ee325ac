cimport cython

from bench.control.lane_change cimport LaneChange
from bench.control.ramp cimport Ramp

cdef double BRAKING_SHARE, SPEED_RATE, LEAD_BUILD_UP_S

@cython.final
cdef class NavigationTarget:
    cdef readonly object limits
    cdef readonly double x, y, v_x, v_y, a_x, a_y, changing_s
    cdef public bint changing
    cdef double _longitudinal, _step_s, _speed_rate, _closing_rate, _lead_s
    cdef Ramp _ramp
    cdef LaneChange _change
    cpdef double wanted(self, double error, double speed)
    cpdef void fall_back(self, double x, double v_x, double a_x)
    cdef void _across(self)
    cpdef void advance(self, double slot_x, double slot_speed, double least, double most)
    cpdef (double, double, double, double, double, double) ahead(self, double time_s)
