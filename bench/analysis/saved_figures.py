"""The figures of a report as files: SVG or PNG, drawn by matplotlib, or their data as CSV."""

from __future__ import annotations

import csv
import importlib.util
import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.analysis.page_data import PageData
from bench.errors import BadInput
from bench.files import check_directory, written_aside

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {"limit": "#c8102e", "ink": "#1d1f21"}
"""On white paper; all other colours are given as they are."""

_SOFT = "#62666b"
_GRID = "#e9e9e6"
_DPI = 160
_STRIP = "busiest-cycle"
_STRIP_TITLE = "The busiest cycle of each bus"
_STRIP_COLUMNS = ("bus", "message", "identifier", "sender", "released [ms]", "start [ms]", "end [ms]")
_SENDERS = {"conductor": "#8a8a8a", "plant": "#009e73", "planner": "#0072b2", "tracker": "#d55e00"}

Row = Sequence[object]


class Format(StrEnum):
    """What a figure can be saved as."""

    SVG = "svg"
    PNG = "png"
    CSV = "csv"


def check_savable(folder: Path, formats: Sequence[Format]) -> None:
    """Check that figures can be saved.

    Raises:
        BadInput: the folder cannot be created or is not writable, or a package is not installed.
    """
    if folder.exists() and not folder.is_dir():
        raise BadInput(f"--save-figures {folder} is a file; give a directory")
    check_directory(folder / "figure" if folder.is_dir() else folder)
    if any(each is not Format.CSV for each in formats) and importlib.util.find_spec("matplotlib") is None:
        raise BadInput("SVG and PNG need the package matplotlib; install it with: pip install matplotlib")


def save_figures(data: PageData, folder: Path, formats: Sequence[Format]) -> list[Path]:
    """Write each figure of a page's data to a file in each format, and return the files.

    Args:
        data: as of `bench.analysis.report.data_of`.
        folder: created if it does not exist; older files of the same names are overwritten.
        formats: which ones.

    Raises:
        BadInput: a file cannot be written.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise BadInput(f"cannot create {folder}: {error.strerror or error}") from error
    return [path for kind in dict.fromkeys(formats) for path in _saved(data, folder, kind)]


def figure_rows(figure: Mapping[str, Any], pool: Mapping[str, Sequence[float | None]]) -> list[Row]:
    """Return the data of a figure: the head, then a row for each index of its columns; empty where one has ended.

    Each column of the pool comes once: the times of the curves, their x and their y.
    """
    heads: dict[str, str] = {}
    for curve in figure["curves"]:
        run = curve.get("run", "")
        who = " ".join(part for part in (run, curve["label"] or curve["name"]) if part)
        if curve["at"]:
            heads.setdefault(curve["at"], f"{run} time [s]".strip())
        heads.setdefault(curve["x"], f"{who}: {figure['x_label']}")
        heads.setdefault(curve["y"], f"{who}: {figure['y_label']}")
    columns = [pool[key] for key in heads]
    length = max(map(len, columns), default=0)
    rows = ([column[index] if index < len(column) else None for column in columns] for index in range(length))
    return [list(heads.values()), *rows]


def strip_rows(data: PageData) -> list[Row]:
    """Return the frames of the busiest cycle of each bus, after the head."""
    return [_STRIP_COLUMNS, *([bus["bus"], *frame] for bus in data["buses"] for frame in bus["busiest"])]


def csv_text(rows: Sequence[Row]) -> str:
    """Return rows as CSV (RFC 4180, with line feeds)."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def _saved(data: PageData, folder: Path, kind: Format) -> Iterator[Path]:
    for name, rows, draw in _all(data):
        path = folder / f"{name}.{kind}"
        with written_aside(path) as aside:
            if kind is Format.CSV:
                aside.write_text(csv_text(rows()), encoding="utf-8")
            else:
                _write_drawing(draw, aside, kind)
        yield path


def _all(data: PageData) -> Iterator[tuple[str, Callable[[], list[Row]], Callable[[], Figure]]]:
    """Yield the name of each figure, and functions that return its data and draw it."""
    for figure in data["figures"]:
        name = re.sub(r"[^A-Za-z0-9_-]+", "-", figure["id"])
        yield name, partial(figure_rows, figure, data["pool"]), partial(_drawn, figure, data)
    if any(bus["busiest"] for bus in data["buses"]):
        yield _STRIP, partial(strip_rows, data), partial(_drawn_strip, data)


def _write_drawing(draw: Callable[[], Figure], path: Path, kind: Format) -> None:
    # Here, because it takes a while to import.
    from matplotlib import rc_context

    # Text stays text, without formulas in it; the same figure gives the same bytes.
    settings: Any = {"svg.fonttype": "none", "svg.hashsalt": "platoon", "text.parse_math": False, "font.size": 9.0}
    with rc_context(settings):
        draw().savefig(path, format=str(kind), dpi=_DPI, metadata={"Date": None} if kind is Format.SVG else None)


