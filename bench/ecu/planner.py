"""The planner ECU: own sensors and V2V broadcasts in, the tracker's reference and an own broadcast out."""

import math
from collections.abc import Mapping
from time import perf_counter

from bench.bus.network import EcuSlot
from bench.bus.quantities import ACCELERATION, ACTUATORS, REFERENCE, SENSORS, Peer, Reference, broadcast, bus_health
from bench.bus.reception import Health, ReceptionState
from bench.bus.states import Cause, EcuState, Manoeuvre, ReferenceState
from bench.bus.topic import Outgoing, Signals, Topic
from bench.control.felt import Felt
from bench.control.outcome import Limit
from bench.control.planner import Motion, Planner, PlannerOutput, PlatoonGoal
from bench.cycle import CYCLE_S
from bench.ecu.following import Following
from bench.ecu.limits import timeout_cycles
from bench.ecu.peers import PeerWatch
from bench.ecu.plausibility import OwnMotion
from bench.names import V2V, vehicle_bus
from bench.scenario import Scenario
from platoon_fmu.parameters import VehicleParameters

CLEARANCE_M = 7.0
"""Distance (m) that a vehicle falling back keeps to the one ahead, within its braking limit."""

MAKE_WAY_M = 12.0
"""Distance (m) that a vehicle keeps to an untrusted one behind: larger than a normal gap, because a coasting vehicle
may be approaching."""

OVERTAKEN_M = 6.0
"""Distance (m) ahead from which such a vehicle counts as having overtaken."""

LANE_M = 3.5
"""Two vehicles with a smaller lateral distance (m) can collide."""

_UNTRUSTED = (Cause.PEER_LOST, Cause.PEER_IMPLAUSIBLE, Cause.PEER_UNSAFE)
_UNKNOWN = (Cause.PEER_LOST, Cause.PEER_IMPLAUSIBLE)
_STAYING = (Manoeuvre.NONE, Manoeuvre.APPROACH, Manoeuvre.SLOW_DOWN)


