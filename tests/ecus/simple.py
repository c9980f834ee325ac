"""Small real ECUs: a planner that holds the platoon's speed and a proportional tracker.

They exercise the bench with all its messages and none of the paper's mathematics. Loaded by file, as a user's own ECU.
"""

import time
from collections.abc import Mapping

from bench.ecu.base import Health, Outgoing, Signals, Topic, vehicle_bus
from bench.scenario import Scenario

_WHEEL_RADIUS_M = 0.3
_MASS_KG = 1723.0


class CruisePlanner:
    """Refers to the platoon's speed and no yaw rate; its diagnostics tell how many neighbours it hears."""

    def __init__(self, vehicle: int, scenario: Scenario) -> None:
        bus = vehicle_bus(vehicle)
        self.name = f"{bus}.planner"
        self._bus, self._vehicle = bus, vehicle
        self._speed = scenario.platoon.speed_mps
        self._position = Topic(bus, "VehiclePosition")
        self._motion = Topic(bus, "VehicleMotion")
        others = [number for number in range(1, len(scenario.vehicles) + 1) if number != vehicle]
        self._heard = tuple(Topic("v2v", f"V2VPosition_{number}") for number in others)
        also = tuple(Topic("v2v", f"V2VMotion_{number}") for number in others)
        self.inputs = (self._position, self._motion, *self._heard, *also)

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        started = time.perf_counter()
        position = inputs[self._position] or {"X": 0.0, "Y": 0.0}
        motion = inputs[self._motion] or {"VelocityX": 0.0, "YawRate": 0.0}
        neighbours = sum(inputs[topic] is not None for topic in self._heard)
        bus = self._bus
        return [
            Outgoing(bus, "Reference", {"VelocityX": self._speed, "YawRate": 0.0, "ReferenceState": 1}),
            Outgoing(
                bus,
                "PlannerStatus",
                {
                    "State": 1,
                    "Slot": cycle % 17,
                    "Neighbours": neighbours,
                    "Limit": 0,
                    "BoundaryMargin": 1.0,
                    "OptimisationCost": time_s,
                },
            ),
            Outgoing(bus, "PlannerPotential", {"Ga": 1.0, "Gb": 2.0}),
            Outgoing(bus, "PlannerGains", {"P11": 1.0, "P12": 1.0, "P21": 1.0, "P22": 1.0}),
            Outgoing(bus, "PlannerTarget", {"TargetX": position["X"], "TargetY": position["Y"]}),
            Outgoing(bus, "PlannerBusHealth", {"FramesLost": health.frames_lost, "E2EErrors": health.e2e_errors}),
            Outgoing("v2v", f"V2VPosition_{self._vehicle}", position),
            Outgoing("v2v", f"V2VStatus_{self._vehicle}", {"State": 1}),
            Outgoing(
                "v2v",
                f"V2VMotion_{self._vehicle}",
                {"Speed": motion["VelocityX"], "Course": 0.0, "YawRate": motion["YawRate"]},
            ),
            Outgoing(
                bus,
                "PlannerTiming",
                {"OptimisationTime": 0.0, "StepTime": (time.perf_counter() - started) * 1e6},
            ),
        ]


class SpeedTracker:
    """Wheel torques in proportion to the speed error, steering against the yaw rate's."""

    def __init__(self, vehicle: int, scenario: Scenario) -> None:  # noqa: ARG002 - the signature of every ECU
        bus = vehicle_bus(vehicle)
        self.name = f"{bus}.tracker"
        self._bus = bus
        self._motion = Topic(bus, "VehicleMotion")
        self._reference = Topic(bus, "Reference")
        self.inputs: tuple[Topic, ...] = (self._motion, self._reference)

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        started = time.perf_counter()
        motion, reference = inputs[self._motion], inputs[self._reference]
        if motion is None or reference is None:
            force, steering, state = 0.0, 0.0, 2
            motion, reference = motion or {}, reference or {}
        else:
            force = 0.5 * _MASS_KG * (reference["VelocityX"] - motion["VelocityX"])
            steering, state = 0.1 * (reference["YawRate"] - motion["YawRate"]), 1
        torque = force / 4 * _WHEEL_RADIUS_M
        bus = self._bus
        return [
            Outgoing(bus, "SteeringCommand", {"SteeringAngle": steering, "CommandState": state}),
            Outgoing(bus, "TorqueCommandFront", {"TorqueFL": torque, "TorqueFR": torque}),
            Outgoing(bus, "TorqueCommandRear", {"TorqueRL": torque, "TorqueRR": torque}),
            Outgoing(
                bus,
                "TrackerStatus",
                {"State": 1, "SolverStatus": 6, "GainSource": 3, "Iterations": cycle % 64, "Tau": time_s},
            ),
            Outgoing(bus, "TrackerDisturbance", {"DisturbanceX": 0, "DisturbanceY": 0, "DisturbanceYaw": 0}),
            Outgoing(
                bus,
                "TrackerReferenceState",
                {
                    "VelocityX": reference.get("VelocityX", 0.0),
                    "VelocityY": 0.0,
                    "YawRate": reference.get("YawRate", 0.0),
                },
            ),
            Outgoing(bus, "TrackerReferenceInput", {"SteeringAngle": 0.0, "Force": force, "YawMoment": 0.0}),
            Outgoing(bus, "TrackerTarget", {"VelocityX": 0.0, "VelocityY": 0.0, "YawRate": 0.0}),
            Outgoing(bus, "TrackerBusHealth", {"FramesLost": health.frames_lost, "E2EErrors": health.e2e_errors}),
            Outgoing(bus, "TrackerTiming", {"SolveTime": 0.0, "StepTime": (time.perf_counter() - started) * 1e6}),
        ]