def _axes(title: str, wide: bool, caption: str) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 3.2) if wide else (7.0, 3.6), layout="constrained")
    axes = figure.subplots()
    axes.set_title(re.sub(" +", " ", title), loc="left", fontweight="bold")
    axes.grid(color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    if caption:
        figure.supxlabel(caption, fontsize=7.5, color=_SOFT, wrap=True)
    return figure, axes


def _drawn(figure: Mapping[str, Any], data: PageData) -> Figure:
    picture, axes = _axes(figure["title"], figure["wide"], figure["caption"])
    axes.set_xlabel(figure["x_label"])
    axes.set_ylabel(figure["y_label"])
    for curve in figure["curves"]:
        _draw_curve(axes, curve, data["pool"])
    _draw_road(axes, figure["lanes"])
    _set_ranges(axes, figure)
    for line in figure["lines"]:
        _draw_line(axes, line)
    _add_legend(picture)
    return picture


def _draw_curve(axes: Axes, curve: Mapping[str, Any], pool: Mapping[str, Sequence[float | None]]) -> None:
    x, y = ([float("nan") if value is None else value for value in pool[curve[key]]] for key in ("x", "y"))
    run = curve.get("run", "")
    # With two runs, B is dashed, and what is dashed for a single run is dotted.
    style = "--" if run == "B" or curve["dash"] else "-"
    style = ":" if run and curve["dash"] else style
    colour = COLOURS.get(curve["colour"], curve["colour"])
    name = " ".join(part for part in (run, curve["label"] or curve["name"]) if part)
    look: dict[str, Any] = {"color": colour, "linewidth": 1.3, "linestyle": style}
    if curve["points"]:
        look |= {"linestyle": "none", "marker": ".", "markersize": 2.5}
    axes.plot(x, y, label=name, drawstyle="steps-post" if curve["step"] else "default", **look)
    if curve["fill"] and run != "B":
        axes.fill_between(x, y, step="post" if curve["step"] else None, color=colour, alpha=0.35, linewidth=0.0)


def _draw_line(axes: Axes, line: Mapping[str, Any]) -> None:
    colour = COLOURS["limit"] if line["limit"] else _SOFT
    axes.axhline(line["y"], linewidth=1.0, zorder=1.5, color=colour, linestyle="-" if line["limit"] else (0, (2, 3)))
    place = axes.get_yaxis_transform()
    axes.text(0.99, line["y"], line["name"], transform=place, ha="right", va="bottom", color=_SOFT, fontsize=7.5)


def _draw_road(axes: Axes, lanes: Sequence[tuple[float, bool]]) -> None:
    if not lanes:
        return
    axes.grid(visible=False)
    axes.axhspan(min(level for level, _ in lanes), max(level for level, _ in lanes), color=_GRID, zorder=0.5)
    for level, solid in lanes:
        axes.axhline(level, color=_SOFT, linewidth=1.0, linestyle="-" if solid else (0, (9, 9)), zorder=0.6)


def _set_ranges(axes: Axes, figure: Mapping[str, Any]) -> None:
    levels = [*figure["y_range"], *(line["y"] for line in figure["lines"])]
    axes.update_datalim([(axes.dataLim.x0, level) for level in levels])
    axes.autoscale_view()
    if figure["x_range"]:
        axes.set_xlim(*figure["x_range"])
    if figure["y_top"] is not None:
        axes.set_ylim(0.0, figure["y_top"])


def _drawn_strip(data: PageData) -> Figure:
    caption = "A bar is a frame on the wire, the line below it is its waiting time."
    picture, axes = _axes(_STRIP_TITLE, wide=True, caption=caption)
    axes.set_xlabel("time in the cycle [ms]")
    for row, bus in enumerate(data["buses"]):
        for _, _, sender, released, start, end in bus["busiest"]:
            colour = _SENDERS.get(sender.rpartition(".")[2], COLOURS["limit"])
            axes.broken_barh([(start, end - start)], (row - 0.25, 0.5), facecolor=colour)
            axes.plot([released, start], [row + 0.35] * 2, color=colour, linewidth=1.0, alpha=0.55)
    axes.set_yticks(range(len(data["buses"])), [bus["bus"] for bus in data["buses"]])
    axes.invert_yaxis()
    for role, colour in (*_SENDERS.items(), ("others", COLOURS["limit"])):
        axes.plot([], [], color=colour, linewidth=5.0, label=role)
    _add_legend(picture)
    return picture


def _add_legend(picture: Figure) -> None:
    # Beside the axes, where it covers nothing, however many curves there are.
    picture.legend(fontsize=7.5, frameon=False, loc="outside right upper")
