"""What a receiver knows of each message it takes: the state of its reception and its age."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

from bench.bus.topic import Topic


class ReceptionState(IntEnum):
    """State of the reception of one message; the values are those of the bus signals that show it."""

    INIT = 0
    """None has come yet, nor been due for longer than its timeout."""
    OK = 1
    """This cycle's frame came and is good."""
    MISSING = 2
    """This cycle's frame did not come; the timeout is not over."""
    REPEATED = 3
    """What came carries the counter of the frame before: an old frame again."""
    WRONG_SEQUENCE = 4
    """More frames are missing in between than cycles went by."""
    ERROR = 5
    """Wrong CRC, impossible counter or wrong length."""
    LOST = 6
    """No good frame for the message's timeout."""


@dataclass(frozen=True, slots=True)
class Reception:
    """How one input is received.

    Attributes:
        state: of the cycle that is being stepped.
        age: cycles since the last good frame, 0 is this cycle; before the first one, since the start.
    """

    state: ReceptionState = ReceptionState.INIT
    age: int = 0

    @property
    def lost(self) -> bool:
        """Whether the message's timeout is over."""
        return self.state is ReceptionState.LOST


@dataclass(frozen=True, slots=True)
class Health:
    """What a node knows about its buses since it started.

    Attributes:
        frames_lost: frames that the kernel dropped before this node could read them.
        e2e_errors: received frames with a wrong CRC or an alive counter out of sequence.
        late_cycles: cycles this node has left out in real time, as it was late for them.
        inputs: how each input is received.
    """

    frames_lost: int = 0
    e2e_errors: int = 0
    late_cycles: int = 0
    inputs: Mapping[Topic, Reception] = field(default_factory=dict)

    def of(self, topic: Topic) -> Reception:
        """Return how an input is received; a topic that is not watched is as before the first frame."""
        return self.inputs.get(topic, _UNWATCHED)


_UNWATCHED = Reception()
