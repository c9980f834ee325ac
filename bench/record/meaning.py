"""The decoded signals of a bus: those decoded in the log, or its raw frames decoded with a DBC file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench.bus.codec import Codec, load_codecs
from bench.errors import BadInput
from bench.record.reader import Columns, Run
from bench.record.signals import SignalTable, signal_message


@dataclass(frozen=True)
class Message:
    """All frames of one message.

    Attributes:
        columns: its signals by name, each (n,), and `t` in s.
        units: units of the signals that have one.
        labels: names of values, by signal with a value table.
    """

    columns: Columns
    units: Mapping[str, str]
    labels: Mapping[str, Mapping[int, str]]

    def text(self, row: int) -> str:
        """Return the values of one row as text, with units and names."""
        return ", ".join(self._text(name, float(self.columns[name][row])) for name in self.columns if name != "t")

    def _text(self, name: str, value: float) -> str:
        return value_text(name, value, self.units.get(name, ""), self.labels.get(name, {}))


def value_text(signal: str, value: float, unit: str, labels: Mapping[int, str]) -> str:
    """Return a signal's value as text: its name in the value table, else with its unit."""
    label = labels.get(int(value)) if value.is_integer() else None
    return f"{signal} {value:.9g} {unit}".rstrip() if label is None else f"{signal} {label}"


class Meaning:
    """The decoded signals of one bus of a log.

    Attributes:
        can_ids: identifiers of its messages by name, in order.
        wall_clock_ids: identifiers of the messages that carry wall-clock times.
    """

    def __init__(self, run: Run, bus: str, codec: Codec | None = None) -> None:
        """Use the log's decoded signals, or with a codec its raw frames."""
        self._run, self._bus, self._codec = run, bus, codec
        self.wall_clock_ids = run.wall_clock_ids(bus)
        if codec is None:
            self.can_ids = {name: run.can_id(bus, name) for name in run.messages(bus)}
        else:
            self._frames = run.frame_table(bus)
            seen = set(self._frames["can_id"].tolist())
            self.can_ids = {name: codec.can_id(name) for name in codec.names if codec.can_id(name) in seen}
            self.wall_clock_ids |= {can_id for can_id in self.can_ids.values() if codec.is_wall_clock(can_id)}

    def message(self, name: str) -> Message:
        """Return all frames of a message with the correct length.

        Raises:
            BadInput: there is no such message.
        """
        return self._logged(name) if self._codec is None else self._decoded(name, self._codec)

    def _logged(self, name: str) -> Message:
        topic = f"/signals/{self._bus}/{name}"
        columns = self._run.message(self._bus, name)
        units = {signal: self._run.unit(topic, signal) for signal in columns if signal != "t"}
        return Message(columns, units, self._run.log.decoder(topic).labels)

    def _decoded(self, name: str, codec: Codec) -> Message:
        described = signal_message(self._bus, codec, name)
        frames = self._frames
        frames = frames[(frames["can_id"] == described.can_id) & (frames["length"] == described.length)]
        _, values = SignalTable([described]).decode(frames["data"], np.zeros(len(frames), np.int64))
        fields = described.layout.fields
        table = values.reshape(len(frames), len(fields))
        columns = {"t": frames["time"] / 1e9} | {field.name: table[:, at] for at, field in enumerate(fields)}
        return Message(
            Columns(f"{self._bus} {name}", columns),
            {field.name: field.unit for field in fields if field.unit},
            {field.name: field.names for field in fields if field.names},
        )


def meanings(a: Run, b: Run, bus: str) -> tuple[Meaning, Meaning] | None:
    """Return the decoded signals of a bus in two logs, by the same rules in both.

    As decoded in the logs; if one has none, with the DBC file attached to either, else with the bench's own if one is
    the log of a run. None if there is no DBC.
    """
    if all(run.messages(bus) for run in (a, b)):
        return Meaning(a, bus), Meaning(b, bus)
    codec = a.codec(bus) or b.codec(bus) or _of_the_bench(a, bus) or _of_the_bench(b, bus)
    return None if codec is None else (Meaning(a, bus, codec), Meaning(b, bus, codec))


def _of_the_bench(run: Run, bus: str) -> Codec | None:
    try:
        return load_codecs(run.vehicles).get(bus) if "scenario" in run.metadata else None
    except BadInput:
        return None
