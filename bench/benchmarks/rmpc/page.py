"""The page in docs/: what the benchmark solves, how it measures, and the tables of one machine."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bench.benchmarks.rmpc.nominal import HORIZON
from bench.benchmarks.rmpc.problems import Problems
from bench.benchmarks.rmpc.worst import DURATION_S, RUNS
from bench.benchmarks.sheet import Sheet

_TEXT = Path(__file__).with_suffix(".md")


def page(problems: Problems, found: Sequence[Sheet | str], verdict: Sequence[str], tolerance: float) -> str:
    """Return the page.

    Args:
        problems: the set.
        found: the tables and remarks, the first of which describes the machine.
        verdict: the outcome of the check over all problems; empty if there was none.
        tolerance: of the bench's own program.
    """
    machine, *rest = found
    left_out = problems.about.get("left out", "0")
    return _TEXT.read_text(encoding="utf-8").format(
        option="--all " if verdict else "",
        count=len(problems),
        groups="\n".join(_groups(problems)),
        tau=problems.about["tau"],
        left_out=f" {left_out} more that it could not decide were left out." if left_out != "0" else "",
        tolerance=tolerance,
        horizon=HORIZON,
        worst_runs=RUNS,
        worst_s=DURATION_S,
        machine=machine,
        verdict="".join(f"{line}\n" for line in verdict) + "\n" if verdict else "",
        sheets="\n".join(each if isinstance(each, str) else each.markdown() for each in rest),
    )


def _groups(problems: Problems) -> list[str]:
    names = list(dict.fromkeys(problems.group.tolist()))
    masks = [problems.group == name for name in names]
    return [
        f"| {name} | {mask.sum()} | {np.isinf(problems.tau[mask]).sum()} |"
        for name, mask in zip(names, masks, strict=True)
    ]
