"""Common part of `PlannerBase` and `TrackerBase`: inputs by message name, health, diagnostics."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from time import perf_counter
from typing import ClassVar, final

from bench.bus.network import EcuSlot
from bench.bus.quantities import bus_health
from bench.bus.reception import Health, Reception
from bench.bus.states import EcuState
from bench.bus.topic import Outgoing, Signals, Topic
from bench.names import vehicle_bus
from bench.scenario import Scenario


class EcuBase(ABC):
    """An ECU of one vehicle, as the base class of a controller.

    Attributes:
        role: `planner` or `tracker`.
        more_inputs: input messages on the vehicle's bus in addition to those of every ECU of its role.
        vehicle: number of its vehicle, from 1.
        scenario: the scenario of the run.
        cycle: number of the cycle, from 0.
        time_s: simulated time (s).
        health: frames lost, E2E errors and the reception of each input.
    """

    role: ClassVar[str]
    more_inputs: ClassVar[tuple[str, ...]] = ()

    def __init__(self, vehicle: int, scenario: Scenario) -> None:
        """Create the ECU of vehicle number `vehicle`."""
        self.vehicle = vehicle
        self.scenario = scenario
        self._bus = vehicle_bus(vehicle)
        self._slot = EcuSlot(self.role, vehicle)
        self.name = self._slot.name
        self.inputs: tuple[Topic, ...] = tuple(
            dict.fromkeys((*self._own_inputs(), *map(self._topic, self.more_inputs)))
        )
        self.cycle = 0
        self.time_s = 0.0
        self.health = Health()
        self._received: Mapping[Topic, Signals | None] = {}
        self._diagnostics: dict[str, Signals] = {}

    @final
    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        """See `bench.ecu.base.Ecu`."""
        begin = perf_counter()
        self.cycle, self.time_s, self.health, self._received = cycle, time_s, health, inputs
        self._diagnostics = {}
        messages, state = self._work()
        name = self._slot.message
        status: Signals = {"State": state, **self._diagnostics.pop(name("Status"), {})}
        own = {name("Status"): status, name("BusHealth"): self._bus_health(), **self._diagnostics}
        timing: dict[str, Signals] = {name("Timing"): {"StepTime": 1e6 * (perf_counter() - begin)}}
        return [*messages, *self._outgoing(own), *self._outgoing(timing)]

    def received(self, message: str) -> Signals | None:
        """Return the signals of an input in this cycle; None if missing or damaged.

        Args:
            message: its name on the vehicle's bus, e.g. `ActuatorStatus`.

        Raises:
            KeyError: it is not an input; add it to `more_inputs`.
        """
        return self._received[self._topic(message)]

    def reception(self, message: str) -> Reception:
        """Return the reception of an input on the vehicle's bus: its state, and the age of the last valid frame."""
        return self.health.of(self._topic(message))

    def show(self, message: str, **signals: float) -> None:
        """Send signals of a diagnostic message in this cycle; signals not given have their start values.

        A message that is not shown is not sent.

        Args:
            message: a message of this ECU without E2E protection, e.g. `TrackerDisturbance`.
            **signals: physical values in the DBC's units.
        """
        self._diagnostics[message] = {**self._diagnostics.get(message, {}), **signals}

    def _bus_health(self) -> dict[str, float]:
        """Return the signals that report this ECU's reception."""
        return bus_health(self.health)

    @abstractmethod
    def _own_inputs(self) -> Iterable[Topic]:
        """Return the inputs of every ECU of this role."""

    @abstractmethod
    def _work(self) -> tuple[list[Outgoing], EcuState]:
        """Run the cycle; return all messages but the diagnostics, and the state."""

    def _topic(self, message: str) -> Topic:
        return Topic(self._bus, message)

    def _outgoing(self, messages: Mapping[str, Signals], bus: str | None = None) -> list[Outgoing]:
        return [Outgoing(bus or self._bus, name, signals) for name, signals in messages.items()]
