"""Faults as earlier versions wrote them in their logs, in the words of this one."""

from collections.abc import Mapping
from typing import Any


def renewed(fault: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of a fault from a log as this version writes it.

    `tyre_blowout` was a loss of cornering stiffness of an axle, which is now called `axle_softening`.
    """
    if fault.get("kind") == "tyre_blowout" and "axle" in fault:
        return {**fault, "kind": "axle_softening"}
    return dict(fault)
