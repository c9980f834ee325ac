"""Runs two checkouts in turn, so that whatever else the machine does meanwhile concerns both."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from bench.benchmarks.against.checkout import Checkout
from bench.benchmarks.against.profile import RATE, profile, shares
from bench.benchmarks.against.run_cost import RunCost, measure
from bench.errors import RunFailed

BUSES = ("udp", "direct")

SHORT_S = 0.1
"""Duration of the runs whose cost is that of starting (simulated s)."""

SAMPLES = 1000
"""How many samples a profile should have."""

MOST_PROFILES = 5
"""How often a run is profiled at most."""

Say = Callable[[str], None]


@dataclass
class Costs:
    """What the runs of one checkout took, on each bus; the n-th of each list are of the n-th pair.

    Attributes:
        checkout: the checkout.
        long: runs of the whole duration.
        short: runs of `SHORT_S`.
    """

    checkout: Checkout
    long: dict[str, list[RunCost]] = field(default_factory=lambda: {bus: [] for bus in BUSES})
    short: dict[str, list[RunCost]] = field(default_factory=lambda: {bus: [] for bus in BUSES})


def in_pairs(
    checkouts: Sequence[Checkout], scenario: Path, seconds: float, pairs: int, folder: Path, say: Say
) -> list[Costs]:
    """Run both checkouts in turn, `pairs` times, every other time the second one first.

    One run of each on each bus comes before, whose cost is left out: it fills the caches.

    Raises:
        RunFailed: a run did not complete.
    """
    costs = [Costs(checkout) for checkout in checkouts]
    for bus in BUSES:
        for checkout in checkouts:
            say(f"{checkout.name}: once over {bus}, to fill caches")
            measure(checkout, scenario, bus, SHORT_S, folder)
    for pair in range(pairs):
        for bus in BUSES:
            for duration in (SHORT_S, seconds):
                for each in costs if pair % 2 == 0 else costs[::-1]:
                    say(f"pair {pair + 1} of {pairs}: {each.checkout.name}, {duration:g} s over {bus}")
                    cost = measure(each.checkout, scenario, bus, duration, folder)
                    (each.short if duration == SHORT_S else each.long)[bus].append(cost)
    return costs


def shares_by_part(costs: Costs, scenario: Path, seconds: float, folder: Path, say: Say) -> dict[str, float]:
    """Return the share of each part in the processor time of a simulated second on `direct`.

    Raises:
        RunFailed: see `profile`.
    """
    used_s = sum(cost.cpu_s for cost in costs.long["direct"]) / len(costs.long["direct"])
    times = min(MOST_PROFILES, max(1, round(SAMPLES / RATE / used_s)))
    long, short = Counter[str](), Counter[str]()
    for number in range(times):
        say(f"profile {number + 1} of {times}: {costs.checkout.name}")
        long += profile(costs.checkout, scenario, seconds, folder)
        short += profile(costs.checkout, scenario, SHORT_S, folder)
    return shares(long, short)


def in_real_time(
    checkouts: Sequence[Checkout], scenario: Path, seconds: float, folder: Path, say: Say
) -> Mapping[str, RunCost | str]:
    """Run each checkout once on the wall clock, over udp; return the costs by name, or why a run failed."""
    found: dict[str, RunCost | str] = {}
    for checkout in checkouts:
        say(f"{checkout.name}: {seconds:g} s on the wall clock")
        try:
            found[checkout.name] = measure(checkout, scenario, "udp", seconds, folder, "--clock", "realtime")
        except RunFailed as error:
            found[checkout.name] = str(error)
    return found
