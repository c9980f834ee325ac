"""The CAN links of the Linux kernel: which are missing, and bringing up the virtual ones (vcan)."""

import socket
import subprocess
from collections.abc import Collection, Iterable
from pathlib import Path

from bench.errors import BadInput

BIT_RATE = 500_000
"""Bits per second, as in the DBC files; a real link is set up with it."""

_VIRTUAL = "vcan"


def require_links(channels: Collection[str]) -> None:
    """See to it that the kernel has SocketCAN and that all these links are up; make the virtual ones where permitted.

    What is made stays: other tools, and the next run, use the same links, whatever becomes of this process.

    Raises:
        BadInput: something is missing and cannot be made; the message says what to type for all of it.
    """
    if any(map(commands_for, channels)):
        make_links(channels)
    check_links(channels)


def check_links(channels: Iterable[str]) -> None:
    """Check that the kernel has SocketCAN and all these links, and that they are up.

    Raises:
        BadInput: something is missing; the message says what to type for all of it.
    """
    commands = "".join(f"\n  sudo ip {command}" for channel in channels for command in commands_for(channel))
    problem = lack_of_can()
    if problem:
        raise BadInput(
            f"this kernel has no SocketCAN loaded ({problem}); use --can udp, put `platoon vcan` before the command, "
            f"or type:\n  sudo modprobe -a can_raw vcan{commands}\n"
            "and where there is no such module, on Ubuntu first:\n"
            "  sudo apt-get install linux-modules-extra-$(uname -r)"
        )
    if commands:
        raise BadInput(f"not all CAN links are there and up; type:{commands}")


def make_links(channels: Iterable[str]) -> None:
    """Make the virtual links that are missing and bring them up, as far as that is permitted (root, CAP_NET_ADMIN)."""
    commands = [command for channel in channels if channel.startswith(_VIRTUAL) for command in commands_for(channel)]
    try:
        # One process for all of them; -force goes on after a link that another bench has made meanwhile.
        subprocess.run(["ip", "-force", "-batch", "-"], input="\n".join(commands).encode(), capture_output=True)
    except FileNotFoundError:
        # Without iproute2 the links stay missing, which is found by who checks them.
        return


def lack_of_can() -> str:
    """Return why no CAN socket can be opened; empty where it can. As root this loads the module, if there is one."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        return error.strerror or str(error)
    return ""


def commands_for(channel: str) -> list[str]:
    """Return what `ip` is to be told to bring a link up; empty where it is up."""
    flags = Path("/sys/class/net") / channel / "flags"
    if channel.startswith(_VIRTUAL):
        commands = [f"link add {channel} type vcan", f"link set {channel} up"]
    else:
        commands = [f"link set {channel} up type can bitrate {BIT_RATE}"]
    if not flags.exists():
        return commands
    is_up = int(flags.read_text(), 16) & 1
    return [] if is_up else commands[-1:]
