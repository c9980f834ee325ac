from bench.bus.inbox cimport Inbox
from bench.bus.outbox cimport Outbox
from bench.ecu.sent_values cimport SentValues


cdef class _Due:
    cdef object topic
    cdef long long can_id, period, asked, sent
    cdef bint protected, reported


cdef class EcuNode:
    cdef public object name
    cdef public double input_wait_s
    cdef readonly Inbox _inbox
    cdef Outbox _outbox
    cdef SentValues _sent_values
    cdef object _ecu, _codecs, _clock
    cdef dict _links, _due_by_name
    cdef list _due

    cdef bint _waited(self) except -1
    cdef object _step(self)
    cdef object _announce_absent(self, long long cycle, bint lockstep)
