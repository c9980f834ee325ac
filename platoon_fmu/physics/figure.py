"""One metric: its measured value, its expected value, and whether it passes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """A metric of a manoeuvre; created by `near`, `between` or `at_most`.

    Attributes:
        name: for display.
        measured: the FMU's value [unit].
        low: least value that passes [unit].
        high: greatest value that passes [unit].
        unit: empty for a plain number.
        source: where the expectation comes from.
        expected: the middle of a band [unit]; None if only bounds are required.
        relative: the band's half width over |expected|; None if the band is absolute or absent.
    """

    name: str
    measured: float
    low: float
    high: float
    unit: str
    source: str
    expected: float | None = None
    relative: float | None = None

    @property
    def met(self) -> bool:
        """Whether the measured value is within the bounds; False for NaN."""
        return self.low <= self.measured <= self.high


def near(
    name: str,
    measured: float,
    expected: float,
    *,
    relative: float | None = None,
    absolute: float = 0.0,
    unit: str = "",
    source: str,
) -> Figure:
    """A metric near the expected value: within `relative` times it, or else within `absolute` [unit]."""
    band = absolute if relative is None else relative * abs(expected)
    return Figure(name, float(measured), expected - band, expected + band, unit, source, float(expected), relative)


def between(name: str, measured: float, low: float, high: float, *, unit: str = "", source: str) -> Figure:
    """A metric between two bounds."""
    return Figure(name, float(measured), low, high, unit, source)


def at_most(name: str, measured: float, limit: float, *, unit: str = "", source: str) -> Figure:
    """A magnitude, never negative, that does not exceed a limit."""
    return Figure(name, float(measured), 0.0, limit, unit, source)
