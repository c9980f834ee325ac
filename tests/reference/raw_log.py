"""Logs of nothing but raw frames, with what an ECU needs to be run again on them."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from bench.record import can_frame
from bench.record.can_frame import Frame

Metadata = Mapping[str, Mapping[str, str]]

_COLUMNS = [("receive", "<i8"), ("can_id", "<u4"), ("wire", "<i8"), ("response", "<i8"), ("length", "u1")]
_ROW = np.dtype([*_COLUMNS, ("data", "u1", (can_frame.MAX_DATA,))])


def write(
    out: Path,
    frames: Iterable[Frame],
    buses: Iterable[str],
    scenario: str,
    metadata: Metadata,
    attachments: Mapping[str, bytes] | None = None,
) -> None:
    """Write a log; the same arguments give the same bytes.

    Args:
        out: the file.
        frames: in the order of the log; what they have of times on the wire is left out.
        buses: names of all buses.
        scenario: as TOML.
        metadata: values by key, by the name of the record: run, result.
        attachments: what else is attached: content by name. Nothing in the log tells which bus a DBC file is for.
    """
    with out.open("wb") as stream:
        # One chunk of the whole log packs best.
        writer = Writer(stream, chunk_size=1 << 24)
        writer.start("platoon", "platoon")
        writer.add_attachment(0, 0, "scenario.toml", "application/toml", scenario.encode())
        for name, data in (attachments or {}).items():
            writer.add_attachment(0, 0, name, "text/plain", data)
        for name, values in metadata.items():
            writer.add_metadata(name, dict(values))
        schema = writer.register_schema(can_frame.NAME, "protobuf", can_frame.SCHEMA)
        channels = {bus: writer.register_channel(f"/can/{bus}", "protobuf", schema) for bus in buses}
        for frame in frames:
            writer.add_message(channels[frame.bus], frame.time_ns, _payload(frame), frame.time_ns)
        writer.finish()


def _payload(frame: Frame) -> bytes:
    row = np.zeros(1, _ROW)
    row["can_id"], row["length"], row["receive"] = frame.can_id, len(frame.data), frame.receive_ns
    row["data"][0, : len(frame.data)] = list(frame.data)
    out = np.frombuffer(can_frame.template(len(frame.data)), np.uint8).copy()
    can_frame.fill(out, np.zeros(1, np.int64), row)
    return out.tobytes()
