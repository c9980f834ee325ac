"""A study: a base scenario, the distributions of what is uncertain in it, and the requirements on every run.

Its TOML file is validated like a scenario's; `example` is one that explains itself.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import tomli_w
from pydantic import BaseModel, Field, ValidationError, model_validator

from bench.campaign.distributions import Distribution, Normal, Value
from bench.campaign.requirements import Requirement, default_requirements, requirement
from bench.ecu.loading import load_class
from bench.errors import BadInput
from bench.faults.profile import STRICT, Constant
from bench.scenario import Scenario, load, shipped
from bench.scenario.errors import Source, closest
from bench.scenario.families import FAMILIES, is_random
from bench.scenario.loading import name_from, read_toml, validated

STUDY_DIR = Path(__file__).parent / "studies"

DEFAULT_RUNS = 100
MOST_RUNS = 1_000_000
MOST_INPUTS = 100
MOST_REQUIREMENTS = 100
FIRST_NUMBERS = 8
"""Scenarios of a random family in which the inputs' ranges are checked."""

Sampling = Literal["monte-carlo", "latin-hypercube", "sobol", "grid", "corners"]
WITHOUT_CHANCE = ("grid", "corners")
"""Kinds of sampling that are complete, so that the study decides the number of runs."""

EXTENSIBLE = ("monte-carlo", "sobol")
"""Kinds of sampling of which a longer campaign begins with the shorter one."""

KeyName = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*(\.\w+|\[[0-9]+\])*$", max_length=200)]


class Input(BaseModel):
    """An uncertain value.

    Attributes:
        key: key of the scenario as `--set` takes it, such as `road.lambda_f` or `vehicles.0.speed_mps`.
        distribution: the distribution of its value, a table with its kind.
        points: number of values of a grid; a choice has all of its values, whatever this is.
    """

    model_config = STRICT

    key: KeyName
    distribution: Distribution
    points: Annotated[int, Field(ge=1, le=1000)] = 5


class Group(BaseModel):
    """Normal inputs that are correlated; lists have one value per key.

    Each input by itself has exactly its truncated normal distribution. The correlation is that of the normal
    distributions before they are truncated (a Gaussian copula); truncation far from the mean hardly changes it.

    Attributes:
        keys: keys of the scenario, at least two.
        means: means before truncation.
        standard_deviations: standard deviations before truncation, above 0.
        low: smallest values.
        high: largest values.
        correlation: correlation matrix, a list of rows: symmetric, positive definite, with ones on the diagonal.
    """

    model_config = STRICT

    keys: Annotated[tuple[KeyName, ...], Field(min_length=2, max_length=MOST_INPUTS)]
    means: Annotated[tuple[float, ...], Field(min_length=2, max_length=MOST_INPUTS)]
    standard_deviations: Annotated[
        tuple[Annotated[float, Field(gt=0)], ...], Field(min_length=2, max_length=MOST_INPUTS)
    ]
    low: Annotated[tuple[float, ...], Field(min_length=2, max_length=MOST_INPUTS)]
    high: Annotated[tuple[float, ...], Field(min_length=2, max_length=MOST_INPUTS)]
    correlation: Annotated[
        tuple[tuple[Annotated[float, Field(ge=-1, le=1)], ...], ...], Field(min_length=2, max_length=MOST_INPUTS)
    ]

    @model_validator(mode="after")
    def _check(self) -> Self:
        count = len(self.keys)
        for name in ("means", "standard_deviations", "low", "high", "correlation"):
            if len(getattr(self, name)) != count:
                raise ValueError(f"{name} has {len(getattr(self, name))} entries; allowed: {count}, one for each key")
        for key, normal in zip(self.keys, self._parts(), strict=True):
            try:
                Normal.model_validate(normal)
            except ValidationError as error:
                raise ValueError(f"of {key}: {error.errors()[0]['ctx']['error']}") from None
        self._check_correlation(count)
        return self

    def _parts(self) -> Iterator[dict[str, Any]]:
        """Yield the distribution of each key as a table."""
        for mean, deviation, low, high in zip(self.means, self.standard_deviations, self.low, self.high, strict=True):
            yield {"kind": "normal", "mean": mean, "standard_deviation": deviation, "low": low, "high": high}

    def _check_correlation(self, count: int) -> None:
        if any(len(row) != count for row in self.correlation):
            raise ValueError(f"correlation is not square; allowed: {count} rows of {count} numbers")
        matrix = np.array(self.correlation)
        if not (np.array_equal(matrix, matrix.T) and np.array_equal(np.diag(matrix), np.ones(count))):
            raise ValueError("correlation is not symmetric with ones on its diagonal, as a correlation matrix must be")
        least = float(np.linalg.eigvalsh(matrix)[0])
        if least < 1e-9:
            raise ValueError(
                f"correlation has the eigenvalue {least:.3g}, so no inputs can be correlated like this;"
                " allowed: positive definite; make the correlations smaller"
            )

    def inputs(self) -> tuple[Input, ...]:
        """Return each input by itself."""
        parts = zip(self.keys, self._parts(), strict=True)
        return tuple(Input(key=key, distribution=Normal.model_validate(part)) for key, part in parts)


