"""A recorded run, read back: signals, truth and frames as numpy arrays, or joined as a table.

Only requested data is read; only that of a short log is cached. A truncated log (of a killed run) is readable up to its
last complete chunk, after one warning.

    run = Run("logs/formation.mcap")
    t, rate = run.signal("veh1.VehicleMotion.YawRate")
    table = run.table(["truth.*.v_x", "veh1.TrackerTarget.VelocityX"], start_s=2.0, every_s=0.01)
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from bench.bus.codec import Codec
from bench.errors import BadInput
from bench.mcap.time_span import ALL, NS, Span
from bench.record import event
from bench.record.can_frame import MAX_DATA, MOST_BUSES, Frame
from bench.record.catalogue import Catalogue, check_text
from bench.record.columns import Columns
from bench.record.comfort import felt
from bench.record.dbc_files import DbcFiles
from bench.record.event import Event
from bench.record.frame_table import FRAME_TABLE, frames_of
from bench.record.topic_decoder import TopicDecoder
from bench.record.topic_reader import LogDamaged, TopicReader
from bench.scenario import Scenario, from_log

if TYPE_CHECKING:
    import polars as pl

__all__ = ["FRAME_TABLE", "Columns", "Event", "LogDamaged", "Run"]

MOST_EVENTS = 1_000_000
"""Events that are read, of a span of time; a run with noise and lost frames has some 200 a second."""

MOST_VEHICLES = 1_000
"""Limit on the number of vehicles that a log may claim."""

KEPT_BYTES = 32 * 1024 * 1024
"""Maximum number of decoded topics kept in memory besides the one requested last."""


class Run:
    """One run's log.

    Attributes:
        path: the file.
        log: its topics, for data without a method in this class.
        attachments: file name -> content.
        result: result of the run; empty if the log is truncated.
        metadata: all metadata of the run and its result, flat.
        topics: topic -> channel, of all recorded topics.
    """

    def __init__(self, path: Path | str) -> None:
        """Open a log.

        Raises:
            BadInput: the file cannot be read or is not a log.
        """
        self.path = Path(path)
        self.log = TopicReader(self.path)
        contents = self.log.contents
        self.attachments = contents.attachments
        self.result = contents.metadata.get("result", {})
        self.metadata = {**contents.metadata.get("run", {}), **self.result}
        self.topics = self.log.topics
        self._dbc_files = DbcFiles(self.path, self.topics, self.attachments)
        self._kept: OrderedDict[str, Columns] = OrderedDict()

    def __repr__(self) -> str:
        """Return path, number of vehicles and number of topics."""
        return f"Run({str(self.path)!r}): {self.vehicles} vehicles, {len(self.topics)} topics"

    @property
    def damage(self) -> str:
        """Damage found in the file as far as it has been read; empty if intact."""
        return self.log.damage

    @property
    def vehicles(self) -> int:
        """Number of vehicles."""
        try:
            number = int(self.metadata["vehicles"])
        except (KeyError, ValueError) as error:
            raise BadInput(f"{self.path} is not a run's log: its metadata has no number of vehicles") from error
        if not 0 <= number <= MOST_VEHICLES:
            raise BadInput(f"{self.path} has {number} vehicles in its metadata; allowed: 0 to {MOST_VEHICLES}")
        return number

    @cached_property
    def buses(self) -> list[str]:
        """Names of the buses with frames, in order.

        Raises:
            BadInput: there are more than `MOST_BUSES`.
        """
        found = [channel for topic, channel in self.topics.items() if topic.startswith("/can/")]
        if len(found) > MOST_BUSES:
            raise BadInput(f"{self.path} has {len(found)} CAN buses; allowed: at most {MOST_BUSES}")
        return [channel.topic.removeprefix("/can/") for channel in sorted(found, key=lambda channel: channel.id)]

    @cached_property
    def events(self) -> list[Event]:
        """The events, in order."""
        return self._events(ALL)

    @cached_property
    def scenario_text(self) -> str:
        """The complete scenario as TOML, with all defaults.

        Raises:
            BadInput: the log has none.
        """
        try:
            return self.attachments["scenario.toml"].decode()
        except (KeyError, UnicodeDecodeError) as error:
            raise BadInput(
                f"{self.path} is not the log of a run, or what was recorded of it ends before the scenario"
            ) from error

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario of the run, validated.

        Raises:
            BadInput: the log has none that this version can read.
        """
        try:
            return from_log(self.scenario_text)
        except (ValueError, RecursionError) as error:
            raise BadInput(f"{self.path}: the scenario attached to it cannot be read: {error}") from error

    def codec(self, bus: str) -> Codec | None:
        """Return the codec of the DBC file attached for `bus`, None if absent or unusable."""
        return self._dbc_files.codec(bus)

    def dbc(self, bus: str) -> bytes | None:
        """Return the DBC file attached for `bus`, None if absent."""
        return self._dbc_files.content(bus)

    def messages(self, bus: str) -> list[str]:
        """Return the names of the decoded messages on `bus`, sorted by identifier."""
        return self._messages.get(bus, [])

    @cached_property
    def _messages(self) -> dict[str, list[str]]:
        """Bus -> names of its decoded messages; with one pass over all topics."""
        found: dict[str, list[str]] = {}
        for topic in self.topics:
            if topic.startswith("/signals/"):
                bus, _, message = topic.removeprefix("/signals/").partition("/")
                found.setdefault(bus, []).append(message)
        return {bus: sorted(names, key=lambda name: (self.can_id(bus, name), name)) for bus, names in found.items()}

    def can_id(self, bus: str, message: str) -> int:
        """Return the identifier of a message, -1 if the log does not have it.

        Raises:
            BadInput: no such message was recorded.
        """
        try:
            return int(self.log.channel(f"/signals/{bus}/{message}").metadata["can_id"], 16)
        except (KeyError, ValueError):
            return -1

    def has(self, bus: str, message: str) -> bool:
        """Return whether `message` was recorded on `bus`."""
        return f"/signals/{bus}/{message}" in self.topics

    def message(self, bus: str, message: str, *, start_s: float | None = None, end_s: float | None = None) -> Columns:
        """Return all signals of a message, by name, and `t`, the time in s; each (n,).

        Args:
            bus: the bus.
            message: the message.
            start_s: only data of this time or later.
            end_s: only data of an earlier time.

        Raises:
            BadInput: no such message was recorded.
        """
        return self._table(f"/signals/{bus}/{message}", Span.of(start_s, end_s))

    def signal(
        self,
        bus: str,
        message: str = "",
        signal: str = "",
        *,
        start_s: float | None = None,
        end_s: float | None = None,
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return the times (n,) in s and the physical values (n,) of a signal, numbers if it has a value table.

        Args:
            bus: the bus, or, alone, the whole name as `names` gives it: veh1.VehicleMotion.YawRate, truth.veh1.v_x.
            message: the message.
            signal: the signal.
            start_s: only data of this time or later.
            end_s: only data of an earlier time.

        Raises:
            BadInput: no such signal was recorded.
        """
        check_text(bus=bus, message=message, signal=signal)
        if message:
            topic, field = f"/signals/{bus}/{message}", signal
        else:
            topic, field = self.catalogue.place(bus)
        columns = self._table(topic, Span.of(start_s, end_s))
        return columns["t"], columns[field].astype(np.float64)

    def truth(self, vehicle: int, *, start_s: float | None = None, end_s: float | None = None) -> Columns:
        """Return a vehicle's true values by their FMU name, and `t`, the time in s; each (n,).

        Raises:
            BadInput: none were recorded.
        """
        return self._table(f"/truth/veh{vehicle}", Span.of(start_s, end_s))

    def comfort(self, vehicle: int) -> Columns:
        """Return what is felt in a vehicle over time, from its true values; each (n,).

        `t`: the time, s. `a_x`, `a_y`: acceleration of the centre of mass, forward and to the left, m/s^2. `jerk_x`,
        `jerk_y`: jerk averaged over the last 0.5 s (ISO 11270), m/s^3; NaN in the first 0.5 s. `weighted_x`,
        `weighted_y`: acceleration weighted with W_d (ISO 2631-1), m/s^2.

        Raises:
            BadInput: no true accelerations were recorded.
        """
        return felt(self.truth(vehicle), f"comfort of veh{vehicle} in {self.path}")

    @cached_property
    def catalogue(self) -> Catalogue:
        """The names of all signals and true values."""
        order = [f"/signals/{bus}/{message}" for bus in self.buses for message in self.messages(bus)]
        others = sorted(self.topics.keys() - set(order))
        decoders = (self._decoder_of_table(topic) for topic in [*order, *others])
        return Catalogue(self.path, [decoder for decoder in decoders if decoder], has_frames=bool(self.buses))

    def names(self, pattern: str = "*") -> list[str]:
        """Return the names of all signals and true values that match: `*.VehicleMotion.*`, `truth.veh1.v_?`.

        Case-sensitive; `*` matches any text, including dots, `?` one character.
        """
        check_text(pattern=pattern)
        return self.catalogue.matching(pattern)

    def table(
        self,
        names: str | Sequence[str],
        *,
        start_s: float | None = None,
        end_s: float | None = None,
        every_s: float | None = None,
        labels: bool = False,
    ) -> pl.DataFrame:
        """Return signals joined on one time base: the column `t` in s, and a column for each signal.

        A signal is sampled with zero-order hold, also from before `start_s`; null before its first value. Of several
        values at one time the last in the file counts.

        Args:
            names: names or patterns, as of `names`.
            start_s: only data of this time or later.
            end_s: only data of an earlier time.
            every_s: step of the time base from start_s (default: the first signal's start); if not given, all times of
                the signals.
            labels: signals with a value table as its names, of polars' type Enum, instead of numbers.

        Raises:
            BadInput: there is no such signal, or a time is invalid.
        """
        # polars takes a while to import.
        from bench.record.joining import joined

        chosen = self.catalogue.chosen(names)
        return joined(self.log, chosen, Span.of(start_s, end_s), every_s, labels=labels)

    def message_table(
        self, message: str, *, start_s: float | None = None, end_s: float | None = None, labels: bool = False
    ) -> pl.DataFrame:
        """Return a message as recorded, a row for each time it was sent: `t` in s and its signals.

        Args:
            message: its name, veh1.VehicleMotion; of the truth, truth.veh1.
            start_s: only data of this time or later.
            end_s: only data of an earlier time.
            labels: signals with a value table as its names, of polars' type Enum, instead of numbers.

        Raises:
            BadInput: there is no such message.
        """
        from bench.record.joining import message_table

        check_text(message=message)
        topic = self.catalogue.topic(message)
        return message_table(self._table(topic, Span.of(start_s, end_s)), self.log.decoder(topic), labels=labels)

    def event_table(self, *, start_s: float | None = None, end_s: float | None = None) -> pl.DataFrame:
        """Return the events, or those with start_s <= t < end_s; see `joining.event_table`.

        Raises:
            BadInput: a time is invalid.
        """
        from bench.record.joining import event_table

        span = Span.of(start_s, end_s)
        return event_table(self.events if span == ALL else self._events(span))

    def signal_table(self, pattern: str = "*", *, ranges: bool = False) -> pl.DataFrame:
        """Return a description of signals: `name`, `unit`, `values` (their number), `start_s`, `end_s`, `comment`.

        Args:
            pattern: as of `names`.
            ranges: also `min` and `max`, for which the signals are read.

        Raises:
            BadInput: nothing matches.
        """
        from bench.record.joining import signal_table

        return signal_table(self.log, self.catalogue.chosen(pattern), ranges=ranges)

    def unit(self, topic: str, name: str = "") -> str:
        """Return the unit of a value, empty for none.

        Args:
            topic: its topic, or, alone, its whole name as `names` gives it.
            name: its name in the topic.

        Raises:
            BadInput: there is no such topic or name.
        """
        check_text(topic=topic, name=name)
        if not name:
            topic, name = self.catalogue.place(topic)
        return str(self.log.channel(topic).metadata.get(f"unit {name}", ""))

    def wall_clock_ids(self, bus: str) -> set[int]:
        """Return the identifiers on `bus` whose frames carry wall-clock times, which differ from run to run."""
        return {self.can_id(bus, message) for message in self.messages(bus) if self.is_wall_clock(bus, message)}

    def is_wall_clock(self, bus: str, message: str) -> bool:
        """Return whether a message carries wall-clock times.

        Raises:
            BadInput: no such message was recorded.
        """
        return bool(self.log.channel(f"/signals/{bus}/{message}").metadata.get("wall_clock") == "yes")

    def frame_table(self, bus: str, *, start_s: float | None = None, end_s: float | None = None) -> npt.NDArray[Any]:
        """Return all raw frames of a bus in the order of the file, as `FRAME_TABLE`.

        Raises:
            BadInput: no frame was recorded on it.
        """
        topic = f"/can/{bus}"
        decoder = self.log.decoder(topic)
        groups = self.log.parts([topic], Span.of(start_s, end_s))
        tables = (frames_of(part, decoder) for group in groups for _, part in group)
        return np.concatenate([np.empty(0, FRAME_TABLE), *tables])

    def frames(self, *, start_s: float | None = None, end_s: float | None = None) -> Iterator[Frame]:
        """Yield every raw frame, or those with start_s <= t < end_s, in the order of the file, in bounded memory."""
        buses = {f"/can/{bus}": bus for bus in self.buses}
        for group in self.log.parts(list(buses), Span.of(start_s, end_s)):
            names = [buses[topic] for topic, part in group for _ in range(len(part.offsets))]
            order = np.argsort(np.concatenate([part.offsets for _, part in group]))
            table = np.concatenate([frames_of(part, self.log.decoder(topic)) for topic, part in group])[order]
            data = table["data"].tobytes()
            columns = (table[name].tolist() for name in ("time", "can_id", "length", "receive", "wire", "response"))
            rows = zip(order.tolist(), *columns, strict=True)
            for row, (number, time_ns, can_id, length, receive_ns, wire_ns, response_ns) in enumerate(rows):
                at = row * MAX_DATA
                payload = data[at : at + length]
                yield Frame(time_ns, names[number], can_id, payload, receive_ns, wire_ns, response_ns)

    def _events(self, span: Span) -> list[Event]:
        topic, read = (event.TOPIC, event.read) if event.TOPIC in self.topics else (event.OLD_TOPIC, event.read_old)
        if topic not in self.topics:
            return []
        decoder = self.log.decoder(topic)
        found: list[Event] = []
        # Flapping states repeat the same few events: these share their texts and fields.
        known: dict[bytes, Event] = {}
        for _, part in itertools.chain.from_iterable(self.log.parts([topic], span)):
            if len(found) + len(part.offsets) > MOST_EVENTS:
                raise BadInput(
                    f"{self.path} has more than {MOST_EVENTS} events in this time; read fewer with start_s and end_s"
                )
            for time_ns, payload in zip(part.time_ns.tolist(), part.payloads(), strict=True):
                first = known.get(payload)
                if first is None:
                    try:
                        first = known[payload] = read(time_ns / NS, decoder.message(payload))
                    except (AttributeError, ValueError, RecursionError) as error:
                        text = f"{self.path}: topic {topic} has messages that are not events: {error}"
                        raise BadInput(text) from error
                found.append(dataclasses.replace(first, time_s=time_ns / NS))
        return found

    def _decoder_of_table(self, topic: str) -> TopicDecoder | None:
        try:
            decoder = self.log.decoder(topic)
        except BadInput:
            # Unreadable data raises an error when requested.
            return None
        return decoder if decoder.is_table else None

    def _table(self, topic: str, span: Span = ALL) -> Columns:
        if topic in self._kept:
            self._kept.move_to_end(topic)
            return self._kept[topic] if span == ALL else self._kept[topic].within(span)
        while sum(kept.nbytes for kept in self._kept.values()) > KEPT_BYTES:
            self._kept.popitem(last=False)
        columns = self.log.tables([topic], span)[topic]
        if span == ALL:
            self._kept[topic] = columns
        return columns
