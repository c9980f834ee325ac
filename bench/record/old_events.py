"""Kind and fields of events in older logs, which have neither: parsed from their texts as written then.

The patterns match the old texts and do not change with `bench.events`.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from bench import events
from bench.names import CONDUCTOR

Found = tuple[str, Mapping[str, Any]]
"""Kind and fields."""

_PARAMETER = re.compile(r"(\w+) (\{.*?\}|[^,]+)(?:, |$)")


def kind_and_fields(level: str, source: str, text: str) -> Found:
    """Return kind and fields of an old log's event; `events.OTHER` without fields if its text is not recognised."""
    if (level, source) == ("fatal", CONDUCTOR):
        status = "interrupted" if text.startswith("interrupted by ") else "failed"
        return _of(events.RunEnded(status, text))
    named = source in _TEXTS
    for pattern, made in _TEXTS[source if named else ""]:
        if found := re.fullmatch(pattern, text, re.DOTALL):
            with suppress(ValueError):
                return _of(made(found, source, level))
    return (events.OTHER, {}) if named or level != "warning" else _of(events.ProcessOutput(source, text))


def _of(event: events.Event) -> Found:
    return event.kind, event.fields


def _parameters(text: str | None) -> dict[str, Any]:
    return {name: _value(value) for name, value in _PARAMETER.findall(text or "")}


def _value(text: str) -> Any:
    with suppress(ValueError, SyntaxError):
        return ast.literal_eval(text)
    return text


def _number(text: str | None) -> float | None:
    return None if text is None else float(text)


def _whole(text: str | None) -> int | None:
    return None if text is None else int(text)


_Made = Callable[[re.Match[str], str, str], events.Event]

_TEXTS: dict[str, tuple[tuple[str, _Made], ...]] = {
    events.FAULT: (
        (
            r"(\w+)(?:: (.*))? begins, until (?:the end|(\S+) s)",
            lambda found, *_: events.FaultBegins(found[1], _parameters(found[2]), _number(found[3])),
        ),
        (r"(\w+)(?:: (.*))? ends", lambda found, *_: events.FaultEnds(found[1], _parameters(found[2]))),
    ),
    CONDUCTOR: (
        (r"asked for while running: (\{.*\})", lambda found, *_: events.FaultRequested(json.loads(found[1]))),
        (r"(.*); the run goes on without (.*)", lambda found, *_: events.EcuFailed(found[2].split(", "), found[1])),
        (
            r"frame 0x([0-9A-F]+) on (\S+) is not due in the cycle it came in, or came twice",
            lambda found, *_: events.StrayFrame(found[2], int(found[1], 16)),
        ),
        (
            r"(no )?SCHED_FIFO.*, (?:(each on a core of its own)|(\d+) processes share (\d+) cores)",
            lambda found, *_: events.Scheduling(not found[1], bool(found[2]), _whole(found[3]), _whole(found[4])),
        ),
        (
            r"the host of this virtual machine took (\S+) s of processor time from it meanwhile",
            lambda found, *_: events.StolenTime(float(found[1])),
        ),
    ),
    events.BUS: (
        (
            r"bus (?P<bus>\S+): in the worst case (?P<message>\S+) \(0x(?P<id>[0-9A-F]+)\) takes "
            r"(?:without bound|up to (?P<response>\S+) ms) at (?P<rate>\S+) kbit/s, "
            r"longer than its period of (?P<period>\S+) ms",
            lambda found, *_: events.ResponseBeyondPeriod(
                found["bus"],
                found["message"],
                int(found["id"], 16),
                _number(found["response"]),
                float(found["period"]),
                round(1000 * float(found["rate"])),
            ),
        ),
    ),
    "": (
        (
            r"(init|run|degraded|safe|wait|active|hold|\d+) -> (init|run|degraded|safe|wait|active|hold|\d+)"
            r"(?: \((\w+)\))?",
            lambda found, source, level: events.StateChange(level, source, found[1], found[2], found[3] or ""),
        ),
        (
            r"(\w+): FramesLost (\d+), E2EErrors (\d+)",
            lambda found, source, _: events.ReceptionErrors(source, found[1], int(found[2]), int(found[3])),
        ),
        (
            r"missed its deadline: (?:sent nothing|was (\S+) ms late)",
            lambda found, source, _: events.DeadlineMissed(source, _number(found[1])),
        ),
        (
            r"in time again after (\d+) missed deadlines",
            lambda found, source, _: events.DeadlineMet(source, int(found[1])),
        ),
    ),
}
"""What each source says, as pattern and what it stands for; under the empty name what ECUs, processes and buses say."""
