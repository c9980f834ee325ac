"""Faults in logs of earlier versions, translated to this one."""

from collections.abc import Mapping
from typing import Any


def renewed(fault: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of a fault from a log in this version's form.

    `tyre_blowout` was a loss of cornering stiffness of an axle, now called `axle_softening`.
    """
    if fault.get("kind") == "tyre_blowout" and "axle" in fault:
        return {**fault, "kind": "axle_softening"}
    return dict(fault)
