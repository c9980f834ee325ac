"""Studies: what is read, what is refused with which words, and that nothing that cannot run is accepted."""

import pickle
import tomllib

import pytest

from bench.campaign.sampling import samples
from bench.campaign.study import example, load_study, shipped_studies
from bench.errors import BadInput
from bench.scenario import load
from bench.scenario.model import Noise

UNIFORM = '{ kind = "uniform", low = 0.4, high = 0.8 }'
GROUP = """
[[groups]]
keys = ["road.mu", "road.lambda_f"]
means = [0.6, 0.0]
standard_deviations = [0.1, 0.5]
low = [0.3, -1.0]
high = [0.9, 1.0]
correlation = [[1.0, 0.5], [0.5, 1.0]]
"""


def an_input(key: str = "road.mu", distribution: str = UNIFORM, more: str = "") -> str:
    return f'\n[[inputs]]\nkey = "{key}"\ndistribution = {distribution}\n{more}\n'


@pytest.fixture
def study_of(tmp_path):
    def load(text: str, *, base: str | None = "formation", runs: int | None = None):
        path = tmp_path / "mine.toml"
        path.write_text((f'base = "{base}"\n' if base else "") + text)
        return load_study(path, runs)

    return load


def test_the_example_runs_with_every_kind_of_distribution(tmp_path):
    path = tmp_path / "example.toml"
    path.write_text(example())
    study = load_study(path)
    kinds = {each.distribution.kind for each in study.inputs}
    assert kinds == {"uniform", "normal", "log-uniform", "choice", "integers"}
    assert study.groups
    found = samples(study)
    assert len(found) == study.runs == 16
    for sample in found:
        scenario = study.scenario(sample.number, sample.values)
        assert scenario.road.lambda_f.level == sample.values["road.lambda_f"]
        assert scenario.vehicles[1].speed_mps == sample.values["vehicles.1.speed_mps"]
        assert scenario.seed == sample.values["seed"]


@pytest.mark.parametrize("name", shipped_studies())
def test_shipped_studies_load_and_their_first_samples_are_scenarios(name):
    assert shipped_studies() == ["faults", "robustness", "seed-paper"]
    study = load_study(name, 3)
    assert (study.name, study.runs) == (name, 3)
    assert [study.scenario(sample.number, sample.values) for sample in samples(study)]


def test_a_run_of_robustness_is_the_random_scenario_of_its_number_with_noise():
    study = load_study("robustness", 3)
    runs = [study.scenario(sample.number, sample.values) for sample in samples(study)]
    assert [run.model_copy(update={"noise": Noise()}) for run in runs] == [load(f"random:{n}") for n in range(3)]
    assert set(study.keys) == {f"noise.{key}" for key in Noise.model_fields}
    assert all(value > 0.0 for run in runs for value in dict(run.noise).values())


def test_a_run_of_faults_is_the_random_fault_of_its_number():
    study = load_study("faults", 3)
    assert [study.scenario(sample.number, sample.values) for sample in samples(study)] == [
        load(f"random-fault:{n}") for n in range(3)
    ]


def test_the_text_is_the_study_from_any_directory_and_under_any_name(tmp_path, study_of):
    (tmp_path / "base.toml").write_text((load_text("formation")).replace("duration_s = 10.0", "duration_s = 1.0"))
    study = study_of(an_input(), base="base.toml", runs=7)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "study.toml").write_text(study.text)
    again = load_study(elsewhere / "study.toml", 7)
    assert again == study
    assert again.scenario(0, samples(again)[0].values).duration_s == 1.0
    assert tomllib.loads(study.text)["name"] == "mine"


def load_text(name: str) -> str:
    from bench.scenario import SCENARIO_DIR

    return (SCENARIO_DIR / f"{name}.toml").read_text()


def test_a_study_reaches_a_worker_unchanged(study_of):
    study = study_of(an_input() + GROUP.replace("road.mu", "road.force_y_n"))
    assert pickle.loads(pickle.dumps(study)) == study


