"""Plots as SVG without scripts: curves over linear or logarithmic axes, with names and units.

Drawn about as wide as a phone, so that the text is readable there and two fit side by side on paper.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from platoon_fmu.physics.drive import Array
from platoon_fmu.physics.numbers import power_of_ten

BLUE, ORANGE, GREEN, PURPLE, INK = "#0072b2", "#d55e00", "#00795a", "#a04a82", "#1d1f21"
"""Colours of curves: Okabe and Ito's for colour-blind readers, dark enough for white paper, and the page's own ink."""

MAX_POINTS = 500
"""Approximate maximum number of points of a curve; longer ones are thinned out."""

_WIDTH, _HEIGHT = 460, 300
_RIGHT, _TOP, _BOTTOM = 14, 10, 46
_CHARACTER = 7.0


@dataclass(frozen=True)
class Curve:
    """One curve.

    Attributes:
        name: in the legend; empty for a curve without an entry.
        x, y: its points, (n,) each.
        colour: `#rrggbb`.
        dash: whether it is dashed, e.g. an expected curve.
        dots: whether its points are marked.
    """

    name: str
    x: Array
    y: Array
    colour: str
    dash: bool = False
    dots: bool = False


@dataclass(frozen=True)
class Plot:
    """One plot.

    Attributes:
        title: what it shows.
        x_label, y_label: names of the axes, with units.
        curves: later ones are drawn on top.
        caption: further text.
        logarithmic: whether both axes are.
        x_range, y_range: the visible range; None for all.
    """

    title: str
    x_label: str
    y_label: str
    curves: Sequence[Curve]
    caption: str = ""
    logarithmic: bool = False
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None


def figure(plot: Plot) -> str:
    """The plot as an HTML figure with its title, legend and caption."""
    title = html.escape(plot.title)
    keys = "".join(_key(curve) for curve in plot.curves if curve.name)
    caption = f"<p>{html.escape(plot.caption)}</p>" if plot.caption else ""
    return f"<figure><h4>{title}</h4><div class='keys'>{keys}</div>{svg(plot)}{caption}</figure>\n"


def svg(plot: Plot) -> str:
    """The plot alone as an SVG element."""
    x = _axis([curve.x for curve in plot.curves], plot.x_range, plot.logarithmic, count=6, spare=0.0)
    y = _axis([curve.y for curve in plot.curves], plot.y_range, plot.logarithmic, count=6, spare=0.06)
    left = 30 + _CHARACTER * max(len(label) for _, label in y.ticks)
    width, height = _WIDTH - left - _RIGHT, _HEIGHT - _TOP - _BOTTOM
    bottom = _TOP + height
    parts = []
    for value, label in x.ticks:
        at = left + width * x.share(value)
        parts.append(f'<path class="grid" d="M{at:.1f} {_TOP}V{bottom}"/>')
        parts.append(f'<text x="{at:.1f}" y="{bottom + 17}" text-anchor="middle">{label}</text>')
    for value, label in y.ticks:
        at = bottom - height * y.share(value)
        parts.append(f'<path class="grid" d="M{left:.1f} {at:.1f}h{width:.1f}"/>')
        parts.append(f'<text x="{left - 6:.1f}" y="{at + 4:.1f}" text-anchor="end">{label}</text>')
    lines = "".join(_line(curve, x, y, width, height) for curve in plot.curves)
    # A nested SVG element clips its content.
    parts.append(f'<svg x="{left:.1f}" y="{_TOP}" width="{width:.1f}" height="{height}">{lines}</svg>')
    parts.append(f'<rect class="frame" x="{left:.1f}" y="{_TOP}" width="{width:.1f}" height="{height}"/>')
    middle = left + width / 2
    parts.append(
        f'<text class="axis" x="{middle:.1f}" y="{_HEIGHT - 8}" text-anchor="middle">{_text(plot.x_label)}</text>'
    )
    turned = f'transform="translate(13 {_TOP + height / 2:.1f}) rotate(-90)" text-anchor="middle"'
    parts.append(f'<text class="axis" {turned}>{_text(plot.y_label)}</text>')
    names = ", ".join(curve.name for curve in plot.curves if curve.name)
    described = html.escape(f"{plot.title}: {plot.y_label} over {plot.x_label}; {names}", quote=True)
    return f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{described}">{"".join(parts)}</svg>'


@dataclass(frozen=True)
class _Axis:
    """An axis: its least and greatest value, and the values and texts of its ticks."""

    low: float
    high: float
    logarithmic: bool
    ticks: list[tuple[float, str]]

    def share(self, value: float) -> float:
        """Position of a value along the axis, 0 to 1."""
        return float(self.shares(np.array([value]))[0])

    def shares(self, values: Array) -> Array:
        """Positions of values along the axis, 0 to 1; NaN if a logarithmic axis cannot show them."""
        low, high = self.low, self.high
        if self.logarithmic:
            values, low, high = np.log10(np.where(values > 0, values, np.nan)), np.log10(low), np.log10(high)
        return (values - low) / (high - low)


def _axis(
    values: Sequence[Array], shown: tuple[float, float] | None, logarithmic: bool, *, count: int, spare: float
) -> _Axis:
    together = np.concatenate([each[np.isfinite(each)] for each in values])
    if logarithmic:
        together = together[together > 0]
    low, high = shown or ((float(together.min()), float(together.max())) if len(together) else (0.5, 1.0))
    if logarithmic:
        low, high = low / 1.3, high * 1.3
        return _Axis(low, high, True, _log_ticks(low, high, count))
    size = high - low
    if size <= 1e-12 * max(abs(low), abs(high), 1e-6):
        size = max(abs(low), 1e-6)
        low, high = low - size / 2, high + size / 2
    if shown is None:
        low, high = low - spare * size, high + spare * size
    return _Axis(low, high, False, _ticks(low, high, count))


def _ticks(low: float, high: float, count: int) -> list[tuple[float, str]]:
    """About `count` round values from low to high."""
    raw = (high - low) / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= 0.999 * raw)
    digits = max(0, -int(np.floor(np.log10(step) + 1e-9)))
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [(i * step, _plain(i * step, digits)) for i in range(first, last + 1)]


def _log_ticks(low: float, high: float, count: int) -> list[tuple[float, str]]:
    """Powers of ten; if there are few, also the values 2 and 5 between them."""
    first, last = int(np.ceil(np.log10(low))), int(np.floor(np.log10(high)))
    if last - first < 2:
        round_values = [factor * 10.0**power for power in range(first - 1, last + 1) for factor in (1, 2, 5)]
        return [(value, f"{value:g}") for value in round_values if low <= value <= high]
    apart = -(-(last - first + 1) // (count + 1))
    return [(10.0**power, power_of_ten(power)) for power in range(first, last + 1, apart)]


def _plain(value: float, digits: int) -> str:
    return f"{value + 0.0:.{digits}f}".replace("-", "−")


def _line(curve: Curve, x: _Axis, y: _Axis, width: float, height: float) -> str:
    stride = max(1, len(curve.x) // MAX_POINTS)
    # The last point is kept, so that the curve keeps its end.
    rows = np.unique(np.append(np.arange(0, len(curve.x), stride), len(curve.x) - 1))
    across, down = width * x.shares(curve.x[rows]), height * (1 - y.shares(curve.y[rows]))
    shown = [(a, d) for a, d in zip(across, down, strict=True) if np.isfinite(a) and np.isfinite(d)]
    path = "".join(f"{'L' if i else 'M'}{a:.1f} {d:.1f}" for i, (a, d) in enumerate(shown))
    dash = ' stroke-dasharray="6 4"' if curve.dash else ""
    line = f'<path class="curve" stroke="{curve.colour}"{dash} d="{path}"/>' if path else ""
    if not curve.dots:
        return line
    return line + "".join(f'<circle cx="{a:.1f}" cy="{d:.1f}" r="3" fill="{curve.colour}"/>' for a, d in shown)


def _key(curve: Curve) -> str:
    style = "dashed" if curve.dash else "solid"
    return f'<span><i style="border-top:2.5px {style} {curve.colour}"></i>{_text(curve.name)}</span>'


def _text(text: str) -> str:
    return html.escape(text)