class PlannerEcu:
    """The paper's planning level as an ECU.

    States: *init* until it has a slot, with the start speed held; *run*; *degraded* while a sensor is replaced by
    redundant sources, or a vehicle is missing or untrusted (those behind it then open the gap); *safe* while the own
    motion is unknown or the vehicle does not follow: it slows down in its lane and reports this. See `docs/states.md`.

    Attributes:
        input_wait_s: in real time, time in s after BenchSync for which it waits for its inputs: the plant's arrive
            within about 2 ms, and the tracker waits for the planner.
    """

    input_wait_s = 0.003

    def __init__(self, vehicle: int, scenario: Scenario) -> None:
        """Create the planner of vehicle number `vehicle` (from 1).

        Raises:
            ValueError: the planner's settings are inconsistent.
        """
        count = len(scenario.vehicles)
        self.name = EcuSlot("planner", vehicle).name
        self._vehicle = vehicle
        self._bus = vehicle_bus(vehicle)
        self._platoon = scenario.platoon
        self._emergency = scenario.planner.emergency_braking_mps2
        self._crawl = scenario.planner.speed_min_mps
        self._planner = Planner(
            scenario.planner,
            PlatoonGoal(scenario.platoon.lane_y_m, scenario.platoon.speed_mps, scenario.platoon.gap_m),
            VehicleParameters(),
            vehicle,
            count,
            scenario.seed,
            CYCLE_S,
        )
        self._grid = {
            number: Motion(start.x_m, start.y_m, start.speed_mps, start.yaw_rad, 0.0)
            for number, start in enumerate(scenario.vehicles, start=1)
        }
        self._peers = {number: PeerWatch(number) for number in self._grid if number != vehicle}
        self._peer_topics = tuple(topic for peer in self._peers.values() for topic in peer.topics)
        self._own_topics = {message: Topic(self._bus, message) for message in (*SENSORS, ACTUATORS, ACCELERATION)}
        self.inputs: tuple[Topic, ...] = (
            *self._own_topics.values(),
            *self._peer_topics,
        )
        self._broadcast_topics = broadcast(vehicle)
        self._own = OwnMotion(VehicleParameters())
        self._following = Following()
        comfort = scenario.planner.comfort
        self._felt: Felt | None = Felt(comfort, CYCLE_S) if comfort.enabled else None
        self._uncomfortable = False
        # After this wait for all vehicles to be heard, slots are assigned by the start grid.
        self._wait_cycles = timeout_cycles("v2v.dbc", broadcast(vehicle).position.message)
        self._first_cycle: int | None = None
        self._last_cycle = 0
        self._last_broadcast: Motion | None = None
        self._last: PlannerOutput | None = None
        self._optimise_s = 0.0

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        """Plan the next cycle's reference and broadcast this cycle's motion."""
        begin = perf_counter()
        self._optimise_s = 0.0
        if self._first_cycle is None:
            self._first_cycle, self._last_cycle = cycle, cycle - 1
            if cycle == 0:
                grid = self._grid[self._vehicle]
                self._own.start_from(grid.X, grid.Y, grid.course, grid.speed)
        cycles, self._last_cycle = cycle - self._last_cycle, cycle
        for peer in self._peers.values():
            peer.update(inputs, health, cycles)
        own = self._listen(inputs, cycles)
        self._feel(inputs[self._own_topics[ACCELERATION]], cycles)
        cause, manoeuvre = self._own.cause, Manoeuvre.NONE
        if own is not None:
            motion, v_x = own
            self._following.update(inputs[self._own_topics[ACTUATORS]], v_x, motion.yaw_rate)
            if not self._planner.assigned:
                self._take_slot(cycle, time_s, motion)
            manoeuvre = self._plan(cycle, time_s, motion, v_x)
            cause = max(cause, self._following.cause)
        for peer in self._peers.values():
            cause = max(cause, peer.cause)
        state = self._state(cause)
        outgoing = [*self._messages(state, cause, manoeuvre), self._bus_health(health)]
        outgoing += self._broadcast(own, state, cause, manoeuvre)
        timing = {"OptimisationTime": 1e6 * self._optimise_s, "StepTime": 1e6 * (perf_counter() - begin)}
        return [*outgoing, Outgoing(self._bus, "PlannerTiming", timing)]

    def _listen(self, inputs: Mapping[Topic, Signals | None], cycles: int) -> tuple[Motion, float] | None:
        """Return own motion and v_x, or None while they are unknown."""
        frames = {message: inputs[self._own_topics[message]] for message in SENSORS}
        state = self._own.update(frames, cycles)
        if state is None:
            return None
        return Motion(state.x, state.y, state.speed, state.course, state.yaw_rate), state.v_x

    def _feel(self, acceleration: Signals | None, cycles: int) -> None:
        """Compare the measured acceleration with the limits of comfort."""
        if self._felt is None:
            return
        if acceleration is None or cycles != 1:
            self._felt.forget()
        self._uncomfortable = acceleration is not None and self._felt.exceeds(
            acceleration["AccelerationX"], acceleration["AccelerationY"]
        )

    def _limit(self, limit: Limit) -> Limit:
        """Return what to say of the reference and of what the vehicle feels."""
        return Limit.COMFORT if self._uncomfortable and limit is not Limit.HARD_BRAKING else limit

    def _take_slot(self, cycle: int, time_s: float, own: Motion) -> None:
        """Join an existing platoon; else assign slots by the first broadcasts, or after a timeout by the start grid."""
        first = self._first_cycle or 0
        waited = cycle - first >= self._wait_cycles
        # A planner that ran from the start ignores reported slots: another one still without a slot, because frames
        # were lost, would take the same free one. Broadcasts and grid give all of them the same order.
        under_way = first >= self._wait_cycles
        reports = {n: p.report for n, p in self._peers.items() if under_way and p.report is not None and p.report.slot}
        if reports and (len(reports) == len(self._peers) or waited):
            taken = {number: report.slot for number, report in reports.items()}
            free = set(range(1, len(self._grid) + 1)) - set(taken.values())
            leader_x = sum(report.leader_x for report in reports.values()) / len(reports)
            # If others are missing too, the rearmost free slot has the most of them ahead.
            slot = max(free, default=len(self._grid))
            self._planner.join(slot, leader_x + self._platoon.speed_mps * CYCLE_S, time_s, taken)
            self._expect_falling_back()
            return
        starts: dict[int, Motion] | None = None
        started_s = time_s
        if not self._peers:
            starts = {self._vehicle: own}
        elif self._last_broadcast is not None and all(peer.heard for peer in self._peers.values()):
            # All broadcasts are from the cycle before, so the own broadcast of that cycle is used.
            heard = {n: peer.motion for n, peer in self._peers.items() if peer.motion is not None}
            starts = {n: motion.later(-CYCLE_S) for n, motion in heard.items()} | {self._vehicle: self._last_broadcast}
            started_s = time_s - CYCLE_S
        elif waited:
            starts, started_s = self._grid, 0.0
            for number, peer in self._peers.items():
                peer.assume(self._grid[number], time_s)
        if starts is not None:
            self._planner.assign_slots(starts, started_s)
            self._expect_falling_back()

    def _expect_falling_back(self) -> None:
        """Assume of those ahead that they fall back as soon as they are not heard any more, as this vehicle does."""
        for number, peer in self._peers.items():
            if self._is_ahead(number):
                peer.braking = self._planner.fall_back_braking(self._planner.slots.get(number, 1))
                peer.crawl = self._crawl

    def _plan(self, cycle: int, time_s: float, own: Motion, v_x: float) -> Manoeuvre:
        """Plan the next cycle's reference and return the manoeuvre."""
        if self._planner.assigned and self._following.cause is not Cause.NONE:
            self._last = self._planner.slow_down(cycle, time_s, own, v_x)
            manoeuvre = Manoeuvre.SLOW_DOWN
        else:
            braking = self._braking(own)
            way = self._make_way_x(own)
            self._last = self._planner.step(
                cycle, time_s, own, v_x, self._neighbours(), braking, way, self._staying(), self._unheard()
            )
            manoeuvre = Manoeuvre.PLATOON if self._planner.changing else Manoeuvre.APPROACH
            if braking is not None:
                manoeuvre = Manoeuvre.FALL_BACK
        self._following.ask(self._last.v_x, self._last.yaw_rate)
        self._optimise_s = self._last.optimise_s
        return manoeuvre if self._planner.assigned else Manoeuvre.NONE

    def _neighbours(self) -> dict[int, Motion]:
        """Return the vehicles to keep clear of, by number; of lost ones the motion that is assumed."""
        return {number: peer.motion for number, peer in self._peers.items() if peer.motion is not None}

    def _staying(self) -> set[int]:
        """Return the numbers of the vehicles that have reported that they stay in their own lanes for now."""
        return {
            number
            for number, peer in self._peers.items()
            if peer.report is not None and peer.report.manoeuvre in _STAYING
        }

    def _unheard(self) -> set[int]:
        """Return the numbers of the vehicles that are not heard any more, or not believed."""
        return {number for number, peer in self._peers.items() if peer.cause in _UNKNOWN}

    def _is_ahead(self, number: int) -> bool:
        slots = self._planner.slots
        return slots.get(number, 0) < slots.get(self._vehicle, 0)

    def _braking(self, own: Motion) -> float | None:
        """Return the braking (m/s^2) to fall back from untrusted vehicles ahead; None if all are trusted."""
        suspects = [peer for n, peer in self._peers.items() if peer.cause in _UNTRUSTED and self._is_ahead(n)]
        if not suspects:
            return None
        braking = self._planner.fall_back_braking(self._planner.slots[self._vehicle])
        for peer in suspects:
            if peer.motion is not None and peer.cause is Cause.PEER_UNSAFE:
                braking = max(braking, _braking_behind(own, peer.motion))
        return min(braking, self._emergency)

    def _make_way_x(self, own: Motion) -> float | None:
        """Return the minimum X (m) that keeps ahead of untrusted vehicles behind until they have overtaken, or None."""
        ahead_of = [
            peer.motion.X + MAKE_WAY_M
            for number, peer in self._peers.items()
            if peer.cause in _UNTRUSTED
            and peer.motion is not None
            and not self._is_ahead(number)
            and -OVERTAKEN_M < own.X - peer.motion.X < MAKE_WAY_M
        ]
        return max(ahead_of, default=None)

    def _state(self, cause: Cause) -> EcuState:
        if self._last is None or not self._planner.assigned:
            return EcuState.INIT
        if cause >= Cause.ACTUATOR_FAULT:
            return EcuState.SAFE
        return EcuState.RUN if cause is Cause.NONE else EcuState.DEGRADED

    def _messages(self, state: EcuState, cause: Cause, manoeuvre: Manoeuvre) -> list[Outgoing]:
        """Return the reference and the diagnostics."""
        status: dict[str, float] = {"State": state, "Cause": cause}
        reference: Signals = {"ReferenceState": ReferenceState.NONE}
        potential: dict[str, float] = {}
        gains: dict[str, float] = {}
        target: dict[str, float] = {"Manoeuvre": manoeuvre}
        plan = self._last
        if plan is not None:
            worth = ReferenceState.VALID if state in (EcuState.INIT, EcuState.RUN) else ReferenceState.DEGRADED
            if cause in (Cause.OWN_MOTION_LOST, Cause.VEHICLE_FAULT):
                # The tracker has better information, or receives wrong references: it must slow down by itself.
                worth = ReferenceState.NONE
            reference = Reference(plan.v_x, plan.yaw_rate).messages(worth)[REFERENCE]
            status |= {
                "Slot": plan.slot,
                "Neighbours": plan.neighbours,
                "Limit": self._limit(plan.limit),
                "BoundaryMargin": plan.margin,
                "OptimisationCost": plan.cost,
            }
            potential["Ga"], potential["Gb"], gains["P11"], gains["P12"], gains["P21"], gains["P22"] = plan.gains
            target["TargetX"], target["TargetY"] = plan.target
        return [
            Outgoing(self._bus, REFERENCE, reference),
            Outgoing(self._bus, "PlannerStatus", status),
            Outgoing(self._bus, "PlannerPotential", potential),
            Outgoing(self._bus, "PlannerGains", gains),
            Outgoing(self._bus, "PlannerTarget", target),
        ]

    def _bus_health(self, health: Health) -> Outgoing:
        values = bus_health(health)
        worst, lost = ReceptionState.INIT, 0
        for topic in self._peer_topics:
            worst = max(worst, health.of(topic).state)
        for peer in self._peers.values():
            lost += peer.cause is Cause.PEER_LOST
        values["PeerReception"], values["PeersLost"] = worst, lost
        return Outgoing(self._bus, "PlannerBusHealth", values)

    def _broadcast(
        self, own: tuple[Motion, float] | None, state: EcuState, cause: Cause, manoeuvre: Manoeuvre
    ) -> list[Outgoing]:
        """Return the broadcast, with the motion only if it is known."""
        status = self._broadcast_topics.status
        slot, leader_x = (self._last.slot, self._last.leader_x) if self._last is not None else (0, 0.0)
        report = {"State": state, "Slot": slot, "Cause": cause, "LeaderX": leader_x, "Manoeuvre": manoeuvre}
        messages = [Outgoing(V2V, status.message, report)]
        if own is not None:
            motion = self._last_broadcast = own[0]
            told = Peer(motion.X, motion.Y, motion.speed, motion.course, motion.yaw_rate).messages(self._vehicle)
            messages += [Outgoing(V2V, name, values) for name, values in told.items()]
        return messages


def _braking_behind(own: Motion, ahead: Motion) -> float:
    """Return the braking (m/s^2) that keeps `CLEARANCE_M` to a vehicle ahead at constant speed; 0 if none is needed."""
    closing = own.speed * math.cos(own.course) - ahead.speed * math.cos(ahead.course)
    if closing <= 0.0 or abs(ahead.Y - own.Y) > LANE_M:
        return 0.0
    return closing**2 / (2.0 * max(ahead.X - own.X - CLEARANCE_M, 0.1))
