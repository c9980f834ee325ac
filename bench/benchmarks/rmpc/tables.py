"""The benchmark's tables, for the terminal and for a page."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bench.benchmarks.figures import seconds_text
from bench.benchmarks.rmpc.contestants import Result
from bench.benchmarks.rmpc.nominal import Outcome
from bench.benchmarks.sheet import Sheet

Array = NDArray[np.float64]


def robust_sheet(results: Sequence[Result]) -> Sheet:
    """Return accuracy and time of each contestant."""
    headings = ("solver", "problems", "certified", "τ/optimum p50", "p99", "largest", "time p50", "p99", "largest")
    rows = [[result.name, str(len(result.gains)), _certified(result), *_ratios(result), *_times(result.seconds)]
            for result in results]  # fmt: skip
    return Sheet("The robust MPC, each gain with its certificate", headings, rows)


def groups_sheet(result: Result) -> Sheet:
    """Return accuracy and time of one contestant on each kind of problem, and which program gave its gains."""
    headings = ("problems", "count", "certified", "by", "τ/optimum p50", "p99", "largest", "time p50", "p99", "largest")
    rows = []
    for group in dict.fromkeys(result.problems.group.tolist()):
        part = _part(result, result.problems.group == group)
        rows.append(
            [group, str(len(part.gains)), _certified(part), _sources(part), *_ratios(part), *_times(part.seconds)]
        )
    return Sheet(f"{result.name} by kind of problem", headings, rows)


def nominal_sheet(outcomes: Sequence[Outcome]) -> Sheet:
    """Return what a step of other MPC solvers costs, which solve an easier problem; costs are relative to the first."""
    headings = ("MPC solver", "problems", "solved", "cost too high, largest", "time p50", "p99", "largest")
    rows = []
    for each in outcomes:
        same = len(each.costs) == len(outcomes[0].costs) and not np.isnan(each.costs).all()
        excess = f"{max(0.0, np.nanmax(each.costs / outcomes[0].costs - 1.0)):.0e}" if same else "-"
        done = f"{100 * np.mean(each.solved):.1f} %"
        rows.append([each.name, str(len(each.seconds)), done, excess, *_times(each.seconds)])
    return Sheet("Other MPC solvers, without a guarantee for other tyres", headings, rows)


def _part(result: Result, which: NDArray[np.bool_]) -> Result:
    gains = [gain for gain, taken in zip(result.gains, which, strict=True) if taken]
    return Result(result.name, result.problems.chosen(which), gains, result.seconds[which])


def _certified(result: Result) -> str:
    """Return the share of the problems that have a gain for which it found one; cut, so that only all are 100 %."""
    share = result.usable[result.feasible].mean() if result.feasible.any() else np.nan
    return f"{np.floor(1e4 * share) / 1e2:.2f} %"


def _sources(result: Result) -> str:
    return ", ".join(f"{name} {count}" for name, count in result.sources.items())


def _ratios(result: Result) -> list[str]:
    found = result.ratio[np.isfinite(result.ratio)]
    return [f"{value:.5f}" for value in np.quantile(found, [0.5, 0.99, 1.0])] if found.size else ["-"] * 3


def _times(seconds: Array) -> list[str]:
    return [seconds_text(float(value)) for value in np.quantile(seconds, [0.5, 0.99, 1.0])]
