"""The plant process: all vehicles of a bench, one FMU instance each."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path

from bench.bus.codec import Codec, load_codecs
from bench.bus.control_channel import ControlChannel
from bench.bus.link.address import Address
from bench.bus.link.base import Link
from bench.bus.link.opening import open_link
from bench.bus.node import read_up, serve
from bench.faults.plan import FaultPlan
from bench.names import PLANT, vehicle_bus
from bench.plant.description import read_description
from bench.plant.fmu import FmuInstance, unpack
from bench.plant.noise import sensor_noise
from bench.plant.plant import TruthSink, VehicleNode, start_values
from bench.scenario import Scenario


def make_nodes(
    scenario: Scenario,
    fmu: Path,
    links: Callable[[str], Link],
    codecs: Mapping[str, Codec],
    truth: TruthSink,
    stack: ExitStack,
    plan: FaultPlan,
) -> list[VehicleNode]:
    """Create the node of every vehicle; `stack` closes its resources.

    Args:
        scenario: start values, road and noise.
        fmu: the vehicle's FMU file.
        links: opens the link to a bus, by its name.
        codecs: codec of every bus.
        truth: takes the truth rows.
        stack: takes over links and FMU instances.
        plan: the faults of the run.

    Raises:
        BadInput: the FMU cannot be read, or a bus cannot be opened.
        RunFailed: the FMU cannot be loaded or refuses its start values.
    """
    description = read_description(fmu)
    folder = unpack(fmu)
    nodes = []
    for number, vehicle in enumerate(scenario.vehicles, start=1):
        bus = vehicle_bus(number)
        link = stack.enter_context(links(bus))
        instance = FmuInstance(description, folder, bus, start_values(vehicle))
        stack.callback(instance.close)
        road = scenario.road_of(number)
        noise = sensor_noise(scenario, number)
        nodes.append(VehicleNode(number, instance, description, road, link, codecs[bus], truth, plan, noise))
    return nodes


def serve_plant(channel: ControlChannel, scenario: Scenario, fmu: Path, address: Address) -> None:
    """Run the plant in this process until the conductor stops it or has ended.

    Raises:
        BadInput: see `make_nodes`.
        RunFailed: the FMU failed or a bus went down.
    """
    vehicles = len(scenario.vehicles)
    with ExitStack() as stack:
        plan = FaultPlan(scenario.faults, scenario.seed, channel.fault_board())
        codecs = load_codecs(vehicles)
        nodes = make_nodes(scenario, fmu, lambda bus: open_link(bus, address), codecs, channel.truth, stack, plan)
        # It publishes without waiting for any input of the cycle, so nothing can delay it.
        read_up(nodes)
        channel.ready(PLANT, ())
        serve(nodes, channel.lifeline)
