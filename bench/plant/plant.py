"""A vehicle on its bus: sensor frames out, actuator commands in, the FMU in between.

In cycle k it publishes the state at t_k as soon as BenchSync k opens the cycle, waits for the cycle's three command
messages, applies them and advances to t_k + 10 ms.
"""

import math
import time
from array import array
from collections.abc import Callable, Mapping

import cython

from bench.bus.codec import Codec
from bench.bus.inbox import Inbox
from bench.bus.link.base import Link
from bench.bus.node import REST_S
from bench.bus.outbox import Outbox
from bench.bus.quantities import (
    ACTUATORS,
    ATTITUDE,
    COMMAND_RECEPTIONS,
    COMMANDS,
    MOTION,
    POSITION,
    WHEELS_FRONT,
    WHEELS_REAR,
)
from bench.bus.topic import Signals, Topic
from bench.cycle import CYCLE_S, time_of
from bench.faults.plan import FaultPlan
from bench.faults.profile import Constant
from bench.names import vehicle_bus
from bench.plant.actuators import Actuators
from bench.plant.description import FmuDescription
from bench.plant.faults import VehicleFaults
from bench.plant.fmu import FmuInstance
from bench.plant.noise import SensorNoise
from bench.scenario import Road, Vehicle
from platoon_fmu.parameters import VehicleParameters

_ACCELERATION, _HEALTH, _TIMING = "VehicleAcceleration", "PlantBusHealth", "PlantTiming"

MOST_HELD_CYCLES = 255
"""Largest value of the DBC's HeldCycles."""

COLLECT_S = 0.008
"""In real time, when after its BenchSync the plant reads the commands of a cycle: late enough for most to arrive,
and early enough for a step before the next BenchSync."""

TruthSink = Callable[[int, int, "array[float]"], None]
"""Takes vehicle, cycle and truth row: all outputs, then all inputs of the FMU in its description's order.

The outputs are those at the cycle's time; the inputs are those applied until then, from which the outputs follow.
"""

_STATE: Mapping[str, Mapping[str, str]] = {
    POSITION: {"X": "X", "Y": "Y"},
    ATTITUDE: {"Yaw": "psi", "Roll": "phi"},
    MOTION: {"VelocityX": "v_x", "VelocityY": "v_y", "YawRate": "gamma"},
    _ACCELERATION: {"AccelerationX": "a_x", "AccelerationY": "a_y"},
    WHEELS_FRONT: {"WheelSpeedFL": "omega_fl", "WheelSpeedFR": "omega_fr"},
    WHEELS_REAR: {"WheelSpeedRL": "omega_rl", "WheelSpeedRR": "omega_rr"},
}
"""The messages about the vehicle's state: the FMU's output that each signal has."""


