# cython: annotation_typing=False, binding=True
"""Checks of an ECU's class, of an ECU, and of what its steps return.

Each message says what is wrong, where, and what is allowed.
"""

import inspect
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import cython

from bench.bus.codec import Codec
from bench.bus.e2e import COUNTER_SIGNAL, CRC_SIGNAL
from bench.bus.network import ROLES, EcuSlot, transmissions
from bench.bus.topic import Outgoing, Signals, Topic
from bench.ecu.base import Ecu, Health
from bench.ecu.runtime import INPUT_WAIT_S
from bench.ecu.user_code import described, is_users, place_of
from bench.ecu.words import NUMBERS, shown, unknown
from bench.errors import BadInput, BenchError, EcuError
from bench.scenario import Scenario
from bench.scenario.errors import closest

_METHODS = {"control": ("motion", "reference"), "plan": ("pose", "motion", "peers")}
"""What a class derived from `TrackerBase` or `PlannerBase` implements, with its arguments."""

_STEP = ("cycle", "time_s", "inputs", "health")


def check_class(found: type, spec: str, role: str | None) -> None:
    """Check that a class is an ECU's, of this role.

    Raises:
        BadInput: it is not.
    """
    if not callable(getattr(found, "step", None)):
        raise BadInput(
            f"ECU {spec!r}: the class {found.__name__} is not an ECU: it has no method step; "
            f"derive it from TrackerBase or PlannerBase of bench.ecu, or see bench.ecu.base.Ecu{place_of(found)}"
        )
    missing = sorted(getattr(found, "__abstractmethods__", ()))
    if missing:
        hints = [_method_hint(found, name) for name in missing]
        raise BadInput(f"ECU {spec!r}: the class {found.__name__} lacks the method {', '.join(hints)}{place_of(found)}")
    if getattr(found, "_is_protocol", False):
        raise BadInput(f"ECU {spec!r}: {found.__name__} only describes ECUs; give a class that is one")
    own = getattr(found, "role", None)
    if role is not None and own in ROLES and own != role:
        raise BadInput(_wrong_role(spec, found, str(own), role) + place_of(found))


def created(ecu_class: type, spec: str, slot: EcuSlot, scenario: Scenario, codecs: Mapping[str, Codec]) -> "CheckedEcu":
    """Return an ECU of this class in its slot, whose steps are checked.

    Raises:
        BadInput: its constructor fails, or it lacks something, or its inputs never arrive.
    """
    name = ecu_class.__name__
    problem = _arguments_problem(ecu_class, ("vehicle", "scenario"))
    if problem:
        base = "; write def __init__(self, vehicle, scenario) and call super().__init__(vehicle, scenario) first"
        mend = base if hasattr(ecu_class, "role") else ""
        raise BadInput(
            f"ECU {spec!r}: the bench calls {name}(vehicle, scenario), but {problem}{place_of(ecu_class)}{mend}"
        )
    try:
        ecu = ecu_class(slot.vehicle, scenario)
    except BadInput as error:
        raise BadInput(f"ECU {spec!r}: {error}") from error
    except (Exception, SystemExit) as error:
        if not is_users(error):
            raise
        raise BadInput(f"ECU {spec!r}: {name}(vehicle {slot.vehicle}, scenario) failed: {described(error)}") from error
    _check_members(ecu, spec, ecu_class)
    _check_place(ecu, spec, slot, codecs, len(scenario.vehicles), ecu_class)
    return CheckedEcu(ecu, slot, codecs)


class CheckedEcu:
    """An ECU whose answers are checked, and whose errors are explained. See `bench.ecu.base.Ecu`."""

    def __init__(self, ecu: Ecu, slot: EcuSlot, codecs: Mapping[str, Codec]) -> None:
        """Check the steps of `ecu`, in this slot."""
        self._ecu = ecu
        self._slot = slot
        self._signals = {
            (topic.bus, topic.message): frozenset(bits.signal for bits in codecs[topic.bus].bits(topic.message))
            for topic in slot.sends(codecs)
        }
        self._by_bus: dict[str, dict[str, frozenset[str]]] = {bus: {} for bus, _ in self._signals}
        for (bus, message), signals in self._signals.items():
            self._by_bus[bus][message] = signals
        self.name = slot.name
        self.inputs: tuple[Topic, ...] = tuple(ecu.inputs)
        self.input_wait_s = float(getattr(ecu, "input_wait_s", INPUT_WAIT_S))

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        """Let the ECU do its step.

        Raises:
            EcuError: it fails, or returns something that cannot be sent.
        """
        try:
            answer = self._ecu.step(cycle, time_s, inputs, health)
            # A generator does its work, and may fail, only when consumed.
            sent = list(answer) if isinstance(answer, Iterable) and not isinstance(answer, (str, bytes)) else None
        except BenchError as error:
            raise EcuError(f"{self.name} failed: {error}") from error
        except Exception as error:
            if not is_users(error):
                raise
            raise EcuError(f"{self.name} failed: {described(error)}") from error
        if sent is not None and _are_plain(sent, self._by_bus):
            return sent
        problem = f"{shown(answer)}, not a list of Outgoing" if sent is None else self._problem(sent)
        if problem:
            raise EcuError(f"{self.name} failed: its step returned {problem}{place_of(type(self._ecu).step)}")
        return sent or []

    def _problem(self, sent: Sequence[Any]) -> str:
        """Return what cannot be sent; empty if all can."""
        for each in sent:
            if not isinstance(each, Outgoing):
                return f"a list with {shown(each)}; allowed: Outgoing(bus, message, values)"
            signals = self._signals.get((each.bus, each.message))
            if signals is None:
                return self._message_problem(each)
            if not isinstance(each.values, Mapping):
                return f"{each.message} with {shown(each.values)}; allowed: a dict with {', '.join(signals)}"
            for name, value in each.values.items():
                if name not in signals:
                    allowed = sorted(signals - {CRC_SIGNAL, COUNTER_SIGNAL})
                    return f"{each.message} with {unknown('signal', name, allowed)}"
                if not isinstance(value, NUMBERS):
                    return f"{each.message} with {name} = {shown(value)}; allowed: a number"
        return ""

    def _message_problem(self, each: Outgoing) -> str:
        names = [message for bus, message in self._signals if bus == each.bus]
        if not names:
            return f"{each.message} on bus {each.bus}; it sends on {', '.join(self._slot.buses)}"
        return unknown("message", each.message, names, of=f"that {self.name} sends on {each.bus}")


