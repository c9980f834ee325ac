"""The faults of a running bench: those of its scenario, and those that `platoon fault` injects."""

import math
import os
import socket
import time
from collections.abc import Collection, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from bench.conductor.fault_server import FaultServer
from bench.conductor.fault_socket import (
    WHO,
    address_of,
    bench_name,
    is_trusted,
    line_of,
    listening_names,
    parsed,
    receive_line,
    send_line,
    user_of,
)
from bench.conductor.free_slots import refuse_outages
from bench.cycle import time_of
from bench.errors import BadInput
from bench.events import FaultBegins, FaultEnds, FaultRequested
from bench.faults.kinds import ONE_FAULT
from bench.faults.plan import FaultBoard, FaultPlan
from bench.scenario.errors import explain_fault
from bench.scenario.fault_targets import target_problems

if TYPE_CHECKING:  # the recorder is imported while the processes start
    from bench.conductor.recorder import Recorder


_GREETING_S = 2.0
"""Wall-clock time in s that a bench may take to say which one it is."""

_ASKED_AT_ONCE = 32
_ANSWER_S = 10.0
"""Wall-clock time in s that it may take to answer."""

_MOST_WORDS = 1000
"""Characters of a problem that are told."""


class FaultDesk:
    """Accepts faults and logs their beginning and end. A context manager, open during the run.

    Attributes:
        plan: all known faults.
    """

    def __init__(
        self,
        plan: FaultPlan,
        board: FaultBoard,
        vehicles: int,
        log: Path,
        without: Collection[str] = (),
        scenario: str = "",
        end_s: float = math.inf,
    ) -> None:
        """Accept faults for a run of a `scenario` with this number of vehicles, which writes `log` and ends at `end_s`.

        The bench does not start the ECUs in `without`, so it cannot crash or stop them.
        """
        self._without = without
        self.plan = plan
        self._board = board
        self._vehicles = vehicles
        self._end_s = end_s
        self._server = FaultServer(bench_name(log), _introduction(log, scenario))
        self._told: set[tuple[int, bool]] = set()

    def __enter__(self) -> "FaultDesk":
        """Open the socket; a bench runs also without one."""
        with suppress(OSError, RuntimeError):
            self._server.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the socket."""
        self._server.stop()

    def open(self, cycle: int, recorder: "Recorder") -> None:
        """Before a cycle begins: accept requests, and log the faults that begin and end with it."""
        self._serve(cycle, recorder)
        if not self.plan.faults:
            return
        for index, fault in enumerate(self.plan.faults):
            window = self.plan.window(index)
            what = fault.name(), fault.parameters()
            if cycle >= window.first and (index, True) not in self._told:
                self._told.add((index, True))
                until_s = None if window.end is None else time_of(window.end)
                recorder.event(cycle, FaultBegins(*what, until_s))
            if window.end is not None and cycle >= window.end and (index, False) not in self._told:
                self._told.add((index, False))
                recorder.event(cycle, FaultEnds(*what))

    def _serve(self, cycle: int, recorder: "Recorder") -> None:
        request = self._server.next()
        if request is None:
            return
        answer = self._answer(request.content, cycle)
        if "fault" in answer:
            recorder.event(cycle, FaultRequested(answer["fault"]))
        request.answer(answer)

    def _answer(self, asked: dict[str, Any], cycle: int) -> dict[str, Any]:
        now_s = time_of(cycle)
        try:
            fault = ONE_FAULT.validate_json(line_of({"at_s": now_s, **asked}))
            if fault.at_s < now_s:
                return {"error": f"at_s = {fault.at_s:g} has passed; the run is at {now_s:g} s"}
            if fault.at_s >= self._end_s:
                return {"error": f"at_s = {fault.at_s:g} is not before the run's end at {self._end_s:g} s"}
            problems = target_problems(fault, self._vehicles)
            if problems:
                return _refusal("; ".join(f"{'.'.join(key)} {text}" for key, text in problems))
            refuse_outages([fault], self._without)
            self._board.post(fault)
        except ValidationError as error:
            return _refusal(explain_fault(error, ONE_FAULT.json_schema()))
        except (ValueError, TypeError, BadInput) as error:
            return _refusal(str(error))
        self.plan.refresh()
        return {"at_s": fault.at_s, "fault": fault.model_dump(mode="json")}


def _refusal(text: str) -> dict[str, Any]:
    return {"error": text if len(text) <= _MOST_WORDS else f"{text[:_MOST_WORDS]} ..."}


def _introduction(log: Path, scenario: str) -> dict[str, Any]:
    """Return what a bench says of itself."""
    inode = _inode_here()
    folder = str(Path.cwd()) if inode else "a deleted directory"
    names = {"log": str(log.absolute()) if inode else str(log), "folder": folder, "scenario": scenario}
    # Names of files may be no text.
    return {key: os.fsencode(name).decode(errors="replace") for key, name in names.items()} | {"inode": inode}


def _inode_here() -> list[int]:
    """Return device and inode of the working directory, which any of its names has; empty if it has been deleted."""
    try:
        here = Path.cwd().stat()
    except OSError:
        return []
    return [here.st_dev, here.st_ino]


@dataclass(frozen=True)
class RunningBench:
    """A running bench.

    Attributes:
        name: process number and log, see `fault_socket.bench_name`.
        log: absolute path of its log.
        folder: the directory in which it was started.
        scenario: name of the scenario.
        here: whether it was started in the present working directory.
    """

    name: str
    log: str
    folder: str
    scenario: str
    here: bool

    @property
    def shown_log(self) -> str:
        """Its log, relative to the present working directory if it is below that."""
        with suppress(OSError, ValueError):
            return str(Path(self.log).relative_to(Path.cwd()))
        return self.log

    def is_meant(self, run: str) -> bool:
        """Whether `run` is part of its name or log."""
        return run in self.name or run in self.log


def running_benches(part: str = "") -> tuple[list[RunningBench], list[str]]:
    """Return this user's running benches, and what is wrong with others that look like them.

    Args:
        part: if there are benches with this in their names, only these are asked.
    """
    names = listening_names()
    names = [name for name in names if part in name] or names
    benches, ignored = [], []
    # Asked at once: one that says nothing delays no other.
    # Imported here because no run needs it.
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(_ASKED_AT_ONCE) as pool:
        for name, said in zip(names, pool.map(_asked, names), strict=True):
            if isinstance(said, RunningBench):
                benches.append(said)
            else:
                ignored.append(f"{name}: {said}")
    return benches, ignored


def _asked(name: str) -> RunningBench | str:
    """Return a bench that is asked which one it is, or why it is none."""
    try:
        with closing(_connected(name)) as connection:
            return _introduced(connection, name)
    except (OSError, ValueError) as error:
        return str(error)


def ask(run: str | None, request: dict[str, Any]) -> dict[str, Any]:
    """Inject a fault into a running bench and return its answer.

    Args:
        run: part of the name of the bench or of its log; None for the one that was started in this directory.
        request: the fault; without `at_s` it begins at once.

    Returns:
        `at_s`, when the fault begins (s); `fault`, the fault; `log`, the path of the bench's log.

    Raises:
        BadInput: no such bench, more than one, or it refuses the fault.
    """
    bench = _chosen(run)
    try:
        with closing(_connected(bench.name)) as connection:
            deadline = time.monotonic() + _ANSWER_S
            send_line(connection, line_of(request), deadline)
            answer = parsed(receive_line(connection, deadline) or b'{"error": "the run has ended"}')
    except (OSError, ValueError) as error:
        raise BadInput(f"the bench {bench.name} does not answer as a bench does: {error}") from error
    if "error" in answer:
        raise BadInput(f"the bench {bench.name} refuses the fault: {answer['error']}")
    if not isinstance(answer.get("at_s"), float | int):
        raise BadInput(f"the bench {bench.name} does not answer as a bench does: it does not say when the fault begins")
    return {**answer, "log": bench.shown_log}


def _chosen(run: str | None) -> RunningBench:
    benches, ignored = running_benches(run or "")
    meant = [bench for bench in benches if (bench.here if run is None else bench.is_meant(run))]
    if run is not None:
        # A process number may be part of another.
        meant = [bench for bench in meant if bench.name.partition("-")[0] == run] or meant
    if len(meant) == 1:
        return meant[0]
    if meant:
        raise BadInput(f"several benches are running; name one with --run:\n{_listed(meant)}")
    which = "no bench of yours is running"
    if benches:
        none = (
            "no running bench was started in this directory"
            if run is None
            else f"no running bench has {run!r} in its name"
        )
        raise BadInput(f"{none}; name one of these with --run:\n{_listed(benches)}")
    if run is not None:
        which = f"no running bench has {run!r} in its name"
    others = "".join(f"\n  ignored: {text}" for text in ignored)
    raise BadInput(f"{which}; start one with: platoon run{others}")


def _listed(benches: Sequence[RunningBench]) -> str:
    rows = [
        (f"--run {bench.name.partition('-')[0]}", bench.scenario, bench.shown_log, bench.folder) for bench in benches
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        f"  {name:{widths[0]}}  {scenario:{widths[1]}}  {log:{widths[2]}}  started in {folder}"
        for name, scenario, log, folder in rows
    )


def _connected(name: str) -> socket.socket:
    """Connect to a bench.

    Raises:
        OSError: nobody listens, or somebody else does.
    """
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connection.settimeout(_GREETING_S)
        connection.connect(address_of(name))
        if not is_trusted(connection):
            raise PermissionError(f"the socket belongs to user {user_of(connection)}")
    except OSError:
        connection.close()
        raise
    return connection


def _introduced(connection: socket.socket, name: str) -> RunningBench:
    """Return what a bench says of itself.

    Raises:
        OSError: it says nothing in time.
        ValueError: it says something else.
    """
    deadline = time.monotonic() + _GREETING_S
    send_line(connection, line_of(WHO), deadline)
    said = parsed(receive_line(connection, deadline))
    log, folder, scenario = (said.get(key) for key in ("log", "folder", "scenario"))
    if not (isinstance(log, str) and isinstance(folder, str) and isinstance(scenario, str)):
        raise ValueError("it does not say which bench it is")
    here = _inode_here()
    return RunningBench(name, log, folder, scenario, here=bool(here) and said.get("inode") == here)