class StudyFile(BaseModel):
    """A study as its file states it.

    Attributes:
        name: name of the study; the file's name if not given.
        description: what it asks, in words.
        base: name of a shipped scenario, a scenario's file (its place as seen from the study's), or `random` or
            `random-fault`, families of random scenarios, of which the number of a run is the scenario.
        seed: seed of the sampling.
        runs: number of runs; of a grid or corners the most that it may have.
        sampling: how the inputs' values are chosen.
        time_limit_s: longest time of a run (s) before it is given up.
        requirements: limits of metrics, such as `least_clearance_m > 1.0`; those of a run's report if not given.
        ecus: classes in place of the bench's ECUs, by role, such as `tracker = "my_ecu.py:MyTracker"`; a file's place
            is as seen from the study's.
        inputs: what is uncertain.
        groups: normal inputs that are correlated.
    """

    model_config = STRICT

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
    description: Annotated[str, Field(max_length=4000)] = ""
    base: Annotated[str, Field(min_length=1, max_length=1000)]
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = 1
    runs: Annotated[int, Field(ge=1, le=MOST_RUNS)] | None = None
    sampling: Sampling = "monte-carlo"
    time_limit_s: Annotated[float, Field(gt=0, le=86_400)] = 120.0
    requirements: Annotated[tuple[str, ...], Field(max_length=MOST_REQUIREMENTS)] | None = None
    ecus: dict[Literal["planner", "tracker"], str] = {}
    inputs: Annotated[tuple[Input, ...], Field(max_length=MOST_INPUTS)] = ()
    groups: Annotated[tuple[Group, ...], Field(max_length=MOST_INPUTS)] = ()


@dataclass(frozen=True)
class Study:
    """A study that has been checked.

    Attributes:
        name: its name.
        base: a shipped scenario, the absolute path of a scenario's file, or a family of random scenarios.
        seed: seed of the sampling.
        runs: number of runs.
        sampling: how the inputs' values are chosen.
        inputs: what is uncertain and independent.
        groups: normal inputs that are correlated.
        requirements: limits of metrics.
        ecus: the class of each role's ECU, as `bench.ecu.loading.load_class` takes it.
        time_limit_s: longest time of a run, s.
        text: the study as TOML that `load_study` reads back, from any directory, without the file's comments; a base
            scenario's file is not in it.
    """

    name: str
    base: str
    seed: int
    runs: int
    sampling: Sampling
    inputs: tuple[Input, ...]
    groups: tuple[Group, ...]
    requirements: tuple[Requirement, ...]
    ecus: Mapping[str, str]
    time_limit_s: float
    text: str

    @property
    def keys(self) -> list[str]:
        """The keys of all inputs, those of groups last."""
        return [each.key for each in _all_inputs(self.inputs, self.groups)]

    @property
    def by_number(self) -> bool:
        """Whether the number of a run decides on its scenario, besides the values."""
        return self.base in FAMILIES

    def types(self) -> dict[str, type]:
        """Return the type of each input's values, text if they have several."""
        found = {}
        for each in _all_inputs(self.inputs, self.groups):
            kinds = {type(value) for value in each.distribution.extremes()}
            numbers = kinds <= {int, float}
            found[each.key] = kinds.pop() if len(kinds) == 1 else float if numbers else str
        return found

    def shown_types(self) -> dict[str, type]:
        """Return the types of what is shown of each run besides the inputs: what a family of scenarios has drawn."""
        family = FAMILIES.get(self.base)
        return {} if family is None else {key: kind for key, kind in family.shown.items() if key not in self.keys}

    def shown(self, number: int, values: dict[str, Value]) -> dict[str, Value]:
        """Return what is shown of a run besides its inputs; nothing of values that make no scenario."""
        keys = self.shown_types()
        try:
            scenario = self.scenario(number, values) if keys else None
        except BadInput:
            return {}
        return {key: _value(scenario, key) for key in keys}

    def files(self) -> dict[str, bytes]:
        """Return the contents of the user's files that runs depend on, by path: base scenario and ECUs.

        Raises:
            BadInput: one cannot be read.
        """
        places = [*_own_ecu_files(self.ecus), *([] if self.by_number or self.base in shipped() else [self.base])]
        try:
            return {place: Path(place).read_bytes() for place in places}
        except OSError as error:
            raise BadInput(f"Study {self.name}: cannot read {error.filename}: {error.strerror}") from error

    def with_files(self, places: Mapping[str, str]) -> Self:
        """Return the study with other places for its files."""
        ecus = {role: ":".join([places.get(file, file), name]) for role, (file, name) in _parted(self.ecus)}
        return replace(self, base=places.get(self.base, self.base), ecus=ecus)

    def continues(self, text: str) -> bool:
        """Return whether runs of a study, given as TOML, are runs of this one too.

        What does not decide on a run may differ, and the number of runs if the first ones do not depend on it.
        """
        free = {"name", "description", "time_limit_s"} | ({"runs"} if self.sampling in EXTENSIBLE else set())
        try:
            documents = [tomllib.loads(each) for each in (self.text, text)]
        except tomllib.TOMLDecodeError:
            return False
        one, other = ({key: value for key, value in each.items() if key not in free} for each in documents)
        return one == other

    def scenario(self, number: int, values: dict[str, Value]) -> Scenario:
        """Return the scenario of a run with these values of its keys.

        Raises:
            BadInput: together they are no possible scenario.
        """
        base = f"{self.base}:{number}" if self.base in FAMILIES else self.base
        return load(base, [f"{key}={_toml(value)}" for key, value in values.items()])

    def problem(self, number: int, values: dict[str, Value]) -> BadInput | None:
        """Return why a run's values are no possible scenario; None if they are one."""
        try:
            self.scenario(number, values)
        except BadInput as error:
            return error
        return None


