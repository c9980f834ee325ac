"""Summary of a log, for `platoon log info`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from bench.events import CauseChange, ProcessOutput, StateChange
from bench.mcap.recovered import Recovery
from bench.mcap.time_span import NS, Span
from bench.record.event import Event
from bench.record.reader import Run


@dataclass(frozen=True)
class TopicCount:
    """Messages of a bus or topic: their number, and their rate per second of the log's time."""

    name: str
    messages: int
    per_s: float | None


@dataclass(frozen=True)
class Noticed:
    """A cause that an ECU reported: when first (s), and how many times it became the most serious one."""

    cause: str
    first_s: float
    times: int


@dataclass(frozen=True)
class Output:
    """What a process has written: the line that says most, the last one of a traceback, and the number of lines."""

    last: str
    lines: int


@dataclass(frozen=True)
class Overview:
    """Summary of a log.

    Attributes:
        path: the file.
        bytes: its size.
        start_s, end_s: log_time of the earliest and latest message, None if there are none.
        status: status of the run, empty for a log that is not from the bench.
        recovered: for a log made by `platoon log recover`, its source and losses; else None.
        metadata: of the run, and its result.
        buses: raw frames of each bus.
        topics: all other topics.
        signals: number of signals and true values by name.
        events: number of events of each level.
        causes: ECU -> the causes that it reported once it had started, in the order of their first times. In logs
            of older versions only those with which its state changed.
        outputs: process -> what it has written to its standard output or error.
        attachments: file name -> bytes.
        damage: damage of the file, empty if intact.
    """

    path: str
    bytes: int
    start_s: float | None
    end_s: float | None
    status: str
    recovered: Recovery | None
    metadata: dict[str, str]
    buses: list[TopicCount]
    topics: list[TopicCount]
    signals: int
    events: dict[str, int]
    causes: dict[str, list[Noticed]]
    outputs: dict[str, Output]
    attachments: dict[str, int]
    damage: str


def overview(run: Run) -> Overview:
    """Return the summary of `run` from the file's index, and check all of its chunks; only events are decoded.

    Raises:
        BadInput: the events cannot be decoded.
    """
    run.log.check_chunks()
    spans = [span for span in map(run.log.span, run.topics) if span]
    whole = Span(min(span.start_ns for span in spans), max(span.end_ns for span in spans)) if spans else None
    raw = [f"/can/{bus}" for bus in run.buses]
    levels = [event.level for event in run.events]
    recovered = Recovery.of(run.log.contents.metadata)
    unfinished = f"unfinished (cut off{'' if recovered else ' or still written'})"
    is_run = "run" in run.log.contents.metadata
    return Overview(
        path=str(run.path),
        bytes=run.path.stat().st_size,
        start_s=whole.start_ns / NS if whole else None,
        end_s=(whole.end_ns - 1) / NS if whole else None,
        status=run.metadata.get("status", unfinished if is_run else ""),
        recovered=recovered,
        metadata=run.metadata,
        buses=[_count(run, topic, topic.removeprefix("/can/"), whole) for topic in raw],
        topics=[_count(run, topic, topic, whole) for topic in sorted(run.topics.keys() - set(raw))],
        signals=len(run.names()),
        events={level: levels.count(level) for level in dict.fromkeys(levels)},
        causes=_causes(run.events),
        outputs=_outputs(run.events),
        attachments={name: len(data) for name, data in run.attachments.items()},
        damage=run.damage,
    )


def _causes(events: Iterable[Event]) -> dict[str, list[Noticed]]:
    found: dict[str, dict[str, Noticed]] = {}
    for event in events:
        cause = event.fields.get("cause")
        if event.kind not in (StateChange.kind, CauseChange.kind) or event.level == "info":
            continue
        if cause and isinstance(cause, str) and cause != event.fields.get("cause_before"):
            own = found.setdefault(event.source, {})
            before = own.get(cause, Noticed(cause, event.time_s, 0))
            own[cause] = replace(before, times=before.times + 1)
    return {ecu: list(found[ecu].values()) for ecu in sorted(found)}


def _outputs(events: Iterable[Event]) -> dict[str, Output]:
    texts: dict[str, list[str]] = {}
    for event in events:
        output = event.fields.get("output")
        if event.kind == ProcessOutput.kind and isinstance(output, str):
            # A traceback may come in several pieces.
            texts.setdefault(event.source, []).append(output)
    found = {}
    for name, pieces in sorted(texts.items()):
        lines = [line.rstrip() for line in "".join(pieces).splitlines() if line.strip()]
        # Lines of a traceback before its last, and what we say of calls after an error, are indented.
        plain = [line for line in lines if not line[0].isspace()]
        if lines:
            found[name] = Output((plain or lines)[-1].strip(), len(lines))
    return found


def _count(run: Run, topic: str, name: str, whole: Span | None) -> TopicCount:
    messages = run.log.count(topic)
    # Between the first and last messages there is one interval fewer than messages.
    length_ns = whole.end_ns - 1 - whole.start_ns if whole else 0
    return TopicCount(name, messages, round((messages - 1) * NS / length_ns, 3) if length_ns and messages > 1 else None)
