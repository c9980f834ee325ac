"""The family of random faults: a random scenario with one fault; each number is one scenario, for ever the same.

`random-fault:SEED` is its name wherever a scenario is named; it is `random:SEED` with a fault of a random kind, target,
time and size. Every kind of fault is among them, with all its keys, and sizes are those of real sensors, actuators,
tyres, roads and buses, some of them beyond what can be controlled.

A kind that is added later takes the numbers whose lot it wins from the others and changes no scenario besides; anything
else here must not change: `tests/scenario/test_random_faults.py` holds hashes of some scenarios.
"""

from collections.abc import Callable, Iterable, Mapping

from bench.control.random_numbers import mixed
from bench.scenario.draw import Draw
from bench.scenario.random_family import situation

Keys = dict[str, object]
"""Keys of a fault with their values."""

LATEST_START_S = 15.0
"""Latest time at which a fault begins (s): the platoon has been formed for long, and 5 s remain."""
DURATION_S = (0.05, 10.0)
"""Duration of a fault that does not stay to the end (s)."""

SENSORS: Mapping[str, Mapping[str, float]] = {
    "VehiclePosition": {"X": 10.0, "Y": 4.0},
    "VehicleAttitude": {"Yaw": 0.2, "Roll": 0.05},
    "VehicleMotion": {"VelocityX": 5.0, "VelocityY": 2.0, "YawRate": 0.4},
    "VehicleAcceleration": {"AccelerationX": 3.0, "AccelerationY": 3.0},
    "WheelSpeedsFront": {"WheelSpeedFL": 30.0, "WheelSpeedFR": 30.0},
    "WheelSpeedsRear": {"WheelSpeedRL": 30.0, "WheelSpeedRR": 30.0},
    "ActuatorStatus": {"SteeringAngle": 0.1},
}
"""Messages of a vehicle's sensors, with the largest bias of each measured value in the signal's unit.

Noise has up to half of that as its standard deviation. The smallest values are a twentieth of the largest.
"""

STATES: Mapping[str, tuple[str, ...]] = {"ActuatorStatus": ("ActuatorState", "HeldCycles", "CommandState")}
"""Further signals of the sensors' messages, which can be stuck."""

COMMANDS: Mapping[str, tuple[str, ...]] = {
    "Reference": ("VelocityX", "YawRate", "ReferenceState"),
    "SteeringCommand": ("SteeringAngle", "CommandState"),
    "TorqueCommandFront": ("TorqueFL", "TorqueFR"),
    "TorqueCommandRear": ("TorqueRL", "TorqueRR"),
}
"""Messages of planner and tracker to another node of the vehicle, with their signals."""

BROADCASTS: Mapping[str, tuple[str, ...]] = {
    "V2VPosition": ("X", "Y"),
    "V2VMotion": ("Speed", "Course", "YawRate"),
    "V2VStatus": ("State", "Slot", "Cause", "LeaderX", "Manoeuvre"),
}
"""Messages to other vehicles without the vehicle's number, with their signals."""

_SMALLEST = 0.05
"""Smallest bias as a share of the largest."""


def random_fault_scenario(seed: int) -> str:
    """Return the scenario of a number from 0 to 2^32 - 1 as TOML."""
    found = situation(seed)
    kind = kind_of(seed, KINDS)
    fault = _fault(kind, Draw(mixed(seed, *kind.encode())), found.vehicles)
    title = f"# random-fault:{seed} is random:{seed} with a fault: the same number is the same scenario, for ever."
    name, description = f'name = "random-fault-{seed}"', f'description = "{found.description}; {_in_words(fault)}"'
    table = ["", "[[faults]]", *(f"{key} = {_toml(value)}" for key, value in fault.items())]
    return "\n".join([title, name, description, *found.lines, *table]) + "\n"


