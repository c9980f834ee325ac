"""The conductor of a real-time run: what it makes of frames and their times; and real time changes nothing else."""

import math
import os
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from bench.analysis.timing import NodeTiming, Timing, timing
from bench.bus.absence import BENCH_ABSENT
from bench.bus.codec import load_codecs
from bench.bus.control_channel import Truth
from bench.bus.frame import CanFrame
from bench.bus.link.address import Address
from bench.bus.link.direct import DirectLink, Hub
from bench.bus.link.opening import open_link
from bench.bus.states import BenchCommand
from bench.bus.sync import BENCH_SYNC
from bench.bus.topic import Topic
from bench.conductor.conducting import Means
from bench.conductor.cycle import frames_due
from bench.conductor.fault_desk import FaultDesk
from bench.conductor.free_slots import FreeSlots
from bench.conductor.interrupts import Interrupts
from bench.conductor.options import RunOptions
from bench.conductor.process_watch import ProcessWatch
from bench.conductor.realtime import Realtime
from bench.conductor.recorder import Recorder
from bench.conductor.run import run
from bench.conductor.stage import Stage
from bench.cycle import CYCLE_NS
from bench.ecu.loading import load_class
from bench.errors import RunFailed
from bench.events import DeadlineMet, DeadlineMissed, EcuFailed, EcuNote, Refusal
from bench.faults.plan import FaultBoard, FaultPlan
from bench.plant.description import read_description
from bench.record import Run, RunWriter
from bench.scenario import load
from platoon_fmu.build import default_fmu

CODECS = load_codecs(1)
DUE = frames_due(CODECS, 1)
BUSES = ("v2v", "veh1")
MS = 1_000_000
START_NS = 1_700_000_000_000_000_000
NODES = ("veh1.plant", "veh1.planner", "veh1.tracker")

Frame = tuple[str, int, int, bytes]
"""Bus, time of receipt in ns, identifier, data."""

SIMPLE_FILE = Path(__file__).parents[1] / "ecus" / "simple.py"
SIMPLE = {"planner": f"{SIMPLE_FILE}:CruisePlanner", "tracker": f"{SIMPLE_FILE}:SpeedTracker"}


def sync(cycle: int, at_ns: int | None = None) -> list[Frame]:
    """BenchSync of a cycle on both buses."""
    at_ns = START_NS + cycle * CYCLE_NS if at_ns is None else at_ns
    values = {"Command": BenchCommand.RUN_REALTIME, "Cycle": cycle, "Time": cycle / 100}
    return [(bus, at_ns, *CODECS[bus].encode(BENCH_SYNC, values, cycle)) for bus in BUSES]


def node(name: str, cycle: int, after_ms: float) -> list[Frame]:
    """All that a node sends in a cycle, so long after the cycle's begin."""
    sender = "plant" if name.endswith(".plant") else name
    at_ns = START_NS + cycle * CYCLE_NS + round(after_ms * MS)
    return [
        (bus, at_ns, *CODECS[bus].encode(due.message, CODECS[bus].start_values(due.message), cycle))
        for bus in BUSES
        for due in DUE[bus].values()
        if due.sender == sender and cycle % due.period == 0
    ]


def cycle_in_time(cycle: int) -> list[Frame]:
    return [*sync(cycle), *(frame for k, name in enumerate(NODES) for frame in node(name, cycle, 1.0 + k))]


def without_tracker(cycle: int) -> list[Frame]:
    return [*sync(cycle), *node("veh1.plant", cycle, 1.0), *node("veh1.planner", cycle, 2.0)]


def without_plant(cycle: int) -> list[Frame]:
    return [*sync(cycle), *node("veh1.planner", cycle, 2.0), *node("veh1.tracker", cycle, 3.0)]


