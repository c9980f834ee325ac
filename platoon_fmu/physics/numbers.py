"""Formats numbers and metrics for display."""

from __future__ import annotations

import math

from platoon_fmu.physics.figure import Figure

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def power_of_ten(exponent: int) -> str:
    """10 to an integer power, written with superscripts."""
    return "10" + str(exponent).translate(_SUPERSCRIPTS)


def number(value: float, digits: int = 4) -> str:
    """A number with `digits` significant digits, as a power of ten if it is small or large."""
    if math.isnan(value):
        return "none"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0.0:
        return "0"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    power = int(exponent)
    if -2 <= power < digits + 1:
        text = f"{float(f'{value:.{digits - 1}e}'):.{max(0, digits - 1 - power)}f}"
    else:
        text = f"{mantissa}·{power_of_ten(power)}"
    return text.replace("-", "−")


def bound(value: float, digits: int = 3) -> str:
    """A round number with at most `digits` digits, without trailing zeros: 0.9, 10⁻⁹, 2.5·10⁻⁴."""
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    power = int(exponent)
    if value == 0.0 or -3 <= power < digits:
        return f"{value:.{digits}g}".replace("-", "−")
    short = mantissa.rstrip("0").rstrip(".").replace("-", "−")
    return {"1": power_of_ten(power), "−1": f"−{power_of_ten(power)}"}.get(short, f"{short}·{power_of_ten(power)}")


def with_unit(text: str, unit: str) -> str:
    """A number and its unit, joined by a non-breaking space."""
    return f"{text}\u00a0{unit}" if unit else text


def readable_unit(unit: str) -> str:
    """A unit of the modelDescription in print form: `kg.m2` as kg m², empty for `1`."""
    return "" if unit == "1" else unit.replace(".", " ").replace("2", "²").replace("3", "³")


def measured(figure: Figure) -> str:
    """The measured value with its unit."""
    return with_unit(number(figure.measured), figure.unit)


def expected(figure: Figure) -> str:
    """The expected value of a metric with its unit, or its bounds."""
    if figure.expected is not None:
        return with_unit(number(figure.expected), figure.unit)
    if math.isinf(figure.high):
        return with_unit(f"at least\u00a0{bound(figure.low)}", figure.unit)
    if figure.low == 0.0:
        return with_unit(f"at most\u00a0{bound(figure.high)}", figure.unit)
    return with_unit(f"{bound(figure.low)} to {bound(figure.high)}", figure.unit)


def tolerance(figure: Figure) -> str:
    """The tolerance of a metric; empty if only bounds are required."""
    if figure.expected is None:
        return ""
    if figure.relative is not None:
        return f"±\u00a0{bound(100 * figure.relative, 2)}\u00a0%"
    return with_unit(f"±\u00a0{bound(figure.high - figure.expected, 2)}", figure.unit)


def deviation(figure: Figure) -> str:
    """The deviation of a metric from its expected value, in the form of its tolerance; empty if there is none."""
    if figure.expected is None:
        return ""
    difference = figure.measured - figure.expected
    if figure.relative is None:
        return with_unit(_signed(difference), figure.unit)
    percent = 100 * difference / abs(figure.expected)
    # A deviation far below the tolerance is rounding, whose digits mean nothing.
    return "below 10⁻⁵\u00a0%" if abs(percent) < 1e-5 else f"{_signed(percent)}\u00a0%"


def _signed(value: float) -> str:
    text = number(value, 2)
    return f"+{text}" if value > 0 else text
