"""The vehicle's node with the real FMU on a direct bus."""

import math
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest

from bench.bus.codec import load_codecs
from bench.bus.link.address import Address
from bench.bus.link.opening import open_link
from bench.errors import BadInput, RunFailed
from bench.faults.plan import FaultPlan
from bench.plant.description import read_description
from bench.plant.fmu import FmuInstance, unpack
from bench.plant.main import make_nodes
from bench.plant.plant import start_values
from bench.scenario import Scenario, load
from platoon_fmu.build import default_fmu

CODEC = load_codecs(1)["veh1"]
ALONE = ["vehicles=[{x_m = 3.0, y_m = -2.0, yaw_rad = 0.1, speed_mps = 15.0}]"]
SENSORS = [
    "VehiclePosition",
    "VehicleAttitude",
    "VehicleMotion",
    "VehicleAcceleration",
    "WheelSpeedsFront",
    "WheelSpeedsRear",
    "ActuatorStatus",
    "PlantBusHealth",
    "PlantTiming",
]


class Rig:
    """One vehicle's node, and the far end of its bus."""

    def __init__(self, scenario: Scenario, stack: ExitStack) -> None:
        address = Address.parse("direct")
        self.far = open_link("veh1", address)
        self.truth: list[tuple[int, int, dict[str, float]]] = []
        names = read_description(default_fmu()).truth_names

        def note(vehicle: int, cycle: int, values: object) -> None:
            self.truth.append((vehicle, cycle, dict(zip(names, values, strict=True))))  # type: ignore[call-overload]

        plan = FaultPlan(scenario.faults, scenario.seed)
        codecs = {"veh1": CODEC}
        nodes = make_nodes(scenario, default_fmu(), lambda bus: open_link(bus, address), codecs, note, stack, plan)
        (self.node,) = nodes

    def send(self, message: str, counter: int, spoil: bool = False, **values: float) -> None:
        can_id, data = CODEC.encode(message, values, counter)
        self.far.send(can_id, bytes([data[0] ^ spoil, *data[1:]]))

    def sync(self, cycle: int, command: int = 1) -> None:
        self.send("BenchSync", cycle, Command=command, Cycle=cycle, Time=cycle / 100)

    def command(self, cycle: int, steering: float = 0.0, torque: float = 0.0, *, spoil: bool = False) -> None:
        self.send("SteeringCommand", cycle, spoil, SteeringAngle=steering, CommandState=1)
        self.send("TorqueCommandFront", cycle, TorqueFL=torque, TorqueFR=torque)
        self.send("TorqueCommandRear", cycle, TorqueRL=torque, TorqueRR=torque)

    def published(self) -> dict[str, dict[str, float]]:
        """Poll, and decode what was published."""
        self.node.poll()
        return dict(CODEC.decode(*frame) for frame in self.far.receive())


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def rig(stack: ExitStack) -> Rig:
    return Rig(load("formation", ALONE), stack)


def test_publishes_its_start_when_the_first_cycle_opens(rig: Rig) -> None:
    assert rig.published() == {}
    rig.sync(0)
    got = rig.published()
    assert list(got) == SENSORS
    assert got["VehiclePosition"]["X"] == pytest.approx(3.0, abs=2e-4)
    assert got["VehiclePosition"]["Y"] == pytest.approx(-2.0, abs=2e-4)
    assert got["VehicleAttitude"]["Yaw"] == pytest.approx(0.1, abs=1e-6)
    assert got["VehicleMotion"]["VelocityX"] == pytest.approx(15.0, abs=3e-4)
    assert got["ActuatorStatus"]["ActuatorState"] == 0
    assert rig.published() == {}
    vehicle, cycle, row = rig.truth[0]
    assert (vehicle, cycle, row["X"], row["v_x"]) == (1, 0, 3.0, 15.0)