class ScriptedCrew:
    """Brings what it is told to, a part at each call of `attend`, and notes whom the conductor excuses."""

    def __init__(self, links: Mapping[str, DirectLink], parts: Sequence[Sequence[Frame]]) -> None:
        self.links = links
        self.parts = list(parts)
        self.listener: Realtime | None = None
        self.restarted: list[str] = []
        self.excused: list[str] = []
        self.inputs: Mapping[str, Sequence[Topic]] = {}
        self.pids: Mapping[str, int] = {}

    def attend(self, timeout_s: float) -> bool:  # noqa: ARG002 - all is there or will never be
        waited = False
        if not self.parts:
            return False
        assert self.listener is not None
        part = self.parts.pop(0)
        for bus, link in self.links.items():
            mine = [frame for frame in part if frame[0] == bus]
            link.times = [at_ns for _, at_ns, _, _ in mine]
            waited |= self.listener.frames(bus, [CanFrame(can_id, data) for _, _, can_id, data in mine])
        return waited

    def restart(self, name: str) -> None:
        self.restarted.append(name)

    def excuse(self, name: str) -> None:
        self.excused.append(name)

    def wait_ready(self, timeout_s: float) -> None:
        raise NotImplementedError

    def kill(self, name: str) -> None:
        raise NotImplementedError

    def pause(self, name: str) -> None:
        raise NotImplementedError

    def resume(self, name: str) -> None:
        raise NotImplementedError

    def stop(self, grace_s: float) -> list[str]:
        raise NotImplementedError


class Conducted:
    """What came of a run: the conductor, its crew, the log read back."""

    def __init__(self, conductor: Realtime, crew: ScriptedCrew, log: Run) -> None:
        self.conductor = conductor
        self.crew = crew
        self.log = log

    @property
    def times(self) -> Timing:
        found = timing(self.log)
        assert found is not None
        return found

    def timing_of(self, name: str) -> NodeTiming:
        return next(node for node in self.times.nodes if node.name == name)


Conduct = Callable[..., Conducted]


@pytest.fixture
def conduct(tmp_path: Path) -> Iterator[Conduct]:
    """Let a real-time conductor run on scripted frames: `conduct(parts, cycles)`; the log is closed either way."""
    board = FaultBoard.create()

    def go(parts: Sequence[Sequence[Frame]], cycles: int, *, silence_s: float = 60.0, go_on: bool = False) -> Conducted:
        hub = Hub()
        links = {bus: DirectLink(bus, hub) for bus in BUSES}
        # As the clock would.
        FaultBoard(board).open_cycle(10**6, realtime=True)
        desk = FaultDesk(FaultPlan(board=FaultBoard(board)), FaultBoard(board), 1, tmp_path / "run.mcap")
        conductor = Realtime(Means(links, CODECS, 1, silence_s, desk, FreeSlots([], CODECS, 1), go_on))
        crew = ScriptedCrew(links, parts)
        crew.listener = conductor
        writer = RunWriter(
            tmp_path / "run.mcap",
            codecs=CODECS,
            truth_names=("X", "Y", "psi", "phi"),
            vehicles=1,
            metadata={"clock": "realtime", "vehicles": "1"},
            attachments={},
        )
        try:
            conductor.run(crew, Recorder(writer, CODECS, ProcessWatch(dict)), cycles, None)
        finally:
            writer.close({"status": "done"})
        return Conducted(conductor, crew, Run(tmp_path / "run.mcap"))

    yield go
    os.close(board)


def test_whoever_is_in_time_misses_nothing(conduct: Conduct) -> None:
    found = conduct([cycle_in_time(cycle) for cycle in range(6)], 6)
    assert found.crew.restarted == ["clock"]
    assert found.conductor.cycles == 6
    assert found.conductor.wall_s == pytest.approx(0.06)
    assert found.conductor.misses == dict.fromkeys(NODES, 0)
    for k, name in enumerate(NODES):
        measured = found.timing_of(name)
        assert (measured.cycles, measured.misses) == (6, 0)
        assert measured.response_ms == pytest.approx([1.0 + k] * 6)


