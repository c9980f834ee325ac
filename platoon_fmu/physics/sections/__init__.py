"""The page's sections: for each manoeuvre a description, its metrics and its plots."""

from __future__ import annotations

from platoon_fmu.physics.measurements import Measurements
from platoon_fmu.physics.sections.conservation import convergence, energy, symmetry
from platoon_fmu.physics.sections.lateral import circular, stability, step_steer
from platoon_fmu.physics.sections.longitudinal import coast_down, friction, standstill
from platoon_fmu.physics.sections.section import Section

__all__ = ["Section", "sections"]

_IN_ORDER = (
    circular,
    step_steer,
    stability,
    coast_down,
    friction,
    standstill,
    energy,
    symmetry,
    convergence,
)


def sections(m: Measurements) -> list[Section]:
    """All sections, in the order of the page."""
    return [make(m) for make in _IN_ORDER]
