"""The signals that differ between two runs, as figures for a page that shows both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from bench.analysis.figure import Curve, Figure
from bench.analysis.motion import Array
from bench.analysis.series import MAX_POINTS, Pool, short
from bench.counts import counted
from bench.record import Run
from bench.record.compare import SignalDifference
from bench.record.drawing import colour
from bench.record.time_join import same_times

MAX_SIGNALS = 24
"""At most this many signals are drawn: the first to differ."""

GROUP = "What differs"


def figures_of(signals: Sequence[SignalDifference], a: Run, b: Run) -> tuple[list[dict[str, Any]], Pool]:
    """Return two figures for each signal, the curves of both runs and B − A, and the pool of their values.

    Args:
        signals: the signals that differ, in order of their first difference.
        a: the first run.
        b: the second run.
    """
    figures, pool = [], Pool()
    for signal in signals[:MAX_SIGNALS]:
        of_a, of_b = (_values(run, signal) for run in (a, b))
        curves = [_curve(pool, signal, letter, *of) for letter, of in (("A", of_a), ("B", of_b))]
        values = f"{counted(signal.count, 'value')} differ{'s' if signal.count == 1 else ''}"
        caption = f"First at {signal.first_s:.3f} s; {values}, {signal.at_most}."
        if signal is signals[0] and len(signals) > MAX_SIGNALS:
            caption += f" {len(signals)} signals differ; the first {MAX_SIGNALS} are drawn, "
            caption += "platoon diff lists all."
        figures.append(_figure(signal, "", curves, caption))
        rows_a, rows_b = same_times(of_a[0], of_b[0])
        difference = of_b[1][rows_b] - of_a[1][rows_a]
        curve = _curve(pool, signal, "B − A", of_a[0][rows_a], difference)
        figures.append(_figure(signal, ": B − A", [curve], ""))
    return figures, pool


def _figure(signal: SignalDifference, what: str, curves: list[dict[str, Any]], caption: str) -> dict[str, Any]:
    name = f"{signal.bus} {signal.message}.{signal.signal}"
    figure = Figure(
        id=f"differs-{name.replace(' ', '-')}{'-by' if what else ''}",
        title=f"{name}{what}",
        group=GROUP,
        x_label="time [s]",
        y_label=f"{signal.signal} [{signal.unit}]" if signal.unit else signal.signal,
        curves=[],
        caption=caption,
    )
    return {**asdict(figure), "curves": curves}


def _values(run: Run, signal: SignalDifference) -> tuple[Array, Array]:
    columns = run.message(signal.bus, signal.message)
    return columns["t"], columns[signal.signal].astype(np.float64)


def _curve(pool: Pool, signal: SignalDifference, name: str, t: Array, values: Array) -> dict[str, Any]:
    """Put times and values into the pool, thinned to at most `MAX_POINTS`, and return their curve."""
    kept = slice(None, None, max(1, -(-len(t) // MAX_POINTS)))
    key = f"differs.{name}.{signal.bus}.{signal.message}.{signal.signal}"
    pool[f"{key}.t"], pool[key] = list(short(t[kept])), list(short(values[kept]))
    colours = {"A": colour(1), "B": colour(2)}
    curve = Curve(name, f"{key}.t", key, colours.get(name, "ink"), at=f"{key}.t", step=True)
    # The page draws a curve with a run in the layer of that run, and B dashed.
    return {**asdict(curve), "run": name if name in colours else ""}
