"""What a run is set up from: its processes or nodes, and what its log says of it."""

import platform
import shlex
import socket
import sys
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from bench.bus.address import Address
from bench.bus.base import Link
from bench.bus.codec import DBC_DIR, Codec
from bench.bus.link import open_link
from bench.bus.node import Node
from bench.bus.ties import Truth
from bench.bus.topic import PLANT, Topic
from bench.conductor.crew import Crew, Listener, Member, ProcessCrew
from bench.conductor.direct import DirectCrew
from bench.conductor.interrupts import Interrupts
from bench.ecu.main import buses_of, ecu_name, load_classes, make_node
from bench.plant.description import FmuDescription
from bench.scenario import Scenario

_PACKAGES = ("platoon", "numpy", "numba", "clarabel", "fmpy", "python-can", "cantools", "mcap")


@dataclass(frozen=True)
class Stage:
    """All that a run is given.

    Attributes:
        scenario: what to run.
        address: where the buses are, settled.
        codecs: codec of every bus.
        fmu: the vehicle's FMU file.
        description: its modelDescription.
        ecus: class of each role's ECU, as `bench.ecu.main.load_class` takes it.
        external: names of ECUs that are not to be started.
    """

    scenario: Scenario
    address: Address
    codecs: Mapping[str, Codec]
    fmu: Path
    description: FmuDescription
    ecus: Mapping[str, str]
    external: Collection[str]

    @property
    def vehicles(self) -> int:
        """Number of vehicles."""
        return len(self.scenario.vehicles)

    def crew(self, links: Mapping[str, Link], listener: Listener, interrupts: Interrupts, stack: ExitStack) -> Crew:
        """Start plant and ECUs; `stack` sees to their end.

        Raises:
            BadInput: in one process: an ECU's class cannot be loaded or takes what is not on its buses.
            RunFailed: in one process: the FMU cannot be loaded.
        """
        if self.address.hub is None:
            crew = ProcessCrew(self._members(), tuple(self.ecus.values()), links, listener, interrupts)
            return stack.enter_context(crew)
        nodes, inputs = self._nodes(listener, stack)
        return DirectCrew(nodes, inputs, links, listener, interrupts)

    def metadata(self, command_line: Sequence[str]) -> dict[str, str]:
        """What the log says of the run before it begins."""
        return {
            "scenario": self.scenario.name,
            "seed": str(self.scenario.seed),
            "duration_s": f"{self.scenario.duration_s:g}",
            "buses": str(self.address),
            "clock": "lockstep",
            "command_line": shlex.join(command_line),
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "host": socket.gethostname(),
            "platform": platform.platform(),
            "python": sys.version.split()[0],
            "fmu_guid": self.description.guid,
            **{f"ecu {role}": spec for role, spec in self.ecus.items()},
            **{f"version {name}": _version(name) for name in _PACKAGES},
        }

    def attachments(self) -> dict[str, bytes]:
        """The files that the log carries along."""
        return {
            "scenario.toml": self.scenario.toml().encode(),
            "vehicle.dbc": (DBC_DIR / "vehicle.dbc").read_bytes(),
            "v2v.dbc": (DBC_DIR / "v2v.dbc").read_bytes(),
            "modelDescription.xml": self.description.xml,
        }

    def _roles(self) -> list[tuple[str, int]]:
        return [(role, vehicle) for role in self.ecus for vehicle in range(1, self.vehicles + 1)]

    def _members(self) -> list[Member]:
        plant = Member(PLANT, "bench.plant.main:serve_plant", (self.scenario, self.fmu, self.address), early=True)
        ecus = [
            Member(
                ecu_name(role, vehicle),
                "bench.ecu.main:serve_ecu",
                (self.ecus[role], role, vehicle, self.scenario, self.address),
            )
            for role, vehicle in self._roles()
            if ecu_name(role, vehicle) not in self.external
        ]
        return [plant, *ecus]

    def _nodes(self, listener: Listener, stack: ExitStack) -> tuple[list[Node], dict[str, Sequence[Topic]]]:
        # The plant's imports are for this process only if it is the plant.
        from bench.plant.main import make_nodes

        load_classes(self.ecus.values())

        def truth(vehicle: int, cycle: int, values: Sequence[float]) -> None:
            listener.truth(Truth(vehicle, cycle, tuple(values)))

        nodes: list[Node] = []
        nodes += make_nodes(
            self.scenario, self.fmu, lambda bus: open_link(bus, self.address), self.codecs, truth, stack
        )
        inputs: dict[str, Sequence[Topic]] = {}
        for role, vehicle in self._roles():
            links = {bus: stack.enter_context(open_link(bus, self.address)) for bus in buses_of(role, vehicle)}
            node, ecu = make_node(self.ecus[role], role, vehicle, self.scenario, links, self.codecs)
            nodes.append(node)
            inputs[node.name] = ecu.inputs
        return nodes, inputs


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"
