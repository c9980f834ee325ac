from bench.bus.layout cimport Layout

cpdef object read_absence(Layout layout, bytes data)
