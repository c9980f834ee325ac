"""The names of the hot modules, which are compiled: what each cycle of a run goes through."""

COMPILED: tuple[str, ...] = ("bench.control.matrices",)
