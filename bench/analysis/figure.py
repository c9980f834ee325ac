"""One figure as data: which curves, over what, with which limits. The page draws it."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Curve:
    """One curve.

    Attributes:
        name: as the legend shows it; curves of one name are shown and hidden together.
        x, y: keys of its values in the pool.
        colour: `#rrggbb`, or `limit` or `ink` for a colour of the page.
        dash: whether it is dashed.
        at: key of the time of each point, for the time cursor; empty for a curve without times.
        step: whether values are held until the next point.
        fill: whether the area down to zero is filled.
        points: whether values are drawn as dots, not joined.
        label: its name among all curves of the figure, for saved data; empty where that is `name`.
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
    label: str = ""


@dataclass(frozen=True)
class Line:
    """A horizontal line across a figure: y, name, and whether it is a limit (otherwise a goal)."""

    y: float
    name: str = ""
    limit: bool = False


@dataclass(frozen=True)
class Figure:
    """One figure.

    Attributes:
        id: for links.
        title, caption: caption may be empty.
        group: heading above it.
        x_label, y_label: with unit.
        curves, lines: what is drawn.
        time: whether x is time, so that the figure zooms together with the others.
        wide: whether it takes the full width of the page.
        y_range: minimum range of y; empty for none.
        y_top: upper end of y even if curves exceed it; None for the range of the data.
        x_range: range of x; empty for the range of the data.
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
