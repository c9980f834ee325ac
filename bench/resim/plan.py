"""Which ECUs of a log to run again, as which class, and notes on the log for the user."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata

from bench.bus.codec import Codec, load_codecs
from bench.bus.network import ROLES, EcuSlot
from bench.conductor.stage import BY_HAND
from bench.cycle import time_of
from bench.ecu.loading import DEFAULT_ECUS, load_classes
from bench.errors import BadInput, RunFailed
from bench.record.reader import Run
from bench.resim.history import History, read_history
from bench.resim.job import Job
from bench.resim.recording import EcuLog, read_buses
from bench.resim.tolerance import parse

_NAME = re.compile(r"veh[1-9][0-9]?\.(planner|tracker)")

RESIMULATED = "resimulated"
"""Entry in the metadata of a log that `bench.resim.rewrite` has written: which ECUs, and as which class."""


@dataclass(frozen=True)
class Plan:
    """What to do with a log.

    Attributes:
        run: the log.
        codecs: codec of every bus.
        jobs: the ECUs, in their order.
        slots: all ECUs of the run.
        specs: class of each of the run's ECUs, by name, also of those that are not run again.
        realtime: whether the wall clock paced the run.
        notes: notes on the log for the user, a sentence each.
    """

    run: Run
    codecs: Mapping[str, Codec]
    jobs: tuple[Job, ...]
    slots: tuple[EcuSlot, ...]
    specs: Mapping[str, str]
    realtime: bool
    notes: tuple[str, ...]


def make_plan(
    run: Run, names: Sequence[str], *, every: bool = False, classes: Sequence[str] = (), tolerances: Sequence[str] = ()
) -> Plan:
    """Decide what to do.

    Args:
        run: the log.
        names: of the ECUs to run again: `veh2.tracker`.
        every: all ECUs of the log.
        classes: other classes for them: `tracker=my.py:Mine`, or without the role where all of `names` have one.
        tolerances: allowed differences of frames, see `bench.resim.tolerance.parse`.

    Raises:
        BadInput: not a run's log, no such ECU or class, or the log was made with a custom class and none is given.
        RunFailed: a named ECU never ran in the log.
    """
    scenario = run.scenario
    vehicles = len(scenario.vehicles)
    codecs = load_codecs(vehicles)
    slots = {slot.name: slot for slot in (EcuSlot(role, n + 1) for n in range(vehicles) for role in ROLES)}
    chosen = _chosen(run, names, slots, every=every)
    given = _given_classes(classes, chosen)
    specs = {name: given.get(slot.role, DEFAULT_ECUS[slot.role]) for name, slot in slots.items()}
    notes = [note for slot in chosen if (note := _class_note(run, slot, given))]
    sent = [topic for slot in chosen for topic in slot.sends(codecs)]
    tolerance = parse(tolerances, {topic.message: codecs[topic.bus] for topic in sent})
    history = read_history(run)
    load_classes(dict.fromkeys(specs[slot.name] for slot in chosen))
    buses = read_buses(run, codecs, scenario.cycles)
    completed = run.result.get("status") == "completed"
    cycles = scenario.cycles if completed else None
    jobs = []
    for slot in chosen:
        ended = history.ended.get(slot.name)
        log = EcuLog(slot, buses, codecs, history.faults, cycles=cycles, until=ended)
        jobs.append(Job(log, specs[slot.name], scenario, history.faults, tolerance))
    realtime = any(job.log.realtime for job in jobs)
    notes += _notes(run, codecs, history, jobs, realtime=realtime)
    return Plan(run, codecs, tuple(jobs), tuple(slots.values()), specs, realtime, tuple(notes))


def class_in(run: Run, slot: EcuSlot) -> str:
    """Return the ECU's class in the run according to the metadata; empty if unknown.

    An entry `ecu veh2.tracker` takes precedence over that of all trackers, `ecu tracker`.
    """
    return run.metadata.get(f"ecu {slot.name}") or run.metadata.get(f"ecu {slot.role}", "")


def _chosen(run: Run, names: Sequence[str], slots: Mapping[str, EcuSlot], *, every: bool) -> list[EcuSlot]:
    for name in names:
        if not _NAME.fullmatch(name):
            raise BadInput(f"--ecu {name}: not an ECU of this log; its ECUs are {', '.join(slots)}")
        if name not in slots:
            raise RunFailed(f"{name} never ran in {run.path}; its ECUs are {', '.join(slots)}")
    if every:
        return list(slots.values())
    if not names:
        raise BadInput(f"give --all, or --ecu with one of {', '.join(slots)}")
    return [slots[name] for name in dict.fromkeys(names)]


def _given_classes(classes: Sequence[str], chosen: Sequence[EcuSlot]) -> dict[str, str]:
    roles = list(dict.fromkeys(slot.role for slot in chosen))
    found = {}
    for text in classes:
        role, equals, spec = text.partition("=")
        if not equals and len(roles) == 1:
            role, spec = roles[0], text
        if role not in roles or not spec:
            raise BadInput(f"--class {text}: write ROLE=CLASS, where ROLE is {' or '.join(roles)}")
        found[role] = spec
    return found


def _class_note(run: Run, slot: EcuSlot, given: Mapping[str, str]) -> str:
    """Note where the class to run differs from the one that ran.

    Raises:
        BadInput: it is a custom class, and none is given.
    """
    own = DEFAULT_ECUS[slot.role]
    ran = class_in(run, slot) or own
    now = given.get(slot.role, own)
    if ran == now:
        return ""
    if slot.role not in given and ran != BY_HAND:
        raise BadInput(
            f"{run.path}: {slot.name} ran as {ran}; give --class {slot.role}={ran} for that one (where the file is "
            f"there and you trust it), or --class {slot.role}={own} for the bench's own"
        )
    how = f"was {BY_HAND}" if ran == BY_HAND else f"ran as {ran}"
    return f"{slot.name} {how}, and is {now} here"


def _notes(
    run: Run, codecs: Mapping[str, Codec], history: History, jobs: Sequence[Job], *, realtime: bool
) -> list[str]:
    notes = []
    if realtime:
        notes.append(
            "a real-time log: in each cycle in which it has a frame of an ECU, that ECU gets what had been received "
            "before that step began; a frame received at that very moment may be misplaced and cause a difference"
        )
    if realtime and RESIMULATED in run.metadata:
        notes.append(
            f"written by resim -o, it does not have the computing times of these ECUs: {run.metadata[RESIMULATED]}; "
            "frames received meanwhile count as their inputs too, which may cause a difference"
        )
    if history.untold:
        notes.append(
            f"{history.untold} faults were injected into the running bench that this log does not hold; from there on "
            "ECUs may send something else because of them"
        )
    if realtime and len(history.faults) > len(run.scenario.faults):
        notes.append(
            "faults were injected into the running bench: in real time each ECU learnt of them at its own time"
        )
    changed = {codec.file_name for bus, codec in codecs.items() if run.dbc(bus) not in (None, codec.dbc)}
    notes += [
        f"{name} has changed since this log was made: the same values may have other bytes" for name in sorted(changed)
    ]
    lost = run.result.get("frames_lost", "0")
    if lost != "0":
        notes.append(f"{lost} frames were lost in this run: their receivers could not react to them")
    cut = min((job.log.end for job in jobs if not job.log.whole), default=None)
    if cut is not None:
        notes.append(f"the log is incomplete: compared up to {time_of(cut):.2f} s")
    failed = {job.name: history.ended[job.name] for job in jobs if job.name in history.ended}
    notes += [
        f"{name} failed in the run, compared up to there: {time_of(cycle):.2f} s" for name, cycle in failed.items()
    ]
    notes += [f"{name} {then} in the log's run, {now} here" for name, then, now in _versions(run) if then != now]
    return notes


def _versions(run: Run) -> list[tuple[str, str, str]]:
    """Name, version in the run and version here of the packages that calculate."""
    found = []
    for name in ("numpy", "clarabel"):
        then = run.metadata.get(f"version {name}")
        if then:
            found.append((name, then, metadata.version(name)))
    return found
