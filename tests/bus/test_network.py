"""Who sends and receives what, as the DBC files have it."""

import pytest

from bench.bus.codec import Codec, load_codecs
from bench.bus.network import ROLES, EcuSlot, Transmission, process_of, transmissions
from bench.bus.topic import Topic
from bench.ecu.loading import DEFAULT_ECUS, load_class
from bench.names import CONDUCTOR, PLANT, V2V
from bench.plant.plant import COMMANDS
from bench.scenario import load

VEHICLES = 3
CODECS = load_codecs(VEHICLES)
SCENARIO = load("formation")


def of(bus: str, vehicles: int | None = VEHICLES) -> dict[str, Transmission]:
    return {each.message: each for each in transmissions(bus, CODECS[bus], vehicles)}


def from_the_conductor(topic: Topic) -> bool:
    return of(topic.bus)[topic.message].sender == CONDUCTOR


@pytest.mark.parametrize(
    ("bus", "node", "process"),
    [
        ("veh2", "Conductor", "conductor"),
        (V2V, "Conductor", "conductor"),
        ("veh2", "Plant", "plant"),
        ("veh2", "Tracker", "veh2.tracker"),
        (V2V, "Vehicle12", "veh12.planner"),
    ],
)
def test_every_node_is_a_process(bus: str, node: str, process: str) -> None:
    assert process_of(bus, node) == process


def test_an_ecu_has_a_name_and_buses() -> None:
    assert EcuSlot("tracker", 3).name == "veh3.tracker"
    assert EcuSlot("tracker", 3).buses == ("veh3",)
    assert EcuSlot("planner", 2).buses == ("veh2", V2V)


@pytest.mark.parametrize("bus", CODECS)
def test_every_message_has_a_sender_and_receivers_in_the_bench(bus: str) -> None:
    processes = {CONDUCTOR, PLANT, *(EcuSlot(role, n + 1).name for role in ROLES for n in range(VEHICLES))}
    for each in of(bus).values():
        assert each.sender in processes
        assert each.receivers
        assert each.receivers <= processes - {each.sender}


def test_vehicles_that_are_not_there_have_no_part_in_v2v() -> None:
    assert "V2VPosition_3" in of(V2V)
    assert "V2VPosition_4" not in of(V2V)
    assert of(V2V)["V2VPosition_3"].receivers == {"veh1.planner", "veh2.planner"}
    assert of(V2V, None)["V2VPosition_16"].sender == "veh16.planner"


def test_what_is_due_at_the_end_of_every_cycle() -> None:
    messages = of("veh1")
    assert messages["SteeringCommand"].has_deadline
    assert messages["VehicleMotion"].has_deadline
    assert messages["VehicleMotion"].station == "veh1.plant"
    assert messages["SteeringCommand"].station == "veh1.tracker"
    without = ("BenchSync", "TrackerStatus", "PlannerGains", "BenchAbsent")
    assert not any(messages[name].has_deadline for name in without)
    assert not any(each.has_deadline for each in of(V2V).values())


def test_periods_are_the_dbc_s_cycle_times() -> None:
    messages = of("veh1")
    periods = {name: messages[name].period for name in ("VehicleMotion", "PlannerGains", "BenchAbsent")}
    assert periods == {"VehicleMotion": 1, "PlannerGains": 10, "BenchAbsent": 0}


def test_a_message_that_no_node_sends_has_no_sender() -> None:
    codec = Codec.from_bytes(
        b'VERSION ""\nBS_:\nBU_: A\nBO_ 5 Lost: 1 Vector__XXX\n SG_ S : 0|8@1+ (1,0) [0|255] "" A\n', "lost.dbc"
    )
    (lost,) = transmissions("veh1", codec)
    assert (lost.sender, lost.receivers) == ("", {"veh1.a"})


@pytest.mark.parametrize("role", ROLES)
def test_the_ecus_of_the_bench_receive_what_the_dbc_says(role: str) -> None:
    """Neither takes an ECU what is not addressed to it, nor does the DBC address to it what it does not take."""
    slot = EcuSlot(role, 2)
    taken = set(load_class(DEFAULT_ECUS[role])(2, SCENARIO).inputs)
    addressed = {topic for topic in slot.receives(CODECS, VEHICLES) if not from_the_conductor(topic)}
    # A sensor that ECUs may take, but the bench's own tracker does not.
    for_others = {Topic("veh2", "VehicleAcceleration")} if role == "tracker" else set()
    assert taken == addressed - for_others


def test_the_plant_receives_what_the_dbc_says() -> None:
    taken = {each.message for each in of("veh2").values() if PLANT in each.receivers and each.sender != CONDUCTOR}
    assert taken == set(COMMANDS)


@pytest.mark.parametrize("role", ROLES)
def test_every_ecu_hears_the_conductor(role: str) -> None:
    heard = [topic for topic in EcuSlot(role, 2).receives(CODECS, VEHICLES) if from_the_conductor(topic)]
    assert heard == [Topic(bus, name) for bus in EcuSlot(role, 2).buses for name in ("BenchSync", "BenchAbsent")]
