"""Writes the log that would result from what ECUs send now, for `platoon diff`, `platoon report` and others.

Only the frames of the ECUs that were run again change. This is open loop: vehicles and other ECUs behave as recorded.
Process usage is left out, and so are the computing times of the ECUs that were run again.
"""

from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from heapq import merge
from pathlib import Path

import numpy as np

from bench.bus.topic import Topic
from bench.bus.wire.timing import BusTimeline
from bench.cycle import CYCLE_NS
from bench.ecu.loading import load_class
from bench.errors import RunFailed
from bench.files import written_aside
from bench.label import LABEL
from bench.record.can_frame import Frame
from bench.record.label import resim_label
from bench.record.reader import Run
from bench.record.writer import RunWriter
from bench.resim.comparison import Pair
from bench.resim.job import Outcome
from bench.resim.plan import RESIMULATED, Plan, class_in

_FRAMES, _TRUTH, _EVENTS = range(3)
"""What comes first of all that has one time."""

_Writing = tuple[int, int, Callable[[], None]]
"""Simulated time (ns), one of the above, and what writes it."""


def write(plan: Plan, outcomes: Sequence[Outcome], out: Path, command_line: str) -> None:
    """Write the log to `out`, which must not exist; if it cannot be written completely, no file remains.

    Raises:
        BadInput: the log is unreadable, or the file cannot be written.
    """
    with written_aside(out, new=True) as path:
        try:
            _write(plan, outcomes, path, command_line)
        except RunFailed as failure:
            # The error names the temporary file; the user knows only `out`.
            if isinstance(failure.__cause__, OSError):
                raise failure.__cause__ from None
            raise


def _write(plan: Plan, outcomes: Sequence[Outcome], path: Path, command_line: str) -> None:
    run = plan.run
    # A log reduced to what ECUs need has no truth.
    truth_names = [name for name in run.truth(1) if name != "t"] if "/truth/veh1" in run.topics else []
    vehicles = range(1, run.vehicles + 1) if truth_names else ()
    units = {name: run.unit("/truth/veh1", name) for name in truth_names}
    before = [run.metadata[RESIMULATED]] if RESIMULATED in run.metadata else []
    resimulated = ", ".join([*before, *(f"{outcome.name} ({outcome.spec})" for outcome in outcomes)])
    head = {key: value for key, value in run.metadata.items() if key not in run.result and not key.startswith("ecu ")}
    with RunWriter(
        path,
        codecs=plan.codecs,
        truth_names=truth_names,
        vehicles=run.vehicles,
        metadata={
            **{**head, LABEL: resim_label(run, [outcome.name for outcome in outcomes])},
            **{**_classes(plan, outcomes), RESIMULATED: resimulated, "resim_command_line": command_line},
        },
        attachments=run.attachments,
        truth_units={name: unit for name, unit in units.items() if unit},
        timeline=BusTimeline(plan.codecs, _inputs(plan), realtime=plan.realtime),
    ) as writer:
        streams = (
            _frames(run, _changes(outcomes), _own_times(plan, outcomes), writer),
            *(_truth(run, vehicle, truth_names, writer) for vehicle in vehicles),
            _events(run, writer),
        )
        for _, _, put in merge(*streams, key=lambda writing: writing[:2]):
            put()
        writer.close(run.result)


def _classes(plan: Plan, outcomes: Sequence[Outcome]) -> dict[str, str]:
    """The metadata of the ECUs' classes: one entry per role if all are the same."""
    again = {outcome.name: outcome.spec for outcome in outcomes}
    of_role: dict[str, dict[str, str]] = defaultdict(dict)
    for slot in plan.slots:
        of_role[slot.role][slot.name] = again.get(slot.name) or class_in(plan.run, slot)
    found: dict[str, str] = {}
    for role, classes in of_role.items():
        different = set(classes.values())
        found |= {role: different.pop()} if len(different) == 1 else classes
    # A log made by hand may lack it.
    return {f"ecu {who}": spec for who, spec in found.items() if spec}


def _own_times(plan: Plan, outcomes: Sequence[Outcome]) -> set[tuple[str, int]]:
    """Bus and identifier of the wall-clock figures that the ECUs run again sent then."""
    again = {outcome.name for outcome in outcomes}
    return {
        (topic.bus, can_id)
        for slot in plan.slots
        if slot.name in again
        for topic in slot.sends(plan.codecs)
        if plan.codecs[topic.bus].is_wall_clock(can_id := plan.codecs[topic.bus].can_id(topic.message))
    }


def _inputs(plan: Plan) -> dict[str, Sequence[Topic]]:
    """The inputs of each ECU, which its frames wait for on the wire."""
    found: dict[str, Sequence[Topic]] = {}
    for slot in plan.slots:
        ecu = load_class(plan.specs[slot.name])(slot.vehicle, plan.run.scenario)
        found[slot.name] = tuple(ecu.inputs)
    return found


def _changes(outcomes: Sequence[Outcome]) -> dict[int, list[Pair]]:
    """The changes, by cycle."""
    changes: dict[int, list[Pair]] = defaultdict(list)
    for outcome in outcomes:
        for cycle, pairs in outcome.changes.items():
            changes[cycle] += pairs
    return changes


def _frames(
    run: Run, changes: Mapping[int, list[Pair]], left_out: Collection[tuple[str, int]], writer: RunWriter
) -> Iterator[_Writing]:
    for old in run.frames():
        for frame in _changed(old, changes.get(old.time_ns // CYCLE_NS, [])):
            if (frame.bus, frame.can_id) in left_out:
                continue
            put = partial(writer.frame, frame.bus, frame.time_ns, frame.can_id, frame.data, frame.receive_ns)
            yield frame.time_ns, _FRAMES, put


def _changed(frame: Frame, pairs: list[Pair]) -> Iterator[Frame]:
    """Yield what replaces a frame; the pairs used are removed from `pairs`."""
    kept = True
    for pair in [pair for pair in pairs if pair.bus == frame.bus]:
        if pair.logged is None and pair.sent is not None:
            # At once, because the cycle has at least a BenchSync on this bus.
            pairs.remove(pair)
            yield frame._replace(can_id=pair.can_id, data=pair.sent)
        elif kept and (pair.can_id, pair.logged) == (frame.can_id, frame.data):
            pairs.remove(pair)
            kept = False
            if pair.sent is not None:
                yield frame._replace(data=pair.sent)
    if kept:
        yield frame


def _truth(run: Run, vehicle: int, names: Sequence[str], writer: RunWriter) -> Iterator[_Writing]:
    columns = run.truth(vehicle)
    rows = np.column_stack([columns[name] for name in names])
    for time_ns, row in zip(columns.time_ns.tolist(), rows, strict=True):
        yield time_ns, _TRUTH, partial(writer.truth, vehicle, time_ns, row)


def _events(run: Run, writer: RunWriter) -> Iterator[_Writing]:
    for event in run.events:
        time_ns = round(event.time_s * 1e9)
        yield time_ns, _EVENTS, partial(writer.event, time_ns, event)
