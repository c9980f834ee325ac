"""What two runs were started with, compared: scenario and seed, versions, options, machine.

A different result has its cause here; what the runs did is compared by `bench.record.compare`.
"""

from __future__ import annotations

import hashlib
import json
import re
import shlex
import tomllib
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from bench.errors import BadInput
from bench.label import cleaned, shortened
from bench.names import vehicle_of
from bench.record.label import names_of
from bench.record.reader import Run

SCENARIO, VERSIONS, OPTIONS, MACHINE = GROUPS = ("scenario", "versions", "options", "machine")
"""The groups of settings, in this order."""

NOTHING_DIFFERS = "Nothing differs in scenario, seed, versions, options and machine."

MOST_SHOWN = 60
"""Maximum number of settings that a text or a page lists."""

_LONGEST_VALUE = 200
"""Longer values are cut off in a text."""

_MOST_NAMES = 30

_SEED, _FAULTS, _VEHICLES = "seed", "faults", "vehicles"
_ECU, _VERSION, _RESIM = "ecu ", "version ", "resim"
_SILENT_OPTIONS = {"--out": 1, "--label": 1, "--live-address": 1, "--no-report": 0, "--live": 0}
"""Options of `platoon run` that change nothing of the run, and the number of their values."""

_FMU, _DESCRIPTION = "FMU", "modelDescription.xml"
_OTHERWISE_COMPARED = ("scenario.toml", "command_line.txt")

Facts = Mapping[str, str]
"""Settings of a run by name."""


@dataclass(frozen=True)
class SettingDifference:
    """A setting that differs: its group, its name, and the value of each run as text; None if a run has none."""

    group: str
    name: str
    a: str | None
    b: str | None


@dataclass(frozen=True)
class Settings:
    """The settings of two runs, compared.

    Attributes:
        names: names that tell A from B: labels or files.
        differences: the settings that differ, in the order of `GROUPS`.
        notes: what could not be compared.
        comparable: whether both are logs of runs; else nothing but frames can be compared.
    """

    names: tuple[str, str]
    differences: tuple[SettingDifference, ...]
    notes: tuple[str, ...]
    comparable: bool = True

    def as_dict(self) -> dict[str, Any]:
        """Return the comparison as JSON values."""
        return asdict(self)

    def __str__(self) -> str:
        """Return the comparison as text for a person."""
        lines = [f"{letter}: {name}" for letter, name in zip("AB", self.names, strict=True)]
        if self.differences:
            shown = self.differences[:MOST_SHOWN]
            names = [text_of(each.name) for each in shown]
            width = min(40, max(map(len, names)))
            lines.append("What differs in scenario, versions, options and machine:")
            for each, name in zip(shown, names, strict=True):
                lines.append(f"  {each.group:8}  {name:{width}}  A: {text_of(each.a)}  B: {text_of(each.b)}")
            if len(self.differences) > MOST_SHOWN:
                lines.append(f"  and {len(self.differences) - MOST_SHOWN} more")
        else:
            lines.append(NOTHING_DIFFERS)
        return "\n".join([*lines, *self.notes])


def text_of(value: str | None) -> str:
    """Return a setting's value as one line, at most 200 characters long; a dash if a run has none."""
    return "–" if value is None else shortened(cleaned(value), _LONGEST_VALUE)


