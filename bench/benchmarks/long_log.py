"""Creates long logs from a short one by repeating its chunks with shifted times.

The messages and their chunks are those of a real run; only log_time and publish_time are changed.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.mcap.container import McapFile
from bench.mcap.gathering import scatter
from bench.mcap.records import MESSAGE
from bench.mcap.scan import ScannedFile, message_heads

_TIMES = ("log_time", "publish_time")


def repeat(source: Path, target: Path, *, period_ns: int, duration_ns: int = 0, size: int = 0) -> int:
    """Write the log `source`, a run of the length `period_ns`, repeatedly; return the number of raw frames.

    Args:
        source: a complete log.
        target: the log to create.
        period_ns: time shift per repetition.
        duration_ns: stop when the log has at least this simulated duration ...
        size: ... and at least this number of bytes.
    """
    file = ScannedFile(source)
    contents = file.contents
    raw = {number for number, channel in contents.channels.items() if channel.topic.startswith("/can/")}
    chunks = [_Chunk(file, number) for number in range(len(contents.chunks))]
    frames = sum(contents.counts.get(number, 0) for number in raw)
    with target.open("xb") as stream:
        log = McapFile(stream, "platoon")
        log.add_metadata("run", contents.metadata["run"])
        for name, data in contents.attachments.items():
            log.add_attachment(name, "", data)
        for number in range(1, max(contents.channels) + 1):
            # A channel without messages is not written; registering it only keeps the channel numbers.
            channel = contents.channels.get(number, next(iter(contents.channels.values())))
            schema = contents.schemas[channel.schema_id]
            log.add_channel(channel.topic, log.add_schema(schema.name, schema.data), channel.metadata)
        rounds = 0
        while rounds * period_ns < duration_ns or stream.tell() < size:
            for chunk in chunks:
                chunk.write(log, rounds * period_ns)
            rounds += 1
        log.add_metadata("result", {**contents.metadata["result"], "cycles": "0"})
        log.finish()
    return rounds * frames


class _Chunk:
    """A chunk's messages, to be rewritten with other times."""

    def __init__(self, file: ScannedFile, number: int) -> None:
        data = file.chunk(number)
        if data is None:
            raise ValueError(f"chunk {number} of {file.path} is damaged")
        self._offset = np.sort(np.concatenate(list(file.messages(number, data).values())))
        heads = message_heads(data, self._offset)
        self._channel, self._time = heads["channel"].astype(np.int64), heads["log_time"].astype(np.int64)
        self._records = data.copy()

    def write(self, log: McapFile, later_ns: int) -> None:
        time = self._time + later_ns
        for name in _TIMES:
            place = int(MESSAGE.fields[name][1])  # type: ignore[index]
            scatter(self._records, self._offset + place, time.astype("<u8"))
        log.add_chunk(self._records.data, self._channel, time, self._offset)
