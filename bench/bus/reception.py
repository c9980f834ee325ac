"""State and age of a message's reception."""

from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import NamedTuple

from bench.bus.topic import Topic


class ReceptionState(IntEnum):
    """State of the reception of one message; the values are those of the bus signals that show it."""

    INIT = 0
    """No frame has arrived yet, and the timeout is not over."""
    OK = 1
    """This cycle's frame has arrived and is valid."""
    MISSING = 2
    """This cycle's frame is missing; the timeout is not over."""
    REPEATED = 3
    """The counter is that of the previous frame: a repeated frame."""
    WRONG_SEQUENCE = 4
    """The counter jumped by more than the elapsed cycles allow."""
    ERROR = 5
    """Wrong CRC, invalid counter or wrong length."""
    LOST = 6
    """No valid frame within the message's timeout."""


class Reception(NamedTuple):
    """The reception of one input.

    Attributes:
        state: state in the current cycle.
        age: cycles since the last valid frame, 0 is this cycle; before the first one, since the start.
    """

    state: ReceptionState = ReceptionState.INIT
    age: int = 0

    @property
    def lost(self) -> bool:
        """Whether the message's timeout is over."""
        return self.state is ReceptionState.LOST


class Health(NamedTuple):
    """State of a node's buses since its start.

    Attributes:
        frames_lost: number of frames that the kernel dropped before this node could read them.
        e2e_errors: number of received frames with a wrong CRC or an alive counter out of sequence.
        late_cycles: number of cycles this node has skipped in real time because it was late.
        inputs: reception of each input.
    """

    frames_lost: int = 0
    e2e_errors: int = 0
    late_cycles: int = 0
    inputs: Mapping[Topic, Reception] = MappingProxyType({})

    def of(self, topic: Topic) -> Reception:
        """Return an input's reception; a topic that is not watched is as before the first frame."""
        return self.inputs.get(topic, _UNWATCHED)


_UNWATCHED = Reception()
