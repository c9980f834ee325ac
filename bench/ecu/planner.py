"""The planner ECU: own sensors and the others' V2V broadcasts in, the tracker's reference and an own broadcast out."""

import math
from collections.abc import Mapping
from time import perf_counter

from bench.bus.states import EcuState, ReferenceState
from bench.bus.topic import V2V, Health, Outgoing, Signals, Topic, vehicle_bus
from bench.control.planner import Motion, Planner, PlannerOutput, PlatoonGoal
from bench.control.settings import PlannerSettings
from bench.scenario import CYCLE_S, Scenario
from platoon_fmu.parameters import VehicleParameters


class PlannerEcu:
    """The paper's planning level as an ECU.

    States: *init* until all vehicles have been heard once, with the start speed held; *run*; *degraded* while own
    sensors or a neighbour are missing: own sensors missing hold the reference, a missing neighbour is taken to keep its
    velocity. A vehicle that is alone needs to hear nobody.
    """

    def __init__(self, vehicle: int, scenario: Scenario) -> None:
        """Make the planner of vehicle number `vehicle` (from 1).

        Raises:
            ValueError: the planner's settings do not go together.
        """
        count = len(scenario.vehicles)
        self.name = f"veh{vehicle}.planner"
        self._vehicle = vehicle
        self._bus = vehicle_bus(vehicle)
        self._others = [number for number in range(1, count + 1) if number != vehicle]
        platoon = scenario.platoon
        self._planner = Planner(
            scenario.planner,
            PlatoonGoal(platoon.lane_y_m, platoon.speed_mps, platoon.gap_m),
            VehicleParameters(),
            vehicle,
            count,
            scenario.seed,
            CYCLE_S,
        )
        self._position = Topic(self._bus, "VehiclePosition")
        self._attitude = Topic(self._bus, "VehicleAttitude")
        self._motion = Topic(self._bus, "VehicleMotion")
        broadcasts = (topic for number in self._others for topic in _broadcast(number))
        self.inputs: tuple[Topic, ...] = (self._position, self._attitude, self._motion, *broadcasts)
        self._last_broadcast: Motion | None = None
        self._peers: dict[int, Motion] = {}
        self._last: PlannerOutput | None = None
        self._optimise_s = 0.0

    @staticmethod
    def warm_up() -> None:
        """Load the compiled functions by using them once, which processes forked afterwards need not do again."""
        planner = Planner(PlannerSettings(), PlatoonGoal(0.0, 20.0, 10.0), VehicleParameters(), 1, 2, 0, CYCLE_S)
        own, other = Motion(0.0, 0.0, 20.0, 0.0, 0.0), Motion(-10.0, 0.0, 20.0, 0.0, 0.0)
        planner.assign_slots({1: own, 2: other}, 0.0)
        planner.step(0, 0.0, own, own.speed, {2: other})

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        """Plan the next cycle's reference and broadcast this cycle's motion."""
        begin = perf_counter()
        heard_all = self._listen(inputs)
        own = self._own(inputs)
        if own is not None:
            motion, v_x = own
            if not self._planner.assigned and heard_all and (self._last_broadcast is not None or not self._others):
                # All broadcasts are of the cycle before, so the own one that counts is that cycle's too.
                starts = {number: peer.later(-CYCLE_S) for number, peer in self._peers.items()}
                starts[self._vehicle] = self._last_broadcast or motion
                self._planner.assign_slots(starts, time_s - CYCLE_S if self._others else time_s)
            self._last = self._planner.step(cycle, time_s, motion, v_x, self._peers)
            self._optimise_s = self._last.optimise_s or self._optimise_s
        state = self._state(heard_all and own is not None)
        outgoing = self._messages(state, health)
        if own is not None:
            outgoing += self._broadcast(own[0])
        timing = {"OptimisationTime": self._optimise_s, "StepTime": perf_counter() - begin}
        return [*outgoing, Outgoing(self._bus, "PlannerTiming", {k: 1e6 * v for k, v in timing.items()})]

    def _listen(self, inputs: Mapping[Topic, Signals | None]) -> bool:
        """Bring the others' motion up to this cycle; whether all were heard."""
        heard_all = True
        for number in self._others:
            position, motion = (inputs[topic] for topic in _broadcast(number))
            if position is not None and motion is not None:
                peer = Motion(position["X"], position["Y"], motion["Speed"], motion["Course"], motion["YawRate"])
            elif number in self._peers:
                peer, heard_all = self._peers[number], False
            else:
                heard_all = False
                continue
            self._peers[number] = peer.later(CYCLE_S)
        return heard_all

    def _own(self, inputs: Mapping[Topic, Signals | None]) -> tuple[Motion, float] | None:
        """Own motion and v_x, or None where a sensor frame is missing."""
        position, attitude, motion = inputs[self._position], inputs[self._attitude], inputs[self._motion]
        if position is None or attitude is None or motion is None:
            return None
        v_x, v_y = motion["VelocityX"], motion["VelocityY"]
        course = math.remainder(attitude["Yaw"] + math.atan2(v_y, v_x), 2.0 * math.pi)
        return Motion(position["X"], position["Y"], math.hypot(v_x, v_y), course, motion["YawRate"]), v_x

    def _state(self, all_there: bool) -> EcuState:
        if self._last is None or not self._planner.assigned:
            return EcuState.INIT
        return EcuState.RUN if all_there else EcuState.DEGRADED

    def _messages(self, state: EcuState, health: Health) -> list[Outgoing]:
        """The reference and the diagnostics."""
        status: dict[str, float] = {"State": state}
        reference: dict[str, float] = {"ReferenceState": ReferenceState.NONE}
        potential: dict[str, float] = {}
        gains: dict[str, float] = {}
        target: dict[str, float] = {}
        plan = self._last
        if plan is not None:
            reference = {
                "VelocityX": plan.v_x,
                "YawRate": plan.yaw_rate,
                "ReferenceState": ReferenceState.DEGRADED if state is EcuState.DEGRADED else ReferenceState.VALID,
            }
            status |= {
                "Slot": plan.slot,
                "Neighbours": plan.neighbours,
                "Limit": plan.limit,
                "BoundaryMargin": plan.margin,
                "OptimisationCost": plan.cost,
            }
            names = ("P11", "P12", "P21", "P22")
            potential = {"Ga": float(plan.gains[0]), "Gb": float(plan.gains[1])}
            gains = dict(zip(names, map(float, plan.gains[2:]), strict=True))
            target = {"TargetX": float(plan.target[0]), "TargetY": float(plan.target[1])}
        bus_health = {"FramesLost": health.frames_lost, "E2EErrors": health.e2e_errors}
        return [
            Outgoing(self._bus, "Reference", reference),
            Outgoing(self._bus, "PlannerStatus", status),
            Outgoing(self._bus, "PlannerPotential", potential),
            Outgoing(self._bus, "PlannerGains", gains),
            Outgoing(self._bus, "PlannerTarget", target),
            Outgoing(self._bus, "PlannerBusHealth", bus_health),
        ]

    def _broadcast(self, motion: Motion) -> list[Outgoing]:
        """The own motion for the others."""
        self._last_broadcast = motion
        position, moving = _broadcast(self._vehicle)
        return [
            Outgoing(V2V, position.message, {"X": motion.X, "Y": motion.Y}),
            Outgoing(V2V, moving.message, {"Speed": motion.speed, "Course": motion.course, "YawRate": motion.yaw_rate}),
        ]


def _broadcast(vehicle: int) -> tuple[Topic, Topic]:
    """What a vehicle tells the others: position and motion."""
    return Topic(V2V, f"V2VPosition_{vehicle}"), Topic(V2V, f"V2VMotion_{vehicle}")
