"""The options of a run."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from bench.bus.link.address import Address
from bench.conductor.fork_server_process import ForkServer
from bench.ecu.loading import DEFAULT_ECUS
from bench.scenario import Scenario

SILENCE_S = 10.0
"""Wall-clock time in s without a frame after which a run has failed."""

WITHOUT_WAIT_S = 120.0
"""Wall-clock time in s that a run waits for the ECUs started by hand."""


@dataclass(frozen=True)
class RunOptions:
    """The options of a run.

    Attributes:
        scenario: the scenario to run.
        address: address of the buses; `direct` keeps everything in this process.
        out: the log to write; it must not exist.
        label: a few words that tell this run from others, for the log; empty for none.
        command_line: the command line, for the log.
        ecus: class of each role's ECU, as `bench.ecu.loading.load_class` takes it.
        without: names of ECUs that are started by hand, not by the run, e.g. `veh1.planner`.
        without_wait_s: wall-clock time in s that the run waits for them.
        fmu: the vehicle's FMU; None for `platoon_fmu.build.default_fmu`.
        silence_s: wall-clock time in s without a frame after which the run has failed.
        realtime: whether the wall clock paces the cycles; else they run as fast as the machine allows.
        on_progress: called periodically with the simulated time in s.
        on_waiting: called with a line of text before the run waits for ECUs.
        on_starting: called every second with a line of text while it takes long to start, see `Patience`.
        fork_server: forks plant and ECUs, and is ended with the run; None to start one.
    """

    scenario: Scenario
    address: Address
    out: Path
    command_line: Sequence[str]
    ecus: Mapping[str, str] = field(default_factory=lambda: DEFAULT_ECUS)
    without: Collection[str] = ()
    without_wait_s: float = WITHOUT_WAIT_S
    fmu: Path | None = None
    silence_s: float = SILENCE_S
    realtime: bool = False
    label: str = ""
    on_progress: Callable[[float], None] | None = None
    on_waiting: Callable[[str], None] | None = None
    on_starting: Callable[[str], None] | None = None
    fork_server: ForkServer | None = None

    @property
    def vehicles(self) -> int:
        """Number of vehicles."""
        return len(self.scenario.vehicles)
