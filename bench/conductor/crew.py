"""The plant and the ECUs of a run, as seen by the conductor; here as separate processes."""

import json
import os
import pickle
import select
import selectors
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from types import TracebackType
from typing import Protocol

from bench.bus.control_channel import Kind, ReportReader, Truth, read_note, read_truth
from bench.bus.frame import CanFrame
from bench.bus.link.base import Link
from bench.bus.node import LOOK_S
from bench.bus.topic import Topic
from bench.conductor.fork_server import NAME as _FORK_SERVER
from bench.conductor.fork_server import Child, Setup
from bench.conductor.fork_server_process import ForkServer
from bench.conductor.interrupts import Interrupts
from bench.conductor.linux import enlarge_pipe, is_stopped, processor_time
from bench.conductor.patience import PERIOD_S, Patience, Say, listed
from bench.errors import RunFailed
from bench.events import EcuNote
from bench.memory_file import memory_file

LAST_WORDS_BYTES = 8192
"""Number of bytes kept from the end of a process's standard error."""

KILL_S = 5.0
"""Wall-clock time in s within which the end of a killed process is reported."""

RESTART_S = 60.0
"""Wall-clock time in s that an ECU may take to restart."""

RESUME_S = 0.1
"""Wall-clock time in s after which stopped processes are resumed, again, at the end of a run."""


class Ended(RunFailed):
    """A process ended unexpectedly.

    Attributes:
        names: the processes; empty if unknown.
    """

    def __init__(self, text: str, names: Sequence[str] = ()) -> None:
        """Create the error with its text and the processes concerned."""
        super().__init__(text)
        self.names = tuple(names)


class Listener(Protocol):
    """Receives frames, truth rows and output from a crew."""

    @property
    def awaited(self) -> str | None:
        """The bus without whose frames the run does not go on; None if frames on any bus matter."""

    def frames(self, bus: str, frames: Sequence[CanFrame]) -> bool:
        """Take frames received on a bus; return whether any of them was waited for, so that the run gets on."""

    def truth(self, row: Truth) -> None:
        """Take a truth row."""

    def words(self, name: str, text: str) -> None:
        """Take what the process `name` has written to its standard output or error."""

    def note(self, event: EcuNote) -> None:
        """Take what is to be noted of the values that an ECU sends."""


class Crew(Protocol):
    """Plant and ECUs of a run."""

    @property
    def inputs(self) -> Mapping[str, Sequence[Topic]]:
        """The inputs of each process, by its name."""

    @property
    def pids(self) -> Mapping[str, int]:
        """Process numbers of the separate, live processes, by name."""

    def wait_ready(self, timeout_s: float, say: Say | None = None) -> None:
        """Wait until all listen on their buses; see `Patience` for `say`.

        Raises:
            RunFailed: one of them ended, or there was no sign of progress for `timeout_s` s.
            Interrupted: a signal has come.
        """

    def attend(self, timeout_s: float) -> bool:
        """Wait for frames and pass on all input.

        Returns False if none that the listener waited for came for `timeout_s` s, or none can come.

        Raises:
            RunFailed: one of them ended or failed.
            Interrupted: a signal has come.
        """

    def kill(self, name: str) -> None:
        """Kill an ECU for a fault; its end is not a failure."""

    def restart(self, name: str) -> None:
        """Restart a killed ECU, and wait until it is listening on its buses.

        Raises:
            RunFailed: it ended, or is not ready in time.
            Interrupted: a signal has come.
        """

    def pause(self, name: str) -> None:
        """Suspend an ECU (SIGSTOP); it does not notice."""

    def resume(self, name: str) -> None:
        """Resume a stopped ECU."""

    def excuse(self, name: str) -> None:
        """Ignore this ECU's failures from now on."""

    def stop(self, grace_s: float) -> list[str]:
        """Wait for all processes to end after the stop command; kill those still alive after `grace_s` s.

        Returns the problems, a sentence each.
        """


