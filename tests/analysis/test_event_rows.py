"""The events as the page lists them: what recurs is one row, and nothing else is."""

from bench.analysis.event_rows import SAME_S, event_rows
from bench.events import CauseChange, DeadlineMissed, StateChange
from bench.events import Event as Told
from bench.record import Event


def recorded(*events: tuple[float, Told]) -> list[Event]:
    return [Event(time_s, each.level, each.source, each.text, each.kind, each.fields) for time_s, each in events]


def shown(*events: tuple[float, Told]) -> list[tuple[float, str, list[float]]]:
    return [(row["time_s"], row["text"], row["repeats"]) for row in event_rows(recorded(*events))]


MISSING = CauseChange("warning", "veh1.planner", "degraded", "PeerMissing", "SensorMissing")
BACK = CauseChange("warning", "veh1.planner", "degraded", "SensorMissing", "PeerMissing")
RUN = StateChange("info", "veh1.planner", "degraded", "run", "", "PeerMissing")


def test_what_recurs_is_one_row_with_the_times_of_all() -> None:
    assert shown((0.0, MISSING), (0.25, BACK), (0.5, MISSING), (0.75, BACK), (1.5, MISSING), (1.5, RUN)) == [
        (0.0, MISSING.text, [0.5, 1.5]),
        (0.25, BACK.text, [0.75]),
        (1.5, RUN.text, []),
    ]


def test_what_comes_back_later_or_from_another_ecu_is_a_row_of_its_own() -> None:
    other = CauseChange("warning", "veh2.planner", "degraded", "PeerMissing", "SensorMissing")
    late = 1.01 * SAME_S
    assert [row[0] for row in shown((0.0, MISSING), (0.5, other), (late, MISSING), (late + 0.5, other))] == [
        *(0.0, 0.5, late, late + 0.5)
    ]


def test_events_of_other_kinds_are_all_listed() -> None:
    missed = DeadlineMissed("veh1.planner", 1.5)
    assert [row[0] for row in shown((0.0, missed), (0.01, missed))] == [0.0, 0.01]
