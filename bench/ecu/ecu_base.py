"""What the bases of one's own planner and tracker have in common: inputs by message name, health, diagnostics."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from time import perf_counter
from typing import ClassVar, final

from bench.bus.network import EcuSlot
from bench.bus.quantities import bus_health
from bench.bus.reception import Health, Reception
from bench.bus.states import EcuState
from bench.bus.topic import Outgoing, Signals, Topic, vehicle_bus
from bench.scenario import Scenario


class EcuBase(ABC):
    """An ECU of one vehicle, seen from the controller in it.

    Attributes:
        role: `planner` or `tracker`.
        more_inputs: messages of the vehicle's bus to take besides those that every ECU of its role takes.
        vehicle: number of its vehicle, from 1.
        scenario: the scenario of the run.
        cycle: number of the cycle, from 0.
        time_s: simulated time (s).
        health: frames lost, E2E errors and the reception of each input.
    """

    role: ClassVar[str]
    more_inputs: ClassVar[tuple[str, ...]] = ()

    def __init__(self, vehicle: int, scenario: Scenario) -> None:
        """Make the ECU of vehicle number `vehicle`."""
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
        """Return the signals of an input of this cycle; None where it is missing or came damaged.

        Args:
            message: its name on the vehicle's bus: `ActuatorStatus`.

        Raises:
            KeyError: it is no input; more of them are taken with `more_inputs`.
        """
        return self._received[self._topic(message)]

    def reception(self, message: str) -> Reception:
        """Return how an input of the vehicle's bus is received: its state, and the age of the last good frame."""
        return self.health.of(self._topic(message))

    def show(self, message: str, **signals: float) -> None:
        """Put signals of a diagnostic message on the bus in this cycle; what is not shown has its start value.

        Args:
            message: a message that this ECU sends, without E2E protection: `TrackerDisturbance`.
            **signals: physical values in the DBC's units.
        """
        self._diagnostics[message] = {**self._diagnostics.get(message, {}), **signals}

    def _bus_health(self) -> dict[str, float]:
        """What the bus is to know of this ECU's reception."""
        return bus_health(self.health)

    @abstractmethod
    def _own_inputs(self) -> Iterable[Topic]:
        """The inputs that every ECU of this role takes."""

    @abstractmethod
    def _work(self) -> tuple[list[Outgoing], EcuState]:
        """Do the cycle's work; the messages that drive something, and the state."""

    def _topic(self, message: str) -> Topic:
        return Topic(self._bus, message)

    def _outgoing(self, messages: Mapping[str, Signals], bus: str | None = None) -> list[Outgoing]:
        return [Outgoing(bus or self._bus, name, signals) for name, signals in messages.items()]
