cpdef bint possible(object limits, object frame, object names) except -1