def kind_of(seed: int, kinds: Iterable[str]) -> str:
    """Return which of the kinds of faults a number has: the one with the highest lot."""
    return max(kinds, key=lambda kind: mixed(seed, *kind.encode()))


def _fault(kind: str, draw: Draw, vehicles: int) -> Keys:
    """Return a fault in a scenario with so many vehicles: its keys, in the order in which they are written."""
    time: Keys = {"at_s": draw.between(0.0, LATEST_START_S)}
    if draw.one_of((True, False)):
        time["for_s"] = draw.between(*DURATION_S)
    vehicle = draw.one_of(range(1, vehicles + 1))
    return {"kind": kind, **time, **KINDS[kind](draw, vehicle)}


def _frames(draw: Draw, vehicle: int) -> Keys:
    """Return one message of a vehicle, or all messages on its bus or on that between vehicles."""
    if draw.one_of((True, False, False)):
        return {"bus": draw.one_of((f"veh{vehicle}", "v2v"))}
    return _message(draw, vehicle)


def _message(draw: Draw, vehicle: int) -> Keys:
    """Return one message that is protected by CRC and counter: of a sensor, an ECU, or to other vehicles."""
    messages = draw.one_of((SENSORS, COMMANDS, BROADCASTS))
    message = draw.one_of(tuple(messages))
    if messages is BROADCASTS:
        return {"bus": "v2v", "message": f"{message}_{vehicle}"}
    return {"bus": f"veh{vehicle}", "message": message}


def _signal(draw: Draw, vehicle: int) -> Keys:
    """Return one signal of such a message."""
    keys = _message(draw, vehicle)
    message = str(keys["message"]).removesuffix(f"_{vehicle}")
    signals = [*SENSORS.get(message, ()), *STATES.get(message, ()), *COMMANDS.get(message, ())]
    return {**keys, "signal": draw.one_of(signals or BROADCASTS[message])}


def _measured(draw: Draw, vehicle: int) -> tuple[Keys, float]:
    """Return one measured value, and its largest bias."""
    message = draw.one_of(tuple(SENSORS))
    signal = draw.one_of(tuple(SENSORS[message]))
    return {"bus": f"veh{vehicle}", "message": message, "signal": signal}, SENSORS[message][signal]


def _probability(draw: Draw) -> Keys:
    """Return that it happens always, which needs no key, or with some probability."""
    return draw.one_of(({}, {"probability": draw.between(0.05, 1.0)}))


def _frame_loss(draw: Draw, vehicle: int) -> Keys:
    bursts = {"to_bad": draw.between(0.01, 0.2), "to_good": draw.between(0.05, 0.5)}
    bursts |= draw.one_of(({}, {"loss_good": draw.between(0.0, 0.1), "loss_bad": draw.between(0.5, 1.0)}))
    return _frames(draw, vehicle) | draw.one_of((_probability(draw), {"bursts": bursts}))


def _frame_delay(draw: Draw, vehicle: int) -> Keys:
    return _frames(draw, vehicle) | {"cycles": draw.one_of(range(1, 21)), "jitter_cycles": draw.one_of(range(11))}


def _frame_duplicate(draw: Draw, vehicle: int) -> Keys:
    return _frames(draw, vehicle) | {"copies": draw.one_of(range(1, 4))} | _probability(draw)


def _frame_corrupt(draw: Draw, vehicle: int) -> Keys:
    return _frames(draw, vehicle) | {"bits": draw.one_of(range(1, 9))} | _probability(draw)


def _sensor_bias(draw: Draw, vehicle: int) -> Keys:
    keys, most = _measured(draw, vehicle)
    return {**keys, "bias": round(draw.one_of((1, -1)) * most * draw.between(_SMALLEST, 1.0), 4)}


def _sensor_noise(draw: Draw, vehicle: int) -> Keys:
    keys, most = _measured(draw, vehicle)
    return {**keys, "sigma": round(0.5 * most * draw.between(_SMALLEST, 1.0), 5)}


