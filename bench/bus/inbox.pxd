from bench.bus.e2e cimport Receiver
from bench.bus.layout cimport Layout

cdef int _MODULUS
cdef object _REFUSED, _FRESH, _new, _OK, _ERROR

cdef class _Slot:
    cdef readonly object topic
    cdef readonly Layout layout
    cdef readonly Receiver receiver
    cdef readonly int delay, timeout
    cdef readonly dict waiting
    cdef readonly object refused, reception

    cdef object receive(self, object values)

cdef class _Bus:
    cdef readonly object link
    cdef readonly Layout sync, absent
    cdef readonly dict slots, own
    cdef readonly long long opened, errors, errors_before

cdef class Inbox:
    cdef readonly long long cycle, opened, late
    cdef readonly bint settled, stopped, realtime
    cdef readonly double opened_at
    cdef readonly dict _arrived, _excused
    cdef readonly tuple _topics, _buses, _slots, _inputs
    cdef double _zero_at
    cdef bint _joins
    cdef object _clock, _name, _plan

    cpdef bint drain(self) except -1
    cpdef dict take(self)
    cpdef object catch_up(self)
    cpdef object skip(self)
    cdef bint _is_own(self, object sync) except -1
    cdef object _forget(self)
    cdef object _sort(self, _Bus bus, _Slot slot, bytes data)
    cdef object _take_sync(self, _Bus bus, _Slot slot, bytes data)
    cdef bint _follows(self, _Bus bus, object sync) except -1
    cdef long long _newest(self, _Bus bus) except -2
    cdef bint _is_next(self, _Bus bus, long long cycle) except -1
    cdef object _note_absent(self, _Bus bus, bytes data)
    cdef long long _cycle_of(self, _Bus bus, int counter) except? -2
    cdef object _open(self, _Bus bus, long long cycle)
    cdef object _put(self, _Slot slot, long long step, object values)
    cdef object _fill(self, _Slot slot, long long step, object values)
