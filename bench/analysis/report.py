"""The report of a run: one HTML file that holds everything and loads nothing."""

from __future__ import annotations

import html
import json
from importlib import resources
from pathlib import Path
from typing import Any

from bench.analysis import requirements
from bench.analysis.bus_load import BusLoad, bus_loads
from bench.analysis.bus_strip import strip
from bench.analysis.figures import Figures
from bench.analysis.metrics import compute
from bench.analysis.picture import snapshots
from bench.bus.base import EXTENDED
from bench.output_paths import write_report
from bench.record import Run

_MAX_EVENTS = 500


def write(run: Run, out: Path) -> None:
    """Write the report of `run` to `out`, over what is there.

    Raises:
        BadInput: the log has no truth or no scenario, or the file cannot be written.
    """
    write_report(out, render(run))


def render(run: Run) -> str:
    """Return the report as HTML.

    Raises:
        BadInput: the log has no truth or no scenario.
    """
    buses = bus_loads(run)
    data = _data(run, buses)
    parts = {
        "TITLE": html.escape(f"platoon: {data['scenario']}"),
        "STYLE": _asset("page.css"),
        "SCRIPT": _asset("page.js"),
        "PICTURE": snapshots(run),
        "BUSES": strip(buses) if buses else "",
        # No text of the log may end or begin an element inside the one that holds the data.
        "DATA": json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
    }
    page = _asset("page.html")
    for name, text in parts.items():
        page = page.replace(f"<!--{name}-->", text, 1)
    return page


def _data(run: Run, buses: list[BusLoad]) -> dict[str, Any]:
    metrics, scenario = compute(run), run.scenario
    rows = requirements.table(metrics, scenario)
    return {
        "scenario": scenario.name,
        "description": scenario.description,
        "formed": metrics.formed,
        "formation_time": metrics.formation_time_s,
        "complete": metrics.complete,
        "status": run.result.get("status", "cut off"),
        "damage": run.damage,
        "metrics": [[row.name, row.value, row.requirement, row.met, row.of_machine] for row in rows],
        "facts": [[name, value] for name, value in run.metadata.items() if value],
        "toml": run.scenario_text,
        "events": [[event.time_s, event.level, event.source, event.text] for event in run.events[:_MAX_EVENTS]],
        "more_events": max(0, len(run.events) - _MAX_EVENTS),
        "buses": [_bus(bus) for bus in buses],
        **Figures(run, buses).as_dict(),
    }


def _bus(bus: BusLoad) -> dict[str, Any]:
    """A bus as values that JSON takes: shares, s; a message is a row, times in ms."""
    return {
        "bus": bus.bus,
        "bit_rate": bus.bit_rate,
        "mean": bus.mean,
        "worst": bus.worst,
        "worst_at": bus.worst_at_s,
        "most": bus.most,
        "messages": [
            [
                f"0x{message.can_id & ~EXTENDED:03X}",
                message.name,
                message.sender,
                message.count,
                1e3 * message.mean_s,
                1e3 * message.worst_s,
                *(None if time is None else 1e3 * time for time in (message.bound_s, message.period_s)),
                message.in_bound,
                message.in_time,
            ]
            for message in bus.messages
        ],
    }


def _asset(name: str) -> str:
    return resources.files("bench.analysis").joinpath("page", name).read_text(encoding="utf-8")
