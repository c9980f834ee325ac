"""The bases of one's own ECU: what a controller is called with, and what it says where something is missing."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from bench.bus.codec import load_codecs
from bench.bus.network import EcuSlot
from bench.bus.reception import Reception, ReceptionState
from bench.bus.states import CommandState, EcuState, ReferenceState
from bench.ecu import Command, Health, Motion, Peer, PlannerBase, Pose, Reference, Signals, Topic, TrackerBase
from bench.ecu.loading import load_class
from bench.errors import BadInput
from bench.scenario import Scenario, load

EXAMPLES = Path(__file__).parents[2] / "bench" / "examples"
SCENARIO = load("formation")
CODECS = load_codecs(len(SCENARIO.vehicles))
HOLD_CYCLES = CODECS["veh1"].timeout_cycles("Reference")
MOTION = {"VelocityX": 20.0, "VelocityY": 0.5, "YawRate": 0.1}
POSITION, ATTITUDE = {"X": 100.0, "Y": -3.5}, {"Yaw": 0.2, "Roll": 0.0}
REFERENCE = {"VelocityX": 21.0, "YawRate": 0.2, "ReferenceState": ReferenceState.VALID}


class Probe(TrackerBase):
    """Keeps what it is called with."""

    more_inputs = ("ActuatorStatus", "VehicleMotion")

    def __init__(self, vehicle: int, scenario: Scenario) -> None:
        super().__init__(vehicle, scenario)
        self.calls: list[tuple[Motion, Reference]] = []

    def control(self, motion: Motion, reference: Reference) -> Command:
        self.calls.append((motion, reference))
        self.show("TrackerTarget", VelocityX=self.time_s)
        self.show("TrackerStatus", Tau=4.0)
        return Command(0.1, 1.0, 2.0, 3.0, 4.0)


class Scout(PlannerBase):
    """Keeps what it is called with."""

    def __init__(self, vehicle: int, scenario: Scenario) -> None:
        super().__init__(vehicle, scenario)
        self.calls: list[tuple[Pose, Motion, dict[int, Peer]]] = []

    def plan(self, pose: Pose, motion: Motion, peers: Mapping[int, Peer]) -> Reference:
        self.calls.append((pose, motion, dict(peers)))
        return Reference(22.0, 0.01 * len(self.calls))


def step(
    ecu: TrackerBase | PlannerBase, cycle: int = 5, health: Health | None = None, **given: Mapping[str, float] | None
) -> dict[str, Signals]:
    """One step with these messages, the rest missing; what it sends, by message."""
    inputs: dict[Topic, Signals | None] = {topic: given.pop(topic.message, None) for topic in ecu.inputs}
    assert given == {}
    sent = ecu.step(cycle, cycle / 100, inputs, health or Health())
    for outgoing in sent:
        # All of it is in the DBC, and of this ECU.
        CODECS[outgoing.bus].encode(
            outgoing.message, {**CODECS[outgoing.bus].start_values(outgoing.message), **outgoing.values}, 0
        )
        assert Topic(outgoing.bus, outgoing.message) in EcuSlot(ecu.role, ecu.vehicle).sends(CODECS)
    assert len({outgoing.message for outgoing in sent}) == len(sent)
    return {outgoing.message: outgoing.values for outgoing in sent}


def all_commands(sent: Mapping[str, Signals]) -> dict[str, float]:
    names = ("SteeringCommand", "TorqueCommandFront", "TorqueCommandRear")
    return {signal: value for name in names for signal, value in sent[name].items()}


def test_a_tracker_is_called_with_quantities_and_answers_with_a_command() -> None:
    tracker = Probe(2, SCENARIO)
    assert tracker.name == "veh2.tracker"
    assert [topic.message for topic in tracker.inputs] == ["VehicleMotion", "Reference", "ActuatorStatus"]
    sent = step(tracker, VehicleMotion=MOTION, Reference=REFERENCE, health=Health(3, 4))
    assert tracker.calls == [(Motion(20.0, 0.5, 0.1), Reference(21.0, 0.2))]
    torques = {"TorqueFL": 1.0, "TorqueFR": 2.0, "TorqueRL": 3.0, "TorqueRR": 4.0}
    assert all_commands(sent) == {"SteeringAngle": 0.1, "CommandState": CommandState.VALID, **torques}
    assert sent["TrackerStatus"] == {"State": EcuState.RUN, "Tau": 4.0}
    assert sent["TrackerTarget"] == {"VelocityX": 0.05}
    assert sent["TrackerBusHealth"] == {"FramesLost": 3, "E2EErrors": 4}


def test_what_is_shown_is_shown_in_that_cycle_only() -> None:
    tracker = Probe(2, SCENARIO)
    step(tracker, VehicleMotion=MOTION, Reference=REFERENCE)
    sent = step(tracker, cycle=6, Reference=REFERENCE)
    assert "TrackerTarget" not in sent
    assert sent["TrackerStatus"] == {"State": EcuState.SAFE}


NONE = REFERENCE | {"ReferenceState": ReferenceState.NONE}


@pytest.mark.parametrize(
    ("worth", "state", "command"),
    [
        (ReferenceState.VALID, EcuState.RUN, CommandState.VALID),
        (ReferenceState.DEGRADED, EcuState.DEGRADED, CommandState.DEGRADED),
    ],
)
def test_a_command_is_worth_what_its_reference_is(
    worth: ReferenceState, state: EcuState, command: CommandState
) -> None:
    tracker = Probe(1, SCENARIO)
    sent = step(tracker, VehicleMotion=MOTION, Reference=REFERENCE | {"ReferenceState": worth})
    assert sent["TrackerStatus"]["State"] == state
    assert all_commands(sent)["CommandState"] == command


@pytest.mark.parametrize("reference", [None, NONE], ids=["missing", "withdrawn"])
def test_a_tracker_holds_the_reference_for_a_while(reference: Signals | None) -> None:
    tracker = Probe(1, SCENARIO)
    step(tracker, VehicleMotion=MOTION, Reference=REFERENCE)
    for _ in range(HOLD_CYCLES - 1):
        sent = step(tracker, VehicleMotion=MOTION, Reference=reference)
        assert sent["TrackerStatus"]["State"] == EcuState.DEGRADED
        assert all_commands(sent)["CommandState"] == CommandState.DEGRADED
        assert tracker.calls[-1][1] == Reference(21.0, 0.2)
    for _ in range(3):
        sent = step(tracker, VehicleMotion=MOTION, Reference=reference)
        assert sent["TrackerStatus"]["State"] == EcuState.SAFE
        assert set(all_commands(sent).values()) == {0}
    assert len(tracker.calls) == HOLD_CYCLES
    sent = step(tracker, VehicleMotion=MOTION, Reference=REFERENCE)
    assert sent["TrackerStatus"]["State"] == EcuState.RUN


def test_a_tracker_waits_for_its_first_reference() -> None:
    tracker = Probe(1, SCENARIO)
    for reference in (None, NONE):
        sent = step(tracker, VehicleMotion=MOTION, Reference=reference)
        assert sent["TrackerStatus"]["State"] == EcuState.INIT
        assert all_commands(sent)["CommandState"] == CommandState.NONE
    assert tracker.calls == []


def test_a_tracker_gives_no_command_without_its_own_motion_and_goes_on_with_it() -> None:
    tracker = Probe(1, SCENARIO)
    step(tracker, VehicleMotion=MOTION, Reference=REFERENCE)
    sent = step(tracker, Reference=REFERENCE)
    assert sent["TrackerStatus"]["State"] == EcuState.SAFE
    assert all_commands(sent)["CommandState"] == CommandState.NONE
    assert step(tracker, VehicleMotion=MOTION, Reference=REFERENCE)["TrackerStatus"]["State"] == EcuState.RUN
    assert len(tracker.calls) == 2


def test_more_inputs_are_read_by_name_with_their_reception() -> None:
    tracker = Probe(3, SCENARIO)
    reception = Reception(ReceptionState.ERROR, 7)
    step(tracker, health=Health(inputs={Topic("veh3", "ActuatorStatus"): reception}), ActuatorStatus={"HeldCycles": 3})
    assert tracker.received("ActuatorStatus") == {"HeldCycles": 3}
    assert tracker.reception("ActuatorStatus") is reception
    assert tracker.received("Reference") is None
    with pytest.raises(KeyError):
        tracker.received("WheelSpeedsRear")


def test_how_the_inputs_are_received_is_on_the_bus() -> None:
    inputs = {
        Topic("veh2", "VehicleMotion"): Reception(ReceptionState.OK),
        Topic("veh2", "ActuatorStatus"): Reception(ReceptionState.LOST, 9),
    }
    sent = step(Probe(2, SCENARIO), health=Health(1, 2, inputs=inputs))
    expected = {"FramesLost": 1, "E2EErrors": 2, "MotionReception": 1, "ActuatorReception": 6}
    assert sent["TrackerBusHealth"] == expected
    inputs = {
        Topic("v2v", "V2VPosition_1"): Reception(ReceptionState.LOST, 20),
        Topic("v2v", "V2VMotion_1"): Reception(ReceptionState.LOST, 20),
        Topic("v2v", "V2VMotion_3"): Reception(ReceptionState.MISSING, 1),
        Topic("veh2", "VehicleAttitude"): Reception(ReceptionState.ERROR, 1),
    }
    sent = step(Scout(2, SCENARIO), health=Health(inputs=inputs))
    expected = {"FramesLost": 0, "E2EErrors": 0, "AttitudeReception": 5, "PeerReception": 6, "PeersLost": 1}
    assert sent["PlannerBusHealth"] == expected


def broadcast(number: int, x: float) -> dict[str, Signals]:
    return {
        f"V2VPosition_{number}": {"X": x, "Y": 0.0},
        f"V2VMotion_{number}": {"Speed": 19.0, "Course": 0.1, "YawRate": 0.0},
    }


OWN = {"VehiclePosition": POSITION, "VehicleAttitude": ATTITUDE, "VehicleMotion": MOTION}


def test_a_planner_is_called_with_the_others_and_broadcasts_the_own_motion() -> None:
    planner = Scout(2, SCENARIO)
    sent = step(planner, **OWN, **broadcast(1, 120.0), **broadcast(3, 80.0))
    ((pose, motion, peers),) = planner.calls
    assert (pose, motion) == (Pose(100.0, -3.5, 0.2), Motion(20.0, 0.5, 0.1))
    assert peers == {1: Peer(120.0, 0.0, 19.0, 0.1, 0.0), 3: Peer(80.0, 0.0, 19.0, 0.1, 0.0)}
    assert sent["Reference"] == {"VelocityX": 22.0, "YawRate": 0.01, "ReferenceState": ReferenceState.VALID}
    assert sent["V2VPosition_2"] == POSITION
    expected = {"Speed": 20.00625, "Course": 0.2249948, "YawRate": 0.1}
    assert sent["V2VMotion_2"] == pytest.approx(expected, abs=1e-6)
    assert sent["PlannerStatus"] == {"State": EcuState.RUN, "Neighbours": 2}


def test_a_planner_is_degraded_while_a_vehicle_is_not_heard() -> None:
    planner = Scout(2, SCENARIO)
    half = {"V2VPosition_3": broadcast(3, 80.0)["V2VPosition_3"]}
    sent = step(planner, **OWN, **broadcast(1, 120.0), **half)
    assert set(planner.calls[0][2]) == {1}
    assert sent["Reference"]["ReferenceState"] == ReferenceState.DEGRADED
    assert sent["PlannerStatus"] == {"State": EcuState.DEGRADED, "Neighbours": 1}


def test_in_the_first_cycle_nobody_can_have_been_heard() -> None:
    assert step(Scout(2, SCENARIO), cycle=0, **OWN)["PlannerStatus"] == {"State": EcuState.RUN, "Neighbours": 0}


@pytest.mark.parametrize("missing", list(OWN))
def test_a_planner_without_its_own_sensors_holds_the_reference_and_does_not_broadcast(missing: str) -> None:
    planner = Scout(2, SCENARIO)
    some = OWN | {missing: None}
    sent = step(planner, **some)
    assert sent["Reference"]["ReferenceState"] == ReferenceState.NONE
    assert sent["PlannerStatus"]["State"] == EcuState.INIT
    step(planner, **OWN)
    sent = step(planner, **some)
    assert sent["Reference"] == {"VelocityX": 22.0, "YawRate": 0.01, "ReferenceState": ReferenceState.DEGRADED}
    assert [name for name in sent if name.startswith("V2V")] == ["V2VStatus_2"]
    assert sent["V2VStatus_2"] == {"State": EcuState.DEGRADED}
    assert len(planner.calls) == 1


def test_a_class_without_its_controller_is_refused(tmp_path: Path) -> None:
    (tmp_path / "half.py").write_text("from bench.ecu import TrackerBase\nclass Half(TrackerBase): ...\n")
    with pytest.raises(BadInput, match="the class Half lacks the method control"):
        load_class(f"{tmp_path}/half.py:Half")


def test_the_readme_shows_the_example_that_is_tested() -> None:
    text = (EXAMPLES / "single_track.py").read_text()
    assert f"```python\n{text}```" in (EXAMPLES.parents[1] / "README.md").read_text()


def test_the_examples_are_short_and_load() -> None:
    for name, spec in {"single_track.py": "SingleTrack", "follow.py": "Follow"}.items():
        assert len((EXAMPLES / name).read_text().splitlines()) < 30
        assert load_class(f"{EXAMPLES / name}:{spec}")(1, SCENARIO).name in ("veh1.tracker", "veh1.planner")
