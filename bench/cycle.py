"""The cycle of the bench, in which sensors, references and commands are exchanged once."""

CYCLE_MS = 10
"""Length of a cycle in simulated ms."""

CYCLE_S = CYCLE_MS / 1000
"""The same in s."""

CYCLE_NS = CYCLE_MS * 1_000_000
"""The same in ns, as in the log."""


def time_of(cycle: int) -> float:
    """Return the simulated time in s at which a cycle begins."""
    return cycle * CYCLE_MS / 1000
