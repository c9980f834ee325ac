"""From physical values to CAN frames and back, as the DBC files describe them.

cantools reads the DBC; each message's layout becomes a table once (`bench.bus.layout`), which gives the same results as
cantools' own codec in a fraction of the time.
"""

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from cantools.database import load_string
from cantools.database.can import Database, Message, Signal
from cantools.database.errors import Error as CantoolsError

from bench.bus import e2e
from bench.bus.frame import CanFrame
from bench.bus.layout import Field, Layout, Replaced
from bench.cycle import CYCLE_MS
from bench.errors import BadInput, BenchError
from bench.names import V2V, vehicle_bus

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


class _Described(NamedTuple):
    """A message of a DBC: its layout, its signals in the DBC's order, whether it holds wall-clock times."""

    layout: Layout
    bits: tuple[SignalBits, ...]
    wall_clock: bool


class Codec:
    """Encodes and decodes the messages of one DBC file.

    Attributes:
        file_name: the DBC file's name; empty if there is none.
        dbc: its content; empty if there is none.
        database: the DBC file as cantools has read it.
        names: message names, sorted by identifier.
        replaced: counts the values that `encode` has replaced.
    """

    def __init__(self, dbc_path: Path) -> None:
        """Read the DBC file at `dbc_path`; a process parses the same content only once.

        Raises:
            BadInput: the file is missing, not a valid DBC, or uses features that this codec does not support (see
                `_describe`).
        """
        try:
            dbc = dbc_path.read_bytes()
        except OSError as error:
            raise BadInput(f"{dbc_path}: cannot read the DBC file: {error.strerror}") from error
        self._set_up(dbc, dbc_path.name, str(dbc_path))

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
        codec = cls.from_bytes(b'VERSION ""\n', "")
        codec.dbc = b""
        return codec

    def _set_up(self, dbc: bytes, file_name: str, where: str) -> None:
        try:
            database, described = _parsed(dbc)
        except BadInput as error:
            raise BadInput(f"{where}: {error}") from error
        layouts = [each.layout for each in described]
        self.file_name = file_name
        self.dbc = dbc
        self.database = database
        self.names = tuple(layout.name for layout in layouts)
        self.replaced = Replaced()
        self._bits = {each.layout.name: each.bits for each in described}
        self._by_name = {layout.name: layout for layout in layouts}
        self._by_id = {layout.can_id: layout for layout in layouts}
        self._data_ids = {layout.can_id: layout.data_id for layout in layouts if layout.data_id}
        self._wall_clock = frozenset(each.layout.can_id for each in described if each.wall_clock)

    def message(self, name: str) -> Message:
        """Return cantools' description of a message: identifier, senders, signals, cycle time, comments.

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
            return CanFrame(layout.can_id, layout.encode(values, counter, self.replaced, False))
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
    def bit_rate(self) -> int:
        """Bits per second of the bus: the DBC's attribute Baudrate."""
        attributes = self.database.dbc.attributes if self.database.dbc else {}
        return int(attributes["Baudrate"].value) if "Baudrate" in attributes else DEFAULT_BIT_RATE

    @property
    def can_ids(self) -> tuple[int, ...]:
        """The identifiers of all messages, highest priority first."""
        return tuple(self._by_id)

    def period(self, name: str) -> int:
        """Return the period of the message `name` in cycles of the bench; 1 if it has no cycle time.

        Raises:
            EncodeError: the DBC has no such message.
        """
        return max(1, round((self.message(name).cycle_time or 0) / CYCLE_MS))

    def timeout_cycles(self, name: str) -> int:
        """Return the number of cycles without a valid frame after which the message `name` is lost.

        The DBC's attribute GenMsgTimeoutTime; if absent, `DEFAULT_TIMEOUT_CYCLES` times its period.

        Raises:
            EncodeError: the DBC has no such message.
        """
        timeout_ms = float(_attribute(self.message(name), "GenMsgTimeoutTime", 0))
        return round(timeout_ms / CYCLE_MS) or DEFAULT_TIMEOUT_CYCLES * self.period(name)

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


def dbc_text(dbc: bytes) -> str:
    """Return a DBC file's content as text: UTF-8 with or without a byte order mark, else Windows-1252.

    The format does not specify an encoding. Windows tools write the latter; an undefined byte becomes U+FFFD.
    """
    try:
        text = dbc.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = dbc.decode("cp1252", errors="replace")
    return text.replace("\r\n", "\n")


MOST_DBC_BYTES = 2 * 1024 * 1024
"""Limit on a DBC file, some 20 times the larger one of the bench."""


