"""From physical values to CAN frames and back, as the DBC files describe them.

cantools reads the DBC (`bench.bus.dbc`), and what it says of the bench's own files is kept between runs. Each message's
layout becomes a table once (`bench.bus.layout`), which gives the same results as cantools' own codec in a fraction of
the time.
"""

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bench.bus import e2e
from bench.bus.description import MessageDescription, SignalDescription
from bench.bus.frame import CanFrame
from bench.bus.kept_description import description_of
from bench.bus.layout import Field, Layout, Replaced
from bench.cycle import CYCLE_MS
from bench.errors import BadInput, BenchError
from bench.names import V2V, vehicle_bus

if TYPE_CHECKING:
    from cantools.database.can import Database, Message

DEFAULT_BIT_RATE = 500_000
"""Bits per second of a bus whose DBC has no attribute Baudrate."""

DEFAULT_TIMEOUT_CYCLES = 10
"""Periods without a valid frame after which a message is lost if its DBC has no GenMsgTimeoutTime."""

MAX_VEHICLES = 16
"""Number of vehicles for which dbc/v2v.dbc has messages."""


def _dbc_dir() -> Path:
    package = Path(__file__).resolve().parents[1]
    in_wheel = package / "dbc"
    return in_wheel if in_wheel.is_dir() else package.parent / "dbc"


DBC_DIR = _dbc_dir()
"""The folder of vehicle.dbc and v2v.dbc: at the top of a checkout, inside the package if installed from the wheel."""


class DecodeError(BenchError):
    """A frame that the DBC does not describe: unknown identifier or wrong length."""


class EncodeError(BenchError):
    """The DBC has no message of this name, or a signal has no value."""


class SignalBits(NamedTuple):
    """How the bits of a frame become a signal's value.

    Attributes:
        signal: its name.
        shift, mask: where its bits are in the frame as one little-endian number: `number >> shift & mask`.
        sign: value of the sign bit of a signed signal (two's complement); 0 for an unsigned one and for a float.
        scale, offset: value = raw * scale + offset.
        is_float: whether the bits are an IEEE 754 float of 32 bits.
    """

    signal: str
    shift: int
    mask: int
    sign: int
    scale: float
    offset: float
    is_float: bool


class _Message(NamedTuple):
    """A message of a DBC: what the DBC says of it, its layout, its signals in the DBC's order."""

    described: MessageDescription
    layout: Layout
    bits: tuple[SignalBits, ...]