@dataclass(frozen=True)
class Member:
    """A process to be started.

    Attributes:
        name: name in messages.
        target: `module:function` to run in it, see `Child`.
        arguments: arguments of the function, after the `ControlChannel`.
        on_call: whether it is started only by `Crew.restart`.
    """

    name: str
    target: str
    arguments: tuple[object, ...]
    on_call: bool = False


@dataclass
class _Process:
    """A monitored process."""

    stderr: int
    words: bytearray = field(default_factory=bytearray)
    pid: int | None = None
    ready: bool = False
    code: int | None = None
    excused: bool = False


class ProcessCrew:
    """A crew of processes, all forked from one fork server (`bench.conductor.fork_server`).

    A context manager: at its end all processes have ended, however the run went.
    """

    def __init__(
        self,
        members: Sequence[Member],
        preload: Sequence[str],
        links: Mapping[str, Link],
        listener: Listener,
        interrupts: Interrupts,
        board: int,
        fork_server: ForkServer,
    ) -> None:
        """Start the processes; `wait_ready` waits for them.

        Args:
            members: the processes.
            preload: ECU classes to import once for all.
            links: the conductor's links, whose frames are passed to `listener`.
            listener: receives frames, truth rows and output.
            interrupts: signals that end the waiting.
            board: file descriptor of the fault board.
            fork_server: forks the processes; the crew ends it.
        """
        self._fork_server = fork_server
        self._inputs: dict[str, Sequence[Topic]] = {}
        self._links = links
        self._listening: list[Link] = []
        self._pollers: dict[str, select.poll] = {}
        self._listener = listener
        self._interrupts = interrupts
        self._reader = ReportReader()
        self._reports, reports = os.pipe()
        orders, self._orders = os.pipe()
        os.set_blocking(self._reports, False)
        enlarge_pipe(self._reports)
        self._reports_open = True
        self._processes: dict[str, _Process] = {}
        self._selector = selectors.DefaultSelector()
        self._watch_words(_FORK_SERVER, fork_server.words)
        stderrs = [self._with_pipe(member.name) for member in members]
        children = tuple(Child(m.name, m.target, pickle.dumps(m.arguments), m.on_call) for m in members)
        for member in members:
            if member.on_call:
                # Do not wait for processes that have not been started.
                self._processes[member.name].excused, self._processes[member.name].code = True, 0
        content = memory_file(pickle.dumps(Setup(children, tuple(preload))))
        fork_server.set_up([content, reports, orders, board, *stderrs])
        for descriptor in (content, reports, orders, *stderrs):
            os.close(descriptor)
        self._register(self._reports, self._take_reports)
        self._register(interrupts.fileno(), self._note_interrupt)

    def __enter__(self) -> "ProcessCrew":
        """Return the crew itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Kill the remaining processes."""
        self.close()

    @property
    def inputs(self) -> Mapping[str, Sequence[Topic]]:
        """See `Crew`."""
        return self._inputs

    @property
    def pids(self) -> Mapping[str, int]:
        """See `Crew`."""
        return {name: p.pid for name, p in self._members() if p.pid is not None and p.code is None}

    def wait_ready(self, timeout_s: float, say: Say | None = None) -> None:
        """See `Crew`."""
        # Frames are due only later, but whoever sends before must not fill the receive queues.
        for bus, link in self._links.items():
            self._register(link.fileno(), partial(self._take_frames, bus, link))
            self._listening.append(link)
            self._pollers[bus] = select.poll()
            self._pollers[bus].register(link.fileno(), select.POLLIN)
            self._pollers[bus].register(self._interrupts.fileno(), select.POLLIN)
        self._await_ready(timeout_s, say)

    def attend(self, timeout_s: float) -> bool:
        """See `Crew`."""
        deadline = time.monotonic() + timeout_s
        while True:
            left = max(0.0, deadline - time.monotonic())
            bus = self._listener.awaited
            if bus is not None:
                # Woken by this bus only, everything that has come meanwhile is read together.
                self._pollers[bus].poll(min(left, LOOK_S) * 1000)
                left = 0.0
            heard = self._select(left)
            self._check()
            if heard:
                return True
            if time.monotonic() >= deadline:
                return False

    def kill(self, name: str) -> None:
        """See `Crew`."""
        process = self._processes[name]
        process.excused = True
        self._signal(name, signal.SIGKILL)
        deadline = time.monotonic() + KILL_S
        while process.code is None and self._reports_open and time.monotonic() < deadline:
            self._select(deadline - time.monotonic())
            self._check()

    def restart(self, name: str) -> None:
        """See `Crew`."""
        process = self._processes[name]
        process.code, process.pid, process.ready, process.excused = None, None, False, False
        os.write(self._orders, f"{name}\n".encode())
        self._await_ready(RESTART_S)

    def pause(self, name: str) -> None:
        """See `Crew`."""
        self._processes[name].excused = True
        self._signal(name, signal.SIGSTOP)

    def resume(self, name: str) -> None:
        """See `Crew`."""
        self._processes[name].excused = False
        self._signal(name, signal.SIGCONT)

    def excuse(self, name: str) -> None:
        """See `Crew`."""
        if name in self._processes:
            self._processes[name].excused = True

    def _signal(self, name: str, number: signal.Signals) -> None:
        process = self._processes[name]
        if process.pid is not None and process.code is None:
            with suppress(ProcessLookupError):
                os.kill(process.pid, number)

    def _await_ready(self, timeout_s: float, say: Say | None = None) -> None:
        patience = Patience(timeout_s, say)
        while waiting := [name for name, process in self._members() if not (process.ready or process.excused)]:
            patience.look(listed(waiting), self._doing(waiting), self._progress)
            self._select(PERIOD_S)
            self._check()

    def _doing(self, waiting: Sequence[str]) -> str:
        """Return what keeps processes from being ready, in words."""
        if stopped := self._stopped(waiting):
            return stopped.removeprefix("; ")
        pids = {name: self._processes[name].pid for name in waiting}
        if not all(pids.values()):
            return f"importing the controllers, and compiling them if need be (process {self._fork_server.pid})"
        numbers = ", ".join(str(pid) for pid in list(pids.values())[:4])
        return f"setting up controllers and buses (process{'es' if len(pids) > 1 else ''} {numbers})"

    def _progress(self) -> tuple[object, ...]:
        """Return how far the processes are: those started and ready, what they have printed, their processor time."""
        members = self._members()
        seconds = sum(map(processor_time, [self._fork_server.pid, *self.pids.values()]))
        said = sum(len(process.words) for process in self._processes.values())
        return len(self.pids), sum(process.ready for _, process in members), said, int(seconds)

    def stop(self, grace_s: float) -> list[str]:
        """See `Crew`."""
        if self._reports < 0:
            return []
        for name, process in self._members():
            if process.excused:
                # It may be stopped, or hang: do not wait for it.
                self._signal(name, signal.SIGKILL)
        for link in self._listening:
            self._selector.unregister(link.fileno())
        self._listening.clear()
        self._await_end(grace_s)
        problems = [
            f"{self._end_of(name)} while stopping{self._last_words(name)}"
            for name, process in self._members()
            if process.code and not process.excused
        ]
        unknown = [name for name, process in self._members() if process.code is None]
        if unknown and (not self._reports_open or is_stopped(self._fork_server.pid)):
            how = "was stopped by a signal" if self._reports_open else "ended"
            problems.append(f"the {_FORK_SERVER} of the processes {how} at the end of the run")
        else:
            problems += [f"{name} did not stop and was killed" for name in unknown]
        self.close()
        return problems

    def close(self) -> None:
        """Kill the remaining processes and close the pipes; idempotent."""
        if self._reports < 0:
            return
        self._fork_server.end_children()
        self._await_end(1.0)
        self._selector.close()
        self._fork_server.end()
        os.close(self._orders)
        os.close(self._reports)
        for _, process in self._members():
            os.close(process.stderr)
        self._reports = -1

    def _members(self) -> list[tuple[str, _Process]]:
        return [(name, process) for name, process in self._processes.items() if name != _FORK_SERVER]

    def _with_pipe(self, name: str) -> int:
        """Register the process `name`; return the writing end of the pipe for its standard error."""
        reader, writer = os.pipe()
        os.set_blocking(reader, False)
        self._watch_words(name, reader)
        return writer

    def _watch_words(self, name: str, reader: int) -> None:
        self._processes[name] = _Process(reader)
        self._register(reader, partial(self._take_words, name))

    def _register(self, descriptor: int, handler: Callable[[], bool]) -> None:
        self._selector.register(descriptor, selectors.EVENT_READ, handler)

    def _select(self, timeout_s: float) -> bool:
        """Wait once and handle all input; return whether frames that were waited for were among it."""
        heard = False
        for key, _ in self._selector.select(timeout_s):
            heard |= key.data()
        return heard

    def _take_frames(self, bus: str, link: Link) -> bool:
        return self._listener.frames(bus, link.receive())

    def _take_words(self, name: str) -> bool:
        process = self._processes[name]
        text = _read(process.stderr)
        if text is None:
            return False
        if not text:
            self._selector.unregister(process.stderr)
            return False
        process.words += text
        del process.words[:-LAST_WORDS_BYTES]
        self._listener.words(name, text.decode(errors="replace"))
        return False

    def _take_reports(self) -> bool:
        data = _read(self._reports)
        if data is None:
            return False
        if not data:
            self._selector.unregister(self._reports)
            self._reports_open = False
            return False
        for kind, payload in self._reader.feed(data):
            if kind is Kind.TRUTH:
                self._listener.truth(read_truth(payload))
            elif kind is Kind.NOTE:
                self._listener.note(read_note(payload))
            else:
                self._note(kind, payload)
        return False

    def _note(self, kind: Kind, payload: bytes) -> None:
        content = json.loads(payload)
        process = self._processes[content["name"]]
        if kind is Kind.STARTED:
            process.pid = content["pid"]
        elif kind is Kind.READY:
            process.ready = True
            self._inputs[content["name"]] = [Topic(bus, message) for bus, message in content["inputs"]]
        elif kind is Kind.ENDED:
            process.code = content["code"]

    def _note_interrupt(self) -> bool:
        self._selector.unregister(self._interrupts.fileno())
        return False

    def _check(self) -> None:
        self._interrupts.check()
        ended = [name for name, process in self._members() if process.code is not None and not process.excused]
        if ended:
            raise Ended("\n".join(f"{self._end_of(name)}{self._last_words(name)}" for name in ended), ended)
        if not self._reports_open:
            raise Ended(f"the {_FORK_SERVER} of the processes ended{self._last_words(_FORK_SERVER)}")

    def _await_end(self, timeout_s: float) -> None:
        deadline = time.monotonic() + timeout_s
        while self._reports_open and any(process.code is None for _, process in self._members()):
            left = deadline - time.monotonic()
            if left <= 0:
                return
            self._resume_stopped()
            self._select(min(left, RESUME_S))

    def _resume_stopped(self) -> None:
        """Let processes end that somebody has stopped (SIGSTOP)."""
        self._fork_server.resume()
        for name, _ in self._members():
            self._signal(name, signal.SIGCONT)

    def _stopped(self, names: Sequence[str]) -> str:
        """Return which of these processes, or the fork server, somebody has stopped, for a message."""
        pids = {_FORK_SERVER: self._fork_server.pid} | {name: self._processes[name].pid or 0 for name in names}
        stopped = [name for name, pid in pids.items() if pid and is_stopped(pid)]
        return f"; stopped by a signal: {', '.join(stopped)}" if stopped else ""

    def _end_of(self, name: str) -> str:
        process = self._processes[name]
        code = process.code or 0
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        return f"{name} (process {process.pid}) {how}"

    def _last_words(self, name: str) -> str:
        # The pipe may hold unread output; the process has ended, so no more will follow.
        process = self._processes[name]
        while text := _read(process.stderr):
            process.words += text
        words = bytes(process.words[-LAST_WORDS_BYTES:]).decode(errors="replace").strip()
        return f"; its last output:\n{words}" if words else "; it printed no error"


def _read(descriptor: int) -> bytes | None:
    """Read the available bytes: b"" at the end of the pipe, None if there are none yet."""
    try:
        return os.read(descriptor, 65536)
    except BlockingIOError:
        return None
