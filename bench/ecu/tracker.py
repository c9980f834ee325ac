"""The tracker ECU: measured motion and the planner's reference in, steering and wheel-torque commands out."""

import math
from collections.abc import Mapping, Sequence
from time import perf_counter

import cython
import numpy as np
from numpy.typing import NDArray

from bench.bus.network import EcuSlot
from bench.bus.quantities import ACTUATORS, REFERENCE, SENSORS, Command, Reference, bus_health
from bench.bus.reception import Health
from bench.bus.states import ActuatorState, Cause, CommandState, EcuState, ReferenceState
from bench.bus.topic import Outgoing, Signals, Topic
from bench.control.allocation import virtual_input
from bench.control.brake_steering import BrakeSteering
from bench.control.outcome import GainSource, SolverStatus
from bench.control.program import Program
from bench.control.settings import TrackerSettings
from bench.control.slow_down import slow_down
from bench.control.tracker import Tracker, TrackerOutput, own_programs
from bench.cycle import CYCLE_S
from bench.ecu.limits import limits_of, possible, timeout_cycles
from bench.ecu.plausibility import OwnMotion, OwnState
from bench.names import vehicle_bus
from bench.scenario import Scenario
from platoon_fmu.parameters import VehicleParameters

NextReference = tuple[float, float]
"""v_x (m/s) and yaw rate (rad/s)."""

FOLLOWS_MPS = 1.0
"""Largest difference (m/s) between the reference of a vehicle that slows down and its speed."""

STEERING_RAD = 1e-3
"""Difference (rad) between commanded and reported angle that exceeds quantisation."""

STEERING_CYCLES = 2
"""Number of consecutive cycles with such a difference after which the steering counts as stuck."""

STEERING_RECOVERY_CYCLES = 50
"""Number of consecutive cycles in which it must be as commanded before it is trusted again."""

UNANSWERED_CYCLES = 3
"""Number of consecutive cycles in which the actuators received no commands of this ECU that count as a fault."""

_NO_TORQUES = (0.0, 0.0, 0.0, 0.0)

DISTURBANCE = np.array([1.0, 4.0, 3.5])
"""Disturbances (m/s^2, m/s^2, rad/s^2) above those of any allowed cornering stiffness, which indicate a defect."""

_LIMITS = tuple(DISTURBANCE.tolist())

DISTURBANCE_CYCLES = 5
"""Number of consecutive cycles with such a disturbance that indicate a defect."""

SLIDING_SLIP_RAD = 0.06
"""Slip angle at which a front tyre saturates on ice (brush tyre, adhesion 0.2, half the axle's load and stiffness)."""

CALM_CYCLES = 100
"""Number of cycles without such a disturbance after which the vehicle counts as not sliding."""


