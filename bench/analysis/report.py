"""The report of one or two runs: a self-contained HTML file that loads nothing.

The page's script is the concatenation of files in `page/*.js`.
"""

from __future__ import annotations

import html
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path

from bench.analysis.bus_load import BusLoad, bus_loads
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
from bench.record.settings import compare_settings

SCRIPTS = (
    "dom",
    "data",
    "marks",
    "cursor",
    "axes",
    "save",
    "plot",
    "car",
    "view",
    "animation",
    "player",
    "rows",
    "tables",
    "print",
    "page",
)
"""The files of the script, in order; while the page loads, each uses only those before it."""

LIVE_SCRIPTS = ("live",)


def write(
    run: Run, out: Path, other: Run | None = None, signals: Sequence[SignalDifference] = (), *, new: bool = False
) -> None:
    """Write the report of `run`, overlaid with `other` if given, to `out`, replacing an existing file unless `new`.

    Of two runs, `signals` that differ are drawn first; see `render_both`.

    Raises:
        BadInput: a log has no ground truth or no scenario, or the file cannot be written, or exists and was to be new.
    """
    page = render(run) if other is None else render_both(run, other, signals)
    write_text(out, page, new=new, option="--out")


def render(run: Run) -> str:
    """Return the report as HTML.

    Raises:
        BadInput: the log has no ground truth or no scenario.
    """
    buses = bus_loads(run)
    data = data_of(run, buses=buses)
    return _page(data, _title(data), _figure(snapshots(run)), strip(buses) if buses else "")


def render_both(a: Run, b: Run, signals: Sequence[SignalDifference] = ()) -> str:
    """Return the report of two overlaid runs, `a` solid and `b` dashed, as HTML.

    Args:
        a: the first run.
        b: the second run.
        signals: the signals that differ, in order of their first difference; their figures come first.

    Raises:
        BadInput: a log has no ground truth or no scenario.
    """
    buses = bus_loads(a)
    data = data_of(a, b, signals, buses)
    title = f"{_title(data)} and {_title(data['other'], '')}"
    pictures = _figure(snapshots(a), "A") + _figure(snapshots(b), "B")
    return _page(data, title, pictures, strip(buses) if buses else "")


def data_of(
    run: Run,
    other: Run | None = None,
    signals: Sequence[SignalDifference] = (),
    buses: list[BusLoad] | None = None,
) -> PageData:
    """Return what the page of a run shows, or of two overlaid, with the `signals` that differ; `buses` are of `run`.

    Raises:
        BadInput: a log has no ground truth or no scenario.
    """
    data = page_data(run, buses)
    if other is None:
        return data
    both = together(data, page_data(other), (compute(run), compute(other)), compare_settings(run, other))
    figures, pool = figures_of(signals, run, other)
    return {**both, "figures": figures + both["figures"], "pool": both["pool"] | pool}


def check_drawable(run: Run) -> None:
    """Reject a log from which no report can be drawn.

    Raises:
        BadInput: it has no ground truth or no scenario.
    """
    missing = [f"/truth/veh{v}" for v in range(1, len(run.scenario.vehicles) + 1) if f"/truth/veh{v}" not in run.topics]
    if missing:
        raise BadInput(f"{run.path} has no {', '.join(missing)}: a report needs the ground truth of every vehicle")


def render_live(run: Run) -> str:
    """Return the page of a running bench, which a server must feed; see `page/live.js`.

    Only what a log has at its start is used of `run`.

    Raises:
        BadInput: the log has no scenario.
    """
    data = live_data(run)
    return _page(data, _title(data), "", "", live=True)


def _title(data: PageData, before: str = "platoon: ") -> str:
    return before + (f"{data['label']} ({data['scenario']})" if data["label"] else str(data["scenario"]))


def _page(data: PageData, title: str, pictures: str, buses: str, *, live: bool = False) -> str:
    scripts = SCRIPTS[:-1] + LIVE_SCRIPTS + SCRIPTS[-1:] if live else SCRIPTS
    parts = {"CONNECT": " connect-src 'self';" if live else "", "PICTURES": pictures, "BUSES": buses}
    script = "\n".join(asset(f"{name}.js") for name in scripts)
    return filled(asset("page.html"), title, asset("page.css"), script, parts, data)


def filled(template: str, title: str, style: str, script: str, parts: Mapping[str, str], data: PageData) -> str:
    """Return a page with everything in it that it needs.

    Args:
        template: HTML with a comment for each part: TITLE, STYLE, SCRIPT, DATA and those of `parts`.
        title: as text.
        style: CSS.
        script: JavaScript.
        parts: further parts by name, as HTML.
        data: as JSON-serialisable values.
    """
    # Text from a log must not close the element that holds the data, or open one inside it.
    values = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    page = template
    for name, text in {"TITLE": html.escape(title), "STYLE": style, "SCRIPT": script, **parts, "DATA": values}.items():
        page = page.replace(f"<!--{name}-->", text, 1)
    return page


def asset(name: str) -> str:
    """Return a file of the page."""
    return resources.files("bench.analysis").joinpath("page", name).read_text(encoding="utf-8")


def _figure(picture: str, run: str = "") -> str:
    caption = "From above; the view moves with the platoon."
    return f"<figure>{picture}<figcaption>{f'{run}: ' if run else ''}{caption}</figcaption></figure>"
