"""The CAN links of the Linux kernel: finding missing ones, and bringing up the virtual ones (vcan)."""

import socket
import subprocess
from collections.abc import Collection, Iterable
from pathlib import Path

from bench.errors import BadInput

BIT_RATE = 500_000
"""Bits per second of a real link, as in the DBC files."""

_VIRTUAL = "vcan"


def require_links(channels: Collection[str]) -> None:
    """Ensure that the kernel has SocketCAN and that all these links are up; create the virtual ones if permitted.

    The links remain when this process ends: other tools and the next run use them.

    Raises:
        BadInput: something is missing and cannot be created; the message lists the commands that create it.
    """
    if any(map(commands_for, channels)):
        make_links(channels)
    check_links(channels)


def check_links(channels: Iterable[str]) -> None:
    """Check that the kernel has SocketCAN and all these links, and that they are up.

    Raises:
        BadInput: something is missing; the message lists the commands that create it.
    """
    commands = "".join(f"\n  sudo ip {command}" for channel in channels for command in commands_for(channel))
    problem = lack_of_can()
    if problem:
        raise BadInput(
            f"this kernel has no SocketCAN loaded ({problem}); use --can udp, put `platoon vcan` before the command, "
            f"or type:\n  sudo modprobe -a can_raw vcan{commands}\n"
            "if the module does not exist, on Ubuntu first:\n"
            "  sudo apt-get install linux-modules-extra-$(uname -r)"
        )
    if commands:
        raise BadInput(f"not all CAN links exist and are up; type:{commands}")


def make_links(channels: Iterable[str]) -> None:
    """Create missing virtual links and bring them up, if permitted (root, CAP_NET_ADMIN)."""
    commands = [command for channel in channels if channel.startswith(_VIRTUAL) for command in commands_for(channel)]
    try:
        # One process for all of them; -force continues after a link that another bench has created meanwhile.
        subprocess.run(["ip", "-force", "-batch", "-"], input="\n".join(commands).encode(), capture_output=True)
    except FileNotFoundError:
        # Without iproute2 the links stay missing; `check_links` reports them.
        return


def lack_of_can() -> str:
    """Return why a CAN socket cannot be opened; empty if it can. As root this loads the module, if it exists."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        return error.strerror or str(error)
    return ""


def commands_for(channel: str) -> list[str]:
    """Return the arguments of `ip` that bring a link up; empty if it is up."""
    flags = Path("/sys/class/net") / channel / "flags"
    if channel.startswith(_VIRTUAL):
        commands = [f"link add {channel} type vcan", f"link set {channel} up"]
    else:
        commands = [f"link set {channel} up type can bitrate {BIT_RATE}"]
    if not flags.exists():
        return commands
    is_up = int(flags.read_text(), 16) & 1
    return [] if is_up else commands[-1:]
