"""The place of one bus: a python-can interface and a channel, written as on the command line.

udp                       python-can's udp_multicast on this host, on a port that no other bench uses
udp:PORT                  the same on a fixed port
udp:PORT@DEVICE           the same on the network device DEVICE, also to other hosts on that network
vcan                      SocketCAN's vcan{}
direct                    inside one process
IFACE:CHANNEL             any other python-can interface: socketcan:can0, pcan:PCAN_USBBUS1
IFACE:CHANNEL?KEY=VALUE   the same with parameters, more of them after &: slcan:/dev/ttyACM0?tty_baudrate=115200

In a channel, {} is replaced by the number of the bus.
"""

import re
from dataclasses import dataclass, replace

from bench.errors import BadInput

ALLOWED = (
    "allowed: udp, udp:PORT, udp:PORT@DEVICE, vcan, direct, IFACE:CHANNEL (any python-can interface, e.g. "
    "socketcan:can{}, pcan:PCAN_USBBUS1)"
)
FIRST_USER_PORT, LAST_PORT = 1024, 65535

_NUMBER = "{}"
_UDP = "udp_multicast"
_DEVICE = re.compile(r"[^\s/:@]{1,15}")
_OPTIONS = re.compile(r"\w+=[^&?]*(&\w+=[^&?]*)*")


@dataclass(frozen=True, slots=True)
class Place:
    """The place of a bus.

    Attributes:
        interface: python-can's name of the interface (udp_multicast, socketcan, pcan, ...), or `direct`.
        channel: its channel, {} in place of the number of the bus; empty for udp_multicast and `direct`.
        port: UDP port, for udp_multicast; None until one is reserved.
        device: network device that sends udp_multicast's frames; empty if they stay on this host.
        options: further parameters for python-can's `Bus`, as typed.
    """

    interface: str
    channel: str = ""
    port: int | None = None
    device: str = ""
    options: tuple[tuple[str, str], ...] = ()

    @classmethod
    def parse(cls, text: str, given: str = "") -> "Place":
        """Parse a place in one of the forms above; messages quote `given` if it differs from `text`.

        Raises:
            BadInput: it has none of these forms.
        """
        given = given or text
        if text == "vcan":
            return cls("socketcan", f"vcan{_NUMBER}")
        if text == "direct":
            return cls("direct")
        interface, _, channel = text.partition(":")
        if text == "udp" or (interface == "udp" and channel):
            return cls._parse_udp(given, channel)
        if not (interface and channel):
            raise BadInput(f"{given}: not a bus; {ALLOWED}")
        # With python-can's own name for `udp` the channel is a group, but the bench needs ports.
        if interface == _UDP or not _is_interface(interface):
            raise BadInput(f"{given}: no such interface; {ALLOWED}")
        channel, mark, options = channel.partition("?")
        if mark and not (channel and _OPTIONS.fullmatch(options)):
            raise BadInput(f"{given}: after ? give KEY=VALUE, further ones after &")
        if options and interface == "socketcan":
            raise BadInput(f"{given}: a CAN link of the kernel takes no parameters here; set it up with `ip link set`")
        pairs = (option.partition("=") for option in options.split("&")) if options else ()
        return cls(interface, channel, options=tuple((key, value) for key, _, value in pairs))

    @classmethod
    def _parse_udp(cls, given: str, channel: str) -> "Place":
        if not channel:
            return cls(_UDP)
        port, mark, device = channel.partition("@")
        if not (re.fullmatch(r"[0-9]{1,5}", port) and FIRST_USER_PORT <= int(port) <= LAST_PORT):
            raise BadInput(f"{given}: PORT must be a whole number from {FIRST_USER_PORT} to {LAST_PORT}")
        if mark and not _DEVICE.fullmatch(device):
            raise BadInput(f"{given}: after @ give the name of a network device, as listed by `ip link`")
        return cls(_UDP, port=int(port), device=device)

    @property
    def is_udp(self) -> bool:
        """Whether the bus is python-can's udp_multicast."""
        return self.interface == _UDP

    @property
    def numbered(self) -> bool:
        """Whether the channel depends on the number of the bus."""
        return _NUMBER in self.channel

    def of_number(self, number: int) -> "Place":
        """Return the place with the number of a bus inserted in its channel."""
        return replace(self, channel=self.channel.replace(_NUMBER, str(number)))

    def __str__(self) -> str:
        """Return the text that `parse` reads."""
        if self.is_udp:
            port = "" if self.port is None else f":{self.port}"
            return f"udp{port}{'@' if self.device else ''}{self.device}"
        if self.interface == "direct":
            return "direct"
        if (self.interface, self.channel) == ("socketcan", f"vcan{_NUMBER}"):
            return "vcan"
        options = "&".join(f"{key}={value}" for key, value in self.options)
        return f"{self.interface}:{self.channel}{'?' if options else ''}{options}"


def _is_interface(name: str) -> bool:
    """Return whether python-can has an interface of this name."""
    if name == "socketcan":
        return True
    # Imported here: the bench's own buses do not need python-can.
    from can.interfaces import VALID_INTERFACES

    return name in VALID_INTERFACES
