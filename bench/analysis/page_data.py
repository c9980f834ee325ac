"""Everything the report page shows of a run, as JSON-serialisable values."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from bench.analysis import requirements
from bench.analysis.bus_load import BusLoad, bus_loads
from bench.analysis.event_rows import event_rows
from bench.analysis.figures import NOTHING_YET, Figures
from bench.analysis.metrics import compute
from bench.analysis.series import Span
from bench.bus.link.base import EXTENDED
from bench.cycle import CYCLE_S
from bench.record import Event, Run
from bench.record.drawing import colour, lane_edges
from bench.record.label import label_of
from platoon_fmu.parameters import BODY, VehicleParameters

PageData = dict[str, Any]

MAX_EVENTS = 5000
"""Maximum number of rows of events; the page lists the first 500 and needs the others for marks and states."""

LONGEST_FACT = 4000
"""Characters shown of a value of the run's metadata."""

WHEEL_WIDTH = 0.22
"""As drawn, m."""


def page_data(run: Run, buses: list[BusLoad] | None = None) -> PageData:
    """Return what the page shows of a finished run; pass `buses` if already computed.

    Raises:
        BadInput: the log has no ground truth or no scenario.
    """
    buses = bus_loads(run) if buses is None else buses
    metrics = compute(run)
    rows = requirements.table(metrics, run.scenario)
    events = event_rows(run.events)
    return {
        **_head(run),
        "live": False,
        "formed": metrics.formed,
        "formation_time": metrics.formation_time_s,
        "complete": metrics.complete,
        "status": run.result.get("status", "cut off"),
        "metrics": [[row.name, row.value, row.requirement, row.met, row.group] for row in rows],
        "events": events[:MAX_EVENTS],
        "more_events": max(0, len(events) - MAX_EVENTS),
        "buses": [_bus(bus) for bus in buses],
        **Figures(run, buses).as_dict(),
    }


def live_data(run: Run) -> PageData:
    """Return what the page shows of a running bench before the first value has arrived.

    The columns are empty; `bench.analysis.figures.pool_of` returns what to append to them. Of `run` only the scenario,
    metadata and channels are used, which are at the start of a log.

    Raises:
        BadInput: the log has no scenario.
    """
    return {
        **_head(run),
        "live": True,
        "formed": False,
        "formation_time": None,
        "complete": False,
        "status": "running",
        "metrics": [],
        "events": [],
        "more_events": 0,
        "buses": [],
        **Figures(run, span=NOTHING_YET).as_dict(),
    }


def events_of(events: Iterable[Event], span: Span | None = None) -> list[dict[str, Any]]:
    """Return events, all or those within a span of time, as `event_rows`."""
    return event_rows(event for event in events if span is None or span[0] <= event.time_s < span[1])


def _head(run: Run) -> PageData:
    scenario = run.scenario
    return {
        "scenario": scenario.name,
        "label": label_of(run),
        "file": run.path.name,
        "description": scenario.description,
        "damage": run.damage,
        "facts": [[name, _cut(value)] for name, value in run.metadata.items() if value],
        "toml": run.scenario_text,
        "road": _road(run),
    }


def _cut(text: str) -> str:
    more = len(text) - LONGEST_FACT
    return text if more <= 0 else f"{text[:LONGEST_FACT]} ... ({more} characters more)"


def _road(run: Run) -> dict[str, Any]:
    """Return what the animation draws: lengths in m, Y of lane markings and whether each is solid."""
    scenario, car = run.scenario, VehicleParameters()
    lanes = sorted({scenario.platoon.lane_y_m, *(vehicle.y_m for vehicle in scenario.vehicles)})
    return {
        "vehicles": run.vehicles,
        "colours": [colour(v) for v in range(1, run.vehicles + 1)],
        "edges": lane_edges(lanes),
        "lane": scenario.platoon.lane_y_m,
        "cycle": CYCLE_S,
        "duration": scenario.duration_s,
        "body": {"front": 0.5 * BODY.length, "rear": 0.5 * BODY.length, "width": BODY.width},
        "axles": [car.l_f, -car.l_r],
        "tread": car.l_t,
        "wheel": [2.0 * car.R_w, WHEEL_WIDTH],
    }


def _bus(bus: BusLoad) -> dict[str, Any]:
    """Return a bus as JSON-serialisable values: loads as fractions, times in s.

    Each message is a row, and each frame of the busiest cycle; their times are in ms.
    """
    return {
        "bus": bus.bus,
        "bit_rate": bus.bit_rate,
        "mean": bus.mean,
        "worst": bus.worst,
        "worst_at": bus.worst_at_s,
        "most": bus.most,
        "busiest": [
            [
                frame.name,
                f"0x{frame.can_id & ~EXTENDED:03X}",
                frame.sender,
                *(1e3 * time for time in (frame.release_s, frame.start_s, frame.end_s)),
            ]
            for frame in bus.busiest
        ],
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
