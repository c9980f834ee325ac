"""The price of comfort: the formation time of `formation` over the limits of acceleration and jerk, as a figure."""

import html
from collections.abc import Sequence
from dataclasses import dataclass

from bench.benchmarks.comfort.limits import overrides
from bench.benchmarks.comfort.results import Result
from bench.benchmarks.comfort.runs import Job
from bench.record.drawing import colour

ACCELERATIONS_MPS2 = (1.5, 2.0, 3.0, 4.0, 5.0)
JERKS_MPS3 = (1.5, 2.5, 5.0, 10.0, 20.0)

_SAME_S = 0.05
"""A formation that is faster by no more than this (s) is as fast."""

_WIDTH, _HEIGHT = 720, 400
_LEFT, _RIGHT, _TOP, _BOTTOM = 60, 150, 20, 50
_STYLE = (
    ".frame{stroke:#888;fill:none}.grid{stroke:#80808040}"
    ".text{font:13px system-ui,sans-serif;fill:#808080}.line{fill:none;stroke-width:2}.best{stroke-width:2;fill:#fff}"
)


@dataclass(frozen=True)
class Point:
    """A pair of limits, the same in both directions, and the run with it.

    Attributes:
        acceleration: limit, m/s^2.
        jerk: limit, m/s^3.
        result: the run's.
    """

    acceleration: float
    jerk: float
    result: Result

    @property
    def formed_s(self) -> float | None:
        """When the platoon was formed, s; None if it was not."""
        return self.result.formed_s


def jobs() -> dict[tuple[float, float], Job]:
    """Return a run of `formation` for each pair of limits, longer than it takes with the strictest."""
    return {
        (acceleration, jerk): Job("formation", ("duration_s=20.0", *overrides(acceleration, jerk)))
        for acceleration in ACCELERATIONS_MPS2
        for jerk in JERKS_MPS3
    }


def on_front(points: Sequence[Point]) -> list[Point]:
    """Return the points of the Pareto front: no other with limits at least as strict is as fast."""
    return [each for each in points if not any(_beats(other, each) for other in points if other is not each)]


def _beats(one: Point, other: Point) -> bool:
    if one.formed_s is None:
        return False
    stricter = one.acceleration <= other.acceleration and one.jerk <= other.jerk
    return stricter and (other.formed_s is None or one.formed_s <= other.formed_s + _SAME_S)


def svg(points: Sequence[Point]) -> str:
    """Return the figure: formation time over the jerk limit, a line for each acceleration limit; dots are the front."""
    formed = [(point, point.formed_s) for point in points if point.formed_s is not None]
    top = 2.0 * (1 + int(max((time for _, time in formed), default=2.0) / 2.0))
    jerks = sorted({point.jerk for point in points})
    best = on_front(points)

    def x(jerk: float) -> float:
        # The limits are spaced evenly, as they double from one to the next.
        return _LEFT + (_WIDTH - _LEFT - _RIGHT) * (jerks.index(jerk) + 0.5) / len(jerks)

    def y(time_s: float) -> float:
        return _HEIGHT - _BOTTOM - (_HEIGHT - _TOP - _BOTTOM) * time_s / top

    parts = [_axes(top, [(f"{jerk:g}", x(jerk)) for jerk in jerks], y(0.0))]
    for place, acceleration in enumerate(sorted({point.acceleration for point in points})):
        line = sorted((point.jerk, time, point in best) for point, time in formed if point.acceleration == acceleration)
        ink = colour(place + 1)
        corners = " ".join(f"{x(jerk):.1f},{y(time):.1f}" for jerk, time, _ in line)
        parts.append(f'<polyline class="line" stroke="{ink}" points="{corners}"/>')
        parts += [
            f'<circle class="best" stroke="{ink}" cx="{x(jerk):.1f}" cy="{y(time):.1f}" r="4"/>'
            for jerk, time, is_best in line
            if is_best
        ]
        words, down = f"{acceleration:g} m/s²", _TOP + 30 + 20 * place
        right = _WIDTH - _RIGHT + 15
        parts.append(f'<path class="line" stroke="{ink}" d="M{right} {down}h24"/>{_text(words, right + 32, down + 4)}')
    parts.append(_text("acceleration limit", _WIDTH - _RIGHT + 15, _TOP + 10))
    size = f'viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" height="{_HEIGHT}"'
    title = "<title>Formation time over the limits of jerk and acceleration</title>"
    body = "\n".join(parts)
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{title}<style>{_STYLE}</style>\n{body}\n</svg>\n'


def _axes(top: float, ticks: Sequence[tuple[str, float]], bottom: float) -> str:
    """Return frame, grid and words; `top` is the largest time, s, `ticks` are the jerk limits and where they are."""
    right, middle = _WIDTH - _RIGHT, 0.5 * (_LEFT + _WIDTH - _RIGHT)
    parts = [f'<rect class="frame" x="{_LEFT}" y="{_TOP}" width="{right - _LEFT}" height="{bottom - _TOP:.1f}"/>']
    for time in range(0, int(top) + 1, 2):
        down = bottom - (bottom - _TOP) * time / top
        parts.append(f'<path class="grid" d="M{_LEFT} {down:.1f}H{right}"/>')
        parts.append(_text(f"{time}", _LEFT - 8, down + 4, "end"))
    parts += [_text(words, across, bottom + 18, "middle") for words, across in ticks]
    parts.append(_text("jerk limit [m/s³]", middle, bottom + 38, "middle"))
    parts.append(f'<g transform="rotate(-90)">{_text("formed [s]", -0.5 * (_TOP + bottom), 18, "middle")}</g>')
    return "\n".join(parts)


def _text(words: str, x: float, y: float, anchor: str = "start") -> str:
    return f'<text class="text" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{html.escape(words)}</text>'