def test_a_late_frame_belongs_to_the_cycle_of_its_counter(conduct: Conduct) -> None:
    parts = [cycle_in_time(cycle) for cycle in range(6)]
    parts[2] = without_tracker(2)
    parts[3] = [*parts[3][:2], *node("veh1.tracker", 2, 11.5), *parts[3][2:]]
    found = conduct(parts, 6)
    assert found.conductor.misses == {"veh1.plant": 0, "veh1.planner": 0, "veh1.tracker": 1}
    steering = CODECS["veh1"].can_id("SteeringCommand")
    status = CODECS["veh1"].can_id("TrackerStatus")
    table = found.log.frame_table("veh1")
    for can_id in (steering, status):
        # The one with a counter, and the one without that came with it.
        rows = table[(table["can_id"] == can_id) & (table["time"] == 2 * CYCLE_NS)]
        assert (rows["receive"] - START_NS).tolist() == [2 * CYCLE_NS + round(11.5 * MS)]
    measured = found.timing_of("veh1.tracker")
    assert (measured.late, measured.missing, measured.longest_miss) == (1, 0, 1)
    said = [(event.kind, event.fields) for event in found.log.events if event.source == "veh1.tracker"]
    assert said == [(DeadlineMissed.kind, {"late_ms": 1.5}), (DeadlineMet.kind, {"missed": 1})]


