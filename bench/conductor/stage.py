"""The setup of a run: its processes or nodes, and the metadata of its log."""

from __future__ import annotations

import os
import platform
import shlex
import socket
import sys
from array import array
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from bench.bus.codec import Codec
from bench.bus.control_channel import Truth
from bench.bus.link.address import Address
from bench.bus.link.base import Link
from bench.bus.link.opening import open_link
from bench.bus.network import EcuSlot
from bench.bus.node import Node
from bench.bus.topic import Topic
from bench.compiled.finder import is_compiled
from bench.conductor.clock import CLOCK
from bench.conductor.crew import Crew, Listener, Member, ProcessCrew
from bench.conductor.direct import DirectCrew, Maker
from bench.conductor.fork_server_process import start_fork_server
from bench.conductor.interrupts import Interrupts
from bench.conductor.options import RunOptions
from bench.ecu.loading import load_classes, make_node
from bench.events import EcuNote
from bench.faults.plan import FaultPlan
from bench.label import LABEL
from bench.names import PLANT
from bench.plant.description import FmuDescription

BY_HAND = "started by hand"
"""The log's entry for the class of an ECU that the bench did not start."""

_PACKAGES = ("platoon", "numpy", "clarabel", "python-can", "cantools", "mcap")


@dataclass(frozen=True)
class Stage:
    """The setup of a run.

    Attributes:
        options: its options.
        address: the settled address of its buses.
        codecs: codec of every bus.
        fmu: the vehicle's FMU file.
        description: its modelDescription.
        plan: the faults of the run.
        board: file descriptor of the fault board, which `plan` reads.
    """

    options: RunOptions
    address: Address
    codecs: Mapping[str, Codec]
    fmu: Path
    description: FmuDescription
    plan: FaultPlan
    board: int

    @property
    def vehicles(self) -> int:
        """Number of vehicles."""
        return self.options.vehicles

    def crew(self, links: Mapping[str, Link], listener: Listener, interrupts: Interrupts, stack: ExitStack) -> Crew:
        """Start plant and ECUs; `stack` ends them.

        Raises:
            BadInput: in one process: an ECU's class cannot be loaded or has inputs that are not on its buses.
            RunFailed: in one process: the FMU cannot be loaded.
        """
        if self.address.hub is None:
            preload = tuple(self.options.ecus.values())
            server = stack.enter_context(self.options.fork_server or start_fork_server(()))
            return stack.enter_context(
                ProcessCrew(self._members(), preload, links, listener, interrupts, self.board, server)
            )
        names = [slot.name for slot in self._slots()]
        return DirectCrew(
            self._plant(listener, stack), names, self._maker(listener, stack), links, listener, interrupts
        )

    def metadata(self, commit: str) -> dict[str, str]:
        """Return the log's metadata before the run begins; `commit` as `bench.conductor.checkout` has it."""
        return {
            **({LABEL: self.options.label} if self.options.label else {}),
            "scenario": self.options.scenario.name,
            "seed": str(self.options.scenario.seed),
            "duration_s": f"{self.options.scenario.duration_s:g}",
            "buses": str(self.address),
            "clock": "realtime" if self.options.realtime else "lockstep",
            "command_line": shlex.join(self.options.command_line),
            "commit": commit,
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "host": socket.gethostname(),
            "platform": _platform(),
            "python": sys.version.split()[0],
            "code": "compiled" if is_compiled() else "interpreted",
            "fmu_guid": self.description.guid,
            **{f"ecu {role}": spec for role, spec in self.options.ecus.items()},
            **{f"ecu {name}": BY_HAND for name in self.options.without},
            **{f"version {name}": _version(name) for name in _PACKAGES},
        }

    def attachments(self) -> dict[str, bytes]:
        """The log's attachments, besides the DBC files."""
        return {
            "command_line.txt": f"{shlex.join(self.options.command_line)}\n".encode(),
            "scenario.toml": self.options.scenario.toml().encode(),
            "modelDescription.xml": self.description.xml,
        }

    def _slots(self) -> list[EcuSlot]:
        return [EcuSlot(role, vehicle) for role in self.options.ecus for vehicle in range(1, self.vehicles + 1)]

    def _members(self) -> list[Member]:
        plant = Member(PLANT, "bench.plant.main:serve_plant", (self.options.scenario, self.fmu, self.address))
        ecus = [
            Member(
                slot.name,
                "bench.ecu.main:serve_ecu",
                (self.options.ecus[slot.role], slot, self.options.scenario, self.address),
            )
            for slot in self._slots()
            if slot.name not in self.options.without
        ]
        if not self.options.realtime:
            return [plant, *ecus]
        arguments = (self.vehicles, self.options.scenario.cycles, self.address)
        return [plant, *ecus, Member(CLOCK, "bench.conductor.clock:serve_clock", arguments, on_call=True)]

    def _plant(self, listener: Listener, stack: ExitStack) -> list[Node]:
        # Imported here because only the process of the plant needs it.
        from bench.plant.main import make_nodes

        def truth(vehicle: int, cycle: int, values: array[float]) -> None:
            listener.truth(Truth(vehicle, cycle, values))

        def link(bus: str) -> Link:
            return open_link(bus, self.address)

        return [*make_nodes(self.options.scenario, self.fmu, link, self.codecs, truth, stack, self.plan)]

    def _maker(self, listener: Listener, stack: ExitStack) -> Maker:
        def note(event: EcuNote) -> None:
            listener.note(event)

        load_classes(self.options.ecus.values())
        slots = {slot.name: slot for slot in self._slots()}

        def make(name: str) -> tuple[Node, tuple[Topic, ...]]:
            slot = slots[name]
            links = {bus: stack.enter_context(open_link(bus, self.address)) for bus in slot.buses}
            spec = self.options.ecus[slot.role]
            node, ecu = make_node(spec, slot, self.options.scenario, links, self.codecs, self.plan, note)
            return node, tuple(ecu.inputs)

        return make


def _platform() -> str:
    """Return what `platform.platform()` does, which starts a program to find out more than that."""
    if sys.platform != "linux":
        return platform.platform()
    system = os.uname()
    parts = system.sysname, system.release, system.machine, "with", "".join(platform.libc_ver())
    return "-".join(filter(None, parts))


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"
