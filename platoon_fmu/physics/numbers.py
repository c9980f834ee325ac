"""Numbers and figures as a person reads them."""

from __future__ import annotations

import math

from platoon_fmu.physics.figure import Figure

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def power_of_ten(exponent: int) -> str:
    """10 to an integer power, written with superscripts."""
    return "10" + str(exponent).translate(_SUPERSCRIPTS)


def number(value: float, digits: int = 4) -> str:
    """A number to so many significant digits, with powers of ten where it is small or large."""
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
    """A round number to so many digits at most, without the zeros behind it: 0.9, 10⁻⁹, 2.5·10⁻⁴."""
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    power = int(exponent)
    if value == 0.0 or -3 <= power < digits:
        return f"{value:.{digits}g}".replace("-", "−")
    short = mantissa.rstrip("0").rstrip(".").replace("-", "−")
    return {"1": power_of_ten(power), "−1": f"−{power_of_ten(power)}"}.get(short, f"{short}·{power_of_ten(power)}")


def with_unit(text: str, unit: str) -> str:
    """A number and its unit, which no line break parts."""
    return f"{text}\u00a0{unit}" if unit else text


def readable_unit(unit: str) -> str:
    """A unit of the modelDescription as print has it: `kg.m2` as kg m², none for the plain number's `1`."""
    return "" if unit == "1" else unit.replace(".", " ").replace("2", "²").replace("3", "³")


def measured(figure: Figure) -> str:
    """The measured value with its unit."""
    return with_unit(number(figure.measured), figure.unit)


def expected(figure: Figure) -> str:
    """What is asked of a figure: the expected value with its unit, or the bounds."""
    if figure.expected is not None:
        return with_unit(number(figure.expected), figure.unit)
    if math.isinf(figure.high):
        return with_unit(f"at least\u00a0{bound(figure.low)}", figure.unit)
    if figure.low == 0.0:
        return with_unit(f"at most\u00a0{bound(figure.high)}", figure.unit)
    return with_unit(f"{bound(figure.low)} to {bound(figure.high)}", figure.unit)


def tolerance(figure: Figure) -> str:
    """How far a figure may be from the expected value; empty where only bounds are asked."""
    if figure.expected is None:
        return ""
    if figure.relative is not None:
        return f"±\u00a0{bound(100 * figure.relative, 2)}\u00a0%"
    return with_unit(f"±\u00a0{bound(figure.high - figure.expected, 2)}", figure.unit)


def deviation(figure: Figure) -> str:
    """How far a figure is from the expected value, in the terms of its tolerance; empty where there is none."""
    if figure.expected is None:
        return ""
    difference = figure.measured - figure.expected
    if figure.relative is None:
        return with_unit(_signed(difference), figure.unit)
    percent = 100 * difference / abs(figure.expected)
    # What is far below any tolerance is rounding, and its digits say nothing.
    return "below 10⁻⁵\u00a0%" if abs(percent) < 1e-5 else f"{_signed(percent)}\u00a0%"


def _signed(value: float) -> str:
    text = number(value, 2)
    return f"+{text}" if value > 0 else text
