"""A counterexample made small: failing values moved back towards the base scenario as long as the run still fails.

Values that do not matter are removed as in delta debugging (Zeller and Hildebrandt, IEEE Transactions on Software
Engineering 28, 2002); those that do are moved to the nearest value that fails.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from bench.campaign.distributions import Choice, Value
from bench.campaign.evaluating import Evaluate, Outcome, Remembered, fails, margin_of
from bench.campaign.requirements import Requirement
from bench.campaign.study import Study
from bench.campaign.unit_cube import check_base
from bench.errors import RunFailed
from bench.files import write_text
from bench.scenario import Scenario

DIGITS = 3
"""Significant digits of the distance to the base's value, to which the nearest failing value is found."""

MOST_DIGITS = 7
"""So many digits are tried for a value that fails with no fewer, before it keeps all of its own."""

MOST_PASSES = 10
"""Passes over all values; two that depend on each other could move by less and less for ever."""


@dataclass(frozen=True)
class Change:
    """A value of a counterexample.

    Attributes:
        key: the scenario's key.
        base: the base scenario's value; None if it has no such key.
        value: the value that fails.
    """

    key: str
    base: Value | None
    value: Value


@dataclass(frozen=True)
class Counterexample:
    """Values that fail, as few and as near to the base scenario as was found.

    Attributes:
        requirement: what they fail.
        changes: the values that differ from the base scenario's.
        outcome: of these values.
        evaluations: number of values evaluated.
    """

    requirement: Requirement
    changes: tuple[Change, ...]
    outcome: Outcome
    evaluations: int

    @property
    def values(self) -> dict[str, Value]:
        """The values by key."""
        return {change.key: change.value for change in self.changes}


def made_small(
    study: Study, requirement: Requirement, values: Mapping[str, Value], evaluate: Evaluate, *, workers: int = 1
) -> Counterexample:
    """Return a small counterexample from values that fail.

    Each value, each table of values and all together are removed if the run still fails. Numbers that remain are moved
    to the nearest value, of few digits, with which it still fails; choices remain what they are. That is repeated
    until nothing moves. To fail is to end with the same status and, if that is the run's end, to miss the requirement.

    Args:
        study: of the values.
        requirement: what they fail, of whatever comparison.
        values: that fail, by key.
        evaluate: evaluates values; some of the study's keys may be missing.
        workers: number of values that are evaluated at a time where one would do.

    Raises:
        BadInput: the study's base is not one scenario.
        RunFailed: the values do not fail.
    """
    check_base(study)
    remembered = Remembered(evaluate)
    shrinking = _Shrinking(study, requirement, dict(values), remembered, workers)
    for _ in range(MOST_PASSES):
        if not shrinking.moves():
            break
    changes = tuple(Change(key, base_value(shrinking.base, key), value) for key, value in shrinking.values.items())
    return Counterexample(requirement, changes, shrinking.outcome, remembered.evaluations)


def scenario_text(study: Study, found: Counterexample) -> str:
    """Return the counterexample as a complete scenario in TOML, which fails by itself; its comments say what."""
    base = study.scenario(0, {})
    metric = (found.outcome.metrics or {}).get(found.requirement.metric)
    said = f"{found.requirement.metric} = {metric}" if found.outcome.metrics is not None else found.outcome.words
    lines = [f"Counterexample to {found.requirement.text}: {said}", f"What differs from the scenario {base.name}:"]
    lines += [_in_words(change) for change in found.changes] or ["  nothing: it fails itself"]
    # What a run says may have several lines.
    comments = [f"# {line}".rstrip() for text in lines for line in text.splitlines()]
    return "\n".join([*comments, "", study.scenario(0, found.values).toml()])


def write_scenario(study: Study, found: Counterexample, target: Path) -> None:
    """Write `scenario_text` to a file.

    Raises:
        BadInput: it cannot be written.
    """
    write_text(target, scenario_text(study, found))


def base_value(base: Scenario, key: str) -> Value | None:
    """Return the value that a scenario has for a key, its default if it is not given; None if there is no such value.

    A vehicle whose own road does not say has the value of the scenario's `road`.
    """
    document = tomllib.loads(base.toml())
    parts = re.sub(r"\[(\d+)\]", r".\1", key).split(".")
    found = _value_at(document, parts)
    if found is None and parts[0] == "vehicles" and parts[2:3] == ["road"]:
        return _value_at(document, parts[2:])
    return found


def _value_at(document: Any, parts: Sequence[str]) -> Value | None:
    node = document
    for part in parts:
        if isinstance(node, dict):
            node = node.get(part)
        elif isinstance(node, list) and part.isdecimal() and int(part) < len(node):
            node = node[int(part)]
        else:
            return None
    return node if isinstance(node, float | int | str) else None


def _in_words(change: Change) -> str:
    base = "" if change.base is None else f" instead of {json.dumps(change.base)}"
    return f"  {change.key} = {json.dumps(change.value)}{base}"


