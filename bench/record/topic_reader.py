"""A log's topics, whoever wrote it: what they are, and their messages as columns."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mcap.records import Channel

from bench.errors import BadInput
from bench.mcap.blocks import Part, blocks
from bench.mcap.container import INDEX_ENTRY
from bench.mcap.scan import ScannedFile
from bench.mcap.time_span import ALL, NS, Span
from bench.record.columns import Columns
from bench.record.topic_decoder import TopicDecoder

_NAMED = 12
"""Topics that a message names at most."""

_TOLD = 3
"""Damaged chunks that `TopicReader.damage` names at most, so that it stays a line."""


class LogDamaged(UserWarning):
    """A log is cut off or damaged; what could be read was."""


class TopicReader:
    """A log open for reading.

    Attributes:
        path: the file.
        contents: what is in it beside messages.
        topics: topic -> channel, of everything that was recorded.
    """

    def __init__(self, path: Path) -> None:
        """Open a log, and warn where it is damaged.

        Raises:
            BadInput: the file cannot be read or is not a log.
        """
        self.path = path
        self._file = ScannedFile(path)
        self.contents = self._file.contents
        self.topics: dict[str, Channel] = {channel.topic: channel for channel in self.contents.channels.values()}
        self._left_out: dict[int, str] = {}
        self._decoders: dict[str, TopicDecoder] = {}
        if self.contents.damage:
            # Only one warning is given, so it must hold for what is met later, too.
            self._warn(f"{self.contents.damage}; any chunk that is damaged is left out: platoon log recover lists all")

    @property
    def damage(self) -> str:
        """What is wrong with the file, so far as it has been read; empty for a whole one."""
        chunks = [f"a chunk {time} is damaged and left out" for time in self._left_out.values()]
        more = f"{len(chunks) - _TOLD} more chunks are damaged and left out" if len(chunks) > _TOLD else ""
        return "; ".join(filter(None, [self.contents.damage, *chunks[:_TOLD], more]))

    def check_chunks(self) -> None:
        """Read every chunk, so that `damage` tells of all that its checksum does not prove."""
        for number in range(len(self.contents.chunks)):
            if self._file.chunk(number) is None:
                self._note_damage(number)

    def channel(self, topic: str) -> Channel:
        """Return the channel of a topic.

        Raises:
            BadInput: it was not recorded.
        """
        try:
            return self.topics[topic]
        except KeyError:
            known = self._near(topic) or sorted(self.topics)
            more = f" and {len(known) - _NAMED} more" if len(known) > _NAMED else ""
            have = f"{', '.join(known[:_NAMED])}{more}" if known else "nothing"
            raise BadInput(f"{self.path} has no topic {topic}; recorded are {have}") from None

    def _near(self, topic: str) -> list[str]:
        """Return the topics that stand where `topic` would, those that are most like it first."""
        beside = sorted(name for name in self.topics if name.startswith(topic.rpartition("/")[0]))
        like = difflib.SequenceMatcher(b=topic.lower())
        ratios = {}
        for name in beside:
            like.set_seq1(name.lower())
            ratios[name] = like.ratio()
        return sorted(beside, key=lambda name: -ratios[name])

    def decoder(self, topic: str) -> TopicDecoder:
        """Return what decodes the messages of a topic.

        Raises:
            BadInput: the topic was not recorded, or has no schema that can be read.
        """
        if topic not in self._decoders:
            channel = self.channel(topic)
            schema = self.contents.schemas.get(channel.schema_id)
            self._decoders[topic] = TopicDecoder(str(self.path), channel, schema)
        return self._decoders[topic]

    def parts(self, topics: Sequence[str], span: Span = ALL) -> Iterator[list[tuple[str, Part]]]:
        """Give the messages of some topics, in pieces that stand together in the file, each by topic.

        Raises:
            BadInput: a topic was not recorded.
        """
        by_channel = {self.channel(topic).id: topic for topic in topics}
        numbers = self.contents.chunks.having(list(by_channel), span)
        for block in blocks(self._file, list(by_channel), numbers, self._note_damage):
            parts = [(by_channel[channel], part.within(span)) for channel, part in block.items()]
            found = [(topic, part) for topic, part in parts if len(part.offsets)]
            if found:
                yield found

    def tables(self, topics: Sequence[str], span: Span = ALL) -> dict[str, Columns]:
        """Return the values of several topics with one pass over the file.

        Raises:
            BadInput: a topic was not recorded, or a message cannot be decoded.
        """
        found: dict[str, list[tuple[npt.NDArray[np.int64], dict[str, npt.NDArray[Any]]]]]
        found = {topic: [] for topic in topics}
        for group in self.parts(topics, span):
            for topic, part in group:
                found[topic].append((part.time_ns, self.decoder(topic).columns(part)))
        return {topic: self._joined(topic, parts) for topic, parts in found.items()}

    def may_have(self, topics: Sequence[str], span: Span) -> bool:
        """Return whether there is anything to read of some topics in a span of time."""
        return bool(self.contents.chunks.having([self.channel(topic).id for topic in topics], span))

    def count(self, topic: str) -> int:
        """Return how many messages a topic has, as the file's index tells."""
        return self.contents.counts.get(self.channel(topic).id, 0)

    def span(self, topic: str) -> Span | None:
        """Return the span that the messages of a topic fill, as the file's index tells; None where there is none."""
        number = self.channel(topic).id
        chunks, indexes = self.contents.chunks, self.contents.chunks.indexes(self.channel(topic).id)
        if not len(indexes):
            return None
        places = chunks.places[indexes["chunk"]]
        ends = int(np.argmin(places["start_ns"])), int(np.argmax(places["end_ns"]))
        parts = [self._file.entries(int(indexes["at"][end]), number) or b"" for end in ends]
        times = np.frombuffer(b"".join(parts), INDEX_ENTRY)["log_time"]
        return Span(int(times.min()), int(times.max()) + 1) if len(times) else None

    def start_of_last_before(self, topics: Sequence[str], time_ns: int) -> int:
        """Return from when on to read so as to have, for each topic, a message before `time_ns`, if it has any."""
        chunks = self.contents.chunks
        start = time_ns
        for topic in topics:
            starts = chunks.places["start_ns"][chunks.indexes(self.channel(topic).id)["chunk"]]
            before = starts[starts < time_ns]
            if len(before):
                start = min(start, int(before.max()))
        return start

    def _joined(
        self, topic: str, parts: Sequence[tuple[npt.NDArray[np.int64], dict[str, npt.NDArray[Any]]]]
    ) -> Columns:
        columns = {"t": np.concatenate([np.empty(0, np.int64), *(times for times, _ in parts)]) / NS}
        for name in self.decoder(topic).names:
            none = np.empty(0, self.decoder(topic).dtypes[name])
            # Each part of a column is given up as soon as the whole is there.
            columns[name] = np.concatenate([part.pop(name) for _, part in parts]) if parts else none
        return Columns(f"{self.path}: topic {topic}", columns)

    def _note_damage(self, number: int) -> None:
        if number in self._left_out:
            return
        is_first = not self.damage
        start_ns, end_ns = self.contents.chunks.places[["start_ns", "end_ns"]][number].tolist()
        self._left_out[number] = f"from {start_ns / NS:.3f} s to {end_ns / NS:.3f} s"
        if is_first:
            self._warn(f"{self.damage}; there may be more: platoon log recover lists all")

    def _warn(self, what: str) -> None:
        # Of whoever opens the log or reads from it.
        warnings.warn(f"{self.path}: {what}", LogDamaged, stacklevel=4)
