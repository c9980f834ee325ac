"""The report of a run, or of two: one HTML file that holds everything and loads nothing.

The page's script is written in pieces, `page/*.js`, which are put into it one after the other.
"""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

from bench.analysis.bus_load import bus_loads
from bench.analysis.bus_strip import strip
from bench.analysis.differences import figures_of
from bench.analysis.metrics import compute
from bench.analysis.page_data import PageData, live_data, page_data
from bench.analysis.picture import snapshots
from bench.analysis.two_runs import together
from bench.errors import BadInput
from bench.files import write_text
from bench.record import Run
from bench.record.compare import SignalDifference

SCRIPTS = ("dom", "data", "marks", "cursor", "axes", "plot", "car", "view", "animation", "player", "tables", "page")
"""The pieces of the script, each of which uses only those before it when the page is loaded."""

LIVE_SCRIPTS = ("live",)


def write(run: Run, out: Path, other: Run | None = None, signals: Sequence[SignalDifference] = ()) -> None:
    """Write the report of `run` to `out`, over what is there; laid over it `other`, where one is given.

    Of two runs, `signals` that differ are drawn before all else; see `render_both`.

    Raises:
        BadInput: a log has no truth or no scenario, or the file cannot be written.
    """
    write_text(out, render(run) if other is None else render_both(run, other, signals))


def render(run: Run) -> str:
    """Return the report as HTML.

    Raises:
        BadInput: the log has no truth or no scenario.
    """
    buses = bus_loads(run)
    data = page_data(run, buses)
    return _page(data, f"platoon: {data['scenario']}", _figure(snapshots(run)), strip(buses) if buses else "")


def render_both(a: Run, b: Run, signals: Sequence[SignalDifference] = ()) -> str:
    """Return the report of two runs laid over each other, `a` solid and `b` dashed, as HTML.

    Args:
        a: the first run.
        b: the second one.
        signals: what differs, in the order in which it begins to; figures of it come first.

    Raises:
        BadInput: a log has no truth or no scenario.
    """
    buses = bus_loads(a)
    data = together(page_data(a, buses), page_data(b), (compute(a), compute(b)))
    figures, pool = figures_of(signals, a, b)
    data |= {"figures": figures + data["figures"], "pool": data["pool"] | pool}
    title = f"platoon: {data['scenario']} and {data['other']['scenario']}"
    pictures = _figure(snapshots(a), "A") + _figure(snapshots(b), "B")
    return _page(data, title, pictures, strip(buses) if buses else "")


def check_drawable(run: Run) -> None:
    """Refuse a log of which no report can be made.

    Raises:
        BadInput: it has no truth or no scenario.
    """
    missing = [f"/truth/veh{v}" for v in range(1, len(run.scenario.vehicles) + 1) if f"/truth/veh{v}" not in run.topics]
    if missing:
        raise BadInput(f"{run.path} has no {', '.join(missing)}: no page can be drawn of a run without its truth")


def render_live(run: Run) -> str:
    """Return the page of a run that goes on, which a server has to feed; see `page/live.js`.

    Only what a log has from its beginning is asked of `run`.

    Raises:
        BadInput: the log has no scenario.
    """
    data = live_data(run)
    return _page(data, f"platoon: {data['scenario']}", "", "", live=True)


def _page(data: PageData, title: str, pictures: str, buses: str, *, live: bool = False) -> str:
    scripts = SCRIPTS[:-1] + LIVE_SCRIPTS + SCRIPTS[-1:] if live else SCRIPTS
    parts = {
        "TITLE": html.escape(title),
        "CONNECT": " connect-src 'self';" if live else "",
        "STYLE": _asset("page.css"),
        "SCRIPT": "\n".join(_asset(f"{name}.js") for name in scripts),
        "PICTURES": pictures,
        "BUSES": buses,
        # No text of the log may end or begin an element inside the one that holds the data.
        "DATA": json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
    }
    page = _asset("page.html")
    for name, text in parts.items():
        page = page.replace(f"<!--{name}-->", text, 1)
    return page


def _figure(picture: str, run: str = "") -> str:
    caption = "From above, the view moving along with the platoon."
    return f"<figure>{picture}<figcaption>{f'{run}: ' if run else ''}{caption}</figcaption></figure>"


def _asset(name: str) -> str:
    return resources.files("bench.analysis").joinpath("page", name).read_text(encoding="utf-8")
