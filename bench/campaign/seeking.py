"""Campaigns that choose their runs: the search for the worst with its counterexample, and rare failures."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

from bench.campaign.campaign import Campaign, Options, begun
from bench.campaign.counterexample import Counterexample, made_small, write_scenario
from bench.campaign.evaluating import fails, requirement_on
from bench.campaign.rare import Estimate, check, subset_simulation
from bench.campaign.requirements import Requirement
from bench.campaign.search import Worst, search
from bench.campaign.statistics import percent
from bench.campaign.study import Study
from bench.campaign.unit_cube import UnitCube
from bench.files import write_text

SEARCH_RUNS = 300
"""Runs of a search, unless told otherwise."""
WORST_FILE, COUNTEREXAMPLE_FILE, FOUND_FILE = "worst.toml", "counterexample.toml", "found.json"

Say = Callable[[str], None]


@dataclass(frozen=True)
class Found:
    """What a search has found.

    Attributes:
        requirement: what was searched.
        worst: the worst run.
        counterexample: the worst run made small; None if it does not fail.
    """

    requirement: Requirement
    worst: Worst
    counterexample: Counterexample | None

    def lines(self, folder: Path) -> list[str]:
        """Return what was found as lines of text."""
        worst, outcome = self.worst, self.worst.outcome
        told = [f"{worst.evaluations} runs from {worst.starts} starts; the search {worst.ended}."]
        if outcome is None or worst.values is None:
            return [*told, f"No run has had a value of {self.requirement.metric}."]
        value = (outcome.metrics or {}).get(self.requirement.metric)
        said = f"{self.requirement.metric} = {_figure(value)}" if outcome.metrics is not None else outcome.words
        verdict = "missed" if self.counterexample else "met"
        told.append(f"The worst, run {outcome.number}: {said}; {self.requirement.text} is {verdict}.")
        told += [f"  {key} = {_figure(each)}" for key, each in worst.values.items()]
        told.append(f"scenario: {folder / WORST_FILE}")
        if self.counterexample:
            told.append(f"Made small in {self.counterexample.evaluations} runs, it fails with:")
            told += [
                f"  {change.key} = {_figure(change.value)} instead of {_figure(change.base)}"
                for change in self.counterexample.changes
            ] or ["  nothing changed: the base scenario fails"]
            told.append(f"scenario: {folder / COUNTEREXAMPLE_FILE}")
        return told


def search_worst(study: Study, metric: str, options: Options, runs: int, say: Say) -> Found:
    """Search for the worst run of a study, make it small if it fails, and write both as scenarios.

    Args:
        study: its inputs are varied within their ranges.
        metric: a metric with a limit from one side in the study, or the whole requirement.
        options: of the campaign; the purpose is set here.
        runs: largest number of runs of the search; the counterexample takes more.
        say: told what is being done, a line each.

    Raises:
        BadInput: the metric has no such limit, or see `begun`.
        RunFailed: see `begun`.
    """
    requirement = requirement_on(study, metric)
    UnitCube(study)
    with begun(study, _for(options, f"the search for the least margin to {requirement.text}"), None) as campaign:
        worst = Worst()
        workers = campaign.threads()
        for worst in search(study, requirement, campaign.evaluate, runs=runs, workers=workers):
            margin = "none yet" if worst.margin is None else f"{worst.margin:.4g}"
            say(f"{worst.evaluations} runs, start {worst.starts}: least margin {margin}")
        small = None
        if worst.values is not None and worst.outcome is not None:
            write_text(options.folder / WORST_FILE, study.scenario(0, worst.values).toml())
            if fails(worst.outcome, requirement):
                say("the worst run fails: it is made small")
                small = made_small(study, requirement, worst.values, campaign.evaluate, workers=workers)
                write_scenario(study, small, options.folder / COUNTEREXAMPLE_FILE)
        found = Found(requirement, worst, small)
        _write_found(options.folder, {"search": requirement.text, "worst": asdict(worst), "small": _plain(small)})
    return found


def rare_failures(study: Study, metric: str, options: Options, samples: int, say: Say) -> tuple[Requirement, Estimate]:
    """Estimate the probability that a requirement is missed by subset simulation.

    Args:
        study: its inputs are drawn from their distributions.
        metric: a metric with a limit from one side in the study, or the whole requirement.
        options: of the campaign; the purpose is set here.
        samples: runs of a level.
        say: told what is being done, a line each.

    Raises:
        BadInput: the metric has no such limit, there are too few samples, or see `begun`.
        RunFailed: hardly any run has the metric, or see `begun`.
    """
    requirement = requirement_on(study, metric)
    UnitCube(study)
    check(requirement, samples)
    purpose = f"subset simulation of missing {requirement.text}, {samples} samples a level"
    with begun(study, _for(options, purpose), None) as campaign:
        estimate = _simulated(study, requirement, campaign, samples, say)
        _write_found(options.folder, {"rare": requirement.text, "estimate": asdict(estimate)})
    return requirement, estimate


def estimate_lines(requirement: Requirement, estimate: Estimate) -> list[str]:
    """Return an estimate as lines of text."""
    if estimate.probability:
        said = f"{estimate.probability:.3g}, coefficient of variation {estimate.variation:.2f}"
    else:
        said = f"at most {percent(estimate.most if estimate.most is not None else 1.0, math.ceil)}: none failed"
    levels = [
        f"  level {number}: margin at most {level.threshold:.4g}, share below the next {level.share:.3f}"
        for number, level in enumerate(estimate.levels, 1)
    ]
    return [f"Probability of missing {requirement.text}: {said}.", f"The simulation {estimate.words}.", *levels]


def _simulated(study: Study, requirement: Requirement, campaign: Campaign, samples: int, say: Say) -> Estimate:
    estimate = None
    for progress in subset_simulation(study, requirement, campaign.evaluate, samples=samples):
        say(f"{progress.evaluations} runs, level {progress.level}: probability reached {progress.reached:.3g}")
        estimate = progress.estimate
    return cast(Estimate, estimate)


def _for(options: Options, purpose: str) -> Options:
    return Options(**{**vars(options), "purpose": purpose})


def _write_found(folder: Path, found: dict[str, Any]) -> None:
    write_text(folder / FOUND_FILE, json.dumps(found, indent=1, default=str) + "\n")


def _plain(small: Counterexample | None) -> dict[str, Any] | None:
    return None if small is None else {**asdict(small), "requirement": small.requirement.text}


def _figure(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else "–" if value is None else str(value)
