"""The faults of a running bench: those of its scenario, and those that `platoon fault` injects.

A bench listens on an abstract Unix socket (unix(7)) and accepts only its own user and root. A request is one line of
JSON, the answer another.
"""

import json
import os
import socket
import struct
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter, ValidationError

from bench.conductor.free_slots import refuse_outages
from bench.cycle import time_of
from bench.errors import BadInput
from bench.events import FaultBegins, FaultEnds, FaultRequested
from bench.faults.base import Fault
from bench.faults.kinds import AnyFault, kinds
from bench.faults.plan import FaultBoard, FaultPlan
from bench.scenario.fault_targets import target_problems

if TYPE_CHECKING:  # the recorder is imported while the processes start
    from bench.conductor.recorder import Recorder

_FAULTS: TypeAdapter[Fault] = TypeAdapter(AnyFault)
_ANSWER_S = 10.0
_MOST_BYTES = 65536
_CREDENTIALS = struct.Struct("=3i")
"""struct ucred: process, user and group."""


def _names() -> str:
    """Return the prefix of this user's benches among the names of abstract Unix sockets on this host."""
    return f"@platoon-{os.getuid()}-"


class FaultDesk:
    """Accepts faults and logs their beginning and end. A context manager, open during the run.

    Attributes:
        plan: all known faults.
    """

    def __init__(
        self, plan: FaultPlan, board: FaultBoard, vehicles: int, log: Path, without: Collection[str] = ()
    ) -> None:
        """Accept faults for a run with this number of vehicles, identified by its `log`.

        The bench does not start the ECUs in `without`, so it cannot crash or stop them.
        """
        self._without = without
        self.plan = plan
        self._board = board
        self._vehicles = vehicles
        self._log = log
        self._socket: socket.socket | None = None
        self._told: set[tuple[int, bool]] = set()

    def __enter__(self) -> "FaultDesk":
        """Open the socket; a bench runs also without one."""
        name = f"{_names()}{os.getpid()}-{'_'.join(self._log.stem.split())[:48]}"
        try:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            self._socket.setblocking(False)
            self._socket.bind(_abstract(name))
            self._socket.listen(8)
        except OSError:
            self._close()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the socket."""
        self._close()

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
        if self._socket is None:
            return
        try:
            connection, _ = self._socket.accept()
        except OSError:
            # No request, or the sender has gone.
            return
        with connection, suppress(OSError):
            if _user_of(connection) not in (0, os.getuid()):
                return
            connection.settimeout(0.2)
            answer = self._answer(_line(connection), cycle)
            if "fault" in answer:
                recorder.event(cycle, FaultRequested(answer["fault"]))
            connection.sendall(json.dumps(answer).encode() + b"\n")

    def _answer(self, line: bytes, cycle: int) -> dict[str, Any]:
        now_s = time_of(cycle)
        try:
            asked = json.loads(line)
            fault = _FAULTS.validate_json(json.dumps({"at_s": now_s, **asked}))
            if fault.at_s < now_s:
                return {"error": f"at_s = {fault.at_s:g} has passed; the run is at {now_s:g} s"}
            problems = target_problems(fault, self._vehicles)
            if problems:
                return {"error": "; ".join(f"{'.'.join(key)} {text}" for key, text in problems)}
            refuse_outages([fault], self._without)
            self._board.post(fault)
        except ValidationError as error:
            return {"error": explain_fault(error)}
        except (ValueError, TypeError, BadInput) as error:
            return {"error": str(error)}
        self.plan.refresh()
        return {"at_s": fault.at_s, "fault": fault.model_dump(mode="json")}

    def _close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _abstract(name: str) -> bytes:
    """Return the address of an abstract socket, which ends with its process and leaves no file."""
    return b"\0" + name.removeprefix("@").encode()


def _user_of(connection: socket.socket) -> int:
    """Return the user ID of the other end; an abstract socket has no permissions."""
    credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    return int(_CREDENTIALS.unpack(credentials)[1])


def explain_fault(error: ValidationError) -> str:
    """Return the problem of a fault as text."""
    texts = []
    for detail in error.errors(include_url=False):
        path = [str(part) for part in detail["loc"] if part not in kinds()]
        if detail["type"] in ("union_tag_invalid", "union_tag_not_found"):
            texts.append(f"no such kind of fault; allowed: {', '.join(kinds())}")
        else:
            texts.append(f"{'.'.join(path)}: {detail['msg']}")
    return "; ".join(texts)


def running() -> list[str]:
    """Return the names of this user's running benches: process number and log."""
    try:
        lines = Path("/proc/net/unix").read_text().splitlines()
    except OSError:
        return []
    names = {line.split()[-1] for line in lines}
    return sorted(name.removeprefix(_names()) for name in names if name.startswith(_names()))


def ask(run: str | None, request: dict[str, Any]) -> dict[str, Any]:
    """Inject a fault into a running bench and return its answer.

    Args:
        run: part of the name of the bench, as in `running`; None if there is only one.
        request: the fault; without `at_s` it begins at once.

    Raises:
        BadInput: no such bench, more than one, or it refuses the fault.
    """
    benches = [name for name in running() if run is None or run in name]
    if not benches:
        which = f"no running bench has {run!r} in its name" if run else "no bench of yours is running"
        raise BadInput(f"{which}; start one with: platoon run")
    if len(benches) > 1:
        raise BadInput(f"several benches are running; name one with --run: {', '.join(benches)}")
    (name,) = benches
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(_ANSWER_S)
        try:
            connection.connect(_abstract(_names() + name))
            connection.sendall(json.dumps(request).encode() + b"\n")
            answer: dict[str, Any] = json.loads(_line(connection) or b'{"error": "the run has ended"}')
        except OSError as error:
            raise BadInput(f"the bench {name} does not answer: {error}") from error
    if "error" in answer:
        raise BadInput(f"the bench {name} refuses the fault: {answer['error']}")
    return answer


def _line(connection: socket.socket) -> bytes:
    """Read one line, or the bytes before the other side closed."""
    data = b""
    while not data.endswith(b"\n") and len(data) < _MOST_BYTES:
        part = connection.recv(4096)
        if not part:
            break
        data += part
    return data
