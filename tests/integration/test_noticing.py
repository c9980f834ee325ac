"""Which ECU noticed a fault, and when: every change of its state or cause on the bus is an event of the log."""

import json
from pathlib import Path

import polars as pl
import pytest

from bench.bus.link.address import Address
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.ecu.loading import DEFAULT_ECUS
from bench.events import CauseChange, StateChange
from bench.record.exchange.events import EventFormat, export_events
from bench.record.overview import Noticed, overview
from bench.record.reader import Run
from bench.scenario import load

OUTAGE = '{kind = "v2v_outage", at_s = 0.3, for_s = 0.3}'
NOISE = '{kind="sensor_noise", at_s=0.2, bus="veh3", message="VehicleMotion", signal="YawRate", sigma=0.02}'
CRASH = '{kind = "ecu_crash", at_s = 0.4, for_s = 0.1, ecu = "veh2.tracker"}'


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Run:
    scenario = load("formation", ["duration_s=1.0", f"faults=[{OUTAGE}, {NOISE}, {CRASH}]"])
    out = tmp_path_factory.mktemp("noisy") / "run.mcap"
    return Run(run(RunOptions(scenario, address=Address.parse("direct"), out=out, command_line=["test"])).path)


@pytest.mark.parametrize("role", ["planner", "tracker"])
@pytest.mark.parametrize("vehicle", [1, 2, 3])
def test_every_change_of_state_or_cause_on_the_bus_is_one_event(noisy: Run, vehicle: int, role: str) -> None:
    table = noisy.message_table(f"veh{vehicle}.{role.capitalize()}Status", labels=True)
    expected, before = [], ("Init", "None")
    for time_s, state, cause in table.select("t", "State", "Cause").iter_rows():
        if (state, cause) != before:
            change = (state.lower(), cause.replace("None", ""), before[1].replace("None", ""))
            expected.append((round(time_s, 3), "state_change" if state != before[0] else "cause_change", *change))
        before = state, cause
    found = [
        (
            round(event.time_s, 3),
            event.kind,
            event.fields.get("after", event.fields.get("state")),
            event.fields["cause"],
            event.fields["cause_before"],
        )
        for event in noisy.events
        if event.kind in (StateChange.kind, CauseChange.kind) and event.fields.get("ecu") == f"veh{vehicle}.{role}"
    ]
    assert found == expected
    assert len(expected) > 1


def test_the_overview_says_who_noticed_what_and_when(noisy: Run) -> None:
    causes = overview(noisy).causes
    assert set(causes) <= {f"veh{vehicle}.{role}" for vehicle in (1, 2, 3) for role in ("planner", "tracker")}
    noticed = {(ecu, each.cause): each for ecu, those in causes.items() for each in those}
    for vehicle in (1, 2, 3):
        for cause in ("PeerMissing", "PeerLost"):
            signal = noisy.message_table(f"veh{vehicle}.PlannerStatus", labels=True)
            rows = [cause == each for each in signal["Cause"]]
            times = [
                t for t, now, was in zip(signal["t"], rows, [False, *rows], strict=False) if now and not was and t > 0
            ]
            assert noticed[f"veh{vehicle}.planner", cause] == Noticed(cause, times[0], len(times))


@pytest.mark.parametrize("kind", EventFormat, ids=str)
def test_the_events_of_a_real_run_are_exported(noisy: Run, tmp_path: Path, kind: EventFormat) -> None:
    target = tmp_path / f"events{kind.suffix}"
    assert export_events(noisy.path, target, kind) == len(noisy.events)
    if kind is EventFormat.JSON:
        rows = [{**row, **row["fields"]} for row in json.loads(target.read_text())]
    else:
        table = pl.read_csv(target).rename({"t [s]": "t"}) if kind is EventFormat.CSV else pl.read_parquet(target)
        rows = table.to_dicts()
    assert [(row["t"], row["text"]) for row in rows] == [(event.time_s, event.text) for event in noisy.events]
    # The question of the table: when did vehicle 3 notice that it heard nobody?
    noticed = [row["t"] for row in rows if row["vehicle"] == 3 and row.get("cause") == "PeerLost"]
    assert noticed[0] == next(c.first_s for c in overview(noisy).causes["veh3.planner"] if c.cause == "PeerLost")
    crash = {(row["ecu"], row["vehicle"]) for row in rows if row.get("fault") == "ecu_crash"}
    assert crash == {("veh2.tracker", 2)}


def test_an_ecu_that_prints_a_traceback_has_its_last_line_in_the_overview(tmp_path: Path) -> None:
    text = """
import traceback
from bench.ecu import Command, TrackerBase

class Grumbling(TrackerBase):
    def control(self, motion, reference):
        try:
            return Command.evenly(1.0 / (self.time_s - 0.05), 0.0)
        except ZeroDivisionError:
            traceback.print_exc()
            return Command.evenly(0.0, 0.0)
"""
    (tmp_path / "my_ecu.py").write_text(text)
    ecus = {**DEFAULT_ECUS, "tracker": f"{tmp_path}/my_ecu.py:Grumbling"}
    scenario = load("formation", ["duration_s=0.1"])
    out, address = tmp_path / "run.mcap", Address.parse("udp")
    recorded = Run(run(RunOptions(scenario, address=address, out=out, command_line=["test"], ecus=ecus)).path)
    last = {output.last for output in overview(recorded).outputs.values()}
    assert last == {"ZeroDivisionError: float division by zero"}
    assert set(overview(recorded).outputs) == {"veh1.tracker", "veh2.tracker", "veh3.tracker"}
