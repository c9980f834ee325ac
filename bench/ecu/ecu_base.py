"""Common part of `PlannerBase` and `TrackerBase`: inputs by message name, health, diagnostics."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from functools import cache
from time import perf_counter
from typing import ClassVar, final

from bench.bus.codec import DBC_DIR, Codec
from bench.bus.network import EcuSlot
from bench.bus.quantities import bus_health
from bench.bus.reception import Health, Reception
from bench.bus.states import EcuState
from bench.bus.topic import Outgoing, Signals, Topic
from bench.ecu.user_code import caller
from bench.ecu.words import NUMBERS, shown, unknown
from bench.errors import BadInput, EcuError
from bench.names import vehicle_bus
from bench.scenario import Scenario


class NotAnInput(EcuError, KeyError):
    """A class asks for a message that it does not have among its inputs."""

    # Not in quotation marks, as a KeyError's is.
    __str__ = Exception.__str__


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
        """Create the ECU of vehicle number `vehicle`.

        Raises:
            BadInput: `more_inputs` is not a tuple of names.
        """
        if isinstance(self.more_inputs, str) or not all(isinstance(name, str) for name in self.more_inputs):
            mend = 'must be a tuple of message names: more_inputs = ("ActuatorStatus",)'
            raise BadInput(f"more_inputs = {self.more_inputs!r} {mend}")
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
        self._can_show: set[tuple[str, ...]] = set()

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
            NotAnInput: it is not an input; add it to `more_inputs`.
        """
        try:
            return self._received[self._topic(message)]
        except KeyError:
            raise self._not_an_input(message) from None

    def reception(self, message: str) -> Reception:
        """Return the reception of an input on the vehicle's bus: its state, and the age of the last valid frame.

        Raises:
            NotAnInput: it is not an input; add it to `more_inputs`.
        """
        if self._topic(message) not in self.inputs:
            raise self._not_an_input(message)
        return self.health.of(self._topic(message))

    def show(self, message: str, **signals: float) -> None:
        """Send signals of a diagnostic message in this cycle; signals not given have their start values.

        A message that is not shown is not sent.

        Args:
            message: a message of this ECU without E2E protection, e.g. `TrackerDisturbance`.
            **signals: physical values in the DBC's units.

        Raises:
            EcuError: this ECU sends no such diagnostic message, it has no such signal, or a value is not a number.
        """
        if (message, *signals) not in self._can_show:
            self._check_shown(message, signals)
            self._can_show.add((message, *signals))
        for name, value in signals.items():
            if not isinstance(value, NUMBERS):
                raise EcuError(f"it shows {message} with {name} = {shown(value)}; allowed: a number{caller()}")
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

    def _not_an_input(self, message: str) -> NotAnInput:
        codec = _vehicle_codec()
        of = f"of {type(self).__name__}"
        if message in codec.names and codec.data_id(message) and not self._sends(message):
            return NotAnInput(
                f"{message} is not an input {of}; add it to the class: "
                f"more_inputs = {(*self.more_inputs, message)!r}{caller()}"
            )
        inputs = [topic.message for topic in self.inputs if topic.bus == self._bus]
        others = [name for name in codec.names if codec.data_id(name) and not self._sends(name) and name not in inputs]
        asked = unknown("input", message, inputs, of, near=(*inputs, *others))
        return NotAnInput(f"it asks for {asked}; with more_inputs also: {', '.join(others)}{caller()}")

    def _check_shown(self, message: str, signals: Iterable[str]) -> None:
        """Check the names of a diagnostic message and its signals.

        Raises:
            EcuError: see `show`.
        """
        codec = _vehicle_codec()
        if message not in codec.names or codec.data_id(message) or not self._sends(message):
            allowed = [name for name in codec.names if self._sends(name) and not codec.data_id(name)]
            raise EcuError(f"it shows {unknown('diagnostic message', message, allowed, f'of a {self.role}')}{caller()}")
        known = list(codec.start_values(message))
        for name in signals:
            if name not in known:
                raise EcuError(f"it shows {unknown('signal', name, known, f'of {message}')}{caller()}")

    def _sends(self, message: str) -> bool:
        """Whether the DBC has a vehicle's bus message as one of this role."""
        return self.role.capitalize() in _vehicle_codec().described(message).senders

    def _topic(self, message: str) -> Topic:
        return Topic(self._bus, message)

    def _outgoing(self, messages: Mapping[str, Signals], bus: str | None = None) -> list[Outgoing]:
        return [Outgoing(bus or self._bus, name, signals) for name, signals in messages.items()]


@cache
def _vehicle_codec() -> Codec:
    return Codec(DBC_DIR / "vehicle.dbc")