def compare_settings(a: Run, b: Run) -> Settings:
    """Return what differs between the settings of two runs; nothing if one log is not from the bench."""
    if not all("run" in run.log.contents.metadata and "scenario" in run.metadata for run in (a, b)):
        return Settings(names_of(a, b), (), ("Only logs of runs tell what they were started with.",), comparable=False)
    found: list[SettingDifference] = []
    notes: list[str] = []
    of_a, of_b = _scenario(a), _scenario(b)
    if of_a is None or of_b is None:
        without = [letter for letter, each in (("A", of_a), ("B", of_b)) if each is None]
        notes.append(f"The scenarios are not compared: {' and '.join(without)} has none that can be read.")
    else:
        found += [
            SettingDifference(SCENARIO, name, *(None if value is _NONE else _toml(value) for value in values))
            for name, *values in _scenario_rows(of_a, of_b)
        ]
    unknown: dict[str, list[str]] = {"A": [], "B": []}
    for group, facts in _FACTS:
        settings = _together(facts(a), facts(b))
        for name in dict.fromkeys([*settings[0], *settings[1]]):
            values = settings[0].get(name), settings[1].get(name)
            if values[0] == values[1]:
                continue
            if None in values and not name.startswith(_RESIM):
                unknown["A" if values[0] is None else "B"].append(name)
            else:
                found.append(SettingDifference(group, name, *values))
    if any(each.name == _FMU for each in found):
        # The GUID stands for the description.
        found = [each for each in found if each.name != _DESCRIPTION]
    notes += [f"Not recorded in {letter}: {_listed(names)}." for letter, names in unknown.items() if names]
    commits = {run.metadata.get("commit", "") for run in (a, b)}
    if len(commits) == 1 and commits.pop().endswith("+"):
        notes.append("Both ran from a checkout with changes since its commit, which may differ.")
    return Settings(names_of(a, b), tuple(found), tuple(notes))


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join(map(text_of, names[:_MOST_NAMES])) + more


# ---- scenario

_NONE = object()
"""In place of the value of a key that a scenario does not have."""

_Row = tuple[str, Any, Any]


def _scenario(run: Run) -> dict[str, Any] | None:
    """Return a run's scenario with all keys, those that are not set as None; None if it has none."""
    try:
        return run.scenario.model_dump(mode="json")
    except BadInput:
        pass
    try:
        # Perhaps by a version with other keys.
        return tomllib.loads(run.scenario_text)
    except (BadInput, ValueError, RecursionError):
        return None


def _scenario_rows(a: dict[str, Any], b: dict[str, Any]) -> Iterator[_Row]:
    a, b = dict(a), dict(b)
    faults = tuple(each.pop(_FAULTS, ()) for each in (a, b))
    vehicles = tuple(each.pop(_VEHICLES, ()) for each in (a, b))
    yield from _rows("", {_SEED: a.pop(_SEED, _NONE)}, {_SEED: b.pop(_SEED, _NONE)})
    yield from _rows("", a, b)
    yield from _rows(_VEHICLES, *(dict(enumerate(each)) for each in vehicles))
    yield from _fault_rows(*faults)


def _rows(path: str, a: Any, b: Any) -> Iterator[_Row]:
    """Yield key and values of what differs, key by key where both are tables."""
    if not (isinstance(a, dict) and isinstance(b, dict)):
        if not _equal(a, b):
            yield path, a, b
        return
    for key in dict.fromkeys([*a, *b]):
        yield from _rows(f"{path}.{key}" if path else str(key), a.get(key, _NONE), b.get(key, _NONE))


def _equal(a: Any, b: Any) -> bool:
    # A key that is not set has no value, and 1 is not True.
    if a in (None, _NONE) or b in (None, _NONE):
        return a in (None, _NONE) and b in (None, _NONE)
    return bool(a == b) and isinstance(a, bool) == isinstance(b, bool)


def _fault_rows(a: Sequence[Any], b: Sequence[Any]) -> Iterator[_Row]:
    """Yield the differences of two lists of faults. Equal ones are paired first, then those of one kind, in order."""
    rest = _unequal(a, b), _unequal(b, a)
    of_kind: dict[str, list[int]] = defaultdict(list)
    for index in reversed(rest[1]):
        of_kind[_kind(b[index])].append(index)
    paired = {index: of_kind[_kind(a[index])].pop() for index in rest[0] if of_kind[_kind(a[index])]}
    for index in rest[0]:
        name = f"{_FAULTS}.{index}"
        if index not in paired:
            yield name, a[index], _NONE
            continue
        other = paired[index]
        name += f" ({_kind(a[index])})" if index == other else f" ({_kind(a[index])}; {_FAULTS}.{other} in B)"
        yield from ((f"{name} {key}", *values) for key, *values in _rows("", a[index], b[other]))
    others = set(paired.values())
    yield from ((f"{_FAULTS}.{index}", _NONE, b[index]) for index in rest[1] if index not in others)
    if not any(rest) and list(a) != list(b):
        # The order seeds their random numbers.
        yield f"{_FAULTS}, order", [_kind(fault) for fault in a], [_kind(fault) for fault in b]


