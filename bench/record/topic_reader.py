"""The topics of any MCAP log, and their messages as columns."""

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
from bench.mcap.records import INDEX_ENTRY
from bench.mcap.scan import ScannedFile
from bench.mcap.time_span import ALL, NS, Span
from bench.record.columns import Columns
from bench.record.topic_decoder import TopicDecoder

_NAMED = 12
"""Maximum number of topics named in a message."""

_COMPARED = 1000
"""Maximum number of topics compared with a wrong one."""

_TOLD = 3
"""Maximum number of damaged chunks named in `TopicReader.damage`, so that it stays one line."""


class LogDamaged(UserWarning):
    """A log is truncated or damaged; its readable part was read."""


class TopicReader:
    """A log open for reading.

    Attributes:
        path: the file.
        contents: its contents other than messages.
        topics: topic -> channel, of all recorded topics.
    """

    def __init__(self, path: Path) -> None:
        """Open a log, and warn if it is damaged.

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
            # There is only one warning, so it must also cover damage found later.
            self._warn(f"{self.contents.damage}; any chunk that is damaged is left out: platoon log recover lists all")

    @property
    def damage(self) -> str:
        """Damage found in the file as far as it has been read; empty if intact."""
        chunks = [f"a chunk {time} is damaged and left out" for time in self._left_out.values()]
        more = f"{len(chunks) - _TOLD} more chunks are damaged and left out" if len(chunks) > _TOLD else ""
        return "; ".join(filter(None, [self.contents.damage, *chunks[:_TOLD], more]))

    def check_chunks(self) -> None:
        """Read every chunk, so that `damage` lists all chunks with a wrong checksum."""
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
        """Return the topics of the same kind as `topic`, most similar first."""
        beside = sorted(name for name in self.topics if name.startswith(topic.rpartition("/")[0]))[:_COMPARED]
        like = difflib.SequenceMatcher(b=topic.lower())
        ratios = {}
        for name in beside:
            like.set_seq1(name.lower())
            ratios[name] = like.ratio()
        return sorted(beside, key=lambda name: -ratios[name])

    def decoder(self, topic: str) -> TopicDecoder:
        """Return the decoder of a topic.

        Raises:
            BadInput: the topic was not recorded, or has no readable schema.
        """
        if topic not in self._decoders:
            channel = self.channel(topic)
            schema = self.contents.schemas.get(channel.schema_id)
            self._decoders[topic] = TopicDecoder(str(self.path), channel, schema)
        return self._decoders[topic]

    def parts(self, topics: Sequence[str], span: Span = ALL) -> Iterator[list[tuple[str, Part]]]:
        """Yield the messages of some topics by topic, in blocks contiguous in the file.

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
        """Return whether some topics may have messages in a time span."""
        return bool(self.contents.chunks.having([self.channel(topic).id for topic in topics], span))

    def count(self, topic: str) -> int:
        """Return the number of messages of a topic by the file's index."""
        return self.contents.counts.get(self.channel(topic).id, 0)

    def span(self, topic: str) -> Span | None:
        """Return the time span of a topic's messages by the file's index; None if it has none."""
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
        """Return the time from which to read to get, for each topic, a message before `time_ns`, if it has one."""
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
            # Each part of a column is freed as soon as the column is complete.
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
        # The caller that opens the log or reads from it.
        warnings.warn(f"{self.path}: {what}", LogDamaged, stacklevel=4)