def test_a_deadline_is_the_next_bench_sync_however_late_that_comes(conduct: Conduct) -> None:
    parts = [cycle_in_time(cycle) for cycle in range(5)]
    parts[1] = [*without_tracker(1), *node("veh1.tracker", 1, 10.4)]
    in_time = [*sync(2, START_NS + 2 * CYCLE_NS + MS // 2), *parts[2][2:]]
    assert conduct([*parts[:2], in_time, *parts[3:]], 5).conductor.misses["veh1.tracker"] == 0


def test_the_conductor_may_be_behind_with_every_bus(conduct: Conduct) -> None:
    # More than a turn of the alive counter comes in one piece, bus after bus.
    parts = [[frame for cycle in range(40) for frame in cycle_in_time(cycle)]]
    found = conduct(parts, 40)
    assert found.conductor.misses == dict.fromkeys(NODES, 0)
    table = found.log.frame_table("veh1")
    motion = table[table["can_id"] == CODECS["veh1"].can_id("VehicleMotion")]
    assert (motion["time"] // CYCLE_NS).tolist() == list(range(40))


def test_a_counter_that_cannot_be_believed_names_no_cycle(conduct: Conduct) -> None:
    parts = [cycle_in_time(cycle) for cycle in range(8)]
    steering = CODECS["veh1"].can_id("SteeringCommand")
    before = next(frame for frame in parts[3] if frame[2] == steering)
    for cycle, data in ((5, before[3]), (6, bytes([before[3][0] ^ 1, *before[3][1:]]))):
        # Cycle 3's frame once more, in cycle 6 with a wrong CRC as well.
        parts[cycle].append((before[0], START_NS + cycle * CYCLE_NS + 4 * MS, steering, data))
        parts[cycle].append((before[0], START_NS + cycle * CYCLE_NS + 5 * MS, steering, data))
    found = conduct(parts, 8)
    assert found.conductor.misses == dict.fromkeys(NODES, 0)
    table = found.log.frame_table("veh1")
    rows = table[table["can_id"] == steering]
    assert np.bincount(rows["time"] // CYCLE_NS).tolist() == [1, 1, 1, 1, 1, 3, 3, 1]


FORGED = [
    ({"Command": 2, "Cycle": 4_000_000, "Time": 16_777.215}, 0),
    ({"Command": 2, "Cycle": 60, "Time": 0.6}, 0),
    ({"Command": 2, "Cycle": 1, "Time": 0.01}, 0),
    ({"Command": 2, "Cycle": 4, "Time": 0.0}, 0),
    ({"Command": 2, "Cycle": 4, "Time": 0.04}, 1),
    ({"Command": 1, "Cycle": 4, "Time": 0.04}, 0),
    ({"Command": 0, "Cycle": 4, "Time": 0.04}, 0),
]
"""BenchSync with a good CRC in cycle 3, and what is added to its alive counter."""


@pytest.mark.parametrize(("values", "more"), FORGED)
def test_a_bench_sync_that_is_not_the_clocks_begins_no_cycle(
    conduct: Conduct, values: dict[str, float], more: int
) -> None:
    parts = [cycle_in_time(cycle) for cycle in range(6)]
    at_ns = START_NS + 3 * CYCLE_NS + 4 * MS
    parts[3] += [(bus, at_ns, *CODECS[bus].encode(BENCH_SYNC, values, int(values["Cycle"]) + more)) for bus in BUSES]
    found = conduct(parts, 6)
    assert found.conductor.cycles == 6
    assert found.conductor.misses == dict.fromkeys(NODES, 0)
    assert [total.counts for total in found.conductor.refused] == [{Refusal.IMPLAUSIBLE: 1}] * 2
    assert found.log.frame_table("veh1")["time"].max() == 6 * CYCLE_NS


def test_a_bench_sync_read_before_that_of_the_cycle_before_loses_neither(conduct: Conduct) -> None:
    """A stranger's, as consistent as the clock's, which the conductor reads when the clock has sent both."""
    parts = [cycle_in_time(cycle) for cycle in range(6)]
    parts[3] = [*sync(4, START_NS + 3 * CYCLE_NS - MS), *parts[3]]
    found = conduct(parts, 6)
    for bus in BUSES:
        table = found.log.frame_table(bus)
        rows = table[table["can_id"] == CODECS[bus].can_id(BENCH_SYNC)]
        assert {*range(6)} <= {*(rows["time"] // CYCLE_NS).tolist()}
    assert [total.counts for total in found.conductor.refused] == [{Refusal.IMPLAUSIBLE: 1}] * 2


@pytest.mark.parametrize("length", range(8))
def test_a_frame_of_another_length_is_refused_whatever_its_identifier(conduct: Conduct, length: int) -> None:
    before = [(bus, START_NS, can_id, bytes(length)) for bus in BUSES for can_id in CODECS[bus].can_ids]
    parts = [cycle_in_time(cycle) for cycle in range(6)]
    parts[3] = [*parts[3], *((bus, at_ns + 3 * CYCLE_NS, *frame) for bus, at_ns, *frame in before)]
    found = conduct([before, *parts], 6)
    assert found.conductor.misses == dict.fromkeys(NODES, 0)
    for total in found.conductor.refused:
        assert total.counts == {Refusal.LENGTH: 2 * len(CODECS[total.bus].can_ids)}
    table = found.log.frame_table("veh1")
    assert np.bincount(table["length"], minlength=9)[length] == len(CODECS["veh1"].can_ids)
    assert set(table[table["length"] == length]["time"]) == {3 * CYCLE_NS}


def test_a_flood_does_not_hide_that_the_clock_says_nothing(conduct: Conduct) -> None:
    flood = [("veh1", START_NS, 0x7FF, b"1"), ("veh1", START_NS, 0x107, b""), *node("veh1.tracker", 0, 3.0)]
    with pytest.raises(RunFailed, match=r"no frame came for 0\.02 s, not even from the clock"):
        conduct([cycle_in_time(0), *([flood] * 100_000)], 5, silence_s=0.02)


def test_an_ecu_that_meets_no_deadline_ends_the_run(conduct: Conduct) -> None:
    with pytest.raises(RunFailed, match=r"veh1\.tracker has met no deadline for 0\.05 s"):
        conduct([cycle_in_time(0), *(without_tracker(cycle) for cycle in range(1, 20))], 20, silence_s=0.05)


def test_a_run_can_go_on_without_it(conduct: Conduct) -> None:
    parts = [cycle_in_time(0), *(without_tracker(cycle) for cycle in range(1, 20))]
    found = conduct(parts, 20, silence_s=0.05, go_on=True)
    assert found.crew.excused == ["veh1.tracker"]
    assert found.conductor.misses["veh1.tracker"] == 6
    (failure,) = [event for event in found.log.events if event.kind == EcuFailed.kind]
    assert failure.fields["ecus"] == ["veh1.tracker"]


def test_a_plant_that_meets_no_deadline_ends_the_run(conduct: Conduct) -> None:
    with pytest.raises(RunFailed, match=r"the plant has met no deadline for 0\.05 s"):
        conduct([cycle_in_time(0), *(without_plant(cycle) for cycle in range(1, 20))], 20, silence_s=0.05)


def test_a_run_in_which_the_plant_has_met_no_deadline_is_not_complete(conduct: Conduct) -> None:
    """However short it is: it has no truth, and nothing can be said of its vehicles."""
    with pytest.raises(RunFailed, match="the plant has met no deadline in the whole run"):
        conduct([without_plant(cycle) for cycle in range(6)], 6)


def test_a_clock_that_says_nothing_ends_the_run(conduct: Conduct) -> None:
    with pytest.raises(RunFailed, match=r"no frame came for 0\.02 s"):
        conduct([cycle_in_time(0)], 5, silence_s=0.02)


class Frames:
    """Takes what a crew brings; the frames are kept by cycle."""

    def __init__(self) -> None:
        self.cycle = 0
        self.by_cycle: dict[tuple[int, str], list[tuple[int, bytes]]] = defaultdict(list)

    def frames(self, bus: str, frames: Sequence[tuple[int, bytes]]) -> None:
        self.by_cycle[self.cycle, bus] += frames

    def truth(self, row: Truth) -> None:
        pass

    def words(self, name: str, text: str) -> None:
        raise AssertionError(f"{name}: {text}")

    def note(self, event: EcuNote) -> None:
        raise AssertionError(event.text)


def test_where_nobody_is_late_the_frames_are_those_of_lockstep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = load("formation", ["duration_s=0.5"])
    vehicles, fmu = len(scenario.vehicles), default_fmu()
    codecs = load_codecs(vehicles)
    lockstep = Run(
        run(
            RunOptions(
                scenario, address=Address.parse("direct"), out=tmp_path / "a.mcap", command_line=["test"], ecus=SIMPLE
            )
        ).path
    )
    for spec in SIMPLE.values():
        monkeypatch.setattr(load_class(spec), "input_wait_s", math.inf, raising=False)
    heard = Frames()
    with ExitStack() as stack:
        address = Address.parse("direct")
        links = {bus: stack.enter_context(open_link(bus, address)) for bus in codecs}
        board = FaultBoard.create()
        stack.callback(os.close, board)
        options = RunOptions(scenario, address, tmp_path / "b.mcap", ["test"], SIMPLE)
        stage = Stage(options, address, codecs, fmu, read_description(fmu), FaultPlan(), board)
        crew = stage.crew(links, heard, stack.enter_context(Interrupts()), stack)
        for heard.cycle in range(scenario.cycles):
            values = {"Command": BenchCommand.RUN_REALTIME, "Cycle": heard.cycle, "Time": heard.cycle / 100}
            for bus, link in links.items():
                link.send(*codecs[bus].encode(BENCH_SYNC, values, heard.cycle))
            while crew.attend(0.0):
                pass
    compared = 0
    for bus, codec in codecs.items():
        table = lockstep.frame_table(bus)
        # Real time announces nothing as absent, and its BenchSync has another command.
        left_out = {codec.can_id(name) for name in (BENCH_SYNC, BENCH_ABSENT)}
        left_out |= {can_id for can_id in codec.can_ids if codec.is_wall_clock(can_id)}
        for cycle in range(scenario.cycles):
            rows = table[table["time"] == cycle * CYCLE_NS]
            expected = sorted((int(row["can_id"]), row["data"].tobytes()[: row["length"]]) for row in rows)
            expected = [frame for frame in expected if frame[0] not in left_out]
            got = sorted(frame for frame in heard.by_cycle[cycle, bus] if frame[0] not in left_out)
            assert got == expected, f"cycle {cycle} on {bus}"
            compared += len(got)
    assert compared >= 50 * scenario.cycles
