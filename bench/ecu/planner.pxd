cdef class PlannerEcu:
    cdef public object name, inputs
    cdef public object _bus, _platoon, _planner, _grid, _peers, _peer_topics, _own_topics, _broadcast_topics, _own, _following
    cdef public int _vehicle, _wait_cycles
    cdef public long long _last_cycle
    cdef public double _emergency, _crawl, _optimise_s
    cdef public object _first_cycle, _last_broadcast, _last, _felt
    cdef public bint _uncomfortable
