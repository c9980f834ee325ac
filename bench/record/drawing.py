"""Appearance of vehicles and road in all drawings: colours, body outline, lane markings."""

from __future__ import annotations

from collections.abc import Sequence

from platoon_fmu.parameters import BODY

# Okabe and Ito's palette for colour-blind readers, darkened where it was too pale for a white page, then lighter
# relatives for the vehicles from the ninth on.
_COLOURS = (
    *("#0072b2", "#d55e00", "#009e73", "#b05a94", "#3a9bd8", "#c98a00", "#7a6fc0", "#6b6b6b"),
    *("#4fa3d1", "#f08a45", "#45bd97", "#d48fbd", "#86bfe5", "#dbb04a", "#a79fdd", "#9b9b9b"),
)

LANE_WIDTH = 3.5
"""Width of a drawn lane, m; the bench's roads have only lane centres."""

BOXES: tuple[tuple[float, float, tuple[float, float, float], float], ...] = (
    (0.0, 0.25, (BODY.length, BODY.width, 0.6), 1.0),
    (-0.35, 0.85, (0.5 * BODY.length, BODY.width - 0.24, 0.6), 0.75),
)
"""The boxes of a drawn vehicle: middle along x [m], base above the road [m], (length, width, height) [m], opacity."""


def colour(vehicle: int) -> str:
    """Return the colour of vehicle `vehicle` (from 1) as `#rrggbb`."""
    return _COLOURS[(vehicle - 1) % len(_COLOURS)]


def lane_edges(lanes: Sequence[float]) -> list[tuple[float, bool]]:
    """Return Y [m] of each marking around lanes with middles `lanes` [m], and whether it is solid (a road's edge)."""
    edges: list[float] = []
    for middle in sorted(lanes):
        for y in (middle - LANE_WIDTH / 2.0, middle + LANE_WIDTH / 2.0):
            if not any(abs(y - other) < LANE_WIDTH / 4.0 for other in edges):
                edges.append(y)
    edges.sort()
    return [(y, index in (0, len(edges) - 1)) for index, y in enumerate(edges)]
