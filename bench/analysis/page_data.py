"""All that the report's page shows of a run, as values that JSON takes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from bench.analysis import requirements
from bench.analysis.bus_load import BusLoad, bus_loads
from bench.analysis.figures import NOTHING_YET, Figures
from bench.analysis.metrics import compute
from bench.analysis.series import Span
from bench.bus.link.base import EXTENDED
from bench.cycle import CYCLE_S
from bench.record import Event, Run
from bench.record.drawing import BODY, colour, lane_edges
from platoon_fmu.parameters import VehicleParameters

PageData = dict[str, Any]

MAX_EVENTS = 500

WHEEL_WIDTH = 0.22
"""As drawn, m."""


def page_data(run: Run, buses: list[BusLoad] | None = None) -> PageData:
    """Return what the page shows of a run that is over; `buses` where they are known already.

    Raises:
        BadInput: the log has no truth or no scenario.
    """
    buses = bus_loads(run) if buses is None else buses
    metrics = compute(run)
    rows = requirements.table(metrics, run.scenario)
    return {
        **_head(run),
        "live": False,
        "formed": metrics.formed,
        "formation_time": metrics.formation_time_s,
        "complete": metrics.complete,
        "status": run.result.get("status", "cut off"),
        "metrics": [[row.name, row.value, row.requirement, row.met, row.of_machine] for row in rows],
        "events": events_of(run.events[:MAX_EVENTS]),
        "more_events": max(0, len(run.events) - MAX_EVENTS),
        "buses": [_bus(bus) for bus in buses],
        **Figures(run, buses).as_dict(),
    }


def live_data(run: Run) -> PageData:
    """Return what the page shows of a run that goes on, before the first value of it has come.

    The columns are empty; `bench.analysis.figures.pool_of` gives what they grow by. Only what a log has from its
    beginning is asked of `run`: scenario, metadata and channels.

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
    """Return events, all or those of a span of time, by the names that `Event` has for what they are made of."""
    return [asdict(event) for event in events if span is None or span[0] <= event.time_s < span[1]]


def _head(run: Run) -> PageData:
    scenario = run.scenario
    return {
        "scenario": scenario.name,
        "file": run.path.name,
        "description": scenario.description,
        "damage": run.damage,
        "facts": [[name, value] for name, value in run.metadata.items() if value],
        "toml": run.scenario_text,
        "road": _road(run),
    }


def _road(run: Run) -> dict[str, Any]:
    """What the animation draws: lengths in m, Y of lane markings and whether each is solid."""
    scenario, car = run.scenario, VehicleParameters()
    lanes = sorted({scenario.platoon.lane_y_m, *(vehicle.y_m for vehicle in scenario.vehicles)})
    return {
        "vehicles": run.vehicles,
        "colours": [colour(v) for v in range(1, run.vehicles + 1)],
        "edges": lane_edges(lanes),
        "lane": scenario.platoon.lane_y_m,
        "cycle": CYCLE_S,
        "duration": scenario.duration_s,
        "body": {name: value for name, value in asdict(BODY).items() if name != "boxes"},
        "axles": [car.l_f, -car.l_r],
        "tread": car.l_t,
        "wheel": [2.0 * car.R_w, WHEEL_WIDTH],
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