def test_keys_inside_a_vehicle_a_profile_and_a_fault_are_inputs(tmp_path, study_of):
    more = '\n[[faults]]\nkind = "ecu_crash"\necu = "veh1.planner"\nat_s = 2.0\n'
    road = '\n[road]\nlambda_f = { kind = "sine", mean = 0.0, amplitude = 0.5, frequency_hz = 1.0 }\n'
    (tmp_path / "base.toml").write_text(load_text("formation") + road + more)
    half = '{ kind = "uniform", low = 0.25, high = 0.5 }'
    keys = ["faults.0.at_s", "road.lambda_f.amplitude", "vehicles[2].road.mu", "vehicles.1.yaw_rad"]
    study = study_of("".join(an_input(key, half) for key in keys), base="base.toml", runs=2)
    sample = samples(study)[1]
    scenario = study.scenario(sample.number, sample.values)
    assert [
        scenario.faults[0].at_s,
        scenario.road.lambda_f.amplitude,
        scenario.vehicles[2].road.mu.level,
        scenario.vehicles[1].yaw_rad,
    ] == [sample.values[key] for key in keys]


REFUSED = {
    "no inputs": ("", "no inputs"),
    "no study key": ("rusn = 3\n" + an_input(), "rusn is not a study key; did you mean runs?"),
    "no runs": ("runs = 0\n" + an_input(), "runs = 0 is not allowed; allowed: a whole number from 1 to 1000000"),
    "sampling": ('sampling = "sobl"\n' + an_input(), "allowed: monte-carlo, latin-hypercube, sobol, grid, corners"),
    "no scenario key": (an_input("road.mue"), "road.mue is not a scenario key; did you mean road.mu?"),
    "no such vehicle": (an_input("vehicles.7.x_m"), "vehicles has 3 entries; allowed index: 0 to 2"),
    "impossible high end": (an_input(distribution=UNIFORM.replace("0.8", "5.0")), "road.mu is 5; allowed: 0.05 to 1.5"),
    "impossible low end": (an_input(distribution=UNIFORM.replace("0.4", "0.0")), "road.mu is 0; allowed: 0.05 to 1.5"),
    "an impossible choice": (an_input(distribution='{ kind = "choice", values = [0.5, 9.0, 0.6] }'), "road.mu is 9"),
    "no whole cycles": (
        an_input("duration_s", '{ kind = "uniform", low = 1.0, high = 2.0 }'),
        'multiples of 0.01 s\nNot all values between the ends are allowed: take kind = "choice"',
    ),
    "a wrong type": (an_input("seed"), "seed = 0.4 is not allowed; allowed: a whole number"),
    "empty range": (an_input(distribution=UNIFORM.replace("0.8", "0.4")), "distribution.low = 0.4 is not below high"),
    "log of a negative": (
        an_input("road.lambda_f", '{ kind = "log-uniform", low = -1.0, high = 1.0 }'),
        "low = -1.0 is not allowed; allowed: a finite number above 0",
    ),
    "unreached range": (
        an_input(distribution='{ kind = "normal", mean = 5.0, standard_deviation = 0.1, low = 0.4, high = 0.8 }'),
        "mean = 5 is too far from the range 0.4 to 0.8",
    ),
    "no kind": (an_input(distribution="{ low = 0.4, high = 0.8 }"), "has no kind; allowed: one of choice"),
    "wrong kind": (an_input(distribution=UNIFORM.replace("uniform", "unifrom")), 'has the kind "unifrom"; allowed'),
    "twice": (an_input("vehicles.0.y_m") + an_input("vehicles[0].y_m"), "vehicles.0.y_m is the key of 2 inputs"),
    "inside": (an_input("road.mu") + an_input("road"), "road.mu is inside the input road"),
    "too large a grid": (
        'runs = 10\nsampling = "grid"\n' + an_input(more="points = 11"),
        '"grid" needs 11 runs; allowed: 10',
    ),
    "too many corners": (
        'runs = 3\nsampling = "corners"\n' + an_input() + an_input("road.lambda_f"),
        '"corners" needs 4 runs; allowed: 3',
    ),
    "unknown metric": ('requirements = ["least_clearance > 1"]\n' + an_input(), "did you mean least_clearance_m?"),
    "no requirement": ('requirements = ["formed"]\n' + an_input(), "write METRIC COMPARISON NUMBER"),
    "the same twice": ('requirements = ["vehicles > 1", "vehicles>1.0"]\n' + an_input(), "stated more than once"),
    "group in a grid": ('sampling = "grid"\n' + GROUP, 'groups cannot be sampled as "grid"'),
    "group and input": (GROUP + an_input(), "road.mu is the key of 2 inputs"),
    "asymmetric": (GROUP.replace("[0.5, 1.0]]", "[0.4, 1.0]]"), "correlation is not symmetric"),
    "indefinite": (GROUP.replace("0.5, 1.0]]", "1.0, 1.0]]").replace("[[1.0, 0.5", "[[1.0, 1.0"), "the eigenvalue 0"),
    "not square": (GROUP.replace("[0.5, 1.0]]", "[0.5]]"), "correlation is not square"),
    "too few means": (
        GROUP.replace("means = [0.6, 0.0]", "means = [0.6, 0.0, 1.0]"),
        "means has 3 entries; allowed: 2",
    ),
    "group's range": (GROUP.replace("low = [0.3, -1.0]", "low = [0.3, 1.0]"), "of road.lambda_f: low = 1 is not below"),
    "group's impossible range": (GROUP.replace("high = [0.9", "high = [1.9"), "road.mu is 1.9; allowed: 0.05 to 1.5"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_study_that_cannot_run_is_refused_in_one_message_that_names_the_file(study_of, case):
    text, words = REFUSED[case]
    with pytest.raises(BadInput) as refused:
        study_of(text)
    assert words in str(refused.value)
    assert "mine.toml" in str(refused.value)


@pytest.mark.parametrize(
    ("base", "words"),
    [
        ("formatoin", 'did you mean "formation"?'),
        ("random:7", 'allowed for its family: "random"'),
        ("random-fault:7", 'allowed for its family: "random-fault"'),
        ("random-faults", 'did you mean "random-fault"?'),
        ("missing.toml", "neither a file beside the study"),
        ("broken.toml", "its base is refused"),
    ],
)
def test_an_unusable_base_is_refused(tmp_path, study_of, base, words):
    (tmp_path / "broken.toml").write_text("duration_s = 1.0\n")
    with pytest.raises(BadInput, match=words):
        study_of(an_input(), base=base)


def test_a_study_that_is_not_there_is_refused_with_what_is(tmp_path):
    with pytest.raises(BadInput, match="Did you mean robustness"):
        load_study("robustnes")
    with pytest.raises(BadInput, match="is a directory"):
        load_study(tmp_path)
    with pytest.raises(BadInput, match="--runs 0 is not allowed"):
        load_study("seed-paper", 0)


def test_the_random_family_needs_no_inputs_but_takes_them(study_of):
    assert samples(study_of("", base="random", runs=2))[1].values == {}
    study = study_of(an_input("platoon.gap_m", '{ kind = "uniform", low = 12, high = 20 }'), base="random", runs=3)
    for sample in samples(study):
        assert study.scenario(sample.number, sample.values).platoon.gap_m == sample.values["platoon.gap_m"]
    with pytest.raises(BadInput, match="nothing to sample"):
        study_of('sampling = "sobol"\n', base="random")


def test_ranges_that_fit_only_together_are_accepted(study_of):
    """Each vehicle alone would start inside another one of the base."""
    moved = [
        an_input(f"vehicles.{i}.x_m", f'{{ kind = "uniform", low = {x}, high = {x + 2} }}')
        for i, x in enumerate((-9.0, -40.0, -80.0))
    ]
    assert study_of("".join(moved)).runs == 100


@pytest.mark.parametrize(("sampling", "points"), [("grid", 3), ("corners", 2)])
def test_a_range_of_which_the_chosen_points_are_possible_is_accepted(study_of, sampling, points):
    """Between them some durations are no whole number of cycles, but no run has them."""
    inputs = an_input("duration_s", '{ kind = "uniform", low = 1.0, high = 2.0 }', "points = 3")
    assert study_of(f'sampling = "{sampling}"\n{inputs}').runs == points


def test_requirements_are_the_reports_unless_stated(study_of):
    assert [each.text for each in study_of('requirements = ["formed == true"]\n' + an_input()).requirements] == [
        "formed == 1"
    ]
    assert study_of(an_input()).requirements[0].text == "formation_time_s <= 6.5"
    assert study_of(an_input(), base="five").requirements[0].text == "formed == 1"
