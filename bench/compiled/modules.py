"""The names of the hot modules, which are compiled: what each cycle of a run goes through."""

COMPILED: tuple[str, ...] = ("bench.bus.wire.frame_length", "bench.bus.wire.timing", "bench.control.matrices")