def shipped_studies() -> list[str]:
    """Return the names of the shipped studies."""
    return sorted(path.stem for path in STUDY_DIR.glob("*.toml"))


def load_study(path_or_shipped_name: str | Path, runs: int | None = None) -> Study:
    """Return a checked study.

    Args:
        path_or_shipped_name: a TOML file, or the name of a shipped study.
        runs: replaces the study's number of runs; of a grid or corners the most that it may have.

    Raises:
        BadInput: one message: what is wrong, where, what is allowed. That covers every key and every end of a range,
            each put into the base scenario.
    """
    path = _find(path_or_shipped_name)
    text, document = read_toml(path, "study")
    document.setdefault("name", name_from(path))
    stated = validated(StudyFile, Source(str(path), text, document, {}, "study"))
    if runs is not None and not 1 <= runs <= MOST_RUNS:
        raise BadInput(f"--runs {runs} is not allowed; allowed: 1 to {MOST_RUNS}")
    inputs = _all_inputs(stated.inputs, stated.groups)
    _check_together(path, stated, inputs)
    base = _base(path, stated.base)
    document["base"] = base
    ecus = _ecus(path, dict(stated.ecus.items()))
    document["ecus"] = ecus
    most = stated.runs if runs is None else runs
    document["runs"] = _number_of_runs(path, stated, most)
    study = Study(
        name=stated.name,
        base=base,
        seed=stated.seed,
        runs=document["runs"],
        sampling=stated.sampling,
        inputs=stated.inputs,
        groups=stated.groups,
        requirements=(),
        ecus=ecus,
        time_limit_s=stated.time_limit_s,
        text=tomli_w.dumps(document),
    )
    scenario = _checked_base(path, study)
    _check_ranges(path, study)
    return _with_requirements(path, study, stated.requirements, scenario)


def combinations(stated: StudyFile | Study) -> int:
    """Return the number of points of a study's grid, or of its corners."""
    if stated.sampling == "grid":
        return math.prod(len(each.distribution.grid(each.points)) for each in stated.inputs)
    return math.prod(len(each.distribution.extremes()) for each in stated.inputs)


def example() -> str:
    """Return a study that explains itself, as TOML."""
    return _EXAMPLE


def _find(path_or_name: str | Path) -> Path:
    name = str(path_or_name)
    if name in shipped_studies():
        return STUDY_DIR / f"{name}.toml"
    path = Path(path_or_name)
    if path.is_file():
        return path
    have = f"shipped studies are {', '.join(shipped_studies())}"
    if path.is_dir():
        raise BadInput(f"Study {name!r} is a directory; give a file, or a name: {have}.")
    near = closest(name, shipped_studies())
    meant = f" Did you mean {near}?" if near else ""
    raise BadInput(f"No study {name!r}: not a file; {have}.{meant} An example: platoon campaign --example")