def test_steps_when_all_three_commands_have_come(rig: Rig) -> None:
    rig.sync(0)
    rig.published()
    rig.send("SteeringCommand", 0, SteeringAngle=0.02, CommandState=1)
    rig.send("TorqueCommandFront", 0, TorqueFL=100.0, TorqueFR=100.0)
    rig.node.poll()
    rig.sync(1)
    assert rig.published() == {}
    rig.send("TorqueCommandRear", 0, TorqueRL=50.0, TorqueRR=50.0)
    got = rig.published()
    assert list(got) == [name for name in SENSORS if CODEC.period(name) == 1]
    assert got["ActuatorStatus"]["ActuatorState"] == 1
    assert got["ActuatorStatus"]["SteeringAngle"] == pytest.approx(0.02, abs=1e-6)
    assert got["VehicleMotion"]["YawRate"] > 0
    row = rig.truth[1][2]
    assert row["steering_angle"] == got["ActuatorStatus"]["SteeringAngle"]
    assert (row["wheel_torque_fl"], row["wheel_torque_rl"]) == (100.0, 50.0)
    assert row["X"] == pytest.approx(3.0 + 0.15 * math.cos(0.1), abs=1e-3)


def test_the_next_bench_sync_may_be_here_before_the_commands(rig: Rig) -> None:
    rig.sync(0)
    rig.sync(1)
    rig.command(0)
    rig.node.poll()
    assert [cycle for _, cycle, _ in rig.truth] == [0, 1]
    assert rig.truth[1][2]["X"] > rig.truth[0][2]["X"]


def test_a_damaged_command_holds_the_whole_set(rig: Rig) -> None:
    rig.sync(0)
    rig.command(0, steering=0.02, torque=10.0)
    rig.sync(1)
    rig.command(1, steering=0.5, torque=500.0, spoil=True)
    rig.send("BenchAbsent", 1, Identifier=CODEC.can_id("SteeringCommand"), Cycle=1)
    rig.sync(2)
    got = rig.published()
    assert got["ActuatorStatus"]["ActuatorState"] == 2
    assert got["ActuatorStatus"]["HeldCycles"] == 1
    assert got["PlantBusHealth"]["E2EErrors"] == 1
    assert rig.truth[2][2]["wheel_torque_fl"] == 10.0
    assert rig.truth[2][2]["steering_angle"] == pytest.approx(0.02, abs=1e-6)


def test_stops(rig: Rig) -> None:
    rig.sync(0)
    rig.node.poll()
    rig.command(0)
    rig.sync(1, command=0)
    rig.node.poll()
    assert rig.node.stopped
    assert len(rig.truth) == 1


def test_the_road_acts_from_the_scenarios_profiles(stack: ExitStack) -> None:
    road = [
        'road.lambda_f={kind = "step", at_s = 0.02, before = 0.0, after = 1.0}',
        "road.lambda_r=-0.5",
        "road.mu=0.5",
        "road.force_y_n=600.0",
        "road.moment_z_nm=70.0",
        "road.slope_rad=0.1",
        "road.force_x_n=100.0",
    ]
    rig = Rig(load("formation", [*ALONE, *road]), stack)
    for cycle in range(5):
        rig.sync(cycle)
        rig.command(cycle)
    rig.node.poll()
    rows = [row for _, _, row in rig.truth]
    assert [row["lambda_f"] for row in rows] == [0.0, 0.0, 0.0, 1.0, 1.0]
    last = rows[-1]
    acting = (last["lambda_r"], last["mu"], last["force_y"], last["moment_z"])
    assert acting == (-0.5, 0.5, 600.0, 70.0)
    assert last["force_x"] == pytest.approx(100.0 - 1723.0 * 9.8 * math.sin(0.1))
    assert last["v_x"] < rows[0]["v_x"]