class Codec:
    """Encodes and decodes the messages of one DBC file.

    Attributes:
        file_name: the DBC file's name; empty if there is none.
        dbc: its content; empty if there is none.
        bit_rate: bits per second of the bus: the DBC's attribute Baudrate.
        names: message names, sorted by identifier.
        replaced: counts the values that `encode` has replaced.
    """

    def __init__(self, dbc_path: Path) -> None:
        """Read the DBC file at `dbc_path`; a process parses the same content only once.

        Raises:
            BadInput: the file is missing, not a valid DBC, or uses features that this codec does not support (see
                `bench.bus.dbc.describe`).
        """
        try:
            dbc = dbc_path.read_bytes()
        except OSError as error:
            raise BadInput(f"{dbc_path}: cannot read the DBC file: {error.strerror}") from error
        self._set_up(dbc, dbc_path.name, str(dbc_path), to_be_kept=dbc_path.parent == DBC_DIR)

    @classmethod
    def from_bytes(cls, dbc: bytes, file_name: str) -> "Codec":
        """Create a codec from a DBC file's content, e.g. one attached to a log.

        Raises:
            BadInput: as the constructor.
        """
        codec = cls.__new__(cls)
        codec._set_up(dbc, file_name, file_name)
        return codec

    @classmethod
    def without_messages(cls) -> "Codec":
        """Return the codec of a bus that no DBC file describes."""
        codec = cls.from_bytes(_NO_MESSAGES, "")
        codec.dbc = b""
        return codec

    def _set_up(self, dbc: bytes, file_name: str, where: str, to_be_kept: bool = False) -> None:
        try:
            bit_rate, messages = _messages(dbc, to_be_kept)
        except BadInput as error:
            raise BadInput(f"{where}: {error}") from error
        layouts = [each.layout for each in messages]
        self.file_name = file_name
        self.dbc = dbc
        self.bit_rate = bit_rate or DEFAULT_BIT_RATE
        self.names = tuple(layout.name for layout in layouts)
        self.replaced = Replaced()
        self._described = {each.layout.name: each.described for each in messages}
        self._bits = {each.layout.name: each.bits for each in messages}
        self._by_name = {layout.name: layout for layout in layouts}
        self._by_id = {layout.can_id: layout for layout in layouts}
        self._data_ids = {layout.can_id: layout.data_id for layout in layouts if layout.data_id}
        self._wall_clock = frozenset(each.layout.can_id for each in messages if each.described.is_wall_clock)

    @property
    def database(self) -> "Database":
        """The DBC file as cantools reads it, which this loads."""
        from bench.bus.dbc import database_of

        return database_of(self.dbc or _NO_MESSAGES)

    def described(self, name: str) -> MessageDescription:
        """Return what the DBC says of a message: identifier, senders, signals, cycle time, comments.

        Raises:
            EncodeError: the DBC has no such message.
        """
        self.layout(name)
        return self._described[name]

    def message(self, name: str) -> "Message":
        """Return cantools' form of a message; this loads cantools, which `described` does not.

        Raises:
            EncodeError: the DBC has no such message.
        """
        self.layout(name)
        return self.database.get_message_by_name(name)

    def encode(self, name: str, values: Mapping[str, float], counter: int = 0) -> CanFrame:
        """Return the frame of the message `name`.

        `values` holds a physical value, in the DBC's unit, for every signal except CRC and AliveCounter; other names
        are ignored. A value outside the signal's range is clamped, NaN is replaced by the start value; both are
        counted. In a protected message AliveCounter is set to `counter` modulo 15 and CRC is computed.

        Raises:
            EncodeError: the DBC has no such message, or a signal has no value.
        """
        layout = self._by_name.get(name)
        if layout is None:
            layout = self.layout(name)
        try:
            return CanFrame(layout.can_id, layout.encode(values, counter % e2e.COUNTER_MODULUS, self.replaced, False))
        except KeyError as error:
            given = ", ".join(values)
            raise EncodeError(f"message {name}: signal {error} has no value; given: {given}") from None

    def ranges(self, name: str) -> tuple[tuple[str, float, float], ...]:
        """Return each signal that `encode` takes for the message `name`, with the ends of its range.

        Raises:
            EncodeError: the DBC has no such message.
        """
        layout = self.layout(name)
        return tuple((each.signal, each.low, each.high) for each in layout.encoded)

    def decode(self, can_id: int, data: bytes) -> tuple[str, dict[str, float]]:
        """Return the name of a frame's message and the physical values of all its signals.

        CRC and AliveCounter are returned unchecked (see `bench.bus.e2e`), states as numbers.

        Raises:
            DecodeError: the DBC has no such identifier, or `data` has the wrong length.
        """
        layout = self._by_id.get(can_id)
        if layout is None:
            raise DecodeError(f"identifier 0x{can_id:03X} is not in the DBC")
        if len(data) != layout.length:
            raise DecodeError(f"message {layout.name}: {len(data)} bytes instead of {layout.length}")
        return layout.name, layout.decode(data)

    def bits(self, name: str) -> tuple[SignalBits, ...]:
        """Return the bit layout of each signal of the message `name`, in the DBC's order.

        Raises:
            EncodeError: the DBC has no such message.
        """
        self.layout(name)
        return self._bits[name]

    def start_values(self, name: str) -> dict[str, float]:
        """Return the physical start value of every signal that `encode` takes for the message `name`.

        Raises:
            EncodeError: the DBC has no such message.
        """
        layout = self.layout(name)
        return {field.signal: field.start for field in layout.encoded}

    @property
    def not_numbers(self) -> int:
        """Number of NaN values that `encode` has replaced by the signal's start value."""
        return self.replaced.not_numbers

    @property
    def saturated(self) -> int:
        """Number of values outside their signal's range that `encode` has clamped."""
        return self.replaced.saturated

    @property
    def can_ids(self) -> tuple[int, ...]:
        """The identifiers of all messages, highest priority first."""
        return tuple(self._by_id)

    def period(self, name: str) -> int:
        """Return the period of the message `name` in cycles of the bench; 1 if it has no cycle time.

        Raises:
            EncodeError: the DBC has no such message.
        """
        return max(1, round(self.described(name).cycle_time_ms / CYCLE_MS))

    def timeout_cycles(self, name: str) -> int:
        """Return the number of cycles without a valid frame after which the message `name` is lost.

        The DBC's attribute GenMsgTimeoutTime; if absent, `DEFAULT_TIMEOUT_CYCLES` times its period.

        Raises:
            EncodeError: the DBC has no such message.
        """
        return round(self.described(name).timeout_ms / CYCLE_MS) or DEFAULT_TIMEOUT_CYCLES * self.period(name)

    def can_id(self, name: str) -> int:
        """Return the identifier of the message `name`.

        Raises:
            EncodeError: the DBC has no such message.
        """
        return self.layout(name).can_id

    def name_of(self, can_id: int) -> str | None:
        """Return the name of the message of this identifier, None if absent."""
        layout = self._by_id.get(can_id)
        return layout.name if layout else None

    def data_id(self, name: str) -> int:
        """Return the E2E data ID of the message `name`, 0 if it is unprotected.

        Raises:
            EncodeError: the DBC has no such message.
        """
        return self.layout(name).data_id

    def is_possible(self, can_id: int, values: Mapping[str, float]) -> bool:
        """Return whether all states among a message's values are in their value tables."""
        layout = self._by_id.get(can_id)
        return layout is None or bool(layout.is_possible(dict(values)))

    def is_protected(self, can_id: int) -> bool:
        """Return whether the frames of this identifier carry an E2E CRC and counter; False for unknown ones."""
        return can_id in self._data_ids

    def is_wall_clock(self, can_id: int) -> bool:
        """Return whether the message holds wall-clock times; False for unknown ones."""
        return can_id in self._wall_clock

    def receiver(self, can_id: int) -> e2e.Receiver:
        """Return a new E2E receiver for the protected message `can_id`.

        Raises:
            DecodeError: the DBC has no protected message of this identifier.
        """
        if can_id not in self._data_ids:
            raise DecodeError(f"identifier 0x{can_id:03X} is not a protected message of this DBC")
        return e2e.Receiver(self._data_ids[can_id])

    def layout(self, name: str) -> Layout:
        """Return the layout of the message `name`.

        Raises:
            EncodeError: the DBC has no such message.
        """
        try:
            return self._by_name[name]
        except KeyError:
            raise EncodeError(f"message {name!r} is not in the DBC; it has {', '.join(self.names)}") from None


