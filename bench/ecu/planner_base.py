"""Base class of a custom planner, which computes a reference from the own motion and that of the others."""

import math
from abc import abstractmethod
from collections.abc import Iterable, Mapping
from typing import ClassVar, final

from bench.bus.quantities import ATTITUDE, MOTION, POSITION, Motion, Peer, Pose, Reference, broadcast
from bench.bus.reception import ReceptionState
from bench.bus.states import EcuState, ReferenceState
from bench.bus.topic import Outgoing, Topic
from bench.ecu.ecu_base import EcuBase
from bench.ecu.words import fits, misfit
from bench.names import V2V


class PlannerBase(EcuBase):
    """A planner, which sets the tracker's reference with regard to the other vehicles.

    It calls `plan` in every cycle with own sensor frames, and broadcasts the own motion. States, sent in
    `PlannerStatus` and `V2VStatus_i`: *init* until the first plan; *run*; *degraded* while own sensor frames are
    missing (the last reference is held and no motion is broadcast) or while a vehicle is not heard.
    """

    role: ClassVar[str] = "planner"

    _reference: Reference | None = None

    @abstractmethod
    def plan(self, pose: Pose, motion: Motion, peers: Mapping[int, Peer]) -> Reference:
        """Return the reference for the next cycle.

        The result must depend only on the arguments and earlier calls: no clock, no I/O.

        Args:
            pose: pose of the own vehicle.
            motion: motion of the own vehicle.
            peers: the other vehicles heard in this cycle, by number; none in the first cycle.
        """

    @property
    def _others(self) -> list[int]:
        return [number for number in range(1, len(self.scenario.vehicles) + 1) if number != self.vehicle]

    def _own_inputs(self) -> Iterable[Topic]:
        yield from map(self._topic, (POSITION, ATTITUDE, MOTION))
        for number in self._others:
            yield from broadcast(number)[:2]

    @final
    def _work(self) -> tuple[list[Outgoing], EcuState]:
        position, attitude, motion = (self.received(name) for name in (POSITION, ATTITUDE, MOTION))
        peers = self._heard()
        self.show("PlannerStatus", Neighbours=len(peers))
        told: list[Outgoing] = []
        state = EcuState.RUN if len(peers) == len(self._others) else EcuState.DEGRADED
        if position is None or attitude is None or motion is None:
            state = EcuState.DEGRADED
        else:
            pose, moving = Pose.read(position, attitude), Motion.read(motion)
            self._reference = self.plan(pose, moving, peers)
            if not fits(self._reference, Reference):
                raise misfit(self.plan, self._reference, Reference)
            told = self._outgoing(_as_peer(pose, moving).messages(self.vehicle), V2V)
        if self.cycle == 0 and told:
            # No broadcast can have arrived yet.
            state = EcuState.RUN
        worth = ReferenceState.VALID if state is EcuState.RUN else ReferenceState.DEGRADED
        if self._reference is None:
            state, worth = EcuState.INIT, ReferenceState.NONE
        reference = self._reference or Reference(0.0)
        told += [Outgoing(V2V, broadcast(self.vehicle).status.message, {"State": state})]
        return [*self._outgoing(reference.messages(worth)), *told], state

    def _bus_health(self) -> dict[str, float]:
        peers = {number: [self.health.of(topic) for topic in broadcast(number)[:2]] for number in self._others}
        worst = max((reception.state for each in peers.values() for reception in each), default=ReceptionState.INIT)
        lost = sum(any(reception.lost for reception in each) for each in peers.values())
        return {**super()._bus_health(), "PeerReception": float(worst), "PeersLost": float(lost)}

    def _heard(self) -> dict[int, Peer]:
        peers = {}
        for number in self._others:
            position, motion = (self._received[topic] for topic in broadcast(number)[:2])
            if position is not None and motion is not None:
                peers[number] = Peer.read(position, motion)
        return peers


def _as_peer(pose: Pose, motion: Motion) -> Peer:
    """Return the own vehicle as a peer of the others."""
    course = math.remainder(pose.yaw + math.atan2(motion.v_y, motion.v_x), 2.0 * math.pi)
    return Peer(pose.x, pose.y, math.hypot(motion.v_x, motion.v_y), course, motion.yaw_rate)