@cython.cfunc
@cython.locals(sent=list, by_bus=dict, messages=dict, values=dict)
def _are_plain(sent: list[Any], by_bus: dict[str, dict[str, frozenset[str]]]) -> bool:
    """Return whether all can be sent for certain: messages with dicts of Python's own numbers, as nearly always."""
    for each in sent:
        if type(each) is not Outgoing or type(each.values) is not dict:
            return False
        messages = by_bus.get(each.bus)
        signals = None if messages is None else messages.get(each.message)
        if signals is None:
            return False
        values = each.values
        for name, value in values.items():
            if name not in signals or not isinstance(value, (float, int)):
                return False
    return True


def _method_hint(found: type, name: str) -> str:
    near = closest(name, [each for each in vars(found) if each != name and not each.startswith("_")])
    arguments = f"({', '.join(('self', *_METHODS[name]))})" if name in _METHODS else ""
    return f"{name}{arguments}{f' (it has {near})' if near else ''}"


def _wrong_role(spec: str, found: type, own: str, role: str) -> str:
    return f"ECU {spec!r}: the class {found.__name__} is a {own}, not a {role}; give it as {own}={spec}"


def _arguments_problem(function: Any, arguments: Sequence[str]) -> str:
    """Return why a function cannot be called with these arguments; empty if it can, or if that is not known."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return ""
    try:
        signature.bind(*arguments)
    except TypeError:
        return f"it takes {signature.replace(return_annotation=inspect.Signature.empty)}"
    return ""


def _check_members(ecu: Any, spec: str, ecu_class: type) -> None:
    name = type(ecu).__name__
    missing = [member for member in ("name", "inputs") if not hasattr(ecu, member)]
    if missing:
        derived = any(method in dir(ecu) for method in _METHODS)
        mend = "call super().__init__(vehicle, scenario) in its constructor" if derived else "see bench.ecu.base.Ecu"
        raise BadInput(
            f"ECU {spec!r}: an instance of {name} has no attribute {' and '.join(missing)}; {mend}{place_of(ecu_class)}"
        )
    inputs = ecu.inputs
    if not isinstance(inputs, (tuple, list)) or not all(isinstance(each, Topic) for each in inputs):
        raise BadInput(
            f"ECU {spec!r}: the inputs of {name} must be a tuple of Topic(bus, message){place_of(ecu_class)}"
        )
    for method, arguments in (("step", _STEP), *_METHODS.items()):
        own = getattr(ecu, method, None)
        problem = _arguments_problem(own, arguments) if callable(own) else ""
        if problem and own is not None:
            raise BadInput(
                f"ECU {spec!r}: the bench calls {name}.{method}({', '.join(arguments)}), but {problem}{place_of(own)}"
            )


def _check_place(
    ecu: Any, spec: str, slot: EcuSlot, codecs: Mapping[str, Codec], vehicles: int, ecu_class: type
) -> None:
    """Check that an ECU belongs into its slot: its name and inputs.

    Raises:
        BadInput: it is of another role, or waits for something that does not come.
    """
    for role in ROLES:
        if role != slot.role and ecu.name == EcuSlot(role, slot.vehicle).name:
            raise BadInput(_wrong_role(spec, type(ecu), role, slot.role) + place_of(ecu_class))
    sends = slot.sends(codecs)
    for topic in ecu.inputs:
        what = f"{slot.name}: input {topic.message}"
        if topic.bus not in slot.buses:
            raise BadInput(f"{what} is on bus {topic.bus}; this node has {', '.join(slot.buses)}{place_of(ecu_class)}")
        sent = transmissions(topic.bus, codecs[topic.bus], vehicles)
        known = [each.message for each in sent if each.protected and each.sender != slot.name]
        if topic in sends:
            raise BadInput(
                f"{what} is what a {slot.role} sends itself, so it would wait for itself for ever{place_of(ecu_class)}"
            )
        if any(each.message == topic.message for each in sent) and topic.message not in known:
            raise BadInput(
                f"{what} on bus {topic.bus} has no alive counter, which determines its cycle; "
                f"allowed: {', '.join(known)}{place_of(ecu_class)}"
            )
        if topic.message not in known:
            near = closest(topic.message, known)
            meant = f"; did you mean {near}?" if near else ""
            raise BadInput(
                f"{what} does not exist on bus {topic.bus}; its DBC has {', '.join(known)}{meant}{place_of(ecu_class)}"
            )
