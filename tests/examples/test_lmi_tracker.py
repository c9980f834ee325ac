"""The paper's inequalities in cvxpy as a solver of the tracker: right, certified, and replaceable."""

import cvxpy as cp
import numpy as np
import pytest

from bench.control.outcome import SolverStatus
from bench.control.rmpc import Gain, RobustController
from bench.examples.lmi_tracker import LmiTracker, PrintedLmiTracker, RobustMpc
from bench.scenario import load
from tests.control.operating_points import INPUT, STATE, OperatingPoint, controller, operating_point


def certified(stated: RobustMpc, point: OperatingPoint, independent: bool = True) -> Gain:
    """What the tracker gets from a statement of the inequalities."""
    return RobustController(STATE, INPUT, 1.0, [stated], independent=independent).solve(
        point.linear, point.chi, point.room
    )


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("independent", [False, True], ids=["equal", "independent"])
def test_its_gains_are_certified_and_those_of_the_built_in_program(seed: int, independent: bool) -> None:
    point = operating_point(seed)
    theirs = certified(RobustMpc(1.0, independent=independent), point, independent)
    ours = controller(independent).solve(point.linear, point.chi, point.room)
    assert theirs.usable
    assert theirs.iterations > 0
    assert theirs.tau == pytest.approx(ours.tau, rel=3e-3)
    # The optimum is flat: costs that are the same within 0.1 % leave the inputs this much freedom.
    np.testing.assert_allclose(theirs.K @ point.chi / INPUT, ours.K @ point.chi / INPUT, rtol=0.03, atol=2e-3)


def test_its_bound_is_the_optimum_before_and_after_the_certificate() -> None:
    """A proof at the vertices is no worse than the multiplier's, and at these points hardly better."""
    stated = RobustMpc(1.0)
    for seed in range(4):
        point = operating_point(seed)
        answer = stated.solve(point.scaled_linear(), point.chi / STATE, point.room / INPUT)
        proven = certified(stated, point).tau
        assert 0.99 * answer.tau <= proven <= answer.tau * (1 + 1e-5)


def test_epsilon_as_printed_is_never_better() -> None:
    stated, printed = RobustMpc(1.0), RobustMpc(1.0, printed=True)
    ratios = []
    for seed in range(12):
        point = operating_point(seed)
        z, room = point.chi / STATE, point.room / INPUT
        ratios.append(
            printed.solve(point.scaled_linear(), z, room).tau / stated.solve(point.scaled_linear(), z, room).tau
        )
    assert min(ratios) >= 1.0 - 1e-5
    assert 1.01 < max(ratios) < 1.2


def test_the_numbers_of_a_step_change_without_stating_the_problem_again() -> None:
    stated = RobustMpc(1.0)
    assert stated.problem.is_dcp(dpp=True)
    assert len(stated.problem.parameters()) == 7


def test_a_result_depends_on_its_step_alone() -> None:
    fresh, used = RobustMpc(1.0), RobustMpc(1.0)
    for seed in (5, 6, 7):
        certified(used, operating_point(seed))
    point = operating_point(8)
    np.testing.assert_array_equal(certified(used, point).K, certified(fresh, point).K)


class WithMore(RobustMpc):
    """A researcher's own inequality: next to nothing may be spent."""

    def matrix_inequalities(self) -> list[cp.Constraint]:
        return [*super().matrix_inequalities(), self.tau <= 1e-6]


class WithLess(RobustMpc):
    """A mistake: without the input bounds."""

    def matrix_inequalities(self) -> list[cp.Constraint]:
        return super().matrix_inequalities()[:2]


def test_an_inequality_that_cannot_be_met_is_said() -> None:
    gain = certified(WithMore(1.0), operating_point(0))
    assert gain.status is SolverStatus.INFEASIBLE
    assert not gain.usable


def test_an_inequality_that_is_missed_is_caught_by_the_certificate() -> None:
    point = operating_point(0)
    tight = OperatingPoint(point.linear, point.chi, 0.5 * np.abs(certified(RobustMpc(1.0), point).K @ point.chi))
    gain = certified(WithLess(1.0), tight)
    assert gain.status is SolverStatus.CHECK_FAILED
    assert not gain.usable


def test_a_solver_that_cannot_is_no_answer() -> None:
    assert certified(RobustMpc(1.0, solver=cp.OSQP), operating_point(0)).status is SolverStatus.NUMERICAL_ERROR
    limited = RobustMpc(1.0, options={"max_iter": 3})
    assert certified(limited, operating_point(0)).status is SolverStatus.MAX_ITERATIONS


@pytest.mark.parametrize(("tracker", "printed"), [(LmiTracker, False), (PrintedLmiTracker, True)])
def test_the_trackers_take_the_scenarios_settings(tracker: type[LmiTracker], printed: bool) -> None:
    settings = load("formation", ["tracker.input_weight=2.0", "tracker.independent_axles=false"]).tracker
    (stated,) = tracker.solvers(settings)
    assert isinstance(stated, RobustMpc)
    expected = RobustMpc(2.0, independent=False, printed=printed)
    point = operating_point(1)
    z, room = point.chi / STATE, point.room / INPUT
    assert stated.solve(point.scaled_linear(), z, room).tau == expected.solve(point.scaled_linear(), z, room).tau
