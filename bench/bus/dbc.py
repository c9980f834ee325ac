"""Reads DBC files with cantools, which takes a quarter of a second to load: imported only if nothing is kept."""

import math
from functools import lru_cache

from cantools.database import load_string
from cantools.database.can import Database, Message, Signal
from cantools.database.errors import Error as CantoolsError

from bench.bus.description import BusDescription, MessageDescription, SignalDescription
from bench.bus.e2e import COUNTER_SIGNAL, CRC_SIGNAL
from bench.errors import BadInput

MOST_DBC_BYTES = 2 * 1024 * 1024
"""Limit on a DBC file, some 20 times the larger one of the bench."""


def dbc_text(dbc: bytes) -> str:
    """Return a DBC file's content as text: UTF-8 with or without a byte order mark, else Windows-1252.

    The format does not specify an encoding. Windows tools write the latter; an undefined byte becomes U+FFFD.
    """
    try:
        text = dbc.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = dbc.decode("cp1252", errors="replace")
    return text.replace("\r\n", "\n")


@lru_cache(maxsize=16)
def database_of(dbc: bytes) -> Database:
    """Return a DBC file's content as cantools reads it.

    Raises:
        BadInput: it is not a valid DBC.
    """
    if len(dbc) > MOST_DBC_BYTES:
        raise BadInput(f"the DBC file has {len(dbc)} bytes; allowed: at most {MOST_DBC_BYTES}")
    try:
        database = load_string(dbc_text(dbc), database_format="dbc", strict=True)
    except CantoolsError as error:
        raise BadInput(f"not a valid DBC file: {error}") from error
    if not isinstance(database, Database):
        raise BadInput("not a DBC file of a CAN bus")
    return database


def describe(dbc: bytes) -> BusDescription:
    """Return what a DBC file says.

    Raises:
        BadInput: it is not a valid DBC, or has what the codec does not support: a signal is multiplexed, in Motorola
            byte order, a float of other than 32 bits or without a range; the CRC and AliveCounter of a protected
            message are not where E2E Profile 1 has them; an attribute that the bench needs is not a number.
    """
    database = database_of(dbc)
    attribute = database.dbc.attributes.get("Baudrate") if database.dbc else None
    bit_rate = int(_number("the bus", "Baudrate", attribute.value if attribute else 0))
    messages = (_message(message) for message in database.messages)
    return BusDescription(bit_rate, tuple(sorted(messages, key=lambda each: each.can_id)))


def _message(message: Message) -> MessageDescription:
    for signal in message.signals:
        _check_codable(message, signal)
    data_id = int(_number_of(message, "E2EDataId"))
    if data_id:
        _check_protection(message)
    return MessageDescription(
        name=message.name,
        can_id=message.frame_id,
        is_extended=message.is_extended_frame,
        length=message.length,
        senders=tuple(message.senders),
        receivers=tuple(sorted(message.receivers)),
        cycle_time_ms=message.cycle_time or 0,
        timeout_ms=_number_of(message, "GenMsgTimeoutTime"),
        data_id=data_id,
        is_wall_clock=_attribute(message, "WallClock", "No") == "Yes",
        comment=message.comment or "",
        signals=tuple(_signal(message, signal) for signal in message.signals),
    )


def _signal(message: Message, signal: Signal) -> SignalDescription:
    rate = signal.dbc.attributes.get("GenSigRateMax") if signal.dbc else None
    where = f"message {message.name}, signal {signal.name}"
    return SignalDescription(
        name=signal.name,
        start_bit=signal.start,
        length=signal.length,
        is_signed=bool(signal.is_signed),
        is_float=bool(signal.is_float),
        scale=float(signal.scale),
        offset=float(signal.offset),
        low=float(signal.minimum or 0),
        high=float(signal.maximum or 0),
        start=float((signal.raw_initial or 0) * signal.scale + signal.offset),
        most_change_per_s=_number(where, "GenSigRateMax", rate.value if rate is not None else 0),
        choices=tuple((int(number), str(text)) for number, text in (signal.choices or {}).items()),
        unit=signal.unit or "",
        comment=signal.comment or "",
    )


E2E_SIGNALS = {CRC_SIGNAL: (0, 8), COUNTER_SIGNAL: (8, 4)}
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
    for name, (start, length) in E2E_SIGNALS.items():
        if not any((s.name, s.start, s.length) == (name, start, length) for s in message.signals):
            need = f"a signal {name} of {length} bits at bit {start}"
            raise BadInput(f"message {message.name}: it has an E2EDataId, so it needs {need}")


def _number_of(message: Message, name: str) -> float:
    return _number(f"message {message.name}", name, _attribute(message, name, 0))


def _number(where: str, name: str, value: float | str) -> float:
    """Return the value of an attribute that is a number.

    Raises:
        BadInput: it is none.
    """
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise BadInput(f"{where}: attribute {name} = {value!r} is not a number")
    return number


def _attribute(message: Message, name: str, absent: float | str) -> float | str:
    """Return an attribute of the message; an ENUM attribute as its text."""
    attribute = message.dbc.attributes.get(name) if message.dbc else None
    if attribute is None:
        return absent
    choices = attribute.definition.choices
    return choices[int(attribute.value)] if choices else attribute.value
