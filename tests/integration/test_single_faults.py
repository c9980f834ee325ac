"""No single fault makes vehicles collide, and what can be told is told: a sample of the table in docs/faults.md.

In all of the table but one case vehicles come nearest to each other within 1.5 s, so the short form runs for 3 s.
The whole table: `.venv/bin/python -m tests.integration.single_faults`.
"""

import pytest

from tests.conftest import Tries
from tests.integration.single_faults import KINDS, Case, examine

SAMPLE = [
    Case("planner crashes", 2, 0.0),
    Case("planner crashes, back after 1 s", 1, 1.0),
    Case("tracker crashes", 2, 0.0),
    Case("plant off the bus", 2, 0.4),
    Case("radio of all out", 1, 1.0),
    Case("half of all lost, vehicle", 3, 0.4),
    Case("half of all lost, v2v", 1, 0.0),
    Case("broadcast position stuck", 1, 1.0),
    Case("yaw rate off by 0.2 rad/s", 2, 0.4),
    Case("Y off by 2 m", 2, 0.0),
    Case("X off by 5 m", 3, 1.0),
    Case("Reference yaw rate stuck", 3, 1.0),
    Case("steering stuck at 0.03 rad", 1, 1.0),
    Case("ice under all", 1, 0.0),
]


@pytest.mark.parametrize("case", SAMPLE, ids=lambda case: f"{case.name}, vehicle {case.vehicle}, {case.at_s} s")
def test_vehicles_stay_apart_and_the_fault_is_told(case: Case, tries: Tries) -> None:
    outcome = examine(case, duration_s=tries(3, 10))
    assert outcome.is_safe, outcome
    within = KINDS[case.name][1]
    assert outcome.detected is not None
    if within is not None:
        # In the very first cycle there is nothing yet to compare a velocity with.
        assert outcome.detected <= within + (case.at_s == 0.0), outcome


def test_a_tyre_that_blows_out_in_a_comfortable_lane_change_is_coped_with(tries: Tries) -> None:
    """The tracker takes it for a disturbance, so nobody need say anything."""
    outcome = examine(Case("front left tyre blows out", 3, 1.0), duration_s=tries(3, 10))
    assert outcome.is_safe, outcome
    assert outcome.slowest > 19.0


def test_with_its_planner_back_the_vehicle_comes_back(tries: Tries) -> None:
    """Early in a run, and in the long form out of the platoon that has been formed."""
    outcome = examine(Case("planner crashes, back after 1 s", 3, tries(1, 6)), duration_s=tries(7, 14))
    assert outcome.is_safe, outcome
    assert outcome.slowest > 19.0
