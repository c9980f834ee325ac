"""How a campaign evaluates chosen values of a study's inputs, and what their runs mean for a requirement.

Search, counterexamples and rare events choose values; where and how the runs are made is not theirs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from bench.campaign.distributions import Value
from bench.campaign.requirements import METRIC_NAMES, Metric, Requirement
from bench.campaign.statuses import REFUSED
from bench.campaign.study import Study
from bench.errors import BadInput
from bench.scenario.errors import closest


@dataclass(frozen=True)
class Outcome:
    """The row of values that were evaluated.

    Attributes:
        number: of the row in the campaign's table.
        metrics: of its run by name; None if the run did not reach its end, or there was none.
        status: how it ended, `bench.campaign.statuses.REFUSED` if the values make no scenario.
        words: why, if it did not reach its end.
    """

    number: int
    metrics: Mapping[str, Metric] | None
    status: str
    words: str


Evaluate = Callable[[Sequence[dict[str, Value]]], list[Outcome]]
"""Evaluates values of a study's inputs by key, as many at a time as there are workers; the outcomes are in their order.

Keys that are left out keep the value of the base scenario.
"""


class Remembered:
    """Evaluates values once, however often they are asked for."""

    def __init__(self, evaluate: Evaluate) -> None:
        """Remember what `evaluate` returns."""
        self._evaluate = evaluate
        self._known: dict[tuple[tuple[str, type, Value], ...], Outcome] = {}

    @property
    def evaluations(self) -> int:
        """Number of different values that were evaluated."""
        return len(self._known)

    def __call__(self, batch: Sequence[dict[str, Value]]) -> list[Outcome]:
        """Return the outcome of all values, after evaluating those that are new at once."""
        # 1, 1.0 and True are equal in Python and different in a scenario.
        keys = [tuple((key, type(value), value) for key, value in sorted(values.items())) for values in batch]
        new = {key: values for key, values in zip(keys, batch, strict=True) if key not in self._known}
        if new:
            self._known.update(zip(new, self._evaluate(list(new.values())), strict=True))
        return [self._known[key] for key in keys]


def margin_of(outcome: Outcome, requirement: Requirement) -> float | None:
    """Return by how much a run stays on the right side of a limit; negative is beyond it.

    It is minus infinity of a run that did not reach its end. It is None where `Requirement.margin` is, and of values
    that make no scenario.
    """
    if outcome.status == REFUSED:
        return None
    return -math.inf if outcome.metrics is None else requirement.margin(outcome.metrics)


def fails(outcome: Outcome, requirement: Requirement) -> bool:
    """Return whether a run missed a requirement or did not reach its end; values that make no scenario do not fail."""
    if outcome.status == REFUSED:
        return False
    met = None if outcome.metrics is None else requirement.met(outcome.metrics)
    # Comparisons of numpy's numbers are not False itself.
    return outcome.metrics is None or (met is not None and not met)


def requirement_on(study: Study, metric: str) -> Requirement:
    """Return a study's requirement that limits a metric from one side.

    Args:
        study: the study.
        metric: name of the metric, or the whole requirement as `Requirement.text` has it.

    Raises:
        BadInput: there is none, or several.
    """
    limits = [each for each in study.requirements if each.has_margin]
    found = [each for each in limits if metric in (each.metric, each.text)]
    if len(found) == 1:
        return found[0]
    if found:
        texts = " or ".join(f"'{each.text}'" for each in found)
        raise BadInput(f"{metric} has {len(found)} limits in the study {study.name}; give one of them: {texts}")
    raise BadInput(_no_limit(study, metric, [each.metric for each in limits]))


def _no_limit(study: Study, metric: str, limited: Sequence[str]) -> str:
    """Return why a metric has no limit in a study, and which have."""
    allowed = f"allowed: {', '.join(limited) or 'none yet'}"
    add = f'or add a limit to its requirements, such as "{metric} > 1.0"'
    equality = next((each.text for each in study.requirements if each.metric == metric), None)
    if equality:
        return f'{metric} has only "{equality}" in the study {study.name}, which has no margin; {allowed}; {add}'
    if metric in METRIC_NAMES:
        return f"{metric} has no limit in the study {study.name}; {allowed}; {add}"
    near = closest(metric, METRIC_NAMES)
    meant = f"did you mean {near}? " if near else ""
    return f"{metric} is not a metric; {meant}{allowed} (limits in the study {study.name})"
