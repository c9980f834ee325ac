"""The families of random scenarios: `FAMILY:NUMBER` names one wherever a scenario is named."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from bench.errors import BadInput
from bench.scenario.random_family import random_scenario
from bench.scenario.random_faults import random_fault_scenario

MOST = 2**32 - 1
"""The largest number of a scenario, which is its seed as well."""


@dataclass(frozen=True)
class Family:
    """A family of random scenarios.

    Attributes:
        name: what its scenarios' names begin with.
        description: what they are.
        text: returns the scenario of a number from 0 to `MOST` as TOML.
        shown: keys of a scenario by which its runs are told apart, with the types of their values; `vehicles` is the
            number of vehicles.
    """

    name: str
    description: str
    text: Callable[[int], str]
    shown: Mapping[str, type]


_SITUATION: Mapping[str, type] = {
    "vehicles": int,
    "platoon.speed_mps": float,
    "platoon.gap_m": float,
    "platoon.lane_y_m": float,
    "road.mu": float,
}
_FAULT: Mapping[str, type] = {"faults.0.kind": str, "faults.0.at_s": float}

FAMILIES = {
    each.name: each
    for each in (
        Family(
            "random",
            "Two to seven vehicles on a random road; each number is one scenario, for ever the same",
            random_scenario,
            _SITUATION,
        ),
        Family(
            "random-fault",
            "The random scenario of the same number with one fault of a random kind, target, time and size",
            random_fault_scenario,
            {**_SITUATION, **_FAULT},
        ),
    )
}


def is_random(name: str) -> bool:
    """Return whether a name is that of a random scenario, with a possible number or not."""
    family, colon, _ = name.partition(":")
    return bool(colon) and family in FAMILIES


def random_text(name: str) -> str:
    """Return the scenario of a name such as `random:7` as TOML.

    Raises:
        BadInput: not a number, or too large a one.
    """
    family, _, digits = name.partition(":")
    if not (digits.isascii() and digits.isdigit()) or len(digits) > len(str(MOST)) or int(digits) > MOST:
        raise BadInput(f"Scenario {name}: not a number of a random scenario; allowed: {family}:0 to {family}:{MOST}")
    return FAMILIES[family].text(int(digits))
