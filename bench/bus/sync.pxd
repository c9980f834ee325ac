from bench.bus.layout cimport Layout

cpdef object read_sync(Layout layout, bytes data)
