"""Which logs a campaign keeps: of runs that failed, of the worst by each requirement, and those asked for.

Which runs are the worst is known at the end only. Until then each run that is among the worst so far keeps its log, and
the log of one that no longer is goes: of n runs in random order, about k (1 + ln(n / k)) logs are written for k.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Collection, Mapping, Sequence

from bench.campaign.jobs import Made
from bench.campaign.requirements import Requirement
from bench.campaign.statuses import OK

MOST_FAILURES = 500
"""How many failures keep their log: a log is some megabytes, and more of them nobody looks at."""


def failed(made: Made, requirements: Sequence[Requirement]) -> bool:
    """Return whether a run did not reach its end or missed a requirement."""
    return made.status != OK or any(each.met(made.metrics) is False for each in requirements)


class Keeping:
    """Decides which logs stay."""

    def __init__(self, requirements: Sequence[Requirement], worst: int, asked: Collection[int] | None) -> None:
        """Begin with no log.

        Args:
            requirements: of the study.
            worst: how many of the worst runs by each requirement keep their log.
            asked: numbers of runs that keep their log in any case; None for all.
        """
        self._requirements = requirements
        self._most = worst
        self._asked = asked
        # By requirement the worst runs, the least bad first: margin and number, both negative.
        self._worst: dict[str, list[tuple[float, int]]] = {each.text: [] for each in requirements}
        self._failures: set[int] = set()

    def is_asked(self, number: int) -> bool:
        """Return whether a run keeps its log in any case."""
        return self._asked is None or number in self._asked

    def limits(self) -> dict[str, tuple[float, float]]:
        """Return by requirement the margin and number before which a run is among the worst so far.

        Of runs with the same margin the first by number counts as worse, whichever ended first.
        """
        return {
            text: (-found[0][0], -found[0][1]) if len(found) >= self._most else (math.inf, math.inf)
            for text, found in self._worst.items()
            if self._most
        }

    def note(self, made: Made) -> set[int]:
        """Take note of a run whose log is there; return the numbers of runs whose log is no longer to be kept."""
        before = self._kept() | {made.number}
        if failed(made, self._requirements) and len(self._failures) < MOST_FAILURES:
            self._failures.add(made.number)
        for each in self._requirements:
            margin = each.margin(made.metrics)
            if margin is not None and self._most:
                heapq.heappush(self._worst[each.text], (-margin, -made.number))
                if len(self._worst[each.text]) > self._most:
                    heapq.heappop(self._worst[each.text])
        after = self._kept()
        return {number for number in before - after if not self.is_asked(number)}

    def _kept(self) -> set[int]:
        return self._failures.union(*({-number for _, number in found} for found in self._worst.values()))


def is_wanted(made: Made, requirements: Sequence[Requirement], limits: Mapping[str, tuple[float, float]]) -> bool:
    """Return whether a run failed or is among the worst so far.

    Args:
        made: the run.
        requirements: of the study.
        limits: see `Keeping.limits`.
    """
    if failed(made, requirements):
        return True
    margins = {each.text: each.margin(made.metrics) for each in requirements if each.text in limits}
    return any(margin is not None and (margin, made.number) < limits[text] for text, margin in margins.items())
