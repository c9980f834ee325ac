"""One measured figure, what was expected of it, and whether it was met."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """A figure of a manoeuvre; made by `near`, `between` or `at_most`.

    Attributes:
        name: what it is.
        measured: the FMU's [unit].
        low: least value that meets it [unit].
        high: greatest value that meets it [unit].
        unit: empty for a plain number.
        source: where the expectation comes from.
        expected: the middle of a band [unit]; None where only bounds are asked.
        relative: the band's half width over |expected|; None where the band is absolute or there is none.
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
        """Whether the measured value is inside the bounds; what is not a number never is."""
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
    """A figure near the expected value: within a share `relative` of it, or else within `absolute` [unit]."""
    band = absolute if relative is None else relative * abs(expected)
    return Figure(name, float(measured), expected - band, expected + band, unit, source, float(expected), relative)


def between(name: str, measured: float, low: float, high: float, *, unit: str = "", source: str) -> Figure:
    """A figure between two bounds."""
    return Figure(name, float(measured), low, high, unit, source)


def at_most(name: str, measured: float, limit: float, *, unit: str = "", source: str) -> Figure:
    """A magnitude, never negative, that does not exceed a limit."""
    return Figure(name, float(measured), 0.0, limit, unit, source)
