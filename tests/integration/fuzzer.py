"""A stranger on all buses of a bench, in a process of its own and with python-can only: sends whatever it can.

Its argument is JSON: `can` (udp:PORT or vcan), `vehicles`, `seed`, `believed` (also valid frames with nonsense values)
and `pause_s` between two rounds. It prints a line when it begins, and how many frames it has sent when its input ends.
"""

import contextlib
import json
import random
import select
import socket
import sys
import time
from collections.abc import Iterator

import can

from bench.bus.codec import Codec, load_codecs
from bench.bus.e2e import check, protect
from bench.cycle import time_of

GROUP = "239.74.163.2"
ROUND = 40
"""Frames of each bus between two pauses."""


def lengths(dice: random.Random, right: int) -> Iterator[int]:
    """Yield all lengths of a classical frame but the right one, some twice."""
    yield from (length for length in range(9) if length != right)
    yield dice.choice([0, 1])


def message(can_id: int, data: bytes, **more: bool) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False, check=False, **more)


def fd_length(dice: random.Random) -> int:
    return dice.choice([*range(9), 12, 16, 20, 24, 32, 48, 64])


def sync(codec: Codec, command: int, cycle: int) -> can.Message:
    """BenchSync with a good CRC, and consistent."""
    return message(*codec.encode("BenchSync", {"Command": command, "Cycle": cycle, "Time": time_of(cycle)}, cycle))


def refusable(codec: Codec, dice: random.Random, due: set[str]) -> list[can.Message]:
    """Return frames that a bench can tell from those that are due, whatever the cycle."""
    found = []
    for name in codec.names:
        can_id = codec.can_id(name)
        right = codec.message(name).length
        found += [message(can_id, dice.randbytes(length)) for length in lengths(dice, right)]
        found.append(message(can_id, dice.randbytes(fd_length(dice)), is_fd=True))
        found.append(can.Message(arbitration_id=can_id, is_extended_id=False, is_remote_frame=True, dlc=right))
        found.append(can.Message(arbitration_id=can_id, is_extended_id=True, data=dice.randbytes(8)))
        if codec.data_id(name):
            data = dice.randbytes(right)
            if not check(data, codec.data_id(name)):
                found.append(message(can_id, data))
            whole = bytearray(dice.randbytes(dice.choice([2, 3, 7])))
            protect(whole, codec.data_id(name), dice.randrange(15))
            found.append(message(can_id, bytes(whole)))
        if name not in due and not name.startswith("Bench"):
            found.append(message(*codec.encode(name, codec.start_values(name), dice.randrange(15))))
    for _ in range(100):
        can_id = dice.randrange(1 << 11)
        if can_id not in codec.can_ids:
            found.append(message(can_id, dice.randbytes(dice.randrange(9))))
        data = dice.randbytes(dice.randrange(9))
        found.append(can.Message(arbitration_id=dice.randrange(1 << 29), is_extended_id=True, data=data))
    found += [can.Message(is_error_frame=True, arbitration_id=4, dlc=8, data=bytes(8)) for _ in range(5)]
    for command in (0, 1, 2):
        found += [sync(codec, command, dice.choice([90_000, 1_000_000, 16_777_215])) for _ in range(3)]
        found.append(message(*codec.encode("BenchSync", {"Command": command, "Cycle": 70, "Time": 12.0}, 70)))
    found.append(message(*codec.encode("BenchSync", codec.start_values("BenchSync"), 0)))
    for _ in range(10):
        values = {"Identifier": dice.choice(codec.can_ids), "Cycle": dice.randrange(100_000, 1 << 24)}
        found.append(message(*codec.encode("BenchAbsent", values, dice.randrange(15))))
    return found


def believed(codec: Codec, dice: random.Random, due: set[str]) -> list[can.Message]:
    """Return frames as valid as those that are due, with nonsense values."""
    found = []
    for name in due:
        for _ in range(3):
            data = bytearray(dice.randbytes(codec.message(name).length))
            if codec.data_id(name):
                protect(data, codec.data_id(name), dice.randrange(15))
            found.append(message(codec.can_id(name), bytes(data)))
            values = {
                signal.name: dice.choice([signal.minimum, signal.maximum]) for signal in codec.message(name).signals
            }
            found.append(message(*codec.encode(name, values, dice.randrange(15))))
    for _ in range(30):
        values = {"Identifier": codec.can_id(dice.choice(sorted(due))), "Cycle": dice.randrange(100)}
        found.append(message(*codec.encode("BenchAbsent", values, dice.randrange(15))))
    # As of another bench on the same buses, or of the replay of a log, which begins before this bench does.
    found += [sync(codec, command, cycle) for command in (0, 1, 2) for cycle in (0, 0, 1, 2, *range(3, 110, 3))]
    return found


class Ends:
    """Where to send: python-can's buses, and for udp the ports themselves."""

    def __init__(self, address: str, buses: list[str]) -> None:
        self._sock = None
        if address == "vcan":
            self._buses = [can.Bus(interface="socketcan", channel=f"vcan{n}", fd=True) for n in range(len(buses))]
            return
        self._first = int(address.removeprefix("udp:"))
        self._sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        self._buses = [
            can.Bus(interface="udp_multicast", channel=GROUP, port=self._first + n, hop_limit=0)
            for n in range(len(buses))
        ]

    def send(self, number: int, frame: can.Message) -> None:
        # A full queue of a link is no reason to stop.
        with contextlib.suppress(can.CanError):
            self._buses[number].send(frame)

    def close(self) -> None:
        for bus in self._buses:
            bus.shutdown()

    def send_garbage(self, number: int, datagram: bytes) -> None:
        if self._sock is not None:
            self._sock.sendto(datagram, (GROUP, self._first + number))


def main() -> None:
    given = json.loads(sys.argv[1])
    dice = random.Random(given["seed"])
    codecs = load_codecs(given["vehicles"])
    frames: list[list[can.Message]] = []
    for bus, codec in codecs.items():
        due = {
            name
            for name in codec.names
            if not name.startswith("Bench") and (bus != "v2v" or int(name.rpartition("_")[2]) <= given["vehicles"])
        }
        mine = refusable(codec, dice, due) + (believed(codec, dice, due) if given["believed"] else [])
        dice.shuffle(mine)
        frames.append(mine)
    ends = Ends(given["can"], list(codecs))
    sys.stdout.write("sending\n")
    sys.stdout.flush()
    at, sent = 0, 0
    while not select.select([sys.stdin], [], [], 0)[0]:
        for number, mine in enumerate(frames):
            for offset in range(ROUND):
                ends.send(number, mine[(at + offset) % len(mine)])
            ends.send_garbage(number, dice.randbytes(dice.randrange(200)))
            sent += ROUND + 1
        at += ROUND
        time.sleep(given["pause_s"])
    ends.close()
    sys.stdout.write(f"sent {sent}\n")


if __name__ == "__main__":
    main()
