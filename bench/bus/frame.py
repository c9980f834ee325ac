"""A classical CAN data frame, as links give it and codecs make it, and the same with the bus that it is on.

Identifiers of 29 bits have the bit `bench.bus.link.base.EXTENDED` set.
"""

from typing import NamedTuple


class CanFrame(NamedTuple):
    """Identifier and up to 8 bytes of data."""

    can_id: int
    data: bytes


class BusFrame(NamedTuple):
    """A frame on the bus of this name."""

    bus: str
    can_id: int
    data: bytes


class RefusedFrame(BusFrame):
    """One that does not belong to the run: the log has it as it came, undecoded."""

    __slots__ = ()
