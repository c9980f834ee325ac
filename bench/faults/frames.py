"""Faults of frames in transmission: lost, late, duplicated, swapped, corrupted, or with a stuck counter."""

from collections.abc import Sequence
from random import Random
from typing import Annotated, Literal

from pydantic import BaseModel, Field

from bench.faults.base import (
    LOST,
    ON_TIME,
    Bench,
    BusName,
    Fault,
    FrameContext,
    Memory,
    Passage,
    Probability,
    Problem,
)
from bench.faults.profile import STRICT

Chance = Annotated[float, Field(ge=0, le=1)]


class FrameFault(Fault):
    """A fault in the frames of one message, or of all messages on a bus.

    Attributes:
        bus: v2v or veh<i>.
        message: name in the DBC; all messages except the bench's own if not given.
    """

    bus: BusName
    message: str | None = None

    def hits(self, bus: str, message: str) -> bool:
        """See `Fault`."""
        return self.bus == bus and self.message in (None, message)

    def problems(self, bench: Bench) -> list[Problem]:
        """See `Fault`."""
        if self.bus not in bench.buses:
            return [(("bus",), f"= {self.bus} does not exist; allowed: {', '.join(bench.buses)}")]
        if self.message is None:
            return []
        known = self.messages(bench)
        if self.message not in known:
            text = (
                f"= {self.message} is not a message on {self.bus} that can have this fault; allowed: {', '.join(known)}"
            )
            return [(("message",), text)]
        return self.message_problems(self.message, bench)

    def messages(self, bench: Bench) -> Sequence[str]:
        """Return the messages on its bus that can have this fault."""
        return list(bench.senders(self.bus))

    def message_problems(self, message: str, bench: Bench) -> list[Problem]:
        """Return further problems of a target whose `message` can have this fault."""
        return []


class GilbertElliott(BaseModel):
    """Burst losses (Gilbert-Elliott): a channel that is good or bad, and may change from frame to frame.

    Attributes:
        to_bad: probability that a good channel turns bad for the next frame.
        to_good: probability that a bad channel turns good for the next frame; mean burst length 1 / to_good frames.
        loss_good: probability that a good channel loses a frame.
        loss_bad: probability that a bad channel loses a frame.
    """

    model_config = STRICT

    to_bad: Probability
    to_good: Probability
    loss_good: Chance = 0.0
    loss_bad: Chance = 1.0

    def loses(self, memory: Memory, dice: Random) -> bool:
        """Return whether the channel loses the next frame."""
        was_bad = memory.get("bad", False)
        is_bad = was_bad != (dice.random() < (self.to_good if was_bad else self.to_bad))
        memory["bad"] = is_bad
        return dice.random() < (self.loss_bad if is_bad else self.loss_good)


class FrameLoss(FrameFault):
    """Frames are lost: independently (Bernoulli), or in bursts if `bursts` is given.

    Attributes:
        probability: probability that a frame is lost, without `bursts`.
        bursts: a channel that loses frames in bursts.
    """

    kind: Literal["frame_loss"] = "frame_loss"
    probability: Probability = 1.0
    bursts: GilbertElliott | None = None

    def passage(self, data: bytes, frame: FrameContext, memory: Memory) -> Passage:
        """See `Fault`."""
        dice = frame.dice()
        lost = self.bursts.loses(memory, dice) if self.bursts else dice.random() < self.probability
        return LOST if lost else ON_TIME


class FrameDelay(FrameFault):
    """Frames arrive `cycles` cycles late, and up to `jitter_cycles` more, uniformly distributed.

    Attributes:
        cycles: delay in cycles of 10 ms.
        jitter_cycles: largest additional delay in cycles of 10 ms.
    """

    kind: Literal["frame_delay"] = "frame_delay"
    cycles: Annotated[int, Field(ge=0, le=100)] = 1
    jitter_cycles: Annotated[int, Field(ge=0, le=100)] = 0

    def passage(self, data: bytes, frame: FrameContext, memory: Memory) -> Passage:
        """See `Fault`."""
        return Passage(late=self.cycles + frame.dice().randint(0, self.jitter_cycles))


class FrameDuplicate(FrameFault):
    """Frames arrive more than once.

    Attributes:
        copies: number of additional copies.
        probability: probability that a frame is duplicated.
    """

    kind: Literal["frame_duplicate"] = "frame_duplicate"
    copies: Annotated[int, Field(ge=1, le=10)] = 1
    probability: Probability = 1.0

    def extra(self, frame: FrameContext) -> int:
        """See `Fault`."""
        return self.copies if frame.dice().random() < self.probability else 0


class FrameReorder(FrameFault):
    """Every other frame arrives after the one that follows it."""

    kind: Literal["frame_reorder"] = "frame_reorder"

    def passage(self, data: bytes, frame: FrameContext, memory: Memory) -> Passage:
        """See `Fault`."""
        if not self.extra(frame):
            memory["held"] = data
            return LOST
        held = memory.pop("held", None)
        return ON_TIME if held is None else Passage(behind=(held,))

    def extra(self, frame: FrameContext) -> int:
        """See `Fault`; the second frame of each pair goes first."""
        return (frame.cycle - frame.first) % 2


class FrameCorrupt(FrameFault):
    """Bits of a frame flip in transmission, after its CRC was computed.

    Attributes:
        bits: number of bits that flip.
        probability: probability that a frame is corrupted.
    """

    kind: Literal["frame_corrupt"] = "frame_corrupt"
    bits: Annotated[int, Field(ge=1, le=64)] = 1
    probability: Probability = 1.0

    def on_bytes(self, data: bytes, frame: FrameContext) -> bytes:
        """See `Fault`."""
        dice = frame.dice()
        if dice.random() >= self.probability:
            return data
        word = int.from_bytes(data, "little")
        for bit in dice.sample(range(8 * len(data)), min(self.bits, 8 * len(data))):
            word ^= 1 << bit
        return word.to_bytes(len(data), "little")


class CounterStuck(FrameFault):
    """The alive counter is stuck, with a valid CRC: a sender that has stopped computing.

    Attributes:
        message: name in the DBC.
    """

    kind: Literal["counter_stuck"] = "counter_stuck"
    message: str

    def message_problems(self, message: str, bench: Bench) -> list[Problem]:
        """See `FrameFault`."""
        if bench.has_counter(self.bus, message):
            return []
        return [(("message",), f"= {message} has no alive counter")]

    def counter(self, frame: FrameContext) -> int:
        """See `Fault`."""
        return frame.first
