"""The DBC's value tables that more than one node reads or writes, as enumerations."""

import enum


class EcuState(enum.IntEnum):
    """An ECU's state; the values are those of the bus signal `State`."""

    INIT = 0
    RUN = 1
    DEGRADED = 2
    SAFE = 3


class ReferenceState(enum.IntEnum):
    """What a reference is worth; the values are those of the bus signal `ReferenceState`."""

    NONE = 0
    VALID = 1
    DEGRADED = 2


class CommandState(enum.IntEnum):
    """What a command is worth; the values are those of the bus signal `CommandState`."""

    NONE = 0
    VALID = 1
    DEGRADED = 2
    SAFE = 3


class ActuatorState(enum.IntEnum):
    """What the actuators do with commands; the values are those of the bus signal `ActuatorState`."""

    INIT = 0
    ACTIVE = 1
    HOLD = 2
    SAFE = 3
