"""Base class of a custom tracker, which computes a command from motion and reference."""

from abc import abstractmethod
from collections.abc import Iterable
from typing import ClassVar, final

from bench.bus.quantities import MOTION, REFERENCE, Command, Motion, Reference
from bench.bus.states import CommandState, EcuState, ReferenceState
from bench.bus.topic import Outgoing, Topic
from bench.ecu.ecu_base import EcuBase
from bench.ecu.limits import timeout_cycles
from bench.ecu.words import fits, misfit


class TrackerBase(EcuBase):
    """A tracker, which makes the vehicle follow the reference.

    It calls `control` in every cycle in which the own motion is known, with the newest reference. States, sent in
    `TrackerStatus`: *init* until the first reference; *run*; *degraded* while the reference is missing or its
    state is None (the last one is held for the message's timeout in the DBC), or marked as degraded; *safe* while the
    own motion is missing or the reference is lost. In *init* and *safe* the commands are marked invalid: the actuators
    hold their last values, then enter their safe state.
    """

    role: ClassVar[str] = "tracker"

    _reference: Reference | None = None
    _held_cycles = 0

    @abstractmethod
    def control(self, motion: Motion, reference: Reference) -> Command:
        """Return this cycle's command.

        The result must depend only on the arguments and earlier calls: no clock, no I/O.
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
            if not fits(command, Command):
                raise misfit(self.control, command, Command)
            validity = CommandState.VALID if state is EcuState.RUN else CommandState.DEGRADED
        return self._outgoing(command.messages(validity)), state

    def _listen(self) -> EcuState:
        """Process the reference and return the resulting state."""
        frame = self.received(REFERENCE)
        if frame is not None and frame["ReferenceState"] != ReferenceState.NONE:
            self._reference, self._held_cycles = Reference.read(frame), 0
            return EcuState.RUN if frame["ReferenceState"] == ReferenceState.VALID else EcuState.DEGRADED
        if self._reference is None:
            return EcuState.INIT
        self._held_cycles += 1
        return EcuState.SAFE if self._held_cycles >= timeout_cycles("vehicle.dbc", REFERENCE) else EcuState.DEGRADED
