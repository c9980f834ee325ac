from bench.bus.layout cimport Layout

cdef object _new, _identifier

cdef class CycleFrames:
    cdef readonly long long number
    cdef readonly dict frames
    cdef readonly list due
    cdef readonly set spoiled
    cdef set _others
    cdef object _due, _codecs, _plan, _refusals
    cdef dict _sync_id, _absent_id, _layouts, _due_in, _missing, _extra
    cdef long long _count, _counter, _repeats

    cdef object _extra_frames(self)
    cdef bint _take_other(self, str bus, object frame, bint is_missing) except -1
    cdef bint _is_due(self, Layout layout, bytes data) except -1
    cdef bint _waits_for(self, str bus, long long can_id, bytes data) except -1
