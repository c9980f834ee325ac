"""What the events of a run report as wrong, in its metrics."""

from bench.analysis.metrics import compute
from bench.analysis.requirements import table
from bench.events import Clipped, FaultBegins, FaultEnds, NotANumber, NumberAgain, ProcessOutput, StateChange

from .conftest import Motions

NAN = NotANumber("veh1.tracker", 31, "SteeringCommand", "SteeringAngle", "nan", command=True)


def metrics_of(run_of, *events):
    motions = Motions(2, 100)
    motions.events = list(events)
    run = run_of(motions)
    return compute(run), run.scenario


def test_warnings_are_counted_with_the_first_one(run_of):
    fault = {"ecu": "veh1.tracker"}
    metrics, scenario = metrics_of(
        run_of,
        (0.0, StateChange("info", "veh1.planner", "init", "run")),
        # Asked for, unlike what comes of it.
        (0.1, FaultBegins("ecu_crash", fault, 0.2)),
        (0.12, ProcessOutput("veh2.planner", "it is late\nvery late\n")),
        (0.2, FaultEnds("ecu_crash", fault)),
        (0.3, StateChange("warning", "veh1.planner", "run", "safe", "TrackerLost")),
        (0.31, NAN),
    )
    assert str(metrics.warnings) == "3 warnings, first at 0.12 s: veh2.planner: it is late"
    assert metrics.as_dict()["warnings"] == {"count": 3, "first_s": 0.12, "first": "veh2.planner: it is late"}
    rows = {row.name: row for row in table(metrics, scenario)}
    assert rows["Warnings"].value.startswith("3 warnings, first at 0.12 s")
    assert rows["Warnings"].met is None


def test_a_run_without_warnings_says_so(run_of):
    metrics, scenario = metrics_of(run_of, (0.0, StateChange("info", "veh1.planner", "init", "run")))
    assert (metrics.warnings.count, metrics.warnings.first_s, str(metrics.warnings)) == (0, None, "no warnings")
    rows = {row.name: row for row in table(metrics, scenario)}
    assert rows["Warnings"].value == rows["Commands that are not numbers"].value == "0"
    assert rows["Commands that are not numbers"].met


def test_a_command_that_is_not_a_number_is_a_requirement_missed_unless_allowed(run_of):
    torque = NotANumber("veh2.tracker", 40, "TorqueCommandRear", "TorqueRL", "-inf", command=True)
    metrics, scenario = metrics_of(
        run_of,
        (0.31, NAN),
        (0.4, torque),
        (0.5, NumberAgain("veh1.tracker", 50, "SteeringCommand", "SteeringAngle", 19)),
        # Neither a diagnostic nor a clipped value is a reason to fail.
        (0.6, NotANumber("veh2.tracker", 60, "TrackerStatus", "Tau", "nan", command=False)),
        (0.7, Clipped("veh2.tracker", 70, "SteeringCommand", "SteeringAngle", 2.0, 1.0)),
    )
    assert [str(each) for each in metrics.not_numbers] == [
        "veh1.tracker sent SteeringCommand.SteeringAngle = nan, which is not a number, from 0.31 s for 19 cycles",
        "veh2.tracker sent TorqueCommandRear.TorqueRL = -inf, which is not a number, from 0.40 s to the end",
    ]
    assert metrics.warnings.count == 4
    name = "Commands that are not numbers"
    (row,) = [row for row in table(metrics, scenario) if row.name == name]
    assert row.met is False
    assert "veh1.tracker" in row.value
    assert row.value.endswith(" and 1 more")
    allowed = scenario.model_copy(update={"on_not_a_number": "allow"})
    (row,) = [row for row in table(metrics, allowed) if row.name == name]
    assert row.met is None


def test_each_time_a_signal_fails_counts_for_itself(run_of):
    again = NumberAgain("veh1.tracker", 33, "SteeringCommand", "SteeringAngle", 2)
    later = NotANumber("veh1.tracker", 60, "SteeringCommand", "SteeringAngle", "inf", command=True)
    metrics, _ = metrics_of(run_of, (0.31, NAN), (0.33, again), (0.6, later))
    assert [(each.value, each.first_s, each.cycles) for each in metrics.not_numbers] == [
        ("nan", 0.31, 2),
        ("inf", 0.6, None),
    ]
