"""One section of the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from platoon_fmu.physics.figure import Figure
from platoon_fmu.physics.plot import Plot


@dataclass(frozen=True)
class Section:
    """One section of the page.

    Attributes:
        id: anchor for links.
        title: its heading.
        standard: the standard it follows; empty for none.
        done: description of the test, in sentences.
        figures: the metrics, with their expected values.
        plots: its plots.
    """

    id: str
    title: str
    standard: str
    done: str
    figures: Sequence[Figure]
    plots: Sequence[Plot]