class TrackerEcu:
    """The paper's tracking level as an ECU.

    States: *init* until the first reference; *run*; *degraded* while the reference is missing (the last one is held) or
    degraded, a sensor is replaced by redundant sources, or the feedback is a fallback; *safe* while the reference is
    lost or the steering does not respond (it slows down in its lane), and while the own motion is unknown (it sends no
    valid command; the actuators hold and then enter their own safe state). See `docs/states.md`.
    """

    def __init__(self, vehicle: int, scenario: Scenario) -> None:
        """Create the tracker of vehicle number `vehicle` (from 1).

        Raises:
            ValueError: the tracker's settings are inconsistent.
        """
        self.name = EcuSlot("tracker", vehicle).name
        self._bus = vehicle_bus(vehicle)
        self._parameters = VehicleParameters()
        self._tracker = Tracker(scenario.tracker, self._parameters, CYCLE_S, self.solvers(scenario.tracker))
        self._brake_steering = BrakeSteering(self._parameters, scenario.tracker.wheel_force_max_n, CYCLE_S)
        self._braking = scenario.planner.slow_down_mps2
        self._crawl = scenario.planner.speed_min_mps
        self._topics = {message: Topic(self._bus, message) for message in (*SENSORS, ACTUATORS, REFERENCE)}
        self.inputs: tuple[Topic, ...] = tuple(self._topics.values())
        self._limits = limits_of("vehicle.dbc", REFERENCE)
        self._reference_timeout = timeout_cycles("vehicle.dbc", REFERENCE)
        self._own = OwnMotion(self._parameters)
        self._grid = scenario.vehicles[vehicle - 1]
        self._last_cycle: int | None = None
        self._now: NextReference | None = None
        self._reference_age = 0
        self._commanded: NDArray[np.float64] | None = None
        self._sent_steering: float | None = None
        self._applied: NDArray[np.float64] = np.zeros(3)
        self._steering_off = 0
        self._steering_good = STEERING_RECOVERY_CYCLES
        self._unanswered = 0
        self._disturbed = 0
        self._calm = CALM_CYCLES

    @classmethod
    def solvers(cls, settings: TrackerSettings) -> Sequence[Program]:
        """Return what finds the feedback gain, tried in turn until the certificate accepts a result.

        A class that overrides this tries a robust MPC of its own in the otherwise unchanged tracker.
        """
        return own_programs(settings)

    @classmethod
    def warm_up(cls) -> None:
        """Load what a step needs, for all processes forked afterwards."""
        settings = TrackerSettings()
        tracker = Tracker(settings, VehicleParameters(), CYCLE_S, cls.solvers(settings))
        tracker.step(np.array([20.0, 0.0, 0.0]), (20.0, 0.0), (20.1, 0.01))

    def step(
        self, cycle: int, _time_s: float, inputs: Mapping[Topic, Signals | None], health: Health
    ) -> list[Outgoing]:
        """Track this cycle's reference."""
        begin = perf_counter()
        if cycle == 0:
            self._own.start_from(self._grid.x_m, self._grid.y_m, self._grid.yaw_rad, self._grid.speed_mps)
        frames = {message: inputs[topic] for message, topic in self._topics.items()}
        own = self._own.update(frames, 1 if self._last_cycle is None else cycle - self._last_cycle)
        self._last_cycle = cycle
        cause = max(self._own.cause, self._watch_steering(frames[ACTUATORS]))
        then, reference_cause = self._next_reference(frames[REFERENCE], own)
        slowing = own is not None and (reference_cause is Cause.REFERENCE_LOST or self._steering_stuck)
        if own is not None and slowing:
            then = self._slower(own)
        applied = self._really_applied(frames[ACTUATORS])
        out = None if own is None or then is None else self._track(own, then, applied)
        self._now = then
        cause = max(cause, reference_cause, self._doubts(out))
        state = self._state(out, cause, slowing=slowing)
        messages = [
            *self._commands(state, own, then, out, slowing=slowing),
            *self._diagnostics(state, cause, out),
            self._bus_health(health),
        ]
        solve_s = 0.0 if out is None else out.solve_s
        timing = {"SolveTime": 1e6 * solve_s, "StepTime": 1e6 * (perf_counter() - begin)}
        return [*messages, Outgoing(self._bus, "TrackerTiming", timing)]

    @property
    def _steering_stuck(self) -> bool:
        return self._steering_good < STEERING_RECOVERY_CYCLES

    def _track(self, own: OwnState, then: NextReference, applied: NDArray[np.float64]) -> TrackerOutput:
        xi = np.array([own.v_x, own.v_y, own.yaw_rate])
        return self._tracker.step(xi, self._now or (own.v_x, own.yaw_rate), then, applied)

    def _next_reference(self, frame: Signals | None, own: OwnState | None) -> tuple[NextReference | None, Cause]:
        """Return the next cycle's reference, the last one if none arrived, and the fault of it."""
        usable = frame is not None and frame["ReferenceState"] != ReferenceState.NONE
        if frame is not None and usable and possible(self._limits, frame, ("YawRate",)):
            self._reference_age = 0
            valid = frame["ReferenceState"] == ReferenceState.VALID
            reference = Reference.read(frame)
            cause = Cause.NONE if valid else Cause.REFERENCE_DEGRADED
            return (reference.v_x, reference.yaw_rate), cause
        self._reference_age += 1
        if self._reference_age >= self._reference_timeout:
            return self._now or (None if own is None else (own.v_x, own.yaw_rate)), Cause.REFERENCE_LOST
        return self._now, Cause.REFERENCE_MISSING

    def _slower(self, own: OwnState) -> NextReference:
        """Return the next reference while slowing down to a crawl in the lane."""
        v, gamma = self._now or (own.v_x, own.yaw_rate)
        v = min(max(v, own.v_x - FOLLOWS_MPS), own.v_x + FOLLOWS_MPS)
        return slow_down(v, gamma, own.course, self._braking, self._crawl, CYCLE_S)

    def _watch_steering(self, status: Signals | None) -> Cause:
        """Return ACTUATOR_FAULT if the actuators do not follow their commands."""
        if status is None:
            return Cause.NONE
        active = status["ActuatorState"] == ActuatorState.ACTIVE
        self._unanswered = 0 if active or self._sent_steering is None else self._unanswered + 1
        if active and self._sent_steering is not None:
            off = abs(status["SteeringAngle"] - self._sent_steering) > STEERING_RAD
            self._steering_off = self._steering_off + 1 if off else 0
            stuck = self._steering_off >= STEERING_CYCLES
            self._steering_good = 0 if stuck else self._steering_good + (not off)
        faulty = self._steering_stuck or self._unanswered >= UNANSWERED_CYCLES
        return Cause.ACTUATOR_FAULT if faulty else Cause.NONE

    def _really_applied(self, status: Signals | None) -> NDArray[np.float64]:
        """Return the virtual input applied since the last step, as reported by the actuators."""
        state = ActuatorState.HOLD if status is None else status["ActuatorState"]
        if state == ActuatorState.ACTIVE and self._commanded is not None:
            self._applied = self._commanded
        elif state == ActuatorState.SAFE or state == ActuatorState.INIT:
            self._applied = np.zeros(3)
        if status is not None and self._steering_stuck:
            self._applied = np.array([status["SteeringAngle"], *self._applied[1:]])
        return self._applied

    def _doubts(self, out: TrackerOutput | None) -> Cause:
        """Return the fault of vehicle or solver that the tracking shows."""
        broken = out is not None and _is_broken(out.disturbance)
        self._disturbed = self._disturbed + 1 if broken else 0
        self._calm = 0 if self._disturbed >= DISTURBANCE_CYCLES else self._calm + 1
        if self._disturbed >= DISTURBANCE_CYCLES:
            return Cause.VEHICLE_FAULT
        return Cause.NONE if out is None or out.source.is_certified else Cause.SOLVER_FALLBACK

    @property
    def _sliding(self) -> bool:
        """Whether a disturbance has recently exceeded what the tyres can cause."""
        return self._calm < CALM_CYCLES

    def _within_grip(self, steering: float, own: OwnState) -> float:
        """Limit the steering angle to the largest side force of a sliding tyre, which falls at larger slip angles."""
        way = math.atan2(own.v_y + self._parameters.l_f * own.yaw_rate, max(own.v_x, 1.0))
        return min(max(steering, way - SLIDING_SLIP_RAD), way + SLIDING_SLIP_RAD)

    @staticmethod
    def _state(out: TrackerOutput | None, cause: Cause, *, slowing: bool) -> EcuState:
        if out is None:
            return EcuState.SAFE if cause in (Cause.OWN_MOTION_LOST, Cause.REFERENCE_LOST) else EcuState.INIT
        if slowing:
            return EcuState.SAFE
        return EcuState.RUN if cause is Cause.NONE else EcuState.DEGRADED

    def _commands(
        self,
        state: EcuState,
        own: OwnState | None,
        then: NextReference | None,
        out: TrackerOutput | None,
        *,
        slowing: bool,
    ) -> list[Outgoing]:
        steering = 0.0
        torques: Sequence[float] = _NO_TORQUES
        self._commanded, self._sent_steering = None, None
        if out is None or own is None or then is None:
            validity = CommandState.NONE
        else:
            validity = CommandState.VALID if state is EcuState.RUN else CommandState.DEGRADED
            if slowing:
                validity = CommandState.SAFE
            steering, forces = out.steering, out.wheel_forces
            self._commanded = out.u
            if self._sliding:
                steering = self._within_grip(steering, own)
                self._commanded = np.array([steering, *out.u[1:]])
            if self._steering_stuck:
                steering, forces = 0.0, self._brake_steering.forces(own.v_x, own.yaw_rate, *then)
                self._commanded = virtual_input(self._parameters, steering, forces)
            else:
                self._brake_steering.reset()
            self._sent_steering = steering
            torques = [self._parameters.R_w * force for force in forces.tolist()]
        commands = Command.of_wheels(steering, torques).messages(validity)
        return [Outgoing(self._bus, name, values) for name, values in commands.items()]

    def _diagnostics(self, state: EcuState, cause: Cause, out: TrackerOutput | None) -> list[Outgoing]:
        status: dict[str, float] = {
            "State": state,
            "Cause": cause,
            "SolverStatus": SolverStatus.NOT_RUN if out is None else out.status,
            "GainSource": GainSource.NONE if out is None else out.source,
        }
        disturbance: dict[str, float] = {}
        reference: dict[str, float] = {}
        reference_input: dict[str, float] = {}
        target: dict[str, float] = {}
        if out is not None:
            status["Iterations"], status["Tau"] = out.iterations, out.tau
            x, y, yaw = out.disturbance.tolist()
            disturbance = {"DisturbanceX": x, "DisturbanceY": y, "DisturbanceYaw": yaw}
            v_x, v_y, gamma = out.reference.tolist()
            reference = {"VelocityX": v_x, "VelocityY": v_y, "YawRate": gamma}
            steering, force, moment = out.reference_u.tolist()
            reference_input = {"SteeringAngle": steering, "Force": force, "YawMoment": moment}
            v_x, v_y, gamma = out.target.tolist()
            target = {"VelocityX": v_x, "VelocityY": v_y, "YawRate": gamma}
        return [
            Outgoing(self._bus, "TrackerStatus", status),
            Outgoing(self._bus, "TrackerDisturbance", disturbance),
            Outgoing(self._bus, "TrackerReferenceState", reference),
            Outgoing(self._bus, "TrackerReferenceInput", reference_input),
            Outgoing(self._bus, "TrackerTarget", target),
        ]

    def _bus_health(self, health: Health) -> Outgoing:
        return Outgoing(self._bus, "TrackerBusHealth", bus_health(health))


def _is_broken(disturbance: NDArray[np.float64]) -> bool:
    """Return whether a component of a disturbance is above its limit."""
    value: cython.double
    limit: cython.double
    for value, limit in zip(disturbance.tolist(), _LIMITS, strict=True):  # noqa: SIM110 - typed
        if abs(value) > limit:
            return True
    return False