def _all_inputs(inputs: Sequence[Input], groups: Sequence[Group]) -> list[Input]:
    return [*inputs, *(each for group in groups for each in group.inputs())]


def _check_together(path: Path, stated: StudyFile, inputs: Sequence[Input]) -> None:
    """Refuse inputs that do not fit each other or the sampling."""
    if len(inputs) > MOST_INPUTS:
        raise BadInput(f"Study {path} has {len(inputs)} inputs; allowed: at most {MOST_INPUTS}, with those of groups")
    plain = [re.sub(r"\[(\d+)\]", r".\1", each.key) for each in inputs]
    twice = [key for key, count in Counter(plain).items() if count > 1]
    if twice:
        raise BadInput(f"Study {path}: {twice[0]} is the key of {plain.count(twice[0])} inputs; allowed: one input")
    for key in plain:
        inside = next((other for other in plain if other.startswith(f"{key}.")), None)
        if inside:
            raise BadInput(f"Study {path}: the input {inside} is inside the input {key}; leave out one of them")
    if not inputs and not (stated.base in FAMILIES and stated.sampling == "monte-carlo"):
        remedy = 'sampling = "monte-carlo"' if stated.base in FAMILIES else '[[inputs]], or base = "random"'
        raise BadInput(f"Study {path} has no inputs, so there is nothing to sample; give {remedy}")
    if stated.groups and stated.sampling in WITHOUT_CHANCE:
        raise BadInput(
            f'Study {path}: groups cannot be sampled as "{stated.sampling}", which ignores their correlation; allowed:'
            ' "monte-carlo", "latin-hypercube", "sobol"; or give their keys as [[inputs]]'
        )


def _number_of_runs(path: Path, stated: StudyFile, most: int | None) -> int:
    """Return the number of runs; `most` is what the file or the option says."""
    if stated.sampling not in WITHOUT_CHANCE:
        return DEFAULT_RUNS if most is None else most
    count = combinations(stated)
    if count > (MOST_RUNS if most is None else most):
        allowed = f"{MOST_RUNS}, the most of any study" if most is None else f"{most} (runs)"
        mend = f"; or permit it with --runs {count}" if count <= MOST_RUNS else ""
        fewer = "fewer points or inputs" if stated.sampling == "grid" else "fewer inputs"
        raise BadInput(
            f'Study {path}: sampling = "{stated.sampling}" needs {count} runs; allowed: {allowed}; give {fewer}{mend}'
        )
    return count


def _base(path: Path, base: str) -> str:
    """Return the base with the absolute path of a file."""
    if base in FAMILIES or base in shipped():
        return base
    if is_random(base):
        family = base.partition(":")[0]
        raise BadInput(f'Study {path}: base = "{base}" is one scenario; allowed for its family: "{family}"')
    file = path.parent / base
    if file.is_file():
        return str(file.resolve())
    near = closest(base, [*shipped(), *FAMILIES])
    meant = f' did you mean "{near}"?' if near else ""
    raise BadInput(
        f'Study {path}: base = "{base}" is neither a file beside the study nor a shipped scenario;{meant}'
        f" allowed: {', '.join([*shipped(), *FAMILIES])}, or a file such as mine.toml"
    )


def _ecus(path: Path, stated: Mapping[str, str]) -> dict[str, str]:
    """Return the classes of ECUs, files with their absolute path, after loading each."""
    found = {}
    for role, spec in stated.items():
        file, _, name = spec.rpartition(":")
        found[role] = f"{(path.parent / file).resolve()}:{name}" if file.endswith(".py") else spec
        try:
            load_class(found[role], role)
        except BadInput as error:
            raise BadInput(f"Study {path}: ecus.{role}: {error}") from error
    return found


def _parted(ecus: Mapping[str, str]) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield each role with the file or module of its class, and the name."""
    for role, spec in ecus.items():
        place, _, name = spec.rpartition(":")
        yield role, (place, name)


def _own_ecu_files(ecus: Mapping[str, str]) -> list[str]:
    return sorted({place for _, (place, _) in _parted(ecus) if place.endswith(".py")})


def _checked_base(path: Path, study: Study) -> Scenario:
    try:
        return study.scenario(0, {})
    except BadInput as error:
        raise BadInput(f"Study {path}: its base is refused: {error}") from error


def _check_ranges(path: Path, study: Study) -> None:
    """Put values of each input's range into the base scenario: first alone, then with other inputs in their middle."""
    inputs = _all_inputs(study.inputs, study.groups)
    middle = {each.key: each.distribution.at(np.array([0.5]))[0] for each in inputs}
    numbers = range(min(study.runs, FIRST_NUMBERS)) if study.base in FAMILIES else range(1)
    for each in inputs:
        ends = each.distribution.extremes()
        for value in (*ends, *_between(study, each, ends)):
            for number in numbers:
                # Some values fit only together: a vehicle alone may start inside another one.
                error = study.problem(number, {each.key: value}) and study.problem(number, middle | {each.key: value})
                if error:
                    others = ", the others at their medians" if len(inputs) > 1 else ""
                    mend = "" if value in ends else _NOT_ALL
                    raise BadInput(f"Study {path}: input {each.key} = {_toml(value)}{others}: {error}{mend}")


