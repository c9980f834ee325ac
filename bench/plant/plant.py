"""A vehicle on its bus: sensor frames out, actuator commands in, the FMU in between.

In cycle k it publishes the state at t_k as soon as BenchSync k opens the cycle, waits for the cycle's three command
messages, applies them and advances to t_k + 10 ms.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence

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
from bench.names import vehicle_bus
from bench.plant.actuators import Actuators
from bench.plant.description import FmuDescription
from bench.plant.faults import VehicleFaults
from bench.plant.fmu import FmuInstance
from bench.scenario import Road, Vehicle
from platoon_fmu.parameters import VehicleParameters

MOST_HELD_CYCLES = 255
"""Largest value of the DBC's HeldCycles."""

COLLECT_S = 0.008
"""In real time, when after its BenchSync the plant reads the commands of a cycle: late enough for most to arrive,
and early enough for a step before the next BenchSync."""

TruthSink = Callable[[int, int, Sequence[float]], None]
"""Takes vehicle, cycle and truth row: all outputs, then all inputs of the FMU in its description's order.

The outputs are those at the cycle's time; the inputs are those applied until then, from which the outputs follow.
"""


class VehicleNode:
    """One vehicle as a node on its bus."""

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
    ) -> None:
        """Connect vehicle number `vehicle` to its bus `link`."""
        bus = vehicle_bus(vehicle)
        self.name = f"{bus}.plant"
        self._vehicle = vehicle
        self._fmu = fmu
        self._outputs = description.outputs
        self._inputs = description.inputs
        self._weight = VehicleParameters().M * VehicleParameters().g
        self._road = road
        self._bus = bus
        self._link = link
        self._truth = truth
        self._commands = {name: Topic(bus, name) for name in COMMANDS}
        self._inbox = Inbox({bus: link}, {bus: codec}, self._commands.values(), name=self.name, joins=False, plan=plan)
        self._outbox = Outbox(self.name, {bus: link}, {bus: codec}, plan)
        self._faults = VehicleFaults(vehicle, plan, description.inputs)
        self._actuators = Actuators()
        self._applied = self._actuators.applied
        self._published = -1
        self._step_us = 0.0

    @property
    def links(self) -> tuple[Link, ...]:
        """The vehicle's bus."""
        return (self._link,)

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

    def _publish(self, cycle: int) -> None:
        self._published = cycle
        row = self._fmu.outputs()
        self._truth(self._vehicle, cycle, row + self._fmu.inputs())
        for name, values in self._messages(dict(zip(self._outputs, row, strict=True))).items():
            self._outbox.put(self._bus, name, values)
        self._outbox.send(cycle, lockstep=not self._inbox.realtime)

    def _messages(self, output: Mapping[str, float]) -> dict[str, Signals]:
        """The vehicle's messages by name, from the FMU's outputs."""
        health = self._inbox.health
        return {
            POSITION: {"X": output["X"], "Y": output["Y"]},
            ATTITUDE: {"Yaw": output["psi"], "Roll": output["phi"]},
            MOTION: {
                "VelocityX": output["v_x"],
                "VelocityY": output["v_y"],
                "YawRate": output["gamma"],
            },
            "VehicleAcceleration": {"AccelerationX": output["a_x"], "AccelerationY": output["a_y"]},
            WHEELS_FRONT: {"WheelSpeedFL": output["omega_fl"], "WheelSpeedFR": output["omega_fr"]},
            WHEELS_REAR: {"WheelSpeedRL": output["omega_rl"], "WheelSpeedRR": output["omega_rr"]},
            ACTUATORS: {
                "SteeringAngle": self._applied.steering_angle,
                "ActuatorState": self._actuators.state,
                "HeldCycles": min(self._actuators.held_cycles, MOST_HELD_CYCLES),
                "CommandState": self._actuators.command_state,
            },
            "PlantBusHealth": {
                "FramesLost": health.frames_lost,
                "E2EErrors": health.e2e_errors,
                **{signal: health.of(self._commands[name]).state for name, signal in COMMAND_RECEPTIONS.items()},
            },
            "PlantTiming": {"StepTime": self._step_us},
        }

    def _step(self) -> None:
        started = time.perf_counter()
        cycle = self._inbox.cycle
        commands = self._inbox.take()
        self._actuators.take({name: commands[topic] for name, topic in self._commands.items()})
        self._applied = self._faults.on_actuators(cycle, self._actuators.applied)
        time_s = time_of(cycle)
        values = self._faults.on_inputs(cycle, self._acting(time_s))
        self._fmu.step(time_s, CYCLE_S, [values[name] for name in self._inputs])
        self._step_us = (time.perf_counter() - started) * 1e6

    def _acting(self, time_s: float) -> dict[str, float]:
        """The FMU's inputs by name: from the actuators, and from the road at `time_s`."""
        applied, road = self._applied, self._road
        return {
            "steering_angle": applied.steering_angle,
            "wheel_torque_fl": applied.torque_fl,
            "wheel_torque_rl": applied.torque_rl,
            "wheel_torque_rr": applied.torque_rr,
            "wheel_torque_fr": applied.torque_fr,
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
