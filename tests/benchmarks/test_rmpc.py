"""The robust MPC's set of problems: the bench solves a sample as well as cvxpy, and the benchmark is whole."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cvxpy as cp
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from bench.benchmarks.rmpc import command, nominal, worst
from bench.benchmarks.rmpc.check import failures
from bench.benchmarks.rmpc.contestants import OURS, Contestant, Result, by_cvxpy, contestants, solved
from bench.benchmarks.rmpc.making import ORACLE_TOLERANCES, at_bounds, optima_of, random_problem, recorded_steps
from bench.benchmarks.rmpc.page import page
from bench.benchmarks.rmpc.problems import FILE, Problems, load, problems_of, save
from bench.benchmarks.rmpc.tables import groups_sheet, nominal_sheet, robust_sheet
from bench.control.outcome import GainSource, SolverStatus

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def problems() -> Problems:
    return load()


def spread(problems: Problems, count: int) -> Problems:
    """Single problems from all over the set."""
    return problems.chosen(np.linspace(0, len(problems) - 1, count).round().astype(int))


@pytest.fixture(scope="module")
def ours(problems: Problems) -> Result:
    return solved(OURS, spread(problems, 60))


def test_a_sample_is_solved_as_well_as_by_cvxpy_or_by_the_semidefinite_program(ours: Result) -> None:
    assert failures(ours) == []
    assert ours.usable[ours.feasible].all()


@pytest.mark.nightly
def test_all_are(problems: Problems) -> None:
    assert failures(solved(OURS, problems)) == []


def test_consecutive_steps_are_solved_as_well(problems: Problems) -> None:
    assert failures(solved(OURS, problems.sample(40))) == []


def test_the_file_holds_what_it_says(problems: Problems) -> None:
    assert len(problems) > 9_900
    assert FILE.stat().st_size < 1.5e6
    assert {"formation", "crosswind", "random", "at the bounds", "other weights", "equal axles"} <= {*problems.group}
    np.testing.assert_allclose(np.linalg.norm(problems.z, axis=1), 1.0, rtol=1e-6)
    assert (problems.room > 0.0).all()
    assert (problems.tau > 0.0).all()
    for name in ("A", "B", "H", "N1", "N2", "room"):
        assert np.isfinite(getattr(problems, name)).all()
    assert not problems.independent[problems.group == "equal axles"].any()
    # Bounds that cannot be kept have no gain; of the others every point has one.
    assert not np.isinf(problems.tau[problems.run >= 0]).any()


def test_its_optima_are_those_of_cvxpy(problems: Problems) -> None:
    few = spread(problems, 6)
    np.testing.assert_allclose(optima_of(few, lambda _: None), few.tau, rtol=1e-5)
    assert min(ORACLE_TOLERANCES) <= 1e-9


def test_bounds_that_bind_cost() -> None:
    dice = np.random.default_rng(3)
    free = [replace(random_problem(dice), room=np.full(3, 10.0)) for _ in range(4)]
    bound = [at_bounds(each, dice) for each in free]
    taus = [optima_of(problems_of(each, {}), lambda _: None) for each in (free, bound)]
    assert (taus[1] > taus[0] * (1 - 1e-6)).all()
    assert (taus[1] > taus[0] * (1 + 1e-3)).any()


def test_runs_are_recorded_step_by_step() -> None:
    trackers = recorded_steps("formation", ["duration_s=0.3"])
    assert [len(steps) for steps in trackers] == [29] * 3 or [len(steps) for steps in trackers] == [30] * 3
    for step in trackers[0]:
        assert np.linalg.norm(step.z) == pytest.approx(1.0)
        assert (step.room > 0.0).all()
    assert not np.array_equal(trackers[0][5].model.A, trackers[1][5].model.A)


def test_a_set_is_read_as_it_was_written(problems: Problems, tmp_path: Path) -> None:
    few = spread(problems, 5)
    save(few, tmp_path / "few.npz")
    again = load(tmp_path / "few.npz")
    assert again.about == few.about
    for one, other in zip(few, again, strict=True):
        np.testing.assert_array_equal(one.model.A, other.model.A)
        assert (one.tau, one.group, one.run, one.rho) == (other.tau, other.group, other.run, other.rho)


def tampered(ours: Result, place: int, **changes: object) -> Result:
    gains = list(ours.gains)
    gains[place] = replace(gains[place], **changes)
    return Result(ours.name, ours.problems, gains, ours.seconds)


def test_the_check_finds_what_is_wrong(ours: Result) -> None:
    place = int(np.flatnonzero(ours.feasible)[0])
    gain, tau = ours.gains[place], ours.problems.tau[place]
    no_answer = tampered(ours, place, status=SolverStatus.CHECK_FAILED)
    assert "has no answer: CHECK_FAILED" in failures(no_answer)[0]
    assert "is not certified" in failures(tampered(ours, place, K=-gain.K))[0]
    assert "is not certified" in failures(tampered(ours, place, tau=0.9 * gain.tau))[0]
    # Of the semidefinite program it is allowed, of anything faster it is not.
    worse = tampered(ours, place, tau=1.01 * tau, source=GainSource.PREVIOUS_GAIN)
    assert any("1.010000 times the optimum" in line for line in failures(worse))
    allowed = tampered(ours, place, tau=1.01 * tau, source=GainSource.SDP)
    assert not any("times the optimum" in line for line in failures(allowed))


@pytest.mark.parametrize("contestant", contestants(), ids=lambda each: each.name)
def test_every_contestants_gains_are_certified(contestant: Contestant, problems: Problems) -> None:
    if "SCS" in contestant.name:
        pytest.skip("takes seconds for one problem")
    easy = problems.chosen(np.flatnonzero(problems.group == "random")[:2])
    result = solved(contestant, easy)
    assert result.usable.all()
    assert (result.ratio < (2.0 if "printed" in contestant.name else 1.15)).all()
    assert (result.seconds > 0.0).all()
    for place, problem in enumerate(easy):
        assert not failures(Result("", easy.chosen([place]), [result.gains[place]], result.seconds)), problem.group


def test_a_solver_that_cannot_is_said_to_have_no_answer(problems: Problems) -> None:
    result = solved(Contestant("OSQP", by_cvxpy(cp.OSQP), 1), problems.sample(1))
    assert not result.usable.any()
    assert np.isnan(result.ratio).all()
    assert "0.00 %" in robust_sheet([result]).markdown()


def test_the_nominal_solvers_have_one_optimum(problems: Problems) -> None:
    """Where no bound binds it is that of the Riccati equation."""
    far = problems.chosen(np.flatnonzero(problems.group == "formation")[:3])
    far = replace(far, room=np.full_like(far.room, 100.0))
    found = list(nominal.outcomes(far, far.chosen(slice(0, 1))))
    outcomes = [each for each in found if not isinstance(each, str)]
    riccati = [p.z @ solve_discrete_are(p.model.A, p.model.B, np.eye(3), p.rho * np.eye(3)) @ p.z for p in far]
    assert len(outcomes) >= 6
    for outcome in outcomes:
        assert outcome.solved.all()
        if outcome.name in nominal.TITLES.values():
            np.testing.assert_allclose(outcome.costs, riccati, rtol=1e-4)
    assert len(nominal_sheet(outcomes).rows) == len(outcomes)


def test_steps_of_random_runs_are_timed() -> None:
    sheet = worst.worst_sheet(2)
    clock, processor, *by_source = sheet.rows
    assert int(clock[1]) == int(processor[1]) == sum(int(row[1]) for row in by_source)
    # Of each vehicle but the cycles before its first reference.
    assert 2 * 3 * 45 < int(clock[1]) <= 2 * 5 * 50
    assert by_source[0][0] == "of the processor, gain by RICCATI"
    assert all(len(row) == len(sheet.headings) for row in sheet.rows)


def test_the_page_has_every_table(ours: Result, problems: Problems) -> None:
    sheets = [robust_sheet([ours]), groups_sheet(ours)]
    text = page(problems, ["2 x Processor", *sheets, "one is omitted"], ["60 problems", "passed"], 1e-4)
    for part in (
        "2 x Processor",
        "one is omitted",
        "passed",
        "| platoon | 60 |",
        "| at the bounds |",
        "tolerance 1e-09",
    ):
        assert part in text
    assert "{" not in text.replace("{n}", "")
    assert all(sheet.table().row_count == len(sheet.rows) for sheet in sheets)


def test_the_verdict_is_in_words(ours: Result) -> None:
    *_, last = command.verdict(ours)
    assert last == "passed"
    broken = tampered(ours, int(np.flatnonzero(ours.feasible)[0]), status=SolverStatus.CHECK_FAILED)
    *_, last = command.verdict(broken)
    assert last == "FAILED: 1 times"


@pytest.mark.parametrize(("target", "message"), [("page.txt", "ends in .md"), ("none/page.md", "mkdir -p")])
def test_a_page_that_cannot_be_written_is_refused_before_anything_is_measured(
    tmp_path: Path, target: str, message: str
) -> None:
    line = [sys.executable, "-m", "bench.benchmarks", "rmpc", "--write", str(tmp_path / target)]
    done = subprocess.run(line, capture_output=True, text=True, check=False, cwd=ROOT)
    assert (done.returncode, done.stdout) == (2, "")
    assert message in done.stderr
    assert not list(tmp_path.iterdir())
