"""Writes a clean log from everything intact in a damaged one, and reports what was lost.

It copies every chunk with a valid checksum, message by message; attachments with a valid checksum; metadata, schemas
and channels. The new file has its own summary. It needs memory for one chunk and the attachments.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench.errors import BadInput
from bench.files import check_new, written_aside
from bench.mcap.container import McapFile, media_type
from bench.mcap.records import INDEX_ENTRY, MESSAGE, MESSAGE_FIELDS, Records
from bench.mcap.recovered import METADATA, Recovery
from bench.mcap.scan import ScannedFile, message_heads
from bench.mcap.time_span import NS

# Where a message record has the id of its channel, two bytes.
_CHANNEL_AT = sum(MESSAGE[name].itemsize for name in ("opcode", "length"))


@dataclass
class Recovered:
    """The result of a recovery.

    Attributes:
        messages: messages copied, by topic.
        start_ns, end_ns: log_time of the earliest and the latest of them; None without any.
        damaged: the damage in the file, a sentence each.
        cut_off: whether the log is truncated, so that its last half second may never have been written.
    """

    messages: Counter[str] = field(default_factory=Counter)
    start_ns: int | None = None
    end_ns: int | None = None
    damaged: list[str] = field(default_factory=list)
    cut_off: bool = False

    @property
    def summary(self) -> str:
        """The amount copied, in a few words."""
        messages = f"{sum(self.messages.values())} messages of {len(self.messages)} topics"
        if self.start_ns is None or self.end_ns is None:
            return messages
        return f"{messages}, from {self.start_ns / NS:.3f} s to {self.end_ns / NS:.3f} s"

    @property
    def lost(self) -> list[str]:
        """What was lost, a sentence each; empty if nothing."""
        if not self.cut_off:
            return self.damaged
        end = "before the first message" if self.end_ns is None else f"at {self.end_ns / NS:.3f} s"
        unwritten = "at most half a second, which the recorder had not yet written, is missing"
        return [*self.damaged, f"the log is truncated: it ends {end}; {unwritten}"]


def recover(source: Path, target: Path) -> Recovered:
    """Write everything intact in `source` to the new file `target`.

    Raises:
        BadInput: the log cannot be read or has nothing intact, or the file cannot be written or is there
            already.
    """
    check_new(target, ".mcap")
    file = ScannedFile(source)
    contents = file.contents
    if not (len(contents.chunks) or contents.metadata or contents.attachments):
        raise BadInput(f"{source} has nothing intact: there is nothing to recover")
    done = Recovered(damaged=_lost_in_between(file), cut_off=file.walked is not None and not file.walked.ended)
    with written_aside(target, new=True) as path, path.open("xb") as stream:
        out = McapFile(stream, "platoon")
        for name, values in contents.metadata.items():
            if name not in ("result", METADATA):
                out.add_metadata(name, values)
        for name, data in contents.attachments.items():
            out.add_attachment(name, media_type(name), data)
        _Copier(file, out, done).copy()
        if "result" in contents.metadata:
            out.add_metadata("result", contents.metadata["result"])
        before = Recovery.of(contents.metadata)
        if done.lost or before:
            # What an earlier recovery of the source lost is still missing.
            lost = [*(before.lost if before else ()), *done.lost]
            origin = before.source if before and not done.lost else source.name
            out.add_metadata(METADATA, Recovery(origin, lost).values)
        out.finish()
    return done


def _lost_in_between(file: ScannedFile) -> list[str]:
    if file.walked is None:
        return []
    found = []
    for start, end in file.walked.lost:
        where = "at its end" if end == file.size else f"from byte {start} on"
        if end > start:
            found.append(f"{end - start} bytes {where} are not a complete record")
    return found + file.walked.damaged


class _Copier:
    """Copies the messages of a log, chunk by chunk."""

    def __init__(self, file: ScannedFile, out: McapFile, done: Recovered) -> None:
        self._file = file
        self._out = out
        self._done = done
        self._topics: dict[int, str] = {}
        self._numbers: dict[int, int] = {}
        schemas = {
            number: out.add_schema(schema.name, schema.data, schema.encoding)
            for number, schema in sorted(file.contents.schemas.items())
        }
        # In their order, which is that of the buses.
        for number, channel in sorted(file.contents.channels.items()):
            if channel.schema_id == 0 or channel.schema_id in schemas:
                schema = schemas.get(channel.schema_id, 0)
                encoding = channel.message_encoding
                self._numbers[number] = out.add_channel(channel.topic, schema, channel.metadata, encoding)
                self._topics[number] = channel.topic

    def copy(self) -> None:
        nameless = 0
        for number in range(len(self._file.contents.chunks)):
            data = self._file.chunk(number)
            if data is None:
                self._done.damaged.append(self._lost_chunk(number))
                continue
            offsets = self._file.messages(number, data)
            known = [at for channel, at in offsets.items() if channel in self._numbers]
            nameless += sum(map(len, offsets.values())) - sum(map(len, known))
            nameless += self._add(data, np.sort(np.concatenate([np.empty(0, np.int64), *known])))
        if nameless:
            self._done.damaged.append(f"{nameless} messages have an unknown topic or time")

    def _add(self, data: npt.NDArray[np.uint8], offsets: npt.NDArray[np.int64]) -> int:
        """Write the messages at `offsets` as a chunk; return how many were skipped because they have no valid time."""
        heads = message_heads(data, offsets)
        timed = heads["log_time"] < np.uint64(1 << 63)
        heads, offsets = heads[timed], offsets[timed]
        if len(offsets):
            records = self._renumbered(data, offsets, heads)
            self._out.add_chunk(records.data.data, records.channel, records.log_time, records.offset)
            self._note(heads)
        return int((~timed).sum())

    def _renumbered(
        self, data: npt.NDArray[np.uint8], offsets: npt.NDArray[np.int64], heads: npt.NDArray[np.void]
    ) -> Records:
        sizes = heads["length"].astype(np.int64) + (MESSAGE.itemsize - MESSAGE_FIELDS)
        ends = offsets + sizes
        parts = [data[start:end] for start, end in zip(offsets.tolist(), ends.tolist(), strict=True)]
        records = np.concatenate(parts)
        places = np.cumsum(sizes) - sizes
        channel = np.array([self._numbers[number] for number in heads["channel"].tolist()], np.int64)
        at = places + _CHANNEL_AT
        records[at], records[at + 1] = channel & 0xFF, channel >> 8
        return Records(records, channel, heads["log_time"].astype(np.int64), places)

    def _note(self, heads: npt.NDArray[np.void]) -> None:
        done = self._done
        for number, count in zip(*np.unique(heads["channel"], return_counts=True), strict=True):
            done.messages[self._topics[int(number)]] += int(count)
        first, last = int(heads["log_time"].min()), int(heads["log_time"].max())
        done.start_ns = first if done.start_ns is None else min(done.start_ns, first)
        done.end_ns = last if done.end_ns is None else max(done.end_ns, last)

    def _lost_chunk(self, number: int) -> str:
        chunks = self._file.contents.chunks
        start_ns, end_ns = chunks.places[["start_ns", "end_ns"]][number].tolist()
        topics = []
        for at, channel in chunks.indexes_of(number)[["at", "channel"]].tolist():
            entries = self._file.entries(at, channel)
            if entries is not None and channel in self._topics:
                topics.append((self._topics[channel], len(entries) // INDEX_ENTRY.itemsize))
        count = sum(messages for _, messages in topics)
        what = f", {count} messages of {_short([topic for topic, _ in topics])}," if count else ""
        return f"a chunk{what} from {start_ns / NS:.3f} s to {end_ns / NS:.3f} s is damaged"


def _short(topics: list[str]) -> str:
    most = 3
    return ", ".join(topics[:most]) + (f" and {len(topics) - most} more topics" if len(topics) > most else "")