class VehicleNode:
    """One vehicle as a node on its bus.

    Attributes:
        name: its name.
        links: the vehicle's bus.
    """

    def __init__(
        self,
        vehicle: int,
        fmu: FmuInstance,
        description: FmuDescription,
        road: Road,
        link: Link,
        codec: Codec,
        truth: TruthSink,
        plan: FaultPlan,
        noise: SensorNoise | None,
    ) -> None:
        """Connect vehicle number `vehicle` to its bus `link`; its sensors have `noise`, if any."""
        bus = vehicle_bus(vehicle)
        self.name = f"{bus}.plant"
        self._vehicle = vehicle
        self._fmu = fmu
        self._state = tuple(
            (message, tuple((signal, description.outputs.index(output)) for signal, output in outputs.items()))
            for message, outputs in _STATE.items()
        )
        self._noise = noise
        self._inputs = description.inputs
        self._weight = VehicleParameters().M * VehicleParameters().g
        self._road = road
        self._is_road_constant = all(isinstance(getattr(road, name), Constant) for name in type(road).model_fields)
        self._influences = self._influences_at(0.0)
        self._bus = bus
        self.links = (link,)
        self._truth = truth
        self._health_period = codec.period(_HEALTH)
        self._commands = {name: Topic(bus, name) for name in COMMANDS}
        self._inbox = Inbox({bus: link}, {bus: codec}, self._commands.values(), name=self.name, joins=False, plan=plan)
        self._outbox = Outbox(self.name, {bus: link}, {bus: codec}, plan)
        self._faults = VehicleFaults(vehicle, plan, description.inputs)
        self._actuators = Actuators()
        self._applied = self._actuators.applied
        self._published = -1
        self._step_us = 0.0

    @property
    def wake_at(self) -> float | None:
        """None: the plant reacts to BenchSync only."""
        return None

    @property
    def rest_until(self) -> float:
        """In real time: there is only work just before and at BenchSync."""
        inbox = self._inbox
        if not inbox.realtime:
            return 0.0
        return inbox.opened_at + (REST_S if inbox.cycle > inbox.opened else COLLECT_S)

    @property
    def opened(self) -> int:
        """The newest cycle that the conductor has opened; -1 before the first."""
        return self._inbox.opened

    @property
    def stopped(self) -> bool:
        """Whether the conductor has stopped this vehicle."""
        return self._inbox.stopped

    @property
    def awaited(self) -> Link | None:
        """See `bench.bus.node.Node`."""
        return self._inbox.awaited

    def poll(self) -> bool:
        """Take the arrived frames; publish if they open a cycle, step if they complete one; whether there were any.

        In real time a cycle ends when the next one begins, with the commands received by then.

        Raises:
            RunFailed: the FMU failed.
        """
        arrived = self._inbox.drain()
        while not self.stopped:
            if self._published < self._inbox.cycle <= self._inbox.opened:
                self._publish(self._inbox.cycle)
            overdue = self._inbox.realtime and self._inbox.opened > self._inbox.cycle
            if not (self._inbox.complete or overdue):
                break
            self._step()
        return arrived

    def _publish(self, cycle: cython.longlong) -> None:
        """Send the vehicle's messages of a cycle, and report the truth."""
        inbox, outbox, bus, actuators = self._inbox, self._outbox, self._bus, self._actuators
        self._published = cycle
        row = self._fmu.outputs()
        self._truth(self._vehicle, cycle, row + self._fmu.inputs())
        errors = None if self._noise is None else self._noise.at(cycle)
        for message, places in self._state:
            values = {signal: row[place] for signal, place in places}
            if errors is not None:
                for signal in values:
                    values[signal] += errors[signal]
            outbox.put(bus, message, values)
        status = {
            "SteeringAngle": self._applied.steering_angle,
            "ActuatorState": actuators.state,
            "HeldCycles": min(actuators.held_cycles, MOST_HELD_CYCLES),
            "CommandState": actuators.command_state,
        }
        outbox.put(bus, ACTUATORS, status)
        if cycle % self._health_period == 0:
            outbox.put(bus, _HEALTH, self._health())
        outbox.put(bus, _TIMING, {"StepTime": self._step_us})
        outbox.send(cycle, lockstep=not inbox.realtime)

    def _health(self) -> Signals:
        """Return the signals of the message about the plant's end of the bus."""
        health = self._inbox.health
        receptions = {signal: health.of(self._commands[name]).state for name, signal in COMMAND_RECEPTIONS.items()}
        return {"FramesLost": health.frames_lost, "E2EErrors": health.e2e_errors, **receptions}

    def _step(self) -> None:
        started = time.perf_counter()
        inbox = self._inbox
        cycle = inbox.cycle
        commands = inbox.take()
        self._actuators.take({name: commands[topic] for name, topic in self._commands.items()})
        self._applied = self._faults.on_actuators(cycle, self._actuators.applied)
        time_s = time_of(cycle)
        values = self._faults.on_inputs(cycle, self._acting(time_s))
        self._fmu.step(time_s, CYCLE_S, [values[name] for name in self._inputs])
        self._step_us = (time.perf_counter() - started) * 1e6

    def _acting(self, time_s: float) -> dict[str, float]:
        """The FMU's inputs by name: from the actuators, and from the road at `time_s`."""
        applied = self._applied
        influences = self._influences if self._is_road_constant else self._influences_at(time_s)
        return {
            "steering_angle": applied.steering_angle,
            "wheel_torque_fl": applied.torque_fl,
            "wheel_torque_rl": applied.torque_rl,
            "wheel_torque_rr": applied.torque_rr,
            "wheel_torque_fr": applied.torque_fr,
            **influences,
        }

    def _influences_at(self, time_s: float) -> dict[str, float]:
        """The FMU's inputs by name that come from the road at `time_s`, or from nothing."""
        road = self._road
        return {
            "lambda_f": road.lambda_f.value(time_s),
            "lambda_r": road.lambda_r.value(time_s),
            "mu": road.mu.value(time_s),
            "inflation_fl": 1.0,
            "inflation_rl": 1.0,
            "inflation_rr": 1.0,
            "inflation_fr": 1.0,
            "force_x": road.force_x_n.value(time_s) - self._weight * math.sin(road.slope_rad.value(time_s)),
            "force_y": road.force_y_n.value(time_s),
            "moment_z": road.moment_z_nm.value(time_s),
        }


def start_values(vehicle: Vehicle) -> dict[str, float]:
    """The FMU's start parameters for a vehicle of the scenario, rolling straight ahead."""
    return {
        "X_start": vehicle.x_m,
        "Y_start": vehicle.y_m,
        "psi_start": vehicle.yaw_rad,
        "v_x_start": vehicle.speed_mps,
        "v_y_start": 0.0,
        "gamma_start": 0.0,
    }
