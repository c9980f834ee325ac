"""The page in docs/: what is run, what was found, and the figure beside it."""

from collections.abc import Sequence
from pathlib import Path

from bench.benchmarks.comfort.limits import LIMITS, UNITS, WORDS
from bench.benchmarks.comfort.tables import SHIPPED, Wanted
from bench.benchmarks.sheet import Sheet

_TEXT = Path(__file__).with_suffix(".md")


def page(
    seeds: range,
    found: Sequence[Sheet | str],
    front: Sequence[Sheet | str],
    shipped: Sequence[Sheet | str],
    figure: str,
) -> str:
    """Return the page.

    Args:
        seeds: numbers of the random scenarios.
        found: what was found in them.
        front: the formation times over the limits.
        shipped: the figures of the shipped scenarios.
        figure: name of the figure's file.
    """
    return _TEXT.read_text(encoding="utf-8").format(
        limits=", ".join(f"{WORDS[name]} {limit:g} {UNITS[name]}" for name, limit in LIMITS.items()),
        first=seeds[0],
        last=seeds[-1],
        random=_text(found),
        figure=figure,
        front=_text(front),
        wanted="; ".join(f"`{name}` {_words(wanted)}" for name, wanted in SHIPPED.items()),
        shipped=_text(shipped),
    )


def _text(parts: Sequence[Sheet | str]) -> str:
    return "\n".join(part if isinstance(part, str) else part.markdown() for part in parts)


def _words(wanted: Wanted) -> str:
    """Return what a shipped scenario is to reach, in words."""
    comfort = ", the limits of comfort" if wanted.comfortable else ""
    distance = "" if wanted.distance_m is None else f", {wanted.distance_m:g} m between centres"
    return (
        f"formed by {wanted.formed_s:g} s{comfort}, at most {wanted.reversals} reversals of the steering by more than"
        f" 2 mrad, margin {wanted.margin:g}{distance}"
    )