class _Shrinking:
    """Failing values on their way to the base scenario.

    Attributes:
        base: the base scenario.
        values: values that fail, by key; those left out are the base's.
        outcome: of these values.
    """

    def __init__(
        self, study: Study, requirement: Requirement, values: dict[str, Value], evaluate: Remembered, workers: int
    ) -> None:
        self.base = study.scenario(0, {})
        self.values = values
        self._requirement = requirement
        self._evaluate = evaluate
        self._workers = workers
        self._choices = {each.key for each in study.inputs if isinstance(each.distribution, Choice)}
        (self.outcome,) = evaluate([values])
        self._status = self.outcome.status
        if not fails(self.outcome, requirement):
            raise RunFailed(
                f"The run {self.outcome.number} does not miss {requirement.text}, so it is no counterexample"
            )

    def moves(self) -> bool:
        """Make one pass over all values, and return whether anything has moved."""
        before = dict(self.values)
        self._remove()
        for key in list(self.values):
            self._move_nearer(key)
        return self.values != before

    def _first_failing(self, batch: Sequence[dict[str, Value]]) -> int | None:
        """Return the place of the first values that fail, which become this one's; None if none does."""
        outcomes = self._evaluate(batch)
        for place, outcome in enumerate(outcomes):
            if self._fails(outcome):
                self.values, self.outcome = batch[place], outcome
                return place
        return None

    def _fails(self, outcome: Outcome) -> bool:
        return outcome.status == self._status and fails(outcome, self._requirement)

    def _remove(self) -> None:
        """Remove as many values as possible: all that can be removed alone, if possible together."""
        rest = self._removable()
        removed: frozenset[str] = frozenset()
        while rest:
            tried = [removed.union(*rest[:count]) for count in self._counts(len(rest))]
            place = self._first_failing([self._without(keys) for keys in tried])
            if place is None:
                rest = rest[1:]
            else:
                removed = tried[place]
                rest = [keys for keys in rest if not keys <= removed]

    def _counts(self, most: int) -> list[int]:
        """Return how many sets are tried to be removed at once: all, then fewer, as many numbers as workers."""
        return sorted({most, *range(1, min(self._workers, most) + 1)}, reverse=True)

    def _removable(self) -> list[frozenset[str]]:
        """Return the sets of keys of which each can be removed alone; the largest first, then the least important."""
        sets = list(_sets(list(self.values)))
        outcomes = self._evaluate([self._without(keys) for keys in sets])
        found = [(keys, outcome) for keys, outcome in zip(sets, outcomes, strict=True) if self._fails(outcome)]
        found.sort(key=lambda each: (-len(each[0]), self._order(each[1])))
        return [keys for keys, _ in found]

    def _order(self, outcome: Outcome) -> float:
        """Return the margin; 0 if there is none."""
        return margin_of(outcome, self._requirement) or 0.0

    def _without(self, keys: frozenset[str]) -> dict[str, Value]:
        return {key: value for key, value in self.values.items() if key not in keys}

    def _move_nearer(self, key: str) -> None:
        """Move a number to the nearest one to the base's with which the run fails, digit by digit."""
        passing, start = base_value(self.base, key), self.values[key]
        if key in self._choices or not _is_number(passing) or not _is_number(start) or passing == start:
            return
        whole = isinstance(start, int)
        near, first = Decimal(repr(passing)), Decimal(repr(start))
        top = abs(first - near).adjusted()
        for digit in range(MOST_DIGITS):
            step = Decimal(1).scaleb(top - digit)
            far = Decimal(repr(self.values[key]))
            if (whole and step < 1) or (digit >= DIGITS and (far != first or far % step == 0)):
                return
            near = self._nearest(key, _between(near, far, step), near, whole=whole)

    def _nearest(self, key: str, grid: Sequence[Decimal], passing: Decimal, *, whole: bool) -> Decimal:
        """Move a value to the nearest number of a grid with which the run fails, and return the last that passes.

        If some numbers beyond one that passes fail too, it can be any of these.

        Args:
            key: of the value.
            grid: numbers between `passing` and the value, in this order.
            passing: a number with which it does not fail.
            whole: whether the value is an integer.
        """
        low, high = -1, len(grid)
        while high - low > 1:
            places = _sections(low, high, self._workers)
            numbers = [int(grid[place]) if whole else float(grid[place]) for place in places]
            first = self._first_failing([{**self.values, key: number} for number in numbers])
            if first is None:
                low = places[-1]
            else:
                low, high = places[first - 1] if first else low, places[first]
        return passing if low < 0 else grid[low]


def _sets(keys: Sequence[str]) -> Iterator[frozenset[str]]:
    """Yield all keys, those of each table that has several of them, and each key alone."""
    tables = dict.fromkeys(
        ".".join(parts[:count]) for parts in (key.split(".") for key in keys) for count in range(len(parts))
    )
    several = {frozenset(key for key in keys if not table or key.startswith(f"{table}.")) for table in tables}
    yield from sorted((each for each in several if len(each) > 1), key=sorted)
    yield from (frozenset([key]) for key in keys)


def _sections(low: int, high: int, count: int) -> list[int]:
    """Return at most `count` whole numbers that divide the range between `low` and `high` evenly, without these."""
    places = np.linspace(low, high, count + 2)[1:-1].round().astype(int)
    return sorted({min(max(int(place), low + 1), high - 1) for place in places})


def _between(near: Decimal, far: Decimal, step: Decimal) -> list[Decimal]:
    """Return the multiples of a step between two numbers, without these, beginning with the nearest to the first."""
    low, high = min(near, far), max(near, far)
    inside = range(math.floor(low / step) + 1, math.ceil(high / step))
    found = [place * step for place in inside]
    return found if near < far else found[::-1]


def _is_number(value: Value | None) -> bool:
    return isinstance(value, float | int) and not isinstance(value, bool)