@pytest.mark.parametrize(("wheel", "side"), [("fl", 1), ("rl", 1), ("rr", -1), ("fr", -1)])
def test_a_tyre_that_blows_out_loses_load_and_pulls_the_vehicle_to_its_side(
    stack: ExitStack, wheel: str, side: int
) -> None:
    blowout = f'faults=[{{kind="tyre_blowout",at_s=0.1,vehicle=1,wheel="{wheel}"}}]'
    rig = Rig(load("formation", [*ALONE, blowout]), stack)
    for cycle in range(31):
        rig.sync(cycle)
        rig.command(cycle)
        rig.node.poll()
    rows = [row for _, _, row in rig.truth]
    assert [row[f"inflation_{wheel}"] for row in rows] == [1.0] * 11 + [0.0] * 20
    assert abs(rows[10]["gamma"]) < 1e-9
    assert side * rows[30]["gamma"] > 0.01
    assert rows[30][f"F_z_{wheel}"] < 0.95 * rows[10][f"F_z_{wheel}"]
    assert rows[10]["v_x"] - rows[30]["v_x"] > 0.1


def test_a_failing_fmu_is_named_with_the_call(stack: ExitStack) -> None:
    description = read_description(default_fmu())
    vehicle = load("formation", ALONE).vehicles[0]
    fmu = FmuInstance(description, unpack(default_fmu()), "veh1", start_values(vehicle))
    stack.callback(fmu.close)
    with pytest.raises(RunFailed, match=r"the FMU of veh1 failed: fmi2SetReal failed with status 3 \(error\)"):
        fmu.step(0.0, 0.01, [math.nan] * len(description.inputs))


def test_an_fmu_that_cannot_be_loaded_is_named_with_the_reason(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    description = read_description(default_fmu())
    with pytest.raises(RunFailed, match=r"veh1: the FMU cannot be loaded on this machine: .*Vehicle\.so"):
        FmuInstance(description, tmp_path, "veh1", {})
    stranger = replace(description, guid="{another}")
    with pytest.raises(RunFailed, match="veh1: the FMU cannot be loaded on this machine: it creates no instance"):
        FmuInstance(stranger, unpack(default_fmu()), "veh1", {})
    # Its own words are what a person needs.
    assert "[ERROR] " in capfd.readouterr().out


def test_start_values_that_the_fmu_does_not_have_are_named() -> None:
    description = read_description(default_fmu())
    with pytest.raises(RunFailed, match="no variable Z_start"):
        FmuInstance(description, unpack(default_fmu()), "veh1", {"Z_start": 0.0})


def test_instances_are_independent(stack: ExitStack) -> None:
    description, folder = read_description(default_fmu()), unpack(default_fmu())
    vehicles = load("formation").vehicles
    fmus = [FmuInstance(description, folder, f"veh{i}", start_values(v)) for i, v in enumerate(vehicles, start=1)]
    for fmu in fmus:
        stack.callback(fmu.close)
    fmus[0].step(0.0, 0.01, fmus[0].inputs())
    x = description.outputs.index("X")
    assert [fmu.outputs()[x] for fmu in fmus[1:]] == [vehicle.x_m for vehicle in vehicles[1:]]
    assert fmus[0].outputs()[x] > vehicles[0].x_m


def test_an_fmu_is_unpacked_once(tmp_path: Path) -> None:
    fmu = tmp_path / "Vehicle.fmu"
    fmu.write_bytes(default_fmu().read_bytes())
    folder = unpack(fmu)
    assert unpack(fmu) == folder
    assert (folder / "modelDescription.xml").is_file()
    assert sorted(path.name for path in tmp_path.rglob(".part-*")) == []


def test_what_is_no_fmu_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"nothing\.fmu cannot be read as an FMU"):
        read_description(tmp_path / "nothing.fmu")
    text = tmp_path / "text.fmu"
    text.write_text("no zip")
    with pytest.raises(BadInput, match="platoon fmu build"):
        read_description(text)
    other = tmp_path / "other.fmu"
    with zipfile.ZipFile(other, "w") as archive:
        archive.writestr("modelDescription.xml", '<fmiModelDescription fmiVersion="3.0"/>')
    with pytest.raises(BadInput, match=r"not an FMI 2\.0 FMU for co-simulation"):
        read_description(other)