@lru_cache(maxsize=16)
def _parsed(dbc: bytes) -> tuple[Database, tuple[_Described, ...]]:
    """Return a DBC file's content and the tables of its messages, by identifier.

    Raises:
        BadInput: it is not a valid DBC, or uses features that this codec does not support (see `_describe`).
    """
    if len(dbc) > MOST_DBC_BYTES:
        raise BadInput(f"the DBC file has {len(dbc)} bytes; allowed: at most {MOST_DBC_BYTES}")
    try:
        database = load_string(dbc_text(dbc), database_format="dbc", strict=True)
    except CantoolsError as error:
        raise BadInput(f"not a valid DBC file: {error}") from error
    if not isinstance(database, Database):
        raise BadInput("not a DBC file of a CAN bus")
    described = (_describe(message) for message in database.messages)
    return database, tuple(sorted(described, key=lambda each: each.layout.can_id))


def _describe(message: Message) -> _Described:
    """Return the tables of one message.

    Raises:
        BadInput: a signal is multiplexed, in Motorola byte order, a float of other than 32 bits or without a range; or
            the CRC and AliveCounter of a protected message are not where E2E Profile 1 has them.
    """
    for signal in message.signals:
        _check_codable(message, signal)
    data_id = int(_attribute(message, "E2EDataId", 0))
    if data_id:
        _check_protection(message)
    # Floats are last in what `encode` and `decode` go through, as in logs of all versions.
    ordered = sorted(message.signals, key=lambda signal: bool(signal.is_float))
    fields = {signal.name: _field(signal) for signal in ordered}
    layout = Layout(
        name=message.name,
        can_id=message.frame_id,
        length=message.length,
        data_id=data_id,
        crc_of_id=e2e.crc_of_id(data_id),
        fields=tuple(fields.values()),
        encoded=tuple(each for name, each in fields.items() if not (data_id and name in _E2E_SIGNALS)),
        states=tuple((s.name, frozenset(map(int, s.choices))) for s in message.signals if s.choices),
    )
    bits = tuple(_bits(fields[signal.name]) for signal in message.signals)
    return _Described(layout, bits, _attribute(message, "WallClock", "No") == "Yes")


_E2E_SIGNALS = {e2e.CRC_SIGNAL: (0, 8), e2e.COUNTER_SIGNAL: (8, 4)}
"""First bit and number of bits, as E2E Profile 1 has them."""


def _check_codable(message: Message, signal: Signal) -> None:
    where = f"message {message.name}, signal {signal.name}"
    if signal.byte_order != "little_endian" or message.is_multiplexed():
        raise BadInput(f"{where}: only signals in Intel byte order without multiplexing are supported")
    if signal.is_float and signal.length != 32:
        raise BadInput(f"{where}: a float of {signal.length} bits is not supported; allowed: 32")
    if signal.length > 64:
        raise BadInput(f"{where}: {signal.length} bits are not supported; allowed: up to 64")
    if signal.is_float and (signal.scale != 1 or signal.offset != 0):
        raise BadInput(f"{where}: a float must have scale 1 and offset 0")
    if not signal.scale:
        raise BadInput(f"{where}: its scale is 0")
    if signal.minimum is None or signal.maximum is None:
        raise BadInput(f"{where}: give it a range, [minimum|maximum]")
    if not signal.is_float:
        raw_low = -(1 << signal.length - 1) if signal.is_signed else 0
        raw_high = raw_low + (1 << signal.length) - 1
        ends = ((end - signal.offset) / signal.scale for end in (signal.minimum, signal.maximum))
        if not all(raw_low <= round(raw) <= raw_high for raw in ends):
            raise BadInput(f"{where}: its range does not fit into {signal.length} bits")


def _check_protection(message: Message) -> None:
    for name, (start, length) in _E2E_SIGNALS.items():
        if not any((s.name, s.start, s.length) == (name, start, length) for s in message.signals):
            need = f"a signal {name} of {length} bits at bit {start}"
            raise BadInput(f"message {message.name}: it has an E2EDataId, so it needs {need}")


def _field(signal: Signal) -> Field:
    is_signed = signal.is_signed and not signal.is_float
    return Field(
        signal=signal.name,
        shift=signal.start,
        mask=(1 << signal.length) - 1,
        sign=1 << (signal.length - 1) if is_signed else 0,
        scale=float(signal.scale),
        offset=float(signal.offset),
        low=float(signal.minimum or 0),
        high=float(signal.maximum or 0),
        start=float((signal.raw_initial or 0) * signal.scale + signal.offset),
        is_float=signal.is_float,
    )


def _bits(field: Field) -> SignalBits:
    return SignalBits(
        field.signal, field.shift, field.mask, field.sign, field.scale, field.offset, bool(field.is_float)
    )


def _attribute(message: Message, name: str, absent: float | str) -> float | str:
    """Return an attribute of the message; an ENUM attribute as its text."""
    attribute = message.dbc.attributes.get(name) if message.dbc else None
    if attribute is None:
        return absent
    choices = attribute.definition.choices
    return choices[int(attribute.value)] if choices else attribute.value
