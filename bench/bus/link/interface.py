"""Any other interface of python-can, by python-can's own calls: CAN hardware of all makers."""

from typing import Any

import can
from can.util import cast_from_string

from bench.bus.frame import CanFrame
from bench.bus.link.base import EXTENDED, MOST_FRAMES, Link, LinkError
from bench.bus.link.place import Place
from bench.errors import BadInput
from bench.events import Refusal


class InterfaceLink(Link):
    """A link over a python-can bus, which it takes over and closes."""

    def __init__(self, name: str, bus: can.BusABC) -> None:
        """Take over `bus`.

        Raises:
            BadInput: it has no file descriptor to wait on.
        """
        super().__init__(name)
        self._bus = bus
        try:
            bus.fileno()
        except NotImplementedError as error:
            self.close()
            raise BadInput(
                f"bus {name}: {type(bus).__name__} has no file descriptor to wait on, which the bench needs"
            ) from error

    def send(self, can_id: int, data: bytes) -> None:
        """See `Link`."""
        message = can.Message(
            arbitration_id=can_id & ~EXTENDED, data=data, is_extended_id=can_id >= EXTENDED, check=False
        )
        try:
            self._bus.send(message)
        except can.CanError as error:
            raise LinkError(f"bus {self.name}: frame 0x{can_id:03X} cannot be sent: {error}") from error

    def receive(self) -> list[CanFrame]:
        """See `Link`."""
        frames: list[CanFrame] = []
        for _ in range(MOST_FRAMES):
            try:
                message = self._bus.recv(timeout=0)
            except can.CanError as error:
                raise LinkError(f"bus {self.name}: no frames can be received: {error}") from error
            if message is None:
                break
            can_id = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
            why = _other_than_data(message)
            if why is None:
                frames.append(CanFrame(can_id, bytes(message.data)))
            else:
                self._ignore(why, None if why is Refusal.ERROR else can_id)
        return frames

    def fileno(self) -> int:
        """See `Link`."""
        return int(self._bus.fileno())

    def frames_lost(self) -> int:
        """Return 0: python-can does not report lost frames."""
        return 0

    def close(self) -> None:
        """See `Link`."""
        self._bus.shutdown()


def _other_than_data(message: can.Message) -> Refusal | None:
    """Return what a message is if it is not a classical data frame."""
    if message.is_error_frame:
        return Refusal.ERROR
    if message.is_remote_frame:
        return Refusal.REMOTE
    if message.is_fd:
        return Refusal.FD
    return Refusal.MALFORMED if len(message.data) > 8 else None


def open_interface(name: str, place: Place, bit_rate: int) -> InterfaceLink:
    """Join the bus `name` at a place of python-can, at `bit_rate` bit/s unless the place's options set another.

    Raises:
        BadInput: python-can cannot open it, or it has no file descriptor to wait on.
    """
    options: dict[str, Any] = {"bitrate": bit_rate} | {key: cast_from_string(value) for key, value in place.options}
    try:
        bus = can.Bus(interface=place.interface, channel=place.channel, **options)
    except Exception as error:
        raise BadInput(f"bus {name}: python-can cannot open {place}: {error}") from error
    return InterfaceLink(name, bus)
