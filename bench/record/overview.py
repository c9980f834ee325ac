"""What a log is, at a glance: for `platoon log info`."""

from __future__ import annotations

from dataclasses import dataclass

from bench.mcap.recovered import Recovery
from bench.mcap.time_span import NS, Span
from bench.record.reader import Run


@dataclass(frozen=True)
class TopicCount:
    """How much there is of a bus or topic: messages, and how many a second of the log's time."""

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
        status: how the run ended, empty for a log that is not of the bench.
        recovered: for a log that `platoon log recover` made, what from and what was lost; else None.
        metadata: of the run, and its result.
        buses: raw frames of each bus.
        topics: all other topics.
        signals: how many signals and true values there are by name.
        events: how many there are of each level.
        attachments: file name -> bytes.
        damage: what is wrong with the file, empty for a whole one.
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
    attachments: dict[str, int]
    damage: str


def overview(run: Run) -> Overview:
    """Return what `run` is, by the file's index, and check all of its chunks; of the messages only events are decoded.

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
        topics=[_count(run, topic, topic, whole) for topic in sorted(run.topics) if topic not in raw],
        signals=len(run.names()),
        events={level: levels.count(level) for level in dict.fromkeys(levels)},
        attachments={name: len(data) for name, data in run.attachments.items()},
        damage=run.damage,
    )


def _count(run: Run, topic: str, name: str, whole: Span | None) -> TopicCount:
    messages = run.log.count(topic)
    # From a first message at the log's beginning to a last one at its end there is one interval less than messages.
    length_ns = whole.end_ns - 1 - whole.start_ns if whole else 0
    return TopicCount(name, messages, round((messages - 1) * NS / length_ns, 3) if length_ns and messages > 1 else None)
