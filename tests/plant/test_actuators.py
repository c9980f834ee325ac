"""What the actuators apply of what is commanded."""

import pytest

from bench.bus.quantities import COMMANDS
from bench.bus.states import ActuatorState, CommandState
from bench.plant.actuators import Actuators, Applied

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
    seen = []
    for _ in range(5):
        actuators.take(dict.fromkeys(COMMANDS))
        seen.append((actuators.state, actuators.applied))
    # No torque at once, and the wheels back to straight at 0.2 rad/s.
    coasting = [(ActuatorState.SAFE, Applied(steering_angle=pytest.approx(angle))) for angle in (0.098, 0.096)]
    assert seen == [(ActuatorState.HOLD, APPLIED)] * 3 + coasting
    assert actuators.held_cycles == 5
    actuators.take(GOOD)
    assert (actuators.state, actuators.applied, actuators.held_cycles) == (ActuatorState.ACTIVE, APPLIED, 0)


@pytest.mark.parametrize("angle", [0.1, -0.1])
def test_the_steering_ends_straight(angle: float) -> None:
    actuators = Actuators()
    actuators.take(GOOD | {"SteeringCommand": {"SteeringAngle": angle, "CommandState": 1.0}})
    for _ in range(60):
        actuators.take(dict.fromkeys(COMMANDS))
    assert actuators.applied == Applied()


def test_they_hold_as_long_as_the_dbc_has_the_commands_time_out() -> None:
    actuators = Actuators()
    actuators.take(GOOD)
    states = []
    for _ in range(7):
        actuators.take(dict.fromkeys(COMMANDS))
        states.append(actuators.state)
    assert states == [ActuatorState.HOLD] * 5 + [ActuatorState.SAFE] * 2


def test_they_show_what_the_commands_are_worth() -> None:
    actuators = Actuators()
    assert actuators.command_state is CommandState.NONE
    for worth in (CommandState.VALID, CommandState.DEGRADED, CommandState.SAFE):
        actuators.take(GOOD | {"SteeringCommand": {"SteeringAngle": 0.1, "CommandState": float(worth)}})
        assert (actuators.state, actuators.command_state) == (ActuatorState.ACTIVE, worth)
    actuators.take(dict.fromkeys(COMMANDS))
    assert actuators.command_state is CommandState.NONE
