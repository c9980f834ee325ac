from bench.bus.layout cimport Layout, Replaced

cdef object _new

cdef class _Message:
    cdef readonly str bus, name
    cdef readonly Layout layout
    cdef readonly int period
    cdef readonly list frames
    cdef readonly dict largest
    cdef Replaced replaced

    cpdef object to_send(self, object values)
    cpdef bytes encoded(self, object values, long long cycle)

cdef class Outbox:
    cdef readonly object plan
    cdef str _name
    cdef dict _links, _messages, _frames
    cdef object _codecs, _held, _memories
    cdef list _queue

    cpdef object put(self, str bus, str message, object values)
    cdef object _flush(self)
