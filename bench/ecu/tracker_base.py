"""The base of one's own tracker: it is called with the motion and the reference, and answers with a command."""

from abc import abstractmethod
from collections.abc import Iterable
from typing import ClassVar, final

from bench.bus.quantities import MOTION, REFERENCE, Command, Motion, Reference
from bench.bus.states import CommandState, EcuState, ReferenceState
from bench.bus.topic import Outgoing, Topic
from bench.ecu.ecu_base import EcuBase
from bench.ecu.limits import timeout_cycles


class TrackerBase(EcuBase):
    """A tracker: what makes the vehicle follow the reference.

    It calls `control` in every cycle in which the own motion is known, with the newest reference. States, on the bus in
    `TrackerStatus`: *init* until the first reference; *run*; *degraded* while the reference is missing or its
    state is None (the last one is held for the message's timeout in the DBC), or marked as degraded; *safe* while the
    own motion is missing or there is no reference any more. In *init* and *safe* the commands say that they are not to
    be used: the actuators hold what they have, then go to their safe state.
    """

    role: ClassVar[str] = "tracker"

    _reference: Reference | None = None
    _held_cycles = 0

    @abstractmethod
    def control(self, motion: Motion, reference: Reference) -> Command:
        """Return this cycle's command.

        The outcome must follow from the arguments and earlier calls alone: no clock, no I/O.
        """

    def _own_inputs(self) -> Iterable[Topic]:
        return self._topic(MOTION), self._topic(REFERENCE)

    @final
    def _work(self) -> tuple[list[Outgoing], EcuState]:
        state = self._listen()
        motion = self.received(MOTION)
        if motion is None and state is not EcuState.INIT:
            state = EcuState.SAFE
        command, validity = Command(), CommandState.NONE
        if motion is not None and self._reference is not None and state is not EcuState.SAFE:
            command = self.control(Motion.read(motion), self._reference)
            validity = CommandState.VALID if state is EcuState.RUN else CommandState.DEGRADED
        return self._outgoing(command.messages(validity)), state

    def _listen(self) -> EcuState:
        """Take in the reference; the state that follows from it."""
        frame = self.received(REFERENCE)
        if frame is not None and frame["ReferenceState"] != ReferenceState.NONE:
            self._reference, self._held_cycles = Reference.read(frame), 0
            return EcuState.RUN if frame["ReferenceState"] == ReferenceState.VALID else EcuState.DEGRADED
        if self._reference is None:
            return EcuState.INIT
        self._held_cycles += 1
        return EcuState.SAFE if self._held_cycles >= timeout_cycles("vehicle.dbc", REFERENCE) else EcuState.DEGRADED