def load_codecs(vehicles: int) -> dict[str, Codec]:
    """Return a codec for every bus of a bench with `vehicles` (1..16) vehicles: v2v, veh1, veh2, ...

    Raises:
        BadInput: more vehicles than the V2V bus has messages for, or a DBC file is missing.
    """
    if not 1 <= vehicles <= MAX_VEHICLES:
        raise BadInput(f"vehicles = {vehicles}: dbc/v2v.dbc has messages for 1 to {MAX_VEHICLES} vehicles")
    buses = {bus: DBC_DIR / ("v2v.dbc" if bus == V2V else "vehicle.dbc") for bus in bus_names(vehicles)}
    return {bus: Codec(path) for bus, path in buses.items()}


def bus_names(vehicles: int) -> tuple[str, ...]:
    """Return the names of a bench's buses in their order: v2v, veh1, veh2, ... up to `vehicles`."""
    return (V2V, *map(vehicle_bus, range(1, vehicles + 1)))


_NO_MESSAGES = b'VERSION ""\n'


@lru_cache(maxsize=16)
def _messages(dbc: bytes, to_be_kept: bool) -> tuple[int, tuple[_Message, ...]]:
    """Return a DBC file's bit rate, 0 if absent, and its messages by identifier.

    Raises:
        BadInput: as `bench.bus.dbc.describe`.
    """
    bus = description_of(dbc, to_be_kept)
    return bus.bit_rate, tuple(map(_message, bus.messages))


def _message(described: MessageDescription) -> _Message:
    """Return the tables of one message."""
    # Floats are last in what `encode` and `decode` go through, as in logs of all versions.
    ordered = sorted(described.signals, key=lambda signal: signal.is_float)
    fields = {signal.name: _field(signal) for signal in ordered}
    data_id = described.data_id
    computed = (e2e.CRC_SIGNAL, e2e.COUNTER_SIGNAL) if data_id else ()
    layout = Layout(
        name=described.name,
        can_id=described.can_id,
        length=described.length,
        data_id=data_id,
        crc_of_id=e2e.crc_of_id(data_id),
        fields=tuple(fields.values()),
        encoded=tuple(each for name, each in fields.items() if name not in computed),
        states=tuple((each.name, frozenset(each.texts)) for each in described.signals if each.choices),
    )
    return _Message(described, layout, tuple(_bits(fields[signal.name]) for signal in described.signals))


def _field(signal: SignalDescription) -> Field:
    is_signed = signal.is_signed and not signal.is_float
    return Field(
        signal=signal.name,
        shift=signal.start_bit,
        mask=(1 << signal.length) - 1,
        sign=1 << (signal.length - 1) if is_signed else 0,
        scale=signal.scale,
        offset=signal.offset,
        low=signal.low,
        high=signal.high,
        start=signal.start,
        is_float=signal.is_float,
    )


def _bits(field: Field) -> SignalBits:
    return SignalBits(
        field.signal, field.shift, field.mask, field.sign, field.scale, field.offset, bool(field.is_float)
    )