def _kind(fault: Any) -> str:
    return str(fault.get("kind", "")) if isinstance(fault, dict) else ""


def _unequal(own: Sequence[Any], others: Sequence[Any]) -> list[int]:
    """Return the indices of the items that have no equal among the others."""
    left: dict[str, int] = defaultdict(int)
    for item in others:
        left[_canonical(item)] += 1
    found = []
    for index, item in enumerate(own):
        text = _canonical(item)
        left[text] -= 1
        if left[text] < 0:
            found.append(index)
    return found


def _canonical(value: Any) -> str:
    return json.dumps(value, sort_keys=True, default=str)


def _toml(value: Any) -> str:
    """Return a value as in a scenario; what is not set within it is left out."""
    if value is None:
        return "not set"
    if isinstance(value, dict):
        kind_first = sorted(value.items(), key=lambda item: item[0] != "kind")
        items = (f"{key} = {_toml(each)}" for key, each in kind_first if each is not None)
        return f"{{{', '.join(items)}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(value, ensure_ascii=False, default=str)


# ---- versions, options, machine


def _versions(run: Run) -> dict[str, str]:
    facts = {name: run.metadata.get(name, "") for name in ("commit", "python", "code")}
    facts[_FMU] = run.metadata.get("fmu_guid", "")
    facts |= {name.removeprefix(_VERSION): text for name, text in run.metadata.items() if name.startswith(_VERSION)}
    for name, data in run.attachments.items():
        if name not in _OTHERWISE_COMPARED:
            facts[name] = f"sha256 {hashlib.sha256(data).hexdigest()[:16]}"
    return {name: text for name, text in facts.items() if text}


def _options(run: Run) -> dict[str, str]:
    # On one host a port makes no difference, and most are chosen by the bench.
    facts = {"buses": re.sub(r"\budp:\d+(?!\d*@)", "udp", run.metadata.get("buses", ""))}
    facts["clock"] = run.metadata.get("clock", "")
    facts |= {name: text for name, text in run.metadata.items() if name.startswith((_ECU, _RESIM))}
    facts["command"] = _command(run.metadata.get("command_line", ""))
    return {name: text for name, text in facts.items() if text}


def _machine(run: Run) -> dict[str, str]:
    return {name: run.metadata[name] for name in ("host", "platform") if run.metadata.get(name)}


_FACTS: tuple[tuple[str, Callable[[Run], dict[str, str]]], ...] = (
    (VERSIONS, _versions),
    (OPTIONS, _options),
    (MACHINE, _machine),
)


def _command(line: str) -> str:
    """Return a command line without the options that do not change the run."""
    try:
        words = shlex.split(line)
    except ValueError:
        return line
    kept, skipped = [], 0
    for word in words:
        option, equals, _ = word.partition("=")
        if skipped:
            skipped -= 1
        elif option in _SILENT_OPTIONS:
            skipped = 0 if equals else _SILENT_OPTIONS[option]
        else:
            kept.append(word)
    return shlex.join(kept)


def _together(a: dict[str, str], b: dict[str, str]) -> tuple[Facts, Facts]:
    """Return both with the class of each ECU's role named for each ECU where one of them has several classes."""
    names = [name.removeprefix(_ECU) for name in {**a, **b} if name.startswith(_ECU)]
    for name in names:
        role = name.partition(".")[2]
        if vehicle_of(name) is None or not role:
            continue
        for facts in (a, b):
            if f"{_ECU}{role}" in facts:
                facts.setdefault(f"{_ECU}{name}", facts[f"{_ECU}{role}"])
    roles = {name.partition(".")[2] for name in names if "." in name}
    # A role that only one log names as such has its ECUs compared one by one.
    drop = {f"{_ECU}{role}" for role in roles if (f"{_ECU}{role}" in a) != (f"{_ECU}{role}" in b)}
    return tuple({name: text for name, text in facts.items() if name not in drop} for facts in (a, b))  # type: ignore[return-value]
