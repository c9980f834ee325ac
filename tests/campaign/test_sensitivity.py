"""What drives a metric, on problems whose ranking is known."""

import numpy as np
import polars as pl
import pytest
from SALib.analyze import pawn

from bench.campaign.sensitivity import LEAST_RUNS, SLICES, influences, numeric, pawn_means


def ishigami(runs, seed):
    """Ishigami and Homma's function: by total Sobol indices x1 0.56, x2 0.44, x3 0.24; x4 is not in it."""
    x = np.random.default_rng(seed).uniform(-np.pi, np.pi, (runs, 4))
    y = np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    return pl.DataFrame(x, [f"x{number}" for number in range(1, 5)]), pl.Series("y", y)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_pawn_ranks_ishigamis_inputs_as_published(seed):
    # Pianosi and Wagener (2015), section 3.1: x2 first, then x1, then x3; and a dummy last.
    found = influences(*ishigami(2000, seed))
    assert [each.input for each in found.inputs] == ["x2", "x1", "x3", "x4"]
    by_name = {each.input: each for each in found.inputs}
    assert all(by_name[name].index > found.chance for name in ("x1", "x2", "x3"))
    assert by_name["x4"].index - by_name["x4"].half_width < found.chance


@pytest.mark.parametrize("runs", [80, 1000])
@pytest.mark.parametrize("classes", [None, 40, 3])
def test_the_indices_of_resamples_are_those_of_salib(runs, classes):
    inputs, metric = ishigami(runs, 11)
    x, y = inputs.to_numpy(), metric.to_numpy()
    if classes:
        # Many equal values: of the metric, and of an input such as a choice.
        y = np.floor(y * classes / 20.0)
        x[:, 0] = np.floor(x[:, 0])
    rows = np.random.default_rng(12).integers(0, runs, runs)
    problem = {"num_vars": 4, "names": inputs.columns}
    expected = pawn.analyze(problem, x[rows], y[rows], S=SLICES)["mean"]
    assert pawn_means(x[rows], y[rows]) == pytest.approx(expected, abs=1e-12)


def test_a_linear_metric_has_its_inputs_in_the_order_of_their_weights():
    random = np.random.default_rng(4)
    x = random.random((1000, 4))
    weights = {"much": 3.0, "less": -1.5, "little": 0.75, "nothing": 0.0}
    found = influences(pl.DataFrame(x, list(weights)), pl.Series("y", x @ np.array(list(weights.values()))))
    assert [each.input for each in found.inputs] == list(weights)
    direction = {each.input: each.direction for each in found.inputs}
    assert direction["much"] > 0.5 > 0.0 > -0.2 > direction["less"]
    assert abs(direction["nothing"]) < 0.1


def test_the_confidence_interval_narrows_with_the_number_of_runs():
    widths = [influences(*ishigami(runs, 5)).inputs[0].half_width for runs in (200, 2000)]
    assert 0.0 < widths[1] < 0.6 * widths[0]


def test_yes_or_no_and_few_values_have_an_influence_too():
    random = np.random.default_rng(6)
    on, lanes, other = random.random(600) < 0.5, random.integers(0, 3, 600), random.random(600)
    inputs = pl.DataFrame({"other": other, "lanes": lanes, "on": on})
    found = influences(inputs, pl.Series("y", 3.0 * on + 0.7 * lanes + 0.01 * other))
    assert [each.input for each in found.inputs] == ["on", "lanes", "other"]
    assert found.inputs[1].index > found.chance


def test_words_constants_and_seeds_are_no_inputs_to_rank():
    inputs = pl.DataFrame({"seed": [1, 2], "kind": ["a", "b"], "same": [3.0, 3.0], "speed": [1.0, 2.0]})
    assert numeric(inputs) == ["speed"]


def test_runs_without_the_metric_are_left_out():
    inputs, y = ishigami(500, 7)
    y = y.to_frame().with_columns(pl.when(pl.int_range(500) % 5 == 0).then(None).otherwise("y").alias("y"))["y"]
    y[1] = float("nan")
    y[2] = float("inf")
    assert influences(inputs, y).runs == 398


def test_the_same_rows_have_the_same_influences():
    assert influences(*ishigami(300, 8)) == influences(*ishigami(300, 8))


def test_nothing_is_told_of_too_few_runs_a_constant_metric_or_no_input():
    inputs, y = ishigami(LEAST_RUNS, 9)
    assert influences(inputs, y) is not None
    assert influences(inputs.head(LEAST_RUNS - 1), y.head(LEAST_RUNS - 1)) is None
    assert influences(inputs, pl.Series("y", np.zeros(LEAST_RUNS))) is None
    assert influences(pl.DataFrame({"kind": ["a"] * LEAST_RUNS}), y) is None
    assert influences(inputs, pl.Series("y", [None] * LEAST_RUNS, dtype=pl.Float64)) is None


def test_the_dummy_input_is_none_of_the_studys_even_if_the_seeds_are_the_same():
    x = np.random.default_rng(1).random(400)
    found = influences(pl.DataFrame({"x": x}), pl.Series("metric", x), seed=1)
    assert found.inputs[0].index > 2.0 * found.chance
