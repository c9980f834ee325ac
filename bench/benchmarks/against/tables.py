"""The tables of a comparison: medians of both checkouts, and the median and range of the ratios of the pairs."""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from bench.benchmarks.against.comparison import SHORT_S, Costs
from bench.benchmarks.against.profile import OTHER, PARTS
from bench.benchmarks.against.run_cost import STEPS, RunCost
from bench.cycle import CYCLE_MS, CYCLE_S

_MB = 1e6
_PERCENTILES = (50.0, 99.0)

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Row:
    """One metric of both checkouts.

    Attributes:
        title: with its unit.
        other, this: (pairs,) of the other revision and of this one; NaN where there is none.
    """

    title: str
    other: Values
    this: Values

    @property
    def ratios(self) -> Values:
        """(pairs,) this one's over the other's, of the pairs in which both have one."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios: Values = self.this / self.other
        return ratios[np.isfinite(ratios)]

    def cells(self) -> list[str]:
        """Return its cells."""
        ratios = self.ratios
        spread = f"{_digits(ratios.min())} .. {_digits(ratios.max())}" if ratios.size else "-"
        return [self.title, _median(self.other), _median(self.this), _median(ratios), spread]


def times(other: Costs, this: Costs) -> list[list[Row]]:
    """Return the rows of processor time, speed, start and steps, in sections."""
    pair = other, this
    return [
        [
            *(row for bus in other.long for row in _processor_time(pair, bus)),
            *(_row(f"recording, of that, {bus}", pair, _recording, bus) for bus in other.long),
        ],
        [
            *(_row(f"real-time factor in lockstep, {bus}", pair, _factors, bus) for bus in other.long),
            *(_row(f"from the command to the first frame, {bus}, s", pair, _starts, bus) for bus in other.long),
        ],
        [row for bus in reversed(other.long) for row in _steps(pair, bus)],
    ]


def memory(other: Costs, this: Costs) -> list[list[Row]]:
    """Return the rows of the peak memory of a process of each kind over udp."""
    found = []
    for attribute, what in (("peak_bytes", "peak resident"), ("shared_bytes", "proportional (PSS)")):
        kinds = _kinds([*_last(other, "udp"), *_last(this, "udp")])
        found.append(
            [Row(f"{kind}, {what}", *(_memory(each, kind, attribute) for each in (other, this))) for kind in kinds]
        )
    return found


def nodes(other: Costs, this: Costs) -> list[list[Row]]:
    """Return the rows of each kind of process over udp: ms per cycle of all processes of it together."""
    kinds = _kinds([*_last(other, "udp"), *_last(this, "udp")])
    rows = [
        Row(f"{kind}, {what}", *(_of_nodes(each, kind, what) for each in (other, this)))
        for kind in kinds
        for what in ("user", "system")
    ]
    both = ([row.other for row in rows], [row.this for row in rows])
    return [rows, [Row("all", *(np.nansum(np.stack(values), axis=0) for values in both))]]


def parts(other: Costs, this: Costs, shares: Sequence[Mapping[str, float]]) -> list[list[Row]]:
    """Return the rows of each part of a run on `direct`: its share times the processor time per cycle, ms."""
    totals = [float(np.median(_rates(each, "direct"))) * CYCLE_MS for each in (other, this)]
    starts = [np.array([cost.cpu_s for cost in each.short["direct"]]) for each in (other, this)]
    names = [*(name for name, _ in PARTS), OTHER]
    rows = [
        Row(name, *(np.array([total * part[name]]) for total, part in zip(totals, shares, strict=True)))
        for name in names
    ]
    return [rows, [Row("all", *(np.array([total]) for total in totals)), Row("start and end, once, s", *starts)]]


def table(title: str, sections: Sequence[Sequence[Row]], names: tuple[str, str]) -> Table:
    """Return the rows as a table; `names` are the other revision's and this one's."""
    found = Table(title=title, title_justify="left")
    found.add_column("")
    for heading in (*names, "ratio", "of the pairs"):
        found.add_column(heading, justify="right")
    for section in sections:
        for row in section:
            found.add_row(*row.cells())
        found.add_section()
    return found


def deadlines(title: str, found: Mapping[str, RunCost | str]) -> Table:
    """Return the table of runs in real time, a row for each checkout."""
    made = Table(title=title, title_justify="left")
    made.add_column("")
    for heading in ("deadlines missed", "largest response", "cores used", "recording, of a core"):
        made.add_column(heading, justify="right")
    for name, cost in found.items():
        if isinstance(cost, str) or cost.deadlines is None:
            made.add_row(name, str(cost).splitlines()[-1], "-", "-", "-")
            continue
        recorded = cost.recorder_s / cost.simulated_s
        made.add_row(
            name,
            f"{100 * cost.deadlines.missed:.4f} %",
            f"{cost.deadlines.largest_ms:.2f} ms",
            f"{sum(node.user + node.system for node in cost.nodes.values() if math.isfinite(node.user)):.2f}",
            f"{100 * recorded:.1f} %" if math.isfinite(recorded) else "-",
        )
    return made


def _processor_time(pair: tuple[Costs, Costs], bus: str) -> Iterator[Row]:
    yield _row(f"processor time of a simulated second, {bus}, s", pair, _wholes, bus)
    yield _row("  without start and end", pair, _rates, bus)
    yield _row(f"  of start and end (a run of {SHORT_S:g} s)", pair, _shorts, bus)


def _steps(pair: tuple[Costs, Costs], bus: str) -> Iterator[Row]:
    for role in STEPS:
        cycles = max(cost.steps[role].cycles for each in pair for cost in each.long[bus])
        of = f", largest of {cycles} cycles" if cycles > 1 else ""
        for share in _PERCENTILES:
            values = (
                np.array([_percentile(cost.steps[role].largest_of(cycles), share) for cost in each.long[bus]])
                for each in pair
            )
            yield Row(f"{role}'s whole step{of}, p{share:g}, {bus}, ms", *values)


def _percentile(values: Values, share: float) -> float:
    return float(np.percentile(values, share)) if values.size else math.nan


def _row(title: str, pair: tuple[Costs, Costs], values: Callable[[Costs, str], Values], bus: str) -> Row:
    return Row(title, *(values(each, bus) for each in pair))


def _wholes(costs: Costs, bus: str) -> Values:
    return np.array([cost.cpu_s / cost.simulated_s for cost in costs.long[bus]])


def _shorts(costs: Costs, bus: str) -> Values:
    return np.array([cost.cpu_s for cost in costs.short[bus]])


def _rates(costs: Costs, bus: str) -> Values:
    runs = zip(costs.long[bus], costs.short[bus], strict=True)
    return np.array([(long.cpu_s - short.cpu_s) / (long.simulated_s - short.simulated_s) for long, short in runs])


def _recording(costs: Costs, bus: str) -> Values:
    return np.array([cost.recorder_s / cost.simulated_s for cost in costs.long[bus]])


def _factors(costs: Costs, bus: str) -> Values:
    return np.array([cost.simulated_s / cost.lockstep_s for cost in costs.long[bus]])


def _starts(costs: Costs, bus: str) -> Values:
    return np.array([cost.start_s for cost in costs.long[bus]])


def _last(costs: Costs, bus: str) -> list[str]:
    return [name for cost in costs.long[bus] for name in cost.nodes]


def _kinds(names: Sequence[str]) -> list[str]:
    """Return the kinds of processes: names without the number of their vehicle."""
    return sorted({_kind(name) for name in names})


def _kind(name: str) -> str:
    return re.sub(r"^veh\d+\.", "", name)


def _memory(costs: Costs, kind: str, attribute: str) -> Values:
    """Return the largest memory of a process of a kind, in each run over udp."""
    values = (
        [getattr(node, attribute) / _MB for name, node in cost.nodes.items() if _kind(name) == kind]
        for cost in costs.long["udp"]
    )
    return np.array([max(found, default=math.nan) for found in values])


def _of_nodes(costs: Costs, kind: str, what: str) -> Values:
    """Return the processor time of all processes of a kind in ms per cycle, in each run over udp."""
    values = (
        [getattr(node, what) * CYCLE_S * 1000 for name, node in cost.nodes.items() if _kind(name) == kind]
        for cost in costs.long["udp"]
    )
    return np.array([sum(found) if found else math.nan for found in values])


def _median(values: Values) -> str:
    finite = values[np.isfinite(values)]
    return _digits(float(np.median(finite))) if finite.size else "-"


def _digits(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
