"""One figure as data: which curves, over what, with which limits. The page draws it."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Curve:
    """One curve.

    Attributes:
        name: as the legend shows it; curves of one name are shown and hidden together.
        x, y: keys of its values in the pool.
        colour: `#rrggbb`, or `limit` or `ink` for the page's own.
        dash: whether it is dashed.
        at: key of the time of each point, for the time cursor; empty for a curve that has no times.
        step: whether values hold until the next point.
        points: whether the values are dots and not joined.
        fill: whether the area down to zero is filled.
    """

    name: str
    x: str
    y: str
    colour: str
    dash: bool = False
    at: str = "t"
    step: bool = False
    fill: bool = False
    points: bool = False


@dataclass(frozen=True)
class Line:
    """A level across a figure: value of y, name, and whether it is a limit (else a goal)."""

    y: float
    name: str = ""
    limit: bool = False


@dataclass(frozen=True)
class Figure:
    """One figure.

    Attributes:
        id: for links.
        title, caption: caption may be empty.
        group: heading it stands under.
        x_label, y_label: with unit.
        curves, lines: what is drawn.
        time: whether x is the run's time, so that it zooms and moves with the other figures.
        wide: whether it takes the page's whole width.
        y_range: least range of y; empty for none.
        y_top: where y ends, though curves go on; None for the curves' own end.
        x_range: range of x; empty for that of the data.
        lanes: Y of lane markings and whether each is solid, for a figure of the road.
    """

    id: str
    title: str
    group: str
    x_label: str
    y_label: str
    curves: list[Curve]
    caption: str = ""
    lines: list[Line] = field(default_factory=list)
    time: bool = True
    wide: bool = False
    y_range: list[float] = field(default_factory=list)
    y_top: float | None = None
    x_range: list[float] = field(default_factory=list)
    lanes: list[tuple[float, bool]] = field(default_factory=list)