_NOT_ALL = '\nNot all values between the ends are allowed: take kind = "choice" or "integers".'


def _between(study: Study, one: Input, ends: Sequence[Value]) -> list[Value]:
    """Return a value between the ends of a range that is drawn by chance: one that is a multiple of nothing."""
    found = one.distribution.at(np.array([1.0 / math.pi]))[0]
    return [] if study.sampling in WITHOUT_CHANCE or found in ends else [found]


def _with_requirements(path: Path, study: Study, texts: Sequence[str] | None, scenario: Scenario) -> Study:
    if texts is None:
        found = default_requirements(scenario)
    else:
        try:
            found = tuple(requirement(text) for text in texts)
        except BadInput as error:
            raise BadInput(f"Study {path}: {error}") from error
    twice = [text for text, count in Counter(each.text for each in found).items() if count > 1]
    if twice:
        raise BadInput(f'Study {path}: the requirement "{twice[0]}" is stated more than once; state it once')
    return replace(study, requirements=found)


def _value(scenario: Any, key: str) -> Value:
    """Return a scenario's value of a key: of a list the number of its items, of a constant profile its level."""
    for part in key.split("."):
        scenario = scenario[int(part)] if part.isdigit() else getattr(scenario, part)
    if isinstance(scenario, tuple | list):
        return len(scenario)
    found: Value = scenario.level if isinstance(scenario, Constant) else scenario
    return found


def _toml(value: Value) -> str:
    """Return a value as `--set` takes it."""
    return tomli_w.dumps({"v": value}).removeprefix("v = ").strip()


_EXAMPLE = """\
# A study: run it with `platoon campaign FILE`. Keys that are left out have the value shown unless it says otherwise.
name = "example"
description = "How the formation bears tyres, wind and start speeds that are not as planned"

# A shipped scenario, a scenario's file (its place as seen from this one's), or "random" or "random-fault": families of
# random scenarios, of which the number of a run is the scenario (then inputs are not needed).
base = "formation"

# The same seed gives the same values. With "monte-carlo" and "sobol" a longer campaign begins with the shorter one.
seed = 1
runs = 16
# "monte-carlo", "latin-hypercube", "sobol" (scrambled; best with a power of two), "grid" (all combinations of `points`
# values of each input), "corners" (all combinations of the ends of the ranges). The last two have as many runs as there
# are combinations, and `runs` is the most that is allowed.
sampling = "sobol"

# A run that takes longer is given up (s).
time_limit_s = 120.0

# Limits of metrics; left out, they are the requirements of a run's report.
requirements = ["formed == true", "least_clearance_m > 1.0", "comfort_lateral_acceleration_max_mps2 < 5.0"]

# Classes in place of the bench's ECUs; a file's place is as seen from this one's.
# ecus = { tracker = "my_ecu.py:MyTracker" }

# Any key that `--set` takes; `platoon scenarios keys` lists them.
[[inputs]]
key = "road.lambda_f"
distribution = { kind = "uniform", low = -1.0, high = 1.0 }

[[inputs]]
key = "road.force_y_n"
distribution = { kind = "normal", mean = 0.0, standard_deviation = 200.0, low = -600.0, high = 600.0 }

[[inputs]]
key = "platoon.gap_m"
distribution = { kind = "log-uniform", low = 8.0, high = 16.0 }

[[inputs]]
key = "vehicles.0.y_m"
distribution = { kind = "choice", values = [-0.2, 0.0, 0.2] }

[[inputs]]
key = "seed"
distribution = { kind = "integers", low = 1, high = 1000 }

# Normal inputs that are correlated, in the order of `keys`; not for "grid" and "corners".
[[groups]]
keys = ["vehicles.0.speed_mps", "vehicles.1.speed_mps"]
means = [20.0, 22.0]
standard_deviations = [0.5, 0.5]
low = [19.0, 21.0]
high = [21.0, 23.0]
correlation = [[1.0, 0.6], [0.6, 1.0]]
"""