def _sensor_dropout(draw: Draw, vehicle: int) -> Keys:
    return {"bus": f"veh{vehicle}", "message": draw.one_of(tuple(SENSORS)), **_probability(draw)}


def _babbling_idiot(draw: Draw, vehicle: int) -> Keys:
    identifier, frames = draw.one_of(range(0x12, 0x800)), draw.one_of(range(1, 61))
    return {"node": _ecu(draw, vehicle), "identifier": identifier, "frames_per_cycle": frames}


def _ecu(draw: Draw, vehicle: int) -> str:
    return f"veh{vehicle}.{draw.one_of(('planner', 'tracker'))}"


def _vehicle_or_all(draw: Draw, vehicle: int) -> Keys:
    """Return that it is of the vehicle or, of four times once, of all."""
    return draw.one_of(({"vehicle": vehicle}, {"vehicle": vehicle}, {"vehicle": vehicle}, {}))


def _actuator_stuck(draw: Draw, vehicle: int) -> Keys:
    """Return an actuator that stays where it is, or that goes to some steering angle (rad) or torque (N m)."""
    actuator = draw.one_of(("steering", "torque_fl", "torque_rl", "torque_rr", "torque_fr"))
    value = draw.between(-0.1, 0.1, 3) if actuator == "steering" else draw.between(-1500.0, 1500.0, 0)
    return {"vehicle": vehicle, "actuator": actuator, **draw.one_of(({}, {"value": value}))}


def _tyre_blowout(draw: Draw, vehicle: int) -> Keys:
    inflation = draw.one_of(({}, {"inflation": draw.between(0.0, 0.6)}))
    return {"vehicle": vehicle, "wheel": draw.one_of(("fl", "rl", "rr", "fr")), **inflation}


def _axle_softening(draw: Draw, vehicle: int) -> Keys:
    level = draw.one_of(({}, {"lambda_level": draw.between(-1.0, 0.0)}))
    return {"vehicle": vehicle, "axle": draw.one_of(("front", "rear")), **level}


KINDS: Mapping[str, Callable[[Draw, int], Keys]] = {
    "frame_loss": _frame_loss,
    "frame_delay": _frame_delay,
    "frame_duplicate": _frame_duplicate,
    "frame_reorder": _frames,
    "frame_corrupt": _frame_corrupt,
    "counter_stuck": _message,
    "signal_stuck": _signal,
    "sensor_bias": _sensor_bias,
    "sensor_noise": _sensor_noise,
    "sensor_dropout": _sensor_dropout,
    "babbling_idiot": _babbling_idiot,
    "bus_off": lambda draw, vehicle: {"node": f"veh{vehicle}.{draw.one_of(('planner', 'tracker', 'plant'))}"},
    "v2v_outage": _vehicle_or_all,
    "ecu_crash": lambda draw, vehicle: {"ecu": _ecu(draw, vehicle)},
    "ecu_hang": lambda draw, vehicle: {"ecu": _ecu(draw, vehicle)},
    "actuator_stuck": _actuator_stuck,
    "tyre_blowout": _tyre_blowout,
    "axle_softening": _axle_softening,
    "ice_patch": lambda draw, vehicle: _vehicle_or_all(draw, vehicle) | {"mu": draw.between(0.1, 0.35)},
}
"""Every kind of fault of `bench.faults`, with what draws its target and size for a vehicle."""


def _in_words(fault: Keys) -> str:
    keys = ", ".join(f"{key} {_toml(value)}" for key, value in fault.items() if key not in ("kind", "at_s", "for_s"))
    end = f" for {fault['for_s']} s" if "for_s" in fault else " to the end"
    return f"{fault['kind']} from {fault['at_s']} s{end}: {keys}".replace('"', "").removesuffix(": ")


def _toml(value: object) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(part)}" for key, part in value.items()) + " }"
    return f'"{value}"' if isinstance(value, str) else str(value)
