"""What a log is, at a glance: for `platoon log info`."""

from __future__ import annotations

from dataclasses import dataclass

from bench.record.reader import Run
from bench.record.time_span import NS


@dataclass(frozen=True)
class TopicCount:
    """How much there is of a bus or topic: messages, and how many a second from the first to the last."""

    name: str
    messages: int
    per_s: float | None


@dataclass(frozen=True)
class Overview:
    """What a log is.

    Attributes:
        path: the file.
        bytes: its size.
        start_s, end_s: log_time of the earliest and latest message, None where there is none.
        metadata: of the run, and its result.
        buses: raw frames of each bus.
        topics: all other topics.
        signals: how many signals and true values there are by name.
        events: how many there are of each level.
        attachments: file name -> bytes.
        damage: what is wrong with the file, empty for nothing that has been noticed.
    """

    path: str
    bytes: int
    start_s: float | None
    end_s: float | None
    metadata: dict[str, str]
    buses: list[TopicCount]
    topics: list[TopicCount]
    signals: int
    events: dict[str, int]
    attachments: dict[str, int]
    damage: str


def overview(run: Run) -> Overview:
    """Return what `run` is, by the file's index; of the messages only the events are read.

    Raises:
        BadInput: the events cannot be decoded.
    """
    spans = [span for span in map(run.log.span, run.topics) if span]
    raw = [f"/can/{bus}" for bus in run.buses]
    levels = [event.level for event in run.events]
    return Overview(
        path=str(run.path),
        bytes=run.path.stat().st_size,
        start_s=min(span.start_ns for span in spans) / NS if spans else None,
        end_s=(max(span.end_ns for span in spans) - 1) / NS if spans else None,
        metadata=run.metadata,
        buses=[_count(run, topic, topic.removeprefix("/can/")) for topic in raw],
        topics=[_count(run, topic, topic) for topic in sorted(run.topics) if topic not in raw],
        signals=len(run.names()),
        events={level: levels.count(level) for level in dict.fromkeys(levels)},
        attachments={name: len(data) for name, data in run.attachments.items()},
        damage=run.damage,
    )


def _count(run: Run, topic: str, name: str) -> TopicCount:
    span, messages = run.log.span(topic), run.log.count(topic)
    length_ns = span.end_ns - 1 - span.start_ns if span else 0
    return TopicCount(name, messages, round((messages - 1) * NS / length_ns, 3) if length_ns else None)
