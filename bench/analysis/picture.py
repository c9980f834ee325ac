"""A still picture of a run as SVG: the road from above at several moments.

The view moves at the platoon's desired speed, with X and Y to the same scale, so that the cars keep their shape and the
formation is visible.
"""

from __future__ import annotations

import html
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.analysis.metrics import formation_time
from bench.analysis.motion import Array, Motion, motion
from bench.files import write_text
from bench.record import Run
from bench.record.drawing import colour, lane_edges
from platoon_fmu.parameters import BODY

PIXELS_PER_METRE = 9.0
COLUMNS = 2
_AROUND_M = 5.0
_TITLE, _GAP = 20.0, 16.0
_TRAIL_S = 1.0
_STYLE = (
    ".road{fill:#80808024}.edge{stroke:#888;stroke-width:1.6}"
    ".lane{stroke:#888;stroke-width:1.2;stroke-dasharray:12 14}"
    ".time{font:600 14px system-ui,sans-serif;fill:#808080}.name{font:700 11px system-ui,sans-serif;fill:#fff}"
)


def write_svg(run: Run, out: Path, *, moments: int = 6) -> None:
    """Write the picture to a file.

    Raises:
        BadInput: the log has no ground truth or no scenario, or the file cannot be written.
    """
    write_text(out, snapshots(run, moments=moments))


def snapshots(run: Run, *, moments: int = 6) -> str:
    """Return the picture as an SVG element.

    Args:
        run: the run.
        moments: number of moments, at least 2: the first is the start of the run, the last is when the platoon is
            formed, or the end.

    Raises:
        BadInput: the log has no ground truth or no scenario.
    """
    truth = motion(run)
    rows = _rows(truth, _times(run, truth, moments))
    view = _View.around(run, truth, rows)
    width, height = view.size
    strips = []
    for number, row in enumerate(rows):
        across, down = number % COLUMNS, number // COLUMNS
        at = f"translate({across * (width + _GAP):.1f} {down * (height + _TITLE + _GAP):.1f})"
        cars = range(len(truth.X))
        strip = "".join([view.road(), *(view.trail(car, row) for car in cars), *(view.car(car, row) for car in cars)])
        strips.append(
            f'<g transform="{at}"><text class="time" y="{_TITLE - 6}">{truth.t[row]:.1f} s</text>'
            f'<svg y="{_TITLE}" width="{width:.1f}" height="{height:.1f}">{strip}</svg></g>'
        )
    lines = -(-len(rows) // COLUMNS)
    box = f"0 0 {COLUMNS * (width + _GAP) - _GAP:.1f} {lines * (height + _TITLE + _GAP) - _GAP:.1f}"
    title = html.escape(f"{run.scenario.name}: {run.vehicles} vehicles from above, the view moving with the platoon")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" role="img">'
        f"<title>{title}</title><style>{_STYLE}</style>{''.join(strips)}</svg>"
    )


def _times(run: Run, truth: Motion, moments: int) -> Array:
    """Return evenly spaced times (moments,), s, from the start to the formation, rounded up to half a second."""
    goal = run.scenario.platoon
    start, last = float(truth.t[0]), float(truth.t[-1])
    formed = formation_time(truth, goal.lane_y_m, goal.speed_mps, goal.gap_m)
    end = last if formed is None or formed <= start else min(last, max(start + 1.0, math.ceil(formed * 2.0) / 2.0))
    return np.linspace(start, end, moments)


def _rows(truth: Motion, times: Array) -> list[int]:
    found = np.searchsorted(truth.t, times - 1e-9)
    return [int(row) for row in np.minimum(found, len(truth.t) - 1)]


@dataclass(frozen=True)
class _View:
    """A section of road seen from above, moving with the platoon.

    Attributes:
        truth: the motion.
        x: (N, n) X of the vehicles in the moving view, m.
        left, right, low, high: the section of road in the moving view, m.
        edges: Y of each lane marking, m, and whether it is solid.
    """

    truth: Motion
    x: Array
    left: float
    right: float
    low: float
    high: float
    edges: list[tuple[float, bool]]

    @classmethod
    def around(cls, run: Run, truth: Motion, rows: list[int]) -> _View:
        """Return a view that contains all vehicles at the times `rows`."""
        goal = run.scenario.platoon
        edges = lane_edges(sorted({goal.lane_y_m, *(vehicle.y_m for vehicle in run.scenario.vehicles)}))
        x = truth.X - goal.speed_mps * (truth.t - truth.t[0])
        shown, across = x[:, rows], truth.Y[:, rows]
        return cls(
            truth=truth,
            x=x,
            left=float(shown.min()) - _AROUND_M,
            right=float(shown.max()) + _AROUND_M,
            low=min(edges[0][0], float(across.min()) - BODY.width) - 0.3,
            high=max(edges[-1][0], float(across.max()) + BODY.width) + 0.3,
            edges=edges,
        )

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in pixels."""
        return (self.right - self.left) * PIXELS_PER_METRE, (self.high - self.low) * PIXELS_PER_METRE

    def at(self, car: int, row: int) -> tuple[float, float]:
        """Return the position of a car in the view, in pixels from the upper left corner."""
        return (float(self.x[car, row]) - self.left) * PIXELS_PER_METRE, self._down(float(self.truth.Y[car, row]))

    def road(self) -> str:
        """Return the road and its markings."""
        width, _ = self.size
        top, bottom = self._down(self.edges[-1][0]), self._down(self.edges[0][0])
        lines = "".join(
            f'<path class="{"edge" if solid else "lane"}" d="M0 {self._down(y):.1f}H{width:.1f}"/>'
            for y, solid in self.edges
        )
        return f'<rect class="road" y="{top:.1f}" width="{width:.1f}" height="{bottom - top:.1f}"/>{lines}'

    def trail(self, car: int, row: int) -> str:
        """Return the last second of a car's path in the moving view."""
        first = int(np.searchsorted(self.truth.t, self.truth.t[row] - _TRAIL_S))
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in (self.at(car, r) for r in [*range(first, row, 5), row]))
        line = f'stroke="{colour(car + 1)}" stroke-width="3" stroke-opacity=".45" stroke-linecap="round"'
        return f'<polyline points="{points}" fill="none" {line}/>'

    def car(self, car: int, row: int) -> str:
        """Return a car with its number, nose to the right at yaw angle zero."""
        scale = PIXELS_PER_METRE
        x, y = self.at(car, row)
        length, width = BODY.length * scale, BODY.width * scale
        rear = -0.5 * length
        panes = "".join(
            f'<rect x="{rear + length * start:.1f}" y="{-width * 0.36:.1f}" width="{length * share:.1f}" '
            f'height="{width * 0.72:.1f}" rx="3" fill="#fff" fill-opacity=".55"/>'
            for start, share in ((0.62, 0.13), (0.12, 0.09))
        )
        return (
            f'<g class="car" transform="translate({x:.1f} {y:.1f}) '
            f'rotate({-math.degrees(self.truth.psi[car, row]):.2f})">'
            f'<rect x="{rear:.1f}" y="{-width / 2:.1f}" width="{length:.1f}" height="{width:.1f}" '
            f'rx="{width * 0.3:.1f}" fill="{colour(car + 1)}"/>{panes}'
            f'<text class="name" x="{rear + length * 0.42:.1f}" y="4" text-anchor="middle">{car + 1}</text></g>'
        )

    def _down(self, y: float) -> float:
        return (self.high - y) * PIXELS_PER_METRE
