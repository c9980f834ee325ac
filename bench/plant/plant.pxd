from bench.bus.inbox cimport Inbox
from bench.bus.outbox cimport Outbox
from bench.plant.fmu cimport FmuInstance

cdef class VehicleNode:
    cdef readonly str name
    cdef readonly object links
    cdef int _vehicle, _health_period
    cdef str _bus
    cdef FmuInstance _fmu
    cdef readonly Inbox _inbox
    cdef Outbox _outbox
    cdef tuple _state, _inputs
    cdef object _road, _truth, _actuators, _faults, _applied, _noise
    cdef bint _is_road_constant
    cdef dict _influences, _commands
    cdef double _weight, _step_us
    cdef long long _published

    cdef object _publish(self, long long cycle)
    cdef object _step(self)
    cdef dict _acting(self, double time_s)
    cdef dict _influences_at(self, double time_s)
