"""The clearance of a run: what is asked of it, and what it is measured against."""

import pytest

from bench.analysis.metrics import compute
from bench.analysis.report import data_of
from bench.analysis.requirements import keeps_clear, keeps_distance, table
from bench.events import FaultBegins
from platoon_fmu.parameters import BODY

from .conftest import Motions


def test_a_platoon_in_formation_has_the_gap_less_a_body(run_of):
    figures = compute(run_of(Motions(3, 50)))
    assert figures.least_clearance_m == pytest.approx(10.0 - BODY.length)
    assert (figures.required_clearance_m, figures.abreast_at_start) == (1.0, False)
    assert keeps_clear(figures)


def test_a_moment_nearer_than_a_metre_is_a_failure(run_of):
    motions = Motions(3, 50)
    motions.X[1, 20] += 4.51
    run = run_of(motions)
    figures = compute(run)
    assert figures.least_clearance_m == pytest.approx(0.99)
    assert not keeps_clear(figures)
    assert [(row.value, row.met) for row in table(figures, run.scenario) if row.name == "Least clearance"] == [
        ("0.99 m", False)
    ]


def test_with_a_fault_less_is_asked(run_of):
    motions = Motions(2, 50)
    motions.X[1, 20] += 4.6
    motions.events = [(0.1, FaultBegins("v2v_outage", {"vehicle": 1}, None))]
    figures = compute(run_of(motions))
    assert figures.required_clearance_m == 0.3
    assert keeps_clear(figures)
    assert keeps_distance(figures)


@pytest.mark.parametrize(("nearer", "kept"), [(0.01, False), (0.0, True), (-0.01, True)])
def test_not_less_than_at_the_start_is_asked(run_of, nearer, kept):
    motions = Motions(2, 50)
    motions.X[1] += 5.0
    motions.X[1, 30:] += nearer
    figures = compute(run_of(motions))
    assert figures.required_clearance_m == pytest.approx(0.5)
    assert keeps_clear(figures) == kept


def test_abreast_at_the_start_the_distance_between_centres_is_no_measure(run_of):
    motions = Motions(2, 50)
    motions.X[1] = motions.X[0] - 1.0
    motions.Y[1] -= 3.5
    figures = compute(run_of(motions))
    assert figures.abreast_at_start
    assert figures.least_distance_m < 4.0
    assert keeps_distance(figures)
    assert keeps_clear(figures)


def test_a_single_vehicle_has_no_clearance(run_of):
    figures = compute(run_of(Motions(1, 50)))
    assert (figures.least_clearance_m, figures.required_clearance_m) == (None, None)
    assert keeps_clear(figures)


@pytest.mark.parametrize(
    ("overrides", "drawn"),
    [
        ([], (1.0, "minimum without a fault")),
        (['faults=[{kind="v2v_outage",at_s=0.1}]'], (0.3, "minimum with a fault")),
    ],
)
def test_the_figure_has_the_clearance_that_is_required(run_of, overrides, drawn):
    figures = {each["id"]: each for each in data_of(run_of(Motions(2, 50), overrides=overrides))["figures"]}
    assert [(line["y"], line["name"]) for line in figures["clearances"]["lines"]] == [drawn]
