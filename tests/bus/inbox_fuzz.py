"""Gives an inbox frames of all kinds and prints a digest of all that it made of them: `python -m tests.bus.inbox_fuzz`.

Arguments: the number of frames, the seed. Run compiled and interpreted, it must print the same.
"""

import hashlib
import random
import sys

from bench.compiled.finder import install

install()

from bench.bus.codec import Codec, load_codecs  # noqa: E402 - after the machine code is found
from bench.bus.e2e import protect  # noqa: E402
from bench.bus.inbox import Inbox  # noqa: E402
from bench.bus.link.base import EXTENDED  # noqa: E402
from bench.bus.link.direct import DirectLink, Hub  # noqa: E402
from bench.bus.topic import Topic  # noqa: E402

BUSES = ("veh1", "v2v")
INPUTS = (
    *(Topic("veh1", name) for name in ("VehiclePosition", "VehicleMotion", "Reference", "ActuatorStatus")),
    *(Topic("v2v", name) for name in ("V2VPosition_2", "V2VMotion_2", "V2VStatus_2")),
)
OWN = (Topic("veh1", "SteeringCommand"), Topic("veh1", "TorqueCommandFront"))
FRAMES_A_CYCLE = 40


class Unselective(DirectLink):
    """Gives the inbox everything, as links to which a selection is only a hint may."""

    def select(self, can_ids: object) -> None:
        """Receive all identifiers."""


def any_frame(dice: random.Random, codec: Codec, cycle: int) -> tuple[int, bytes]:
    """A frame that is random, or good but for a part of it."""
    can_id = dice.choice(codec.can_ids)
    kind = dice.randrange(6)
    if kind == 0:
        return dice.randrange(1 << 29) | (EXTENDED if dice.random() < 0.5 else 0), dice.randbytes(dice.randrange(9))
    if kind == 1:
        return can_id, dice.randbytes(dice.choice((0, 1, 2, 7, 8, 8, 8, 9, 64)))
    name = codec.name_of(can_id) or ""
    data_id = codec.data_id(name)
    data = bytearray(dice.randbytes(8))
    if data_id:
        protect(data, data_id, cycle + dice.choice((-2, -1, 0, 0, 0, 1, 2, 7)))
    if kind == 2:
        data[dice.randrange(8)] ^= 1 << dice.randrange(8)
    return can_id, bytes(data)


def digest(frames: int, seed: int) -> tuple[int, int, str]:
    """Return the number of steps, that of frames refused, and a hash of all states and of every step's inputs."""
    dice, codecs, hub = random.Random(seed), load_codecs(2), Hub()
    far = {bus: DirectLink(bus, hub) for bus in BUSES}
    now = [0.0]
    inbox = Inbox(
        {bus: Unselective(bus, hub) for bus in BUSES},
        codecs,
        INPUTS,
        name="veh1.planner",
        own=OWN,
        clock=lambda: now[0],
    )
    hashed = hashlib.sha256()
    sent = cycle = steps = 0
    while sent < frames:
        now[0] = cycle / 100
        for bus in BUSES:
            sync = {"Command": 2 if seed % 2 else 1, "Cycle": cycle, "Time": cycle / 100}
            far[bus].send(*codecs[bus].encode("BenchSync", sync, cycle))
        for topic in INPUTS:
            if dice.random() < 0.9:
                codec = codecs[topic.bus]
                values = {name: dice.uniform(low, high) for name, low, high in codec.ranges(topic.message)}
                far[topic.bus].send(*codec.encode(topic.message, values, cycle - topic.delay))
            else:
                absent = {"Identifier": codecs[topic.bus].can_id(topic.message), "Cycle": cycle - topic.delay}
                far[topic.bus].send(*codecs[topic.bus].encode("BenchAbsent", absent, cycle))
        for _ in range(FRAMES_A_CYCLE):
            bus = dice.choice(BUSES)
            far[bus].send(*any_frame(dice, codecs[bus], cycle))
        sent += FRAMES_A_CYCLE + len(INPUTS) + len(BUSES)
        cycle += 1
        inbox.drain()
        inbox.catch_up()
        state = (inbox.cycle, inbox.opened, inbox.settled, inbox.stopped, inbox.late, inbox.complete, inbox.excused)
        hashed.update(repr((state, inbox.opened_at, inbox.health)).encode())
        if inbox.complete or dice.random() < 0.5:
            steps += 1
            hashed.update(repr(inbox.take()).encode())
    return steps, inbox.health.e2e_errors, hashed.hexdigest()


if __name__ == "__main__":
    sys.stdout.write(" ".join(map(str, digest(int(sys.argv[1]), int(sys.argv[2])))) + "\n")
