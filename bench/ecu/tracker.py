"""The tracker ECU: measured motion and the planner's reference in, steering and wheel-torque commands out."""

from collections.abc import Mapping
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from bench.bus.states import ActuatorState, CommandState, EcuState, ReferenceState
from bench.bus.topic import Health, Outgoing, Signals, Topic, vehicle_bus
from bench.control.semidefinite import SolverStatus
from bench.control.tracker import GainSource, Tracker, TrackerOutput
from bench.scenario import CYCLE_S, Scenario
from platoon_fmu.parameters import VehicleParameters

Reference = tuple[float, float]


class TrackerEcu:
    """The paper's tracking level as an ECU.

    States: *init* until the first reference; *run*; *degraded* while the reference is missing (the last one is held) or
    degraded, or while the feedback is a fallback; *safe* while the own motion is not known: no command is given, and
    the actuators hold and then go to their own safe state.
    """

    def __init__(self, vehicle: int, scenario: Scenario) -> None:
        """Make the tracker of vehicle number `vehicle` (from 1).

        Raises:
            ValueError: the tracker's settings do not go together.
        """
        self.name = f"veh{vehicle}.tracker"
        self._bus = vehicle_bus(vehicle)
        self._parameters = VehicleParameters()
        self._tracker = Tracker(scenario.tracker, self._parameters, CYCLE_S)
        self._motion = Topic(self._bus, "VehicleMotion")
        self._actuators = Topic(self._bus, "ActuatorStatus")
        self._reference = Topic(self._bus, "Reference")
        self.inputs: tuple[Topic, ...] = (self._motion, self._actuators, self._reference)
        self._now: Reference | None = None
        self._commanded: NDArray[np.float64] | None = None
        self._applied: NDArray[np.float64] = np.zeros(3)

    def step(
        self, _cycle: int, _time_s: float, inputs: Mapping[Topic, Signals | None], health: Health
    ) -> list[Outgoing]:
        """Track this cycle's reference."""
        begin = perf_counter()
        motion = inputs[self._motion]
        then, good = self._next_reference(inputs[self._reference])
        applied = self._really_applied(inputs[self._actuators])
        out: TrackerOutput | None = None
        if motion is not None and then is not None:
            now = self._now or (motion["VelocityX"], motion["YawRate"])
            xi = np.array([motion["VelocityX"], motion["VelocityY"], motion["YawRate"]])
            out = self._tracker.step(xi, now, then, applied)
        self._commanded = None if out is None else out.u
        self._now = then
        if out is None:
            state = EcuState.INIT if then is None else EcuState.SAFE
        else:
            state = EcuState.RUN if good and out.source is GainSource.SDP else EcuState.DEGRADED
        solve_s = 0.0 if out is None else out.solve_s
        messages = [*self._commands(state, out), *self._diagnostics(state, out, health)]
        timing = {"SolveTime": 1e6 * solve_s, "StepTime": 1e6 * (perf_counter() - begin)}
        return [*messages, Outgoing(self._bus, "TrackerTiming", timing)]

    def _next_reference(self, frame: Signals | None) -> tuple[Reference | None, bool]:
        """The next cycle's reference, the last one where none came, and whether it is fresh and sound."""
        if frame is None or frame["ReferenceState"] == ReferenceState.NONE:
            return self._now, False
        return (frame["VelocityX"], frame["YawRate"]), frame["ReferenceState"] == ReferenceState.VALID

    def _really_applied(self, status: Signals | None) -> NDArray[np.float64]:
        """The virtual input that acted since the last step, as the actuators report it."""
        state = ActuatorState.HOLD if status is None else ActuatorState(int(status["ActuatorState"]))
        if state is ActuatorState.ACTIVE and self._commanded is not None:
            self._applied = self._commanded
        elif state in (ActuatorState.SAFE, ActuatorState.INIT):
            self._applied = np.zeros(3)
        return self._applied

    def _commands(self, state: EcuState, out: TrackerOutput | None) -> list[Outgoing]:
        if out is None:
            validity = CommandState.NONE
            steering, torques = 0.0, np.zeros(4)
        else:
            validity = CommandState.VALID if state is EcuState.RUN else CommandState.DEGRADED
            steering, torques = out.steering, self._parameters.R_w * out.wheel_forces
        fl, rl, rr, fr = map(float, torques)
        return [
            Outgoing(self._bus, "SteeringCommand", {"SteeringAngle": steering, "CommandState": validity}),
            Outgoing(self._bus, "TorqueCommandFront", {"TorqueFL": fl, "TorqueFR": fr}),
            Outgoing(self._bus, "TorqueCommandRear", {"TorqueRL": rl, "TorqueRR": rr}),
        ]

    def _diagnostics(self, state: EcuState, out: TrackerOutput | None, health: Health) -> list[Outgoing]:
        status: dict[str, float] = {
            "State": state,
            "SolverStatus": SolverStatus.NOT_RUN,
            "GainSource": GainSource.NONE,
        }
        contents: dict[str, dict[str, float]] = {
            "TrackerDisturbance": {},
            "TrackerReferenceState": {},
            "TrackerReferenceInput": {},
            "TrackerTarget": {},
        }
        if out is not None:
            status |= {
                "SolverStatus": out.status,
                "GainSource": out.source,
                "Iterations": out.iterations,
                "Tau": out.tau,
            }
            motion = ("VelocityX", "VelocityY", "YawRate")
            contents = {
                "TrackerDisturbance": _named(("DisturbanceX", "DisturbanceY", "DisturbanceYaw"), out.disturbance),
                "TrackerReferenceState": _named(motion, out.reference),
                "TrackerReferenceInput": _named(("SteeringAngle", "Force", "YawMoment"), out.reference_u),
                "TrackerTarget": _named(motion, out.target),
            }
        bus_health = {"FramesLost": health.frames_lost, "E2EErrors": health.e2e_errors}
        return [
            Outgoing(self._bus, "TrackerStatus", status),
            *(Outgoing(self._bus, name, values) for name, values in contents.items()),
            Outgoing(self._bus, "TrackerBusHealth", bus_health),
        ]


def _named(names: tuple[str, ...], values: NDArray[np.float64]) -> dict[str, float]:
    return dict(zip(names, values.tolist(), strict=True))
