cdef class TrackerEcu:
    cdef public object name, inputs
    cdef public object _bus, _parameters, _tracker, _brake_steering, _topics, _limits, _own, _grid
    cdef public double _braking, _crawl
    cdef public object _last_cycle, _now, _commanded, _sent_steering, _applied
    cdef public int _reference_timeout, _reference_age
    cdef public int _steering_off, _steering_good, _unanswered, _disturbed, _calm
