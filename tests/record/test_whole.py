"""Which recorded frames are whole: the same that the conductor's gate lets pass."""

import random

import numpy as np

from bench.bus.codec import load_codecs
from bench.conductor.refusals import Refusals
from bench.record.frame_table import FRAME_TABLE
from bench.record.whole import whole

CODECS = load_codecs(2)


def test_whole_is_what_the_gate_lets_pass() -> None:
    dice, gate = random.Random(3), Refusals(CODECS)
    for bus, codec in CODECS.items():
        frames = []
        for name in codec.names * 20:
            can_id, data = codec.encode(name, codec.start_values(name), dice.randrange(20))
            frames.append((can_id, data))
            frames.append((can_id, data[: dice.randrange(9)]))
            frames.append((dice.choice([can_id, dice.randrange(1 << 11)]), dice.randbytes(8)))
        table = np.zeros(len(frames), FRAME_TABLE)
        for row, (can_id, data) in zip(table, frames, strict=True):
            row["can_id"], row["length"] = can_id, len(data)
            row["data"][: len(data)] = list(data)
        expected = [gate.flaw(bus, can_id, data) is None for can_id, data in frames]
        assert whole(table, codec).tolist() == expected
        assert 0 < sum(expected) < len(expected)
