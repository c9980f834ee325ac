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
        id: for links.
        title: its heading.
        standard: the standard it follows; empty for none.
        done: what was done, in sentences.
        figures: what was measured, and what is asked of it.
        plots: what it looks like.
    """

    id: str
    title: str
    standard: str
    done: str
    figures: Sequence[Figure]
    plots: Sequence[Plot]
