"""The DBC's value tables that more than one node reads or writes, as enumerations."""

import enum


class BenchCommand(enum.IntEnum):
    """The conductor's command to all participants; the values are those of the signal `Command` of `BenchSync`."""

    STOP = 0
    RUN = 1
    RUN_REALTIME = 2


class EcuState(enum.IntEnum):
    """An ECU's state; the values are those of the bus signal `State`."""

    INIT = 0
    RUN = 1
    DEGRADED = 2
    SAFE = 3
    WAIT = 4
    """Before its first BenchSync; never in a frame."""


class ReferenceState(enum.IntEnum):
    """Validity of a reference; the values are those of the bus signal `ReferenceState`."""

    NONE = 0
    VALID = 1
    DEGRADED = 2


class CommandState(enum.IntEnum):
    """Validity of a command; the values are those of the bus signal `CommandState`."""

    NONE = 0
    VALID = 1
    DEGRADED = 2
    SAFE = 3


class ActuatorState(enum.IntEnum):
    """How the actuators treat commands; the values are those of the bus signal `ActuatorState`."""

    INIT = 0
    ACTIVE = 1
    HOLD = 2
    SAFE = 3


class Cause(enum.IntEnum):
    """Why an ECU is not in RUN, in ascending severity; the values are those of the bus signal `Cause`."""

    NONE = 0
    SENSOR_MISSING = 1
    SENSOR_LOST = 2
    SENSOR_IMPLAUSIBLE = 3
    REFERENCE_MISSING = 4
    REFERENCE_LOST = 5
    REFERENCE_DEGRADED = 6
    PEER_MISSING = 7
    PEER_LOST = 8
    PEER_IMPLAUSIBLE = 9
    PEER_UNSAFE = 10
    """Another vehicle reports that it slows down, or that it cannot be trusted."""
    ACTUATOR_FAULT = 11
    SOLVER_FALLBACK = 12
    OWN_MOTION_LOST = 13
    TRACKER_LOST = 14
    VEHICLE_FAULT = 15
    """The vehicle does not respond to its actuators as modelled: tyres or road have changed."""


class Manoeuvre(enum.IntEnum):
    """A vehicle's manoeuvre in the platoon; the values are those of the bus signal `Manoeuvre`."""

    NONE = 0
    PLATOON = 1
    FALL_BACK = 2
    """It opens the gap to a vehicle ahead that cannot be trusted."""
    SLOW_DOWN = 3
    """It slows down in its lane."""
    APPROACH = 4
    """It goes to its slot in its own lane, until the gap in the platoon's lane is open."""
