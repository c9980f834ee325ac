"""Whether what a fault is done to exists: vehicles, messages, signals."""

from bench.bus.codec import bus_names, load_codecs
from bench.faults.kinds import SENSOR_FAULTS, Fault

Problem = tuple[tuple[str, ...], str]
"""Path of a key of the fault, and what is wrong with its value."""


def target_problems(fault: Fault, vehicles: int) -> list[Problem]:
    """Return what is wrong with the target of a fault in a scenario of this many vehicles; empty where all is well."""
    problems: list[Problem] = []
    vehicle = getattr(fault, "vehicle", None)
    if vehicle is not None and vehicle > vehicles:
        problems.append((("vehicle",), f"= {vehicle} does not exist; allowed: 1 to {vehicles}"))
    for key in ("node", "ecu"):
        name = getattr(fault, key, None)
        if name is not None and name.partition(".")[0] not in bus_names(vehicles):
            problems.append(((key,), f"= {name} does not exist; allowed: veh1 to veh{vehicles}"))
    bus = getattr(fault, "bus", None)
    if bus is None:
        return problems
    if bus not in bus_names(vehicles):
        return [*problems, (("bus",), f"= {bus} does not exist; allowed: {', '.join(bus_names(vehicles))}")]
    return [*problems, *_message_problems(fault, bus, vehicles)]


def _message_problems(fault: Fault, bus: str, vehicles: int) -> list[Problem]:
    name = getattr(fault, "message", None)
    if name is None:
        return []
    codec = load_codecs(vehicles)[bus]
    known = [each for each in codec.names if codec.message(each).senders[0] != "Conductor"]
    if isinstance(fault, SENSOR_FAULTS):
        known = [each for each in known if codec.message(each).senders[0] == "Plant"]
    if name not in known:
        return [(("message",), f"= {name} is nothing on {bus} that can have this fault; allowed: {', '.join(known)}")]
    if fault.kind == "counter_stuck" and not codec.data_id(name):
        return [(("message",), f"= {name} has no alive counter")]
    signal = getattr(fault, "signal", None)
    signals = list(codec.start_values(name))
    if signal is not None and signal not in signals:
        return [(("signal",), f"= {signal} is no signal of {name}; allowed: {', '.join(signals)}")]
    return []
