"""What the actuators apply of what is commanded."""

import pytest

from bench.bus.states import ActuatorState
from bench.plant.actuators import COMMANDS, Actuators, Applied

GOOD = {
    "SteeringCommand": {"SteeringAngle": 0.1, "CommandState": 1.0},
    "TorqueCommandFront": {"TorqueFL": 1.0, "TorqueFR": 4.0},
    "TorqueCommandRear": {"TorqueRL": 2.0, "TorqueRR": 3.0},
}
APPLIED = Applied(0.1, 1.0, 2.0, 3.0, 4.0)


def test_they_begin_with_nothing_and_wait() -> None:
    actuators = Actuators()
    assert (actuators.state, actuators.applied, actuators.held_cycles) == (ActuatorState.INIT, Applied(), 0)
    actuators.take(GOOD | {"SteeringCommand": None})
    assert (actuators.state, actuators.applied, actuators.held_cycles) == (ActuatorState.INIT, Applied(), 0)


def test_a_whole_set_is_applied() -> None:
    actuators = Actuators()
    actuators.take(GOOD)
    assert (actuators.state, actuators.applied) == (ActuatorState.ACTIVE, APPLIED)


@pytest.mark.parametrize("missing", COMMANDS)
def test_a_set_that_is_not_whole_is_not_applied_at_all(missing: str) -> None:
    actuators = Actuators()
    actuators.take(GOOD)
    actuators.take({name: dict.fromkeys(values, 9.0) for name, values in GOOD.items()} | {missing: None})
    assert (actuators.state, actuators.applied, actuators.held_cycles) == (ActuatorState.HOLD, APPLIED, 1)


def test_a_tracker_without_a_command_is_none() -> None:
    actuators = Actuators()
    actuators.take(GOOD)
    actuators.take(GOOD | {"SteeringCommand": {"SteeringAngle": 0.0, "CommandState": 0.0}})
    assert (actuators.state, actuators.applied) == (ActuatorState.HOLD, APPLIED)


def test_after_holding_long_enough_they_are_safe_until_commands_come_again() -> None:
    actuators = Actuators(hold_cycles=3)
    actuators.take(GOOD)
    states = []
    for _ in range(5):
        actuators.take(dict.fromkeys(COMMANDS))
        states.append((actuators.state, actuators.applied == APPLIED))
    assert states == [(ActuatorState.HOLD, True)] * 3 + [(ActuatorState.SAFE, False)] * 2
    assert actuators.applied == Applied()
    assert actuators.held_cycles == 5
    actuators.take(GOOD)
    assert (actuators.state, actuators.applied, actuators.held_cycles) == (ActuatorState.ACTIVE, APPLIED, 0)
